"""Rows of the strips: rings of fixed size, and what becomes of several rows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tramstream.web.columns import COLUMNS, FAST_ROWS, SLOW_ROWS, History, condensed


def row(t_s: float, **values: float) -> list[float]:
    known = {"t_s": t_s, **values}
    return [known.get(name, math.nan) for name in COLUMNS]


def column(part: list[list[float | None]], name: str) -> list[float | None]:
    return part[COLUMNS.index(name)]


def test_the_last_minute_and_the_last_hour_are_kept_and_no_more() -> None:
    history = History()
    for tenth in range(10 * (SLOW_ROWS + 100)):
        history.add(row(1e9 + tenth / 10, speed_mps=tenth / 10))
    found = history.as_dict()
    times = column(found["minute"], "t_s")
    assert len(times) == FAST_ROWS
    assert times[-1] - times[0] == pytest.approx(59.9)
    speeds = column(found["hour"], "speed_mps")
    assert len(speeds) == SLOW_ROWS
    assert speeds[-1] == pytest.approx(
        SLOW_ROWS + 98.9
    )  # the last whole second, as it was at its end
    np.testing.assert_allclose(np.diff(speeds), 1.0)


def test_a_row_that_is_no_later_is_left_out_and_a_record_that_begins_again_begins_anew() -> None:
    history = History()
    for t_s in (100.0, 100.1, 100.1, 100.05, 100.2):
        history.add(row(t_s))
    assert column(history.as_dict()["minute"], "t_s") == [100.0, 100.1, 100.2]
    history.add(row(50.0))
    assert column(history.as_dict()["minute"], "t_s") == [50.0]


def test_of_several_rows_counts_add_up_innovations_keep_the_largest_and_the_rest_the_last() -> None:
    rows = [
        row(1.0, speed_mps=3.0, refused=1, gnss_innovation=-4.0),
        row(1.1, speed_mps=4.0, refused=2, gnss_innovation=3.0),
        row(1.2, refused=0),
    ]
    found = dict(zip(COLUMNS, condensed(rows), strict=True))
    assert (found["t_s"], found["speed_mps"], found["refused"]) == (1.2, 4.0, 3)
    assert found["gnss_innovation"] == -4.0
    assert math.isnan(found["wheel_speed_mps"])


def test_what_is_not_known_is_none() -> None:
    history = History()
    history.add(row(1.0, speed_mps=math.inf))
    minute = history.as_dict()["minute"]
    assert column(minute, "speed_mps") == [None]
    assert column(minute, "grade_percent") == [None]
