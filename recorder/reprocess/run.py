"""A whole reprocessing run: record in, record of outputs out, and the comparison."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TypedDict, Unpack

import msgspec

from tramstream import config_file, keys, plugins
from tramstream.clock import S
from tramstream.config import MATCHER, Vehicle
from tramstream.errors import ConfigError, RecordError
from tramstream.live import registry
from tramstream.processor import Ordering, Processor, Smoothing
from tramstream.recorder import identity
from tramstream.recorder.file.writer import CHUNK_BYTES, RecordFile
from tramstream.recorder.reader import Record, open_record
from tramstream.recorder.reprocess import parallel
from tramstream.recorder.reprocess.clocks import check_one_clock
from tramstream.recorder.reprocess.compare import Comparison
from tramstream.recorder.reprocess.inputs import copy_inputs
from tramstream.recorder.reprocess.order import Output
from tramstream.recorder.reprocess.plan import Plan, read_plan
from tramstream.tracks import grades
from tramstream.tracks import network as networks


@dataclass
class Rerun:
    """What came out."""

    outputs: int
    smoothed: int
    """How many of them are a smoother's."""
    sessions: int
    duration_s: float
    missing: dict[str, int]
    undecodable: dict[str, int]
    """Per key path: messages that were left out, as the live processors left them out."""
    comparison: Comparison | None
    without_map: str = ""
    """Why the configured track network was not used."""
    forgotten: int = 0
    """Sessions that begin in the middle of a ride, with memory that was made with other settings:
    the processors began afresh there."""
    unfit: int = 0
    """The same, of other processors than ours or of another version of them."""
    damaged: str = ""
    """What of the record is damaged, one sentence; what could be proved right was reprocessed."""
    paused_s: float = 0.0
    """Pauses of the record, in which no time passed; not in `duration_s`."""
    changed: list[str] = field(default_factory=list)
    """Settings that are others than the record's own, one sentence each."""
    copied: int = 0
    """Messages that were taken over from the record."""

    @property
    def identical(self) -> bool:
        c = self.comparison
        return c is not None and c.compared > 0 and c.difference_count == 0 and not self.missing


def vehicle_of(record: Record, path: Path) -> Vehicle:
    """The configuration that a record was made with.

    Raises
    ------
    ConfigError
        If there is none in it, or this version does not understand it.
    """
    text = record.metadata.get(config_file.RECORD_ENTRY)
    if not text:
        raise ConfigError(f"{path}: holds no configuration; give one with --config")
    try:
        return _with_matcher(msgspec.json.decode(text, type=Vehicle), text)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(
            f"{path}: the configuration in the record does not fit this version ({error}); "
            "give one with --config"
        ) from error


def _with_matcher(vehicle: Vehicle, text: str) -> Vehicle:
    """Name the map matcher in a configuration of a version in which it was a part of the filter."""
    settings = msgspec.json.decode(text).get("map")
    if settings is None or "source" in settings or MATCHER in vehicle.processors:
        return vehicle
    return msgspec.structs.replace(vehicle, processors=(*vehicle.processors, MATCHER))


class Wishes(TypedDict, total=False):
    """How a record is reprocessed; nothing of it unless it is asked for."""

    check: bool
    """Compare with the outputs in the record."""
    fresh: bool
    """Begin with empty memory at the first message and use what came late."""
    smooth: bool
    """At the end, write also what smoothers say."""
    with_inputs: bool
    """Write also what the record has of inputs, fixes and truth."""


