"""Where a report finds its series: in one record, or in outputs, their source and a truth."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from tramstream import keys
from tramstream.analysis.evaluate.source import demand, holds, source_of, truth_meant, vehicle_in
from tramstream.analysis.report.material import Material, read_material
from tramstream.errors import RecordError
from tramstream.recorder.columns import RideSeries, read_ride
from tramstream.recorder.reader import Record, open_record


def collect(file: Path, truth: str, estimate: str, say: Callable[[str], None]) -> Material:
    """Read what `report FILE --truth --estimate` means; what is absent stays out.

    Raises
    ------
    RecordError
        If there is no message, or not what an option names.
    ConfigError
        If `truth` names neither a file nor a key.
    """
    truth_key, truth_file = truth_meant(truth)
    wanted = keys.split(estimate)[1] or estimate or keys.EST_STATE.path
    with ExitStack() as stack:
        record = stack.enter_context(open_record(file))
        if not record.message_count:
            raise RecordError(f"{file}: holds no message; there is nothing to draw")
        if estimate:
            demand(record, wanted, keys.EST_STATE, "see `tramstream info`")
        beside = source_of(record)
        source = stack.enter_context(open_record(beside)) if beside is not None else None
        records = [record] if source is None else [record, source]
        if truth_file is not None:
            records.append(stack.enter_context(open_record(truth_file)))
        if truth:
            demand(records[-1], truth_key, keys.TRUTH_STATE, "see `tramstream info`")
        ride = _ride(records, wanted, truth_key)
        vehicle = next((found for each in records if (found := vehicle_in(each, say))), None)
        return read_material(record, source, ride, vehicle, wanted)


def _ride(records: list[Record], estimate: str, truth_key: str) -> RideSeries:
    """States of the first record, truth of the last that has it, fixes of the first that has."""
    states = list(dict.fromkeys((estimate, keys.EST_SMOOTHED.path)))
    of_truth = next((each for each in reversed(records) if holds(each, truth_key)), None)
    of_fixes = next((each for each in records if holds(each, keys.GNSS_FIX.path)), None)
    level, found = None, RideSeries(None, {}, None, None)
    # The truth first: all positions are drawn in its local level frame.
    order = sorted(records, key=lambda each: each is not of_truth)
    for record in order:
        ride = read_ride(
            record,
            states if record is records[0] else (),
            truth_key if record is of_truth else "",
            fixes=record is of_fixes,
            level=level,
            grade=keys.EST_GRADE.path if record is records[0] else "",
        )
        level = level or ride.level
        found = RideSeries(
            level,
            found.states | ride.states,
            found.truth or ride.truth,
            found.fixes or ride.fixes,
            found.grade or ride.grade,
        )
    return found
