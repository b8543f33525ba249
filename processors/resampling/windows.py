"""Decimation of inertial samples: windows of a run without a gap, weighted by fixed taps.

The mean of kaspar2023 and the decimating low-pass of pusman2017 are the same thing with other taps.
Window k is centred on device samples k·factor … k·factor + factor − 1, its *core*; symmetric taps
make its stamp the core's centre, so no group delay is left.

Equations: docs/theory.md, section 3.3.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.processors.resampling.window_kernels import CHANNELS, read_batch, scatter, weigh
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
    scatter: tuple[float, ...] = (0.0,) * CHANNELS
    """Deviation of the core's samples about their mean, likewise."""


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


class Columns:
    """Samples in the columns of one block: those that are still needed, and the newest one.

    The newest is kept even when no window needs it any more, for a gap is bridged from it. As plain
    data it is what is in use of the block.

    Attributes
    ----------
    block : ndarray, shape (7, m)
    start : int
        First column that is still needed.
    stop : int
        One after the newest sample.
    """

    def __init__(self, room: int = ROOM) -> None:
        self.block = np.zeros((CHANNELS + 1, room))
        self.start = self.stop = 0

    @property
    def _begin(self) -> int:
        return max(0, min(self.start, self.stop - 1))

    def make_room(self, count: int) -> None:
        """Move what is in use to the front of a block that has room for `count` more."""
        begin, used = self._begin, self.block[:, self._begin : self.stop].copy()
        self.block = np.zeros((CHANNELS + 1, max(self.block.shape[1], 2 * (used.shape[1] + count))))
        self.block[:, : used.shape[1]] = used
        self.start, self.stop = self.start - begin, used.shape[1]

    def to_plain(self) -> list[Any]:
        return [self.block[:, self._begin : self.stop].copy(), self.start - self._begin]

    @classmethod
    def from_plain(cls, plain: Any) -> Columns:
        """Raises TypeError if `plain` is not what `to_plain` gives."""
        if not isinstance(plain, list) or len(plain) != 2:
            raise TypeError("memory of another version: not columns and their start")
        used, start = plain
        if not isinstance(used, np.ndarray) or used.dtype != float or used.shape[:-1] != (7,):
            raise TypeError("memory of another version: not columns of seven numbers")
        columns = cls(max(ROOM, 2 * used.shape[1]))
        columns.start, columns.stop = min(max(start, 0), used.shape[1]), used.shape[1]
        columns.block[:, : columns.stop] = used
        return columns


@dataclass
class WindowsMemory:
    """What `Windows` remember: the present run."""

    columns: Columns = field(default_factory=Columns)
    skip: int = 0
    """Columns from the first that is needed to where the next window begins."""
    base_ns: int = 0
    """The run's first stamp."""
    next_window: int = 0
    bridges: list[tuple[int, int]] = field(default_factory=list)
    """Invented samples: first sequence, and one after."""
    last_ns: float = 0.0
    """After `base_ns`."""
    period_ns: float = 0.0
    empty: bool = True
    """Whether no run has begun."""
    next_sequence: int = 0
    """Device sequence that would continue the run."""