def rerun(
    source: Path, out: Path, config: Path | Vehicle | None, **wishes: Unpack[Wishes]
) -> Rerun:
    """Reprocess `source` into `out`; log times of what is made are its stamps.

    Parameters
    ----------
    config : Path, Vehicle or None
        Configuration to use instead of the record's own.
    wishes : Wishes

    Raises
    ------
    RecordError, ConfigError
    """
    fresh, smooth = wishes.get("fresh", False), wishes.get("smooth", False)
    with open_record(source) as record:
        vehicle = config_file.load(config) if isinstance(config, Path) else config
        vehicle = vehicle or vehicle_of(record, source)
        consumers = {registry.PROCESSORS, *plugins.names("processors")}
        plan = Plan() if fresh else read_plan(record, consumers)
        plan.settings = _settings(record, vehicle, config is not None)
        processors = _processors(vehicle, plan)
        shared = {registry.PROCESSORS: registry.joint(vehicle)}
        plan.settle(record, processors, {each: [each] for each in vehicle.running} | shared)
        plan.see_what_fits(processors)
        inputs = {key.path for processor in processors for key in processor.inputs}
        if not any(keys.split(topic)[1] in inputs for topic in record.channels):
            raise RecordError(f"{source}: holds no inputs of the processors; nothing to reprocess")
        if not plan.anchored:
            check_one_clock(record, inputs - {keys.SYNC_TICK.path})
        if smooth:
            _keep(processors)
        comparison = Comparison() if wishes.get("check") else None
        metadata = {
            config_file.RECORD_ENTRY: config_file.to_json(vehicle),
            "reprocessed_from": source.name,
            identity.ENTRY: identity.identity_of(record),
            grades.GRADES_ENTRY: grades.held_to(vehicle),
        }
        name = record.vehicle or vehicle.vehicle
        with RecordFile(out, name, metadata) as target:
            target.block_bytes = CHUNK_BYTES
            outputs, smoothed = _Writer(target, name, comparison), _Writer(target, name)
            takers = parallel.Takers(
                take=outputs.take,
                expect=comparison.expect if comparison is not None else None,
                smoothed=smoothed.take if smooth else None,
            )
            shortfall = parallel.run(record, processors, plan, takers)
            copied = copy_inputs(record, target, processors) if wishes.get("with_inputs") else 0
        if comparison is not None:
            comparison.close()
        return Rerun(
            outputs=outputs.count + smoothed.count,
            smoothed=smoothed.count,
            sessions=len(plan.sessions),
            duration_s=(record.end_ns - record.start_ns - shortfall.paused_ns) / S,
            missing=shortfall.missing,
            undecodable={
                keys.split(topic)[1] or topic: count
                for topic, count in shortfall.undecodable.items()
            },
            comparison=comparison,
            without_map=_without_map(vehicle),
            forgotten=plan.forgotten,
            unfit=len(plan.unfit),
            damaged=shortfall.damaged or record.damaged,
            paused_s=shortfall.paused_ns / S,
            changed=_changed(record, vehicle) if config is not None else [],
            copied=copied,
        )


def _settings(record: Record, vehicle: Vehicle, given: bool) -> frozenset[str]:
    """Digests with which memory in the record is that of processors made from `vehicle`."""
    known = config_file.digest(vehicle)
    text = record.metadata.get(config_file.RECORD_ENTRY, "")
    if given and (not text or config_file.digest(vehicle_of(record, record.paths[0])) != known):
        return frozenset([known])
    return frozenset([known, config_file.text_digest(text)])  # older versions took it of the whole


class _Writer:
    """Appends outputs to `target`; readers put each in its place by its log time, its stamp."""

    def __init__(
        self, target: RecordFile, vehicle: str, comparison: Comparison | None = None
    ) -> None:
        self._append, self._vehicle, self._comparison = target.append, vehicle, comparison
        self._topics: dict[str, str] = {}
        self.count = 0

    def take(self, session: int, log_ns: int, outputs: list[Output]) -> None:
        append, topics, comparison = self._append, self._topics, self._comparison
        self.count += len(outputs)
        for sample, payload in outputs:
            key = sample.key
            path = key.path
            topic = topics.get(path)
            if topic is None:
                topic = topics[path] = key.on(self._vehicle)
            stamp_ns = sample.stamp_ns if sample.stamp_ns > 0 else log_ns
            append(topic, key, payload, stamp_ns, stamp_ns, sample.sequence)
            if comparison is not None:
                comparison.make(session, path, sample.sequence, payload)


def _keep(processors: list[Processor]) -> None:
    """Tell those that can smooth to keep what it takes.

    Raises
    ------
    ConfigError
        If there is none, or the configured model cannot.
    """
    smoothers = [each for each in processors if isinstance(each, Smoothing)]
    for each in smoothers:
        each.keep()
    if not smoothers:
        raise ConfigError("no processor can smooth; leave out --smooth")


def _processors(vehicle: Vehicle, plan: Plan) -> list[Processor]:
    processors = registry.make_processors(vehicle)
    for processor in processors:
        if isinstance(processor, Ordering) and plan.anchored:
            processor.late_recorded = plan.late
    return processors


def _without_map(vehicle: Vehicle) -> str:
    """Why the configured track network is not used; processors go on without it."""
    if vehicle.map is None:
        return ""
    if MATCHER not in vehicle.processors:
        return f"$.processors: does not name {MATCHER}"
    try:
        networks.load(Path(vehicle.map.network))
    except ConfigError as error:
        return f"$.map.network: {error}"
    return ""


def _changed(record: Record, vehicle: Vehicle) -> list[str]:
    """How `vehicle` differs from the configuration that the record was made with, if it has one."""
    try:
        return config_file.differences(vehicle_of(record, record.paths[0]), vehicle)
    except ConfigError:
        return []
