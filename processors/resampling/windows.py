"""Decimation of inertial samples: windows of a run without a gap, weighted by fixed taps.

The mean of kaspar2023 and the decimating low-pass of pusman2017 are the same thing with other taps.
Window k is centred on device samples k·factor … k·factor + factor − 1, its *core*; symmetric taps
make its stamp the core's centre, so no group delay is left.

Equations: docs/theory.md, section 3.3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.processor import State
from tramstream.processors.resampling.window_kernels import CHANNELS, STAMPS, read_batch, weigh
from tramstream.proto.raw_pb2 import ImuBatch

Array = NDArray[np.float64]

ROOM = 4096
"""Columns of the block at first: what is still needed moves to its front once in so many."""


class Window(NamedTuple):
    """One decimated value."""

    stamp_ns: int
    first_sequence: int
    sample_count: int
    bridged_count: int
    interval_ns: float
    counts: tuple[float, ...]
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

    Samples lie in the columns of one block; the newest is kept even when no window needs it any
    more, for a gap is bridged from it.

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
        self._block = np.zeros((CHANNELS + 1, max(ROOM, 4 * len(taps))))
        self._start = 0  # first column that is still needed
        self._stop = 0  # one after the newest sample
        self._skip = 0  # columns from _start to where the next window begins
        self._base_ns = 0  # the run's first stamp
        self._next_window = 0
        self._bridges: list[tuple[int, int]] = []  # invented samples: first sequence, and one after
        self._last_ns = 0.0  # after _base_ns
        self._period_ns = 0.0
        self.empty = True
        """Whether no run has begun."""
        self.next_sequence = 0
        """Device sequence that would continue the run."""
        read_batch(b"", self._block, 0, 0.0, 0.0)  # compiled here, not at the first step
        weigh(self._block, 0, taps)

    @property
    def last_stamp_ns(self) -> int:
        return self._base_ns + int(self._last_ns)

    @property
    def pending(self) -> int:
        """Real samples that no window has been centred on yet."""
        start, stop = self._consumed, self.next_sequence
        return max(0, stop - start) - self._bridged(start, stop)

    @property
    def _first(self) -> int:
        """Device sequence of the first column that is still needed."""
        return self.next_sequence - self._stop + self._start

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
        self.empty = True
        self._start = self._stop = 0
        self._bridges = []
        self._base_ns = batch.stamp_ns
        first = self.next_sequence = batch.first_sample_sequence
        self._next_window = -(-(first + self.lead) // self.factor)  # first that lies in it
        self._skip = self._consumed - self.lead - first
        unused = self.extend(batch)
        self.empty = False
        return unused

    def bridge(self, batch: ImuBatch) -> None:
        """Interpolate from the newest sample to the first of `batch`, marked as invented."""
        first = self.next_sequence
        missing = batch.first_sample_sequence - first
        self._write(batch, missing)  # `extend` puts it there again
        block, stop = self._block, self._stop
        weights: Array = np.arange(1, missing + 1) / (missing + 1)
        last, after = block[:, stop - 1 : stop], block[:, stop + missing : stop + missing + 1]
        block[:, stop : stop + missing] = last + (after - last) * weights
        self._stop += missing
        self.next_sequence += missing
        self._bridges.append((first, first + missing))

    def extend(self, batch: ImuBatch) -> int:
        """Append a batch that continues the run.

        Returns
        -------
        int
            How many of its samples no window will be centred on: they come before the first.
        """
        count = self._write(batch, 0)
        before = self._next_window * self.factor - self.next_sequence
        self._stop += count
        self.next_sequence += count
        return min(count, before) if before > 0 else 0

    def complete(self) -> list[Window]:
        """Windows that lie wholly in what has come; what they no longer need is dropped."""
        windows: list[Window] = []
        begin, size = self._start + self._skip, len(self.taps)
        while begin + size <= self._stop:
            windows.append(self._window(begin))
            self._next_window += 1
            begin += self.factor
        if windows:
            self._start, self._skip = begin, 0
            if self._bridges:
                self._bridges = [bridge for bridge in self._bridges if bridge[1] > self._first]
        return windows

    def _write(self, batch: ImuBatch, skip: int) -> int:
        """Put the samples of `batch` behind what is there and `skip` more; return their count."""
        payload = batch.SerializeToString()
        most = skip + len(payload) // CHANNELS
        if self._stop + most > self._block.shape[1]:
            self._make_room(most)
        start_ns, period_ns = float(batch.stamp_ns - self._base_ns), batch.period_ns
        count = read_batch(payload, self._block, self._stop + skip, start_ns, period_ns)
        if count < 0:
            raise ValueError(f"the columns of batch {batch.sequence} differ in length")
        self._period_ns = period_ns
        self._last_ns = (count - 1) * period_ns + start_ns
        return count

    def _make_room(self, count: int) -> None:
        """Move what is needed, and the newest sample, to the front of a block long enough."""
        begin = max(0, min(self._start, self._stop - 1))
        kept = self._block[:, begin : self._stop].copy()
        room = max(self._block.shape[1], 2 * (kept.shape[1] + count))
        self._block = np.zeros((CHANNELS + 1, room))
        self._block[:, : kept.shape[1]] = kept
        self._start, self._stop = self._start - begin, kept.shape[1]

    def _window(self, begin: int) -> Window:
        sums = weigh(self._block, begin, self.taps)
        first_ns, last_ns = sums[CHANNELS:]
        steps, factor = len(self.taps) - 1, self.factor
        period_ns = (last_ns - first_ns) / steps if steps else self._period_ns
        first_sequence = self._next_window * factor
        bridged = 0
        if self._bridges:
            bridged = self._bridged(first_sequence, first_sequence + factor)
        return Window(
            self._base_ns + round((first_ns + last_ns) / 2.0),
            first_sequence,
            factor - bridged,
            bridged,
            period_ns * factor,
            sums[:CHANNELS],
        )

    def _bridged(self, start: int, stop: int) -> int:
        """How many samples of the sequence numbers [start, stop) were invented."""
        return sum(max(0, min(stop, end) - max(start, first)) for first, end in self._bridges)

    def snapshot(self) -> State:
        block, start, stop = self._block, self._start, self._stop
        return {
            "columns": block[:CHANNELS, start:stop].copy(),
            "stamps": block[STAMPS, start:stop].copy(),
            "base_ns": self._base_ns,
            "first": self._first,
            "next_window": self._next_window,
            "bridges": [list(bridge) for bridge in self._bridges],
            "last": block[:CHANNELS, max(0, stop - 1) : stop].copy(),
            "last_ns": self._last_ns,
            "period_ns": self._period_ns,
        }

    def restore(self, state: State) -> None:
        columns, last = state["columns"], state["last"]
        self._start, self._stop = 0, 0
        self._make_room(1 + columns.shape[1])
        self.empty = last.shape[1] == 0
        block, begin = self._block, last.shape[1]
        block[:CHANNELS, :begin], block[STAMPS, :begin] = last, state["last_ns"]
        self._start, self._stop = begin, begin + columns.shape[1]
        block[:CHANNELS, begin : self._stop] = columns
        block[STAMPS, begin : self._stop] = state["stamps"]
        self._base_ns, self._last_ns = state["base_ns"], state["last_ns"]
        self.next_sequence = state["first"] + columns.shape[1]
        self._next_window = state["next_window"]
        self._skip = self._consumed - self.lead - state["first"]
        self._bridges = [(first, end) for first, end in state["bridges"]]
        self._period_ns = state["period_ns"]
