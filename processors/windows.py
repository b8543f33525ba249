"""Decimation of inertial samples: windows of a run without a gap, weighted by fixed taps.

The mean of kaspar2023 and the decimating low-pass of pusman2017 are the same thing with other taps.
Window k is centred on device samples k·factor … k·factor + factor − 1; symmetric taps make its
stamp the centre, so no group delay is left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.processor import State
from tramstream.proto.raw_pb2 import ImuBatch

Array = NDArray[np.float64]


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
    """Hamming-windowed sinc of even length, unit gain at 0 Hz (pusman2017: cut-off 16 Hz).

    The length puts the stop band (−53 dB) below the first frequency that folds into the pass band:
    transition width 3.3 / length · rate (Oppenheim and Schafer, Discrete-Time Signal Processing,
    3rd ed., table 7.2), from the cut-off to output rate − cut-off.
    """
    transition_hz = max(rate_hz / factor - 2.0 * cutoff_hz, cutoff_hz)
    half = max(factor, int(np.ceil(3.3 * rate_hz / transition_hz / 2.0)))
    time = np.arange(-half, half) + 0.5
    taps = np.sinc(2.0 * cutoff_hz / rate_hz * time) * np.hamming(2 * half)
    normalised: Array = taps / taps.sum()
    return normalised


class Windows:
    """Collects batches of one run of samples and gives the windows that are complete.

    Parameters
    ----------
    factor : int
        Device samples from one window to the next.
    taps : ndarray, shape (L,)
        Symmetric weights; L has the parity of `factor`.
    """

    def __init__(self, factor: int, taps: Array) -> None:
        if (len(taps) - factor) % 2:
            raise ValueError("taps and factor must both be even or both odd, to share a centre")
        self.factor = factor
        self.taps = taps
        self.lead = (len(taps) - factor) // 2
        self.reset()

    def reset(self) -> None:
        """Forget the run; whoever keeps a ledger asks `pending` first."""
        self._columns = np.empty((6, 0))
        self._real = np.empty(0, dtype=bool)
        self._first = 0  # device sequence of column 0
        self._first_ns = 0.0
        self._base_ns = 0
        self._stamps = np.empty(0)  # ns after _base_ns

    @property
    def empty(self) -> bool:
        return self._columns.shape[1] == 0

    @property
    def next_sequence(self) -> int:
        """Device sequence that would continue the run."""
        return self._first + self._columns.shape[1]

    @property
    def last_stamp_ns(self) -> int:
        return self._base_ns + int(self._stamps[-1])

    @property
    def pending(self) -> int:
        """Real samples that no window has been centred on yet."""
        done = max(0, min(self._consumed - self._first, self._real.size))
        return int(np.count_nonzero(self._real[done:]))

    @property
    def _consumed(self) -> int:
        """First device sequence whose window is still to come."""
        return self._next_window * self.factor

    def begin(self, batch: ImuBatch) -> int:
        """Start a run; return how many of its first samples no whole window will be centred on."""
        self.reset()
        self._base_ns = batch.stamp_ns
        self._first = batch.first_sample_sequence
        reach = self._first + self.lead
        self._next_window = -(-reach // self.factor)  # first window that lies wholly in the run
        self._append(batch)
        return self._next_window * self.factor - self._first

    def bridge(self, batch: ImuBatch) -> None:
        """Interpolate from the last sample to the first of `batch`, marked as not real."""
        missing = batch.first_sample_sequence - self.next_sequence
        weights = np.arange(1, missing + 1) / (missing + 1)
        before, after = self._columns[:, -1:], _columns(batch)[:, :1]
        start, end = self._stamps[-1], float(batch.stamp_ns - self._base_ns)
        self._columns = np.hstack([self._columns, before + (after - before) * weights])
        self._stamps = np.concatenate([self._stamps, start + (end - start) * weights])
        self._real = np.concatenate([self._real, np.zeros(missing, dtype=bool)])

    def extend(self, batch: ImuBatch) -> None:
        """Append a batch that continues the run."""
        self._append(batch)

    def complete(self) -> list[Window]:
        """Windows that lie wholly in what has come; what they no longer need is dropped."""
        windows = []
        size = len(self.taps)
        while True:
            start = self._next_window * self.factor - self.lead - self._first
            if start + size > self._columns.shape[1]:
                break
            windows.append(self._window(start, size))
            self._next_window += 1
        keep = self._next_window * self.factor - self.lead - self._first
        if windows and keep > 0:
            # the last column stays: a gap is bridged from it
            keep = min(keep, self._columns.shape[1] - 1)
            self._columns = self._columns[:, keep:]
            self._stamps = self._stamps[keep:]
            self._real = self._real[keep:]
            self._first += keep
        return windows

    def _append(self, batch: ImuBatch) -> None:
        columns = _columns(batch)
        count = columns.shape[1]
        stamps = batch.stamp_ns - self._base_ns + batch.period_ns * np.arange(count)
        if self.empty:
            self._columns, self._stamps = columns, stamps
            self._real = np.ones(count, dtype=bool)
        else:
            self._columns = np.hstack([self._columns, columns])
            self._stamps = np.concatenate([self._stamps, stamps])
            self._real = np.concatenate([self._real, np.ones(count, dtype=bool)])

    def _window(self, start: int, size: int) -> Window:
        stop = start + size
        # Not `@`: BLAS may sum in another order when the slice lies elsewhere in memory, and a
        # reprocessed ride must have the same bits.
        centre = (self._columns[:, start:stop] * self.taps).sum(axis=1)
        first, last = self._stamps[start], self._stamps[stop - 1]
        core = self._real[start + self.lead : stop - self.lead]
        real = int(np.count_nonzero(core))
        return Window(
            stamp_ns=self._base_ns + round((first + last) / 2.0),
            first_sequence=self._first + start + self.lead,
            sample_count=real,
            bridged_count=core.size - real,
            interval_ns=(last - first) / (size - 1) * self.factor if size > 1 else 0.0,
            counts=centre.tolist(),
        )

    def snapshot(self) -> State:
        return {
            "columns": self._columns.copy(),
            "stamps": self._stamps.copy(),
            "real": self._real.copy(),
            "first": self._first,
            "base_ns": self._base_ns,
            "next_window": self._next_window if not self.empty else 0,
        }

    def restore(self, state: State) -> None:
        self._columns, self._stamps = state["columns"].copy(), state["stamps"].copy()
        self._real = state["real"].copy()
        self._first, self._base_ns = state["first"], state["base_ns"]
        self._next_window = state["next_window"]


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
