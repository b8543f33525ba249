"""A whole reprocessing run: record in, record of outputs out, and the comparison."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec

from tramstream import config as configs
from tramstream import registry
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.errors import ConfigError, RecordError
from tramstream.processor import Ordering, Processor, Smoothing
from tramstream.recorder import apart
from tramstream.recorder.compare import Comparison
from tramstream.recorder.reader import Record, open_record
from tramstream.recorder.reprocess import Output, Plan, Take, read_plan
from tramstream.recorder.writer import CHUNK_BYTES, RecordFile


@dataclass
class Rerun:
    """What came out."""

    outputs: int
    smoothed: int
    """How many of them are a smoother's."""
    sessions: int
    duration_s: float
    missing: dict[str, int]
    comparison: Comparison | None

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
    text = record.metadata.get(configs.RECORD_ENTRY)
    if not text:
        raise ConfigError(f"{path}: holds no configuration; give one with --config")
    try:
        return msgspec.json.decode(text, type=Vehicle)
    except msgspec.ValidationError as error:
        raise ConfigError(
            f"{path}: the configuration in the record does not fit this version ({error}); "
            "give one with --config"
        ) from error


def rerun(
    source: Path,
    out: Path,
    config: Path | None,
    check: bool = False,
    fresh: bool = False,
    smooth: bool = False,
) -> Rerun:
    """Reprocess `source` into `out`.

    Parameters
    ----------
    config : Path or None
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
        vehicle = configs.load(config) if config is not None else vehicle_of(record, source)
        consumers = {registry.PROCESSORS, *registry.names("processors")}
        plan = Plan() if fresh else read_plan(record, consumers)
        processors = _processors(vehicle, plan)
        if not any(_has(record, processor) for processor in processors):
            raise RecordError(f"{source}: holds no inputs of the processors; nothing to reprocess")
        smoothers = _smoothers(processors) if smooth else []
        comparison = Comparison() if check else None
        metadata = {
            configs.RECORD_ENTRY: configs.to_json(vehicle),
            "reprocessed_from": source.name,
        }
        name = record.vehicle or vehicle.vehicle
        with RecordFile(out, name, metadata) as target:
            target.block_bytes = CHUNK_BYTES
            take = _writer(target, name, comparison)
            expect = comparison.expect if comparison is not None else None
            missing = apart.run(record, processors, plan, take, expect)
            count = target.message_count
            for smoother in smoothers:
                _write_smoothed(target, name, smoother)
            outputs = target.message_count
        if comparison is not None:
            comparison.close()
        return Rerun(
            outputs=outputs,
            smoothed=outputs - count,
            sessions=len(plan.sessions),
            duration_s=(record.end_ns - record.start_ns) / S,
            missing=missing,
            comparison=comparison,
        )


def _writer(target: RecordFile, vehicle: str, comparison: Comparison | None) -> Take:
    """Appends outputs to `target` and hands them to `comparison`."""
    append = target.append
    topics: dict[str, str] = {}

    def take(session: int, log_ns: int, outputs: list[Output]) -> None:
        for sample, payload in outputs:
            key = sample.key
            topic = topics.get(key.path)
            if topic is None:
                topic = topics[key.path] = key.on(vehicle)
            append(topic, key, payload, log_ns, log_ns, sample.sequence)
            if comparison is not None:
                comparison.make(session, key.path, sample.sequence, payload)

    return take


def _smoothers(processors: list[Processor]) -> list[Smoothing]:
    """Those that can smooth, told to keep what it takes.

    Raises
    ------
    ConfigError
        If there is none, or the configured model cannot.
    """
    smoothers: list[Smoothing] = [each for each in processors if isinstance(each, Smoothing)]
    for each in smoothers:
        each.keep()
    if not smoothers:
        raise ConfigError("no processor can smooth; leave out --smooth")
    return smoothers


def _write_smoothed(target: RecordFile, vehicle: str, smoother: Smoothing) -> None:
    """Append what a smoother says; readers put it in its place by its log time."""
    for sample in smoother.smoothed():
        payload = sample.message.SerializeToString()
        stamp_ns = sample.stamp_ns
        topic = sample.key.on(vehicle)
        target.append(topic, sample.key, payload, stamp_ns, stamp_ns, sample.sequence)


def _processors(vehicle: Vehicle, plan: Plan) -> list[Processor]:
    processors = registry.make_processors(vehicle)
    for processor in processors:
        if isinstance(processor, Ordering) and plan.anchored:
            processor.late_recorded = plan.late
    return processors


def _has(record: Record, processor: Processor) -> bool:
    paths = {key.path for key in processor.inputs}
    return any(topic.split("/", 2)[-1] in paths for topic in record.channels)
