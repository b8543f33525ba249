"""Decimation of inertial samples: windows of a run without a gap, weighted by fixed taps.

The mean of kaspar2023 and the decimating low-pass of pusman2017 are the same thing with other taps.
Window k is centred on device samples k·factor … k·factor + factor − 1, its *core*; symmetric taps
make its stamp the core's centre, so no group delay is left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.processor import State
from tramstream.proto.raw_pb2 import ImuBatch

Array = NDArray[np.float64]

CHANNELS = 6
"""gyro x y z, accelerometer x y z: the rows of all columns here."""


class Window(NamedTuple):
    """One decimated value."""

    stamp_ns: int
    first_sequence: int
    sample_count: int
    bridged_count: int
    interval_ns: float
    counts: list[float]
    """gyro x y z, accelerometer x y z, in counts."""


def mean_taps(factor: int) -> Array:
    """Equal weights over one window (kaspar2023)."""
    return np.full(factor, 1.0 / factor)


def lowpass_taps(factor: int, rate_hz: float, cutoff_hz: float) -> Array:
    """Hamming-windowed sinc, unit gain at 0 Hz, of `factor`'s parity (pusman2017: cut-off 16 Hz).

    At the cut-off, which lies below half the output rate, the gain is one half. The transition is
    centred on it: the pass band is flat up to half the cut-off, and the stop band (−53 dB) begins
    before half the output rate, beyond which everything folds. Its width is 3.3 / length · rate
    (Oppenheim and Schafer, Discrete-Time Signal Processing, 3rd ed., table 7.2).
    """
    transition_hz = min(cutoff_hz, rate_hz / factor - 2.0 * cutoff_hz)
    half = max(factor, int(np.ceil(3.3 * rate_hz / transition_hz / 2.0)))
    length = 2 * half + factor % 2
    time = np.arange(length) - (length - 1) / 2.0
    taps = np.sinc(2.0 * cutoff_hz / rate_hz * time) * np.hamming(length)
    normalised: Array = taps / taps.sum()
    return normalised


class Windows:
    """Collects batches of one run of samples and gives the windows that are complete.

    Parameters
    ----------
    factor : int
        Device samples from one window to the next.
    taps : ndarray, shape (L,)
        Symmetric weights, at least `factor` of them and of its parity.
    """

    def __init__(self, factor: int, taps: Array) -> None:
        if len(taps) < factor or (len(taps) - factor) % 2:
            raise ValueError(f"{len(taps)} taps cannot be centred on windows of {factor} samples")
        self.factor = factor
        self.taps = taps
        self.lead = (len(taps) - factor) // 2
        self._columns = np.empty((CHANNELS, 0))
        self._stamps = np.empty(0)  # ns after _base_ns
        self._base_ns = 0  # the run's first stamp
        self._first = 0  # device sequence of column 0
        self._next_window = 0
        self._bridges: list[tuple[int, int]] = []  # invented samples: first sequence, and one after
        self._last = np.empty((CHANNELS, 0))  # newest sample: a gap is bridged from it
        self._last_ns = 0.0  # after _base_ns
        self._period_ns = 0.0

    @property
    def empty(self) -> bool:
        """Whether no run has begun."""
        return self._last.shape[1] == 0

    @property
    def next_sequence(self) -> int:
        """Device sequence that would continue the run."""
        return self._first + self._columns.shape[1]

    @property
    def last_stamp_ns(self) -> int:
        return self._base_ns + int(self._last_ns)

    @property
    def pending(self) -> int:
        """Real samples that no window has been centred on yet."""
        start, stop = self._consumed, self.next_sequence
        return max(0, stop - start) - self._bridged(start, stop)

    @property
    def _consumed(self) -> int:
        """First device sequence whose window is still to come."""
        return self._next_window * self.factor

    def begin(self, batch: ImuBatch) -> int:
        """Start a run and forget the one before, whose `pending` nobody gets any more.

        Returns
        -------
        int
            How many samples of the batch no window will be centred on, as in `extend`.
        """
        self._columns, self._stamps = np.empty((CHANNELS, 0)), np.empty(0)
        self._bridges = []
        self._base_ns = batch.stamp_ns
        self._first = batch.first_sample_sequence
        self._next_window = -(-(self._first + self.lead) // self.factor)  # first that lies in it
        return self.extend(batch)

    def bridge(self, batch: ImuBatch) -> None:
        """Interpolate from the newest sample to the first of `batch`, marked as invented."""
        first = self.next_sequence
        missing = batch.first_sample_sequence - first
        weights: Array = np.arange(1, missing + 1) / (missing + 1)
        rise = _columns(batch)[:, :1] - self._last
        start_ns = self._last_ns
        span_ns = batch.stamp_ns - self._base_ns - start_ns
        self._append(self._last + rise * weights, start_ns + span_ns * weights)
        self._bridges.append((first, first + missing))

    def extend(self, batch: ImuBatch) -> int:
        """Append a batch that continues the run.

        Returns
        -------
        int
            How many of its samples no window will be centred on: they come before the first.
        """
        columns = _columns(batch)
        count = len(batch.gyro_x)
        self._period_ns = batch.period_ns
        numbers = np.arange(count, dtype=np.float64)
        stamps = numbers * self._period_ns + (batch.stamp_ns - self._base_ns)
        self._append(columns, stamps)
        self._last, self._last_ns = columns[:, -1:], float(stamps[-1])
        return min(count, max(0, self._consumed - batch.first_sample_sequence))

    def complete(self) -> list[Window]:
        """Windows that lie wholly in what has come; what they no longer need is dropped."""
        windows = []
        size = len(self.taps)
        available = self._columns.shape[1]
        start = self._consumed - self.lead - self._first
        while start + size <= available:
            windows.append(self._window(start, start + size))
            self._next_window += 1
            start += self.factor
        if windows:
            self._columns = self._columns[:, start:]
            self._stamps = self._stamps[start:]
            self._first += start
            self._bridges = [bridge for bridge in self._bridges if bridge[1] > self._first]
        return windows

    def _append(self, columns: Array, stamps: Array) -> None:
        if self._columns.shape[1]:
            self._columns = np.concatenate((self._columns, columns), axis=1)
            self._stamps = np.concatenate((self._stamps, stamps))
        else:
            self._columns, self._stamps = columns, stamps

    def _window(self, start: int, stop: int) -> Window:
        # Not `@`, and C order: the sum must not depend on where and how the slice lies in memory,
        # for a reprocessed ride has the same bits.
        centre = np.multiply(self._columns[:, start:stop], self.taps, order="C").sum(axis=1)
        first_ns, last_ns = float(self._stamps[start]), float(self._stamps[stop - 1])
        steps = stop - start - 1
        period_ns = (last_ns - first_ns) / steps if steps else self._period_ns
        first_sequence = self._consumed
        bridged = self._bridged(first_sequence, first_sequence + self.factor)
        return Window(
            stamp_ns=self._base_ns + round((first_ns + last_ns) / 2.0),
            first_sequence=first_sequence,
            sample_count=self.factor - bridged,
            bridged_count=bridged,
            interval_ns=period_ns * self.factor,
            counts=centre.tolist(),
        )

    def _bridged(self, start: int, stop: int) -> int:
        """How many samples of the sequence numbers [start, stop) were invented."""
        return sum(max(0, min(stop, end) - max(start, first)) for first, end in self._bridges)

    def snapshot(self) -> State:
        return {
            "columns": self._columns.copy(),
            "stamps": self._stamps.copy(),
            "base_ns": self._base_ns,
            "first": self._first,
            "next_window": self._next_window,
            "bridges": [list(bridge) for bridge in self._bridges],
            "last": self._last.copy(),
            "last_ns": self._last_ns,
            "period_ns": self._period_ns,
        }

    def restore(self, state: State) -> None:
        self._columns, self._stamps = state["columns"].copy(), state["stamps"].copy()
        self._base_ns, self._first = state["base_ns"], state["first"]
        self._next_window = state["next_window"]
        self._bridges = [(first, end) for first, end in state["bridges"]]
        self._last, self._last_ns = state["last"].copy(), state["last_ns"]
        self._period_ns = state["period_ns"]


def _columns(batch: ImuBatch) -> Array:
    """Counts of a batch, shape (6, n)."""
    return np.array(
        [  # [:] makes lists of the fields, which numpy reads twice as fast
            batch.gyro_x[:],
            batch.gyro_y[:],
            batch.gyro_z[:],
            batch.accel_x[:],
            batch.accel_y[:],
            batch.accel_z[:],
        ],
        dtype=np.float64,
    )
