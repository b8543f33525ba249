"""Thinning of series: every extreme stays, in order, within the limit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tramstream.analysis.report.decimation import extremes

numbers = st.floats(-1e6, 1e6) | st.just(np.nan)


@st.composite
def tables(draw) -> np.ndarray:
    width = draw(st.integers(1, 3))
    seed = draw(st.integers(0, 1 << 32))
    count = draw(st.integers(1, 2000))
    table = np.random.default_rng(seed).normal(size=(count, width)).cumsum(axis=0)
    for _ in range(draw(st.integers(0, 6))):
        row, column = draw(st.integers(0, count - 1)), draw(st.integers(0, width - 1))
        table[row, column] = draw(numbers)
    return table


@given(tables(), st.integers(11, 300))
def test_extremes_of_every_column_stay(table, limit):
    rows = extremes(table, limit)
    assert len(rows) <= limit
    assert (np.diff(rows) > 0).all()
    assert rows[0] == 0
    assert rows[-1] == len(table) - 1
    for column in table.T:
        if np.isfinite(column).any():
            assert np.nanmax(column[rows]) == np.nanmax(column)
            assert np.nanmin(column[rows]) == np.nanmin(column)
        assert np.isnan(column[rows]).any() == np.isnan(column).any()


@given(tables(), st.integers(11, 300))
def test_what_is_left_out_lies_between_neighbours_that_stay(table, limit):
    rows = extremes(table, limit)
    length = -(-len(table) // ((limit - 2) // (3 * table.shape[1])))
    for row in np.setdiff1d(np.arange(len(table)), rows):
        near = table[rows[np.abs(rows - row) < length]]
        for value, column in zip(table[row], near.T, strict=True):
            if np.isfinite(value):
                assert np.nanmin(column) <= value <= np.nanmax(column)


def test_short_series_stays_whole():
    assert extremes([3.0, 1.0, 2.0], 5).tolist() == [0, 1, 2]


def test_spike_of_one_sample_stays():
    series = np.zeros(100_000)
    series[54_321] = 1.0
    rows = extremes(series, 100)
    assert 54_321 in rows
    assert len(rows) <= 100


def test_limit_too_small_for_the_columns_is_refused():
    with pytest.raises(ValueError, match="limit 5: 2 columns need 6"):
        extremes(np.zeros((100, 2)), 5)
