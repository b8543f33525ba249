"""Where `tramstream evaluate` finds states, truth and fixes: in one record or in two."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from tramstream import keys
from tramstream.config import Vehicle
from tramstream.config_file import RECORD_ENTRY
from tramstream.errors import ConfigError, RecordError
from tramstream.estimation.series import FixSeries, GradeSeries, StateSeries, TruthSeries
from tramstream.keys import Key
from tramstream.recorder.columns import read_ride
from tramstream.recorder.reader import Record, open_record
from tramstream.recorder.reprocess.run import vehicle_of

REPROCESSED_FROM = "reprocessed_from"
"""Entry of a record's metadata, see `tramstream.recorder.reprocess.run`."""


@dataclass(frozen=True)
class Gathered:
    """What there is to judge, and by what."""

    states: dict[str, StateSeries]
    """By key path, the wanted one first."""
    truth: TruthSeries
    truth_name: str
    """Key, and file if it is another."""
    fixes: FixSeries | None
    vehicle: Vehicle | None
    origin_ns: int
    """The first arrival in the record of the states."""
    damaged: str
    left_out: str
    """One sentence about messages that could not be decoded, empty without any."""
    grade: GradeSeries | None = None
    """What `est/grade/state` says; None where it is not there."""


def gather(file: Path, truth: str, estimate: str, say: Callable[[str], None]) -> Gathered:
    """Read what `evaluate FILE --truth --estimate` means; `say` tells people where it looks.

    Raises
    ------
    RecordError
        If there is no estimate or no truth.
    ConfigError
        If an option names neither a file nor a key.
    """
    truth_key, truth_file = truth_meant(truth)
    wanted = wanted_keys(estimate)
    with ExitStack() as stack:
        record = stack.enter_context(open_record(file))
        demand(record, wanted[0], keys.EST_STATE, _estimate_cure(record))
        source = record
        if truth_file is not None:
            source = stack.enter_context(open_record(truth_file))
        elif not holds(record, truth_key):
            source = stack.enter_context(reprocessed_from(record, truth_key, say))
        demand(
            source,
            truth_key,
            keys.TRUTH_STATE,
            "name the record that does with --truth FILE; simulated rides have it",
        )
        return gathered(record, source, wanted, truth_key, say)


def wanted_keys(estimate: str) -> list[str]:
    """Key paths that `estimate` means: the one judged, and the smoother's beside the filter's."""
    wanted = [keys.split(estimate)[1] or estimate or keys.EST_STATE.path]
    if wanted[0] == keys.EST_STATE.path:
        wanted.append(keys.EST_SMOOTHED.path)
    return wanted


def gathered(
    record: Record, source: Record, wanted: list[str], truth_key: str, say: Callable[[str], None]
) -> Gathered:
    """Read estimates of `record` and the truth of `source`, which may be the same.

    Raises
    ------
    RecordError
        If nothing of an estimate or of the truth can be read; see `demand`.
    """
    same = source is record
    slope = keys.EST_GRADE.path
    of_truth = read_ride(
        source, wanted if same else (), truth_key, fixes=True, grade=slope if same else ""
    )
    ride = of_truth
    if not same:
        need_fixes = of_truth.fixes is None
        ride = read_ride(record, wanted, fixes=need_fixes, level=of_truth.level, grade=slope)
    if of_truth.truth is None or wanted[0] not in ride.states:
        raise RecordError(f"{record.paths[0]}: nothing of its estimate or truth can be read")
    return Gathered(
        states=ride.states,
        truth=of_truth.truth,
        truth_name=truth_key if same else f"{truth_key} of {source.paths[0]}",
        fixes=of_truth.fixes if of_truth.fixes is not None else ride.fixes,
        vehicle=vehicle_in(record, say) or vehicle_in(source, say),
        origin_ns=record.start_ns,
        damaged=record.damaged or source.damaged,
        left_out=record.left_out or source.left_out,
        grade=ride.grade,
    )


def _estimate_cure(record: Record) -> str:
    """What to do without the estimate asked for."""
    others = estimates_in(record)
    if others:
        return f"choose with --estimate: {', '.join(others)}"
    return f"`tramstream reprocess {record.paths[0]} -o OUT` makes it"


def estimates_in(record: Record) -> list[str]:
    """Key paths that hold what can be judged."""
    name = keys.EST_STATE.type.DESCRIPTOR.full_name
    return [
        keys.split(topic)[1]
        for topic, info in record.channels.items()
        if info.schema == name and info.count
    ]


def truth_meant(text: str) -> tuple[str, Path | None]:
    """Key and file that `--truth` names."""
    if not text:
        return keys.TRUTH_STATE.path, None
    if Path(text).exists():
        return keys.TRUTH_STATE.path, Path(text)
    path = keys.split(text)[1] or text
    if keys.find(path) is not None:
        return path, None
    raise ConfigError(
        f"--truth {text}: no such file and no key; the truth's key is {keys.TRUTH_STATE.path}"
    )


def _topic(record: Record, path: str) -> str | None:
    """The topic of `path` that has messages."""
    topics = (topic for topic, info in record.channels.items() if info.count)
    return next((topic for topic in topics if keys.split(topic)[1] == path), None)


def holds(record: Record, path: str) -> bool:
    return _topic(record, path) is not None


def demand(record: Record, path: str, like: Key, cure: str) -> None:
    """Refuse a record that has no messages of the type of `like` on `path`.

    Raises
    ------
    RecordError
    """
    topic, name = _topic(record, path), like.type.DESCRIPTOR.full_name
    if topic is None:
        raise RecordError(f"{record.paths[0]}: holds no {path}; {cure}")
    if record.type_of(topic) != name:
        raise RecordError(
            f"{record.paths[0]}: {path} holds {record.type_of(topic)}, not {name}; try {like.path}"
        )


def source_of(record: Record) -> Path | None:
    """The record that `record` was reprocessed from, where it still lies beside it."""
    name = record.metadata.get(REPROCESSED_FROM, "")
    beside = record.paths[0].with_name(name) if name else None
    return beside if beside is not None and beside.exists() else None


@contextmanager
def reprocessed_from(
    record: Record, truth_key: str, say: Callable[[str], None]
) -> Iterator[Record]:
    """The record beside this one whose reprocessing it is, or itself where there is none."""
    name = record.metadata.get(REPROCESSED_FROM, "")
    beside = source_of(record)
    if beside is None:
        if name:
            raise RecordError(
                f"{record.paths[0]}: holds no {truth_key}, and {name}, of which it was made, is "
                f"not beside it; name it with --truth FILE"
            )
        yield record
        return
    say(f"truth from {beside}, of which {record.paths[0].name} was made")
    with open_record(beside) as source:
        yield source


def vehicle_in(record: Record, say: Callable[[str], None]) -> Vehicle | None:
    """The configuration in a record; None without one, or one of another version."""
    if not record.metadata.get(RECORD_ENTRY):
        return None
    try:
        return vehicle_of(record, record.paths[0])
    except ConfigError as error:
        say(f"{error}; going on without the antenna's lever arm and the claimed risk")
        return None
