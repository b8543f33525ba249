"""A whole reprocessing run: record in, record of outputs out, and the comparison."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec

from tramstream import config_file, keys, plugins
from tramstream.clock import S
from tramstream.config import MATCHER, Vehicle
from tramstream.errors import ConfigError, RecordError
from tramstream.live import registry
from tramstream.processor import Ordering, Processor, Smoothing
from tramstream.recorder.file.writer import CHUNK_BYTES, RecordFile
from tramstream.recorder.reader import Record, open_record
from tramstream.recorder.reprocess import parallel
from tramstream.recorder.reprocess.compare import Comparison
from tramstream.recorder.reprocess.order import Output
from tramstream.recorder.reprocess.plan import Plan, read_plan
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


def rerun(
    source: Path,
    out: Path,
    config: Path | Vehicle | None,
    check: bool = False,
    fresh: bool = False,
    smooth: bool = False,
) -> Rerun:
    """Reprocess `source` into `out`.

    Parameters
    ----------
    config : Path, Vehicle or None
        Configuration to use instead of the record's own.
    check : bool
        Compare with the outputs in the record.
    fresh : bool
        Begin with empty memory at the first message and use what came late.
    smooth : bool
        At the end, write also what smoothers say; log times of that are its stamps.

    Raises
    ------
    RecordError, ConfigError
    """
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
        if not any(_has(record, processor) for processor in processors):
            raise RecordError(f"{source}: holds no inputs of the processors; nothing to reprocess")
        if smooth:
            _keep(processors)
        comparison = Comparison() if check else None
        metadata = {
            config_file.RECORD_ENTRY: config_file.to_json(vehicle),
            "reprocessed_from": source.name,
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
        if comparison is not None:
            comparison.close()
        return Rerun(
            outputs=outputs.count + smoothed.count,
            smoothed=smoothed.count,
            sessions=len(plan.sessions),
            duration_s=(record.end_ns - record.start_ns) / S,
            missing=shortfall.missing,
            undecodable={
                keys.split(topic)[1] or topic: count
                for topic, count in shortfall.undecodable.items()
            },
            comparison=comparison,
            without_map=_without_map(vehicle),
            forgotten=plan.forgotten,
            unfit=len(plan.unfit),
        )


def _settings(record: Record, vehicle: Vehicle, given: bool) -> frozenset[str]:
    """Digests with which memory in the record is that of processors made from `vehicle`."""
    known = config_file.digest(vehicle)
    text = record.metadata.get(config_file.RECORD_ENTRY, "")
    if given and (not text or config_file.digest(vehicle_of(record, record.paths[0])) != known):
        return frozenset([known])
    return frozenset([known, config_file.text_digest(text)])  # older versions took it of the whole


class _Writer:
    """Appends outputs to `target`; readers put each in its place by its log time."""

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
            append(topic, key, payload, log_ns, log_ns, sample.sequence)
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


def _has(record: Record, processor: Processor) -> bool:
    paths = {key.path for key in processor.inputs}
    return any(topic.split("/", 2)[-1] in paths for topic in record.channels)
