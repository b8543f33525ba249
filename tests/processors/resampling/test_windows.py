"""Windows of inertial samples: truth from numpy, ramps and sines."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streams import PERIOD_NS, batch, batches, noise, stamp_of

from tramstream.clock import S
from tramstream.live.snapshots import pack, unpack
from tramstream.memory.stage import assign, from_plain, to_plain
from tramstream.processors.resampling.windows import (
    Window,
    Windows,
    WindowsMemory,
    lowpass_taps,
    mean_taps,
)

RATE_HZ = 2000.0
CUTOFF_HZ = 16.0
DB_STOP = -50.0
COUNT = 1e-9
"""Rounding of a weighted sum of counts."""


def taps_of(method: str, factor: int = 20) -> np.ndarray:
    return mean_taps(factor) if method == "mean" else lowpass_taps(factor, RATE_HZ, CUTOFF_HZ)


def run(windows: Windows, samples: list) -> list[Window]:
    result = []
    for index, sample in enumerate(samples):
        windows.extend(sample.message) if index else windows.begin(sample.message)
        result += windows.complete()
    return result


def test_mean_equals_numpy_mean_of_each_window() -> None:
    counts = noise(400)
    found = run(Windows(20, mean_taps(20)), batches(counts))
    expected = counts.reshape(6, 20, 20).mean(axis=2).T
    assert len(found) == 20
    np.testing.assert_allclose([window.counts for window in found], expected, atol=COUNT)


@pytest.mark.parametrize("method", ["mean", "lowpass"])
def test_scatter_is_numpys_of_the_samples_that_a_window_is_centred_on(method: str) -> None:
    counts = noise(2000) + 30_000_000  # large counts keep their digits
    found = run(Windows(20, taps_of(method)), batches(counts))
    firsts = [window.first_sequence for window in found]
    expected = [np.std(counts[:, first : first + 20], axis=1, ddof=1) for first in firsts]
    assert len(found) > 50
    np.testing.assert_allclose([window.scatter for window in found], expected, rtol=1e-9)


def test_single_sample_and_equal_ones_do_not_scatter() -> None:
    for factor, counts in ((1, noise(40)), (20, np.tile(np.full(400, 7), (6, 1)))):
        for window in run(Windows(factor, mean_taps(factor)), batches(counts)):
            assert window.scatter == (0.0,) * 6


@pytest.mark.parametrize("method", ["mean", "lowpass"])
@pytest.mark.parametrize("factor", [1, 19, 20])
def test_stamp_is_the_centre_of_the_window(method: str, factor: int) -> None:
    for window in run(Windows(factor, taps_of(method, factor)), batches(noise(2000))):
        first = stamp_of(window.first_sequence)
        assert window.first_sequence % factor == 0
        assert window.stamp_ns == first + (factor - 1) * PERIOD_NS // 2
        assert window.interval_ns == pytest.approx(factor * PERIOD_NS)


@pytest.mark.parametrize("method", ["mean", "lowpass"])
def test_ramp_has_its_value_at_the_stamp(method: str) -> None:
    ramp = np.tile(np.arange(3000), (6, 1)) * np.arange(1, 7)[:, np.newaxis]
    found = run(Windows(20, taps_of(method)), batches(ramp))
    assert len(found) > 100
    for window in found:
        at = (window.stamp_ns - stamp_of(0)) / PERIOD_NS
        np.testing.assert_allclose(window.counts, at * np.arange(1, 7), rtol=1e-9)


@pytest.mark.parametrize("factor", [1, 2, 7, 19, 20, 64])
def test_lowpass_taps_are_symmetric_with_unit_gain(factor: int) -> None:
    taps = lowpass_taps(factor, RATE_HZ, CUTOFF_HZ * 15 / factor)
    np.testing.assert_allclose(taps, taps[::-1], atol=1e-15)
    assert taps.sum() == pytest.approx(1.0)
    assert (len(taps) - factor) % 2 == 0


def gain(windows: Windows, frequency_hz: float) -> float:
    """Greatest output for a sine of amplitude 1e6 counts, over that amplitude."""
    time = np.arange(16_000) / RATE_HZ
    sine = np.round(1e6 * np.sin(2 * np.pi * frequency_hz * time + 0.3)).astype(int)
    found = run(windows, batches(np.tile(sine, (6, 1))))
    return float(np.abs([window.counts[0] for window in found]).max() / 1e6)


def test_lowpass_lets_five_hertz_pass() -> None:
    assert gain(Windows(20, taps_of("lowpass")), 5.0) == pytest.approx(1.0, abs=0.01)


def test_lowpass_halves_the_cut_off() -> None:
    assert gain(Windows(20, taps_of("lowpass")), CUTOFF_HZ) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("frequency_hz", [51.3, 63.7, 84.1, 95.2, 101.7, 213.3, 480.9, 951.3])
def test_lowpass_stops_what_would_fold(frequency_hz: float) -> None:
    assert 20 * np.log10(gain(Windows(20, taps_of("lowpass")), frequency_hz)) < DB_STOP


def test_taps_that_share_no_centre_with_the_window_are_refused() -> None:
    with pytest.raises(ValueError, match="21 taps"):
        Windows(20, np.full(21, 1 / 21))
    with pytest.raises(ValueError, match="18 taps"):
        Windows(20, np.full(18, 1 / 18))


@pytest.mark.parametrize("method", ["mean", "lowpass"])
@settings(max_examples=25)
@given(sizes=st.lists(st.integers(1, 97), max_size=40), first=st.integers(0, 10**9))
def test_any_cut_into_batches_gives_the_same_windows(
    method: str, sizes: list[int], first: int
) -> None:
    counts = noise(1200)
    whole = run(Windows(20, taps_of(method)), batches(counts, [], first))
    assert run(Windows(20, taps_of(method)), batches(counts, sizes, first)) == whole


@pytest.mark.parametrize("method", ["mean", "lowpass"])
@settings(max_examples=25)
@given(cut=st.integers(0, 24))
def test_restored_windows_go_on_with_the_same_bits(method: str, cut: int) -> None:
    samples = batches(noise(1000), [40] * 25, first=3)
    whole = run(Windows(20, taps_of(method)), samples)
    before, after = Windows(20, taps_of(method)), Windows(20, taps_of(method))
    found = run(before, samples[: cut + 1])
    state = pack(to_plain(before.memory))
    run(before, samples)  # whatever it does now is no business of the copy
    assign(after.memory, from_plain(WindowsMemory, unpack(state)))
    assert pack(to_plain(after.memory)) == state
    for sample in samples[cut + 1 :]:
        after.extend(sample.message)
        found += after.complete()
    assert found == whole


def test_bridge_is_the_straight_line_and_is_marked() -> None:
    ramp = np.tile(np.arange(60), (6, 1))
    windows = Windows(20, mean_taps(20))
    windows.begin(batch(ramp[:, :25], stamp_of(0), 0).message)
    windows.complete()
    late = batch(ramp[:, 35:], stamp_of(35), 35).message
    windows.bridge(late)
    windows.extend(late)
    second, third = windows.complete()
    assert (second.sample_count, second.bridged_count) == (10, 10)
    assert (third.sample_count, third.bridged_count) == (20, 0)
    np.testing.assert_allclose(second.counts, 29.5, atol=COUNT)
    np.testing.assert_allclose(third.counts, 49.5, atol=COUNT)


def test_longest_run_gives_the_windows_of_its_pieces() -> None:
    """Far more samples than a block has room for, in one batch and in many."""
    counts = noise(20_000)
    whole = run(Windows(20, taps_of("mean")), [batch(counts, stamp_of(0), 0)])
    assert len(whole) == 1000
    assert run(Windows(20, taps_of("mean")), batches(counts)) == whole


def test_counts_of_the_whole_range_are_read() -> None:
    edges = np.array([-(2**31), 2**31 - 1, -1, 0, 1, 63, -64, 64, -65, 8191, -8192, 8192])
    (window,) = run(Windows(12, np.arange(1.0, 13.0)), [batch(np.tile(edges, (6, 1)), S, 0)])
    assert window.counts == (float(np.arange(1, 13) @ edges),) * 6


def test_columns_of_different_length_are_refused() -> None:
    message = batch(noise(20), S, 0).message
    message.accel_y.append(5)
    with pytest.raises(ValueError, match="differ in length"):
        Windows(20, taps_of("mean")).begin(message)
    del message.accel_y[:]
    with pytest.raises(ValueError, match="differ in length"):
        Windows(20, taps_of("mean")).begin(message)