class Windows:
    """Collects batches of one run of samples and gives the windows that are complete.

    Parameters
    ----------
    factor : int
        Device samples from one window to the next.
    taps : ndarray, shape (L,)
        Symmetric weights, at least `factor` of them and of its parity.
    memory : WindowsMemory or None
        Part of its owner's memory; one of its own by default.
    """

    def __init__(self, factor: int, taps: Array, memory: WindowsMemory | None = None) -> None:
        if len(taps) < factor or (len(taps) - factor) % 2:
            raise ValueError(f"{len(taps)} taps cannot be centred on windows of {factor} samples")
        self.factor = factor
        self.taps = taps
        self.lead = (len(taps) - factor) // 2
        self.memory = WindowsMemory() if memory is None else memory
        self._columns = self.memory.columns
        block = np.zeros((CHANNELS + 1, len(taps)))
        read_batch(b"", block, 0, 0.0, 0.0)  # compiled here, not at the first step
        weigh(block, 0, taps)
        scatter(block, 0, 1)

    @property
    def last_stamp_ns(self) -> int:
        return self.memory.base_ns + int(self.memory.last_ns)

    @property
    def pending(self) -> int:
        """Real samples that no window has been centred on yet."""
        start, stop = self._consumed, self.memory.next_sequence
        return max(0, stop - start) - self._bridged(start, stop)

    @property
    def _first(self) -> int:
        """Device sequence of the first column that is still needed."""
        columns = self._columns
        return self.memory.next_sequence - columns.stop + columns.start

    @property
    def _consumed(self) -> int:
        """First device sequence whose window is still to come."""
        return self.memory.next_window * self.factor

    def begin(self, batch: ImuBatch) -> int:
        """Start a run and forget the one before, whose `pending` nobody gets any more.

        Returns
        -------
        int
            How many samples of the batch no window will be centred on, as in `extend`.
        """
        memory, columns = self.memory, self._columns
        memory.empty = True
        columns.start = columns.stop = 0
        memory.bridges = []
        memory.base_ns = batch.stamp_ns
        first = memory.next_sequence = batch.first_sample_sequence
        memory.next_window = -(-(first + self.lead) // self.factor)  # first that lies in it
        memory.skip = self._consumed - self.lead - first
        unused = self.extend(batch)
        memory.empty = False
        return unused

    def bridge(self, batch: ImuBatch) -> None:
        """Interpolate from the newest sample to the first of `batch`, marked as invented."""
        memory, columns = self.memory, self._columns
        first = memory.next_sequence
        missing = batch.first_sample_sequence - first
        self._write(batch, missing)  # `extend` puts it there again
        block, stop = columns.block, columns.stop
        weights: Array = np.arange(1, missing + 1) / (missing + 1)
        last, after = block[:, stop - 1 : stop], block[:, stop + missing : stop + missing + 1]
        block[:, stop : stop + missing] = last + (after - last) * weights
        columns.stop += missing
        memory.next_sequence += missing
        memory.bridges.append((first, first + missing))

    def extend(self, batch: ImuBatch) -> int:
        """Append a batch that continues the run.

        Returns
        -------
        int
            How many of its samples no window will be centred on: they come before the first.
        """
        count = self._write(batch, 0)
        memory = self.memory
        before = memory.next_window * self.factor - memory.next_sequence
        self._columns.stop += count
        memory.next_sequence += count
        return min(count, before) if before > 0 else 0

    def complete(self) -> list[Window]:
        """Windows that lie wholly in what has come; what they no longer need is dropped."""
        memory, columns = self.memory, self._columns
        windows: list[Window] = []
        begin, size = columns.start + memory.skip, len(self.taps)
        while begin + size <= columns.stop:
            windows.append(self._window(begin))
            memory.next_window += 1
            begin += self.factor
        if windows:
            columns.start, memory.skip = begin, 0
            if memory.bridges:
                memory.bridges = [bridge for bridge in memory.bridges if bridge[1] > self._first]
        return windows

    def _write(self, batch: ImuBatch, skip: int) -> int:
        """Put the samples of `batch` behind what is there and `skip` more; return their count."""
        memory, columns = self.memory, self._columns
        payload = batch.SerializeToString()
        most = skip + len(payload) // CHANNELS
        if columns.stop + most > columns.block.shape[1]:
            columns.make_room(most)
        start_ns, period_ns = float(batch.stamp_ns - memory.base_ns), batch.period_ns
        count = read_batch(payload, columns.block, columns.stop + skip, start_ns, period_ns)
        if count < 0:
            raise ValueError(f"the columns of batch {batch.sequence} differ in length")
        memory.period_ns = period_ns
        memory.last_ns = (count - 1) * period_ns + start_ns
        return count

    def _window(self, begin: int) -> Window:
        memory = self.memory
        sums = weigh(self._columns.block, begin, self.taps)
        first_ns, last_ns = sums[CHANNELS:]
        steps, factor = len(self.taps) - 1, self.factor
        period_ns = (last_ns - first_ns) / steps if steps else memory.period_ns
        first_sequence = memory.next_window * factor
        bridged = 0
        if memory.bridges:
            bridged = self._bridged(first_sequence, first_sequence + factor)
        return Window(
            memory.base_ns + round((first_ns + last_ns) / 2.0),
            first_sequence,
            factor - bridged,
            bridged,
            period_ns * factor,
            sums[:CHANNELS],
            scatter(self._columns.block, begin + self.lead, factor),
        )

    def _bridged(self, start: int, stop: int) -> int:
        """How many samples of the sequence numbers [start, stop) were invented."""
        return sum(max(0, min(stop, end) - max(start, first)) for first, end in self.memory.bridges)
