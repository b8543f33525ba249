"""Many records: which are meant, one table whoever made it, and what has changed in a vehicle."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tramstream.analysis.fleet.changes import DAY_NS, states
from tramstream.analysis.fleet.outcome import Figure, Finding, Outcome
from tramstream.analysis.fleet.places import Place, places
from tramstream.analysis.fleet.table import Row, merged, read, rows_of, write
from tramstream.analysis.report.fleet_page import compose
from tramstream.cli.terminal.fleet import over
from tramstream.errors import ConfigError, DamagedRecordError, RecordError

STD = 0.0001


# Which rides --------------------------------------------------------------------------------------
def laid(folder: Path, *names: str) -> None:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"not empty")


def test_folders_and_globs_mean_each_ride_once_and_parts_of_a_boot_are_one(tmp_path: Path) -> None:
    laid(
        tmp_path,
        "a/tram-1_b7-0001_20260921T100000Z.mcap",
        "a/tram-1_b7-0002_20260921T100500Z.mcap",
        "a/tram-1_b8-0001_20260921T110000Z.mcap",
        "b/c/other.mcap",
        "b/c/notes.txt",
    )
    (tmp_path / "b/empty.mcap").touch()
    found = places([tmp_path, str(tmp_path / "b/*/*.mcap")])
    assert [(Path(each.name).name, len(each.paths)) for each in found] == [
        ("tram-1_b7", 2),
        ("tram-1_b8", 1),
        ("other.mcap", 1),
    ]


def test_name_that_means_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="means no record"):
        places([tmp_path / "*.mcap"])


# The loop -----------------------------------------------------------------------------------------
def looked_at(paths: list[Path], factor: float) -> Finding:
    """What stands for work on a ride: another process imports it from here."""
    text = paths[0].read_text()
    if text == "torn":
        raise DamagedRecordError(f"{paths[0].name}: torn")
    if text == "strange":
        raise RecordError(f"{paths[0].name}: is no record")
    value = math.sin(float(text)) * factor
    figures = (Figure(field="scale", value=value, std=STD, unit="1"),)
    return Finding("tram-1", int(text) * DAY_NS, 60.0, f"digest {text}", "", figures)


def test_table_is_the_same_to_the_bit_with_one_worker_and_with_two(tmp_path: Path) -> None:
    for number in (3, 1, 2):
        (tmp_path / f"{number}.mcap").write_text(str(number))
    (tmp_path / "4.mcap").write_text("torn")
    (tmp_path / "5.mcap").write_text("strange")
    rides = places([tmp_path])
    written = []
    for workers in (1, 2):
        outcomes = over(rides, looked_at, (2.0,), workers)
        assert [bool(each.refused) for each in outcomes] == [False, False, False, True, True]
        assert [each.damaged for each in outcomes] == [False, False, False, True, False]
        out = tmp_path / f"{workers}.parquet"
        write(merged([], rows_of("test", outcomes)), out)
        written.append(out.read_bytes())
    assert written[0] == written[1]
    assert [row.value for row in read(tmp_path / "1.parquet")] == [
        2.0 * math.sin(number) for number in (1, 2, 3)
    ]


def test_file_that_is_no_table_is_refused(tmp_path: Path) -> None:
    (tmp_path / "t.parquet").write_bytes(b"PAR1")
    with pytest.raises(ConfigError, match="cannot be read as a table"):
        read(tmp_path / "t.parquet")


# What has changed ---------------------------------------------------------------------------------
def row(day: int, value: float, digest: str = "", field: str = "scale") -> Row:
    return Row(
        vehicle="tram-1", verb="calibrate", start_ns=day * DAY_NS, digest=digest or f"d{day}",
        field=field, record=f"{day}.mcap", duration_s=60.0, value=value, std=STD, unit="1",
        verdict="",
    )  # fmt: skip


def test_ride_that_is_calibrated_again_replaces_what_was_found_of_it() -> None:
    before, again = row(1, 0.01), row(1, 0.02)
    assert merged([before, row(2, 0.01)], [again]) == [again, row(2, 0.01)]


def test_rides_that_agree_are_put_together_by_their_variance() -> None:
    (state,) = states([row(day, 0.01 + off * STD) for day, off in enumerate((-1, 1, 0.5, -0.5))])
    assert state.value == pytest.approx(0.01)
    assert state.std == pytest.approx(STD / 2)
    assert state.rides == 4
    assert math.isnan(state.changed_by)


def test_wheel_that_was_exchanged_is_dated_and_what_was_before_is_left_out() -> None:
    (state,) = states([row(day, 0.01 if day < 3 else 0.013) for day in range(6)])
    assert state.value == pytest.approx(0.013)
    assert state.rides == 3
    assert state.since_ns == 3 * DAY_NS
    assert state.changed_by == pytest.approx(0.003)


def test_wear_is_the_slope_over_the_rides_that_agree() -> None:
    worn = -2 * STD
    (state,) = states([row(day, 0.01 + worn * day / 100) for day in range(0, 101, 10)])
    assert state.per_100_days == pytest.approx(worn)
    assert state.per_100_days_std < abs(worn)


def test_page_has_vehicles_as_rows_with_what_has_changed_and_who_was_left_out() -> None:
    rows = [row(day, 0.01 if day < 3 else 0.013) for day in range(6)]
    page = compose("calibrate", rows, states(rows), [("torn.mcap", "it is torn")])
    assert "tram-1" in page
    assert "0.003" in page
    assert "it is torn" in page


def test_ride_without_figures_stands_in_the_table_with_its_verdict() -> None:
    finding = Finding("tram-1", 0, 5.0, "d", "too little motion")
    (one,) = rows_of("calibrate", [Outcome(Place("a.mcap", ()), finding)])
    assert (one.field, one.verdict) == ("", "too little motion")
    assert states([one]) == []
