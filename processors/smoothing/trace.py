"""What the filter `tram` does, written down so that a smoother can go back over it.

A `TramLocaliser` with a `Tracer` watching gives what one without gives, to the bit. Every change of
state and covariance goes on a tape: the entries of A of each prediction; innovation, S, gain and
row of H of each scalar that was taken; the slot of each state that was made independent of all
others. Noise that is added and known shifts of the state mean nothing to a smoother and are not on
it. Ten times a second stand beside the tape what the filter had: an `Instant`.

A `Trace` begins where the filter gets a heading, with the departure that it goes through again, and
ends where the vehicle is looked for again: nothing is smoothed across that. Two directions of
travel that are tried side by side have a trace each; only the one that is confirmed counts. A ride
takes about 0.6 GB an hour.
"""

from __future__ import annotations

from array import array
from typing import Annotated, Protocol

import numpy as np

from tramstream.clock import S
from tramstream.estimation.kalman import Array, compiled, sound
from tramstream.estimation.records import Records, dtype_of, numbers
from tramstream.geodesy import LocalLevel
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_model.records import MEMORY, MOST_ROWS, READING, ROW_LENGTH, Reading
from tramstream.processors.tram_model.states import ENTRY_COUNT, SIZE

EVERY_NS = S // 10
"""Between smoothed states: a vehicle's motion holds nothing that is faster."""
PREDICTION, SCALAR, ANEW, INSTANT = range(4)
"""What an entry of the tape is, in its last place, for the tape is read backwards. Before that

- PREDICTION: the entries of A, as in `states.ENTRIES`;
- SCALAR: gain, values of H, their columns; their number, innovation, S;
- ANEW: the slot;
- INSTANT: nothing.
"""
SCALAR_TAIL = 4
"""Places of a scalar behind its arrays."""
TRIANGLE = SIZE * (SIZE + 1) // 2
"""Numbers of the lower triangle of a covariance."""
BLOCK = 1 << 17
"""Places of the tape that are allocated at a time: 1 MB."""
TOGETHER = 512
"""Instants that are allocated at a time."""
LONGEST = max(ENTRY_COUNT + 1, MOST_ROWS * (SIZE + 2 * ROW_LENGTH + SCALAR_TAIL))
"""Most places that one call fills."""
DIRECTIONS = 2
"""In which a departure is gone through, each with a trace."""


class Instant(Protocol):
    """What the filter had."""

    x: Annotated[Array, (SIZE,)]
    triangle: Annotated[Array, (TRIANGLE,)]
    """Lower triangle of P, row by row."""
    reading: Reading
    """The inertial reading that acts."""


INSTANTS = dtype_of(Instant)


@compiled
def write_prediction(tape: Array, at: int, memory: Array) -> int:
    """Add the last prediction of the filter's memory; gives where the tape goes on."""
    f = memory.view(MEMORY)[0]
    for k in range(ENTRY_COUNT):
        tape[at + k] = f.entries[k]
    tape[at + ENTRY_COUNT] = PREDICTION
    return at + ENTRY_COUNT + 1


@compiled
def write_scalars(tape: Array, at: int, memory: Array) -> int:
    """Add the scalars of the last measurement; refused ones have changed nothing."""
    f = memory.view(MEMORY)[0]
    for k in range(f.rows):
        count = f.counts[k]
        if not f.S[k] > 0.0:
            continue
        for i in range(SIZE):
            tape[at + i] = f.K[k, i]
        at += SIZE
        for i in range(count):
            tape[at + i] = f.values[k, i]
            tape[at + count + i] = f.columns[k, i]
        at += 2 * count
        tape[at], tape[at + 1], tape[at + 2], tape[at + 3] = count, f.y[k], f.S[k], SCALAR
        at += SCALAR_TAIL
    return at


@compiled
def write_instant(instants: Records, k: int, memory: Array, u: Array) -> None:
    """Fill instant `k` with the filter's state and covariance, and the reading that acts."""
    f, instant = memory.view(MEMORY)[0], instants[k]
    at = 0
    for i in range(SIZE):
        instant.x[i] = f.x[i]
        for j in range(i + 1):
            instant.triangle[at] = f.P[i, j]
            at += 1
    instant.reading = u.view(READING)[0]


class Trace:
    """Tape and instants from one start of the filter on.

    Parameters
    ----------
    level : LocalLevel
        Frame `l` of the positions.
    ekf : TramFilter
        As it is; what changes of its situation later is not for here.
    """

    def __init__(self, level: LocalLevel, ekf: TramFilter) -> None:
        self.level = level
        self.parameters = numbers(ekf.parameters.copy())
        self.situation = numbers(ekf.situation.copy())
        self.confirmed = False
        """Whether its heading is the one that was taken."""
        self.instants: list[Records] = []
        """Blocks of instants, the last one filled as far as `stamp_ns` goes."""
        self.stamp_ns = array("q")
        self.mode = array("b")
        self.standing = array("b")
        self._tape: list[Array] = []
        self._ends: list[int] = []
        self._block = np.empty(0)
        self._at = 0
        self._last = 0, 0  # blocks and places up to the last instant

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def tape(self) -> list[tuple[Array, int]]:
        """Blocks of the tape up to the last instant, each with the places that are filled."""
        count, end = self._last
        ends = [*self._ends[: count - 1], end] if count else []
        return list(zip(self._tape[:count], ends, strict=True))

    @property
    def size_bytes(self) -> int:
        return sum(each.nbytes for each in (*self._tape, *self.instants))

    def predicted(self, memory: Array) -> None:
        """Write down that the filter has moved on."""
        self._at = write_prediction(self._room(), self._at, memory)

    def updated(self, memory: Array) -> None:
        """Write down the scalars that it has taken."""
        self._at = write_scalars(self._room(), self._at, memory)

    def made_anew(self, state: int) -> None:
        """Write down that a state has become independent of all that was before."""
        block = self._room()
        block[self._at], block[self._at + 1] = state, ANEW
        self._at += 2

    def due(self, stamp_ns: int) -> bool:
        """Whether the state at `stamp_ns` is wanted."""
        return not self.stamp_ns or stamp_ns // EVERY_NS != self.stamp_ns[-1] // EVERY_NS

    def instant(self, stamp_ns: int, mode: int, standing: bool, memory: Array, u: Array) -> None:
        """Keep the state as it is."""
        block = self._room()
        block[self._at] = INSTANT
        self._at += 1
        self._last = len(self._tape), self._at
        row = len(self.stamp_ns) % TOGETHER
        if row == 0:
            self.instants.append(np.empty(TOGETHER, INSTANTS))
        write_instant(self.instants[-1], row, memory, u)
        self.stamp_ns.append(stamp_ns)
        self.mode.append(mode)
        self.standing.append(standing)

    def _room(self) -> Array:
        """The block of the tape, with room for whatever comes."""
        if self._at + LONGEST > len(self._block):
            if self._tape:
                self._ends.append(self._at)
            self._block, self._at = np.empty(BLOCK), 0
            self._tape.append(self._block)
        return self._block


class Tracer:
    """Watches a localiser and keeps the traces of its way: a heading begins one."""

    def __init__(self) -> None:
        self._ended: list[Trace] = []
        self._begun: dict[int, Trace] = {}
        self._number = 0  # of the present one; 0: none
        self._count = 0

    @property
    def traces(self) -> list[Trace]:
        """All that have ended, and the present one, in order of time."""
        present = self._begun.get(self._number)
        return [*self._ended, present] if present is not None and present.confirmed else self._ended

    def heading_found(self, navigation: Navigation) -> None:
        """Begin a trace; two directions of travel may be tried side by side."""
        self._count += 1
        self._begun[self._count] = Trace(navigation.level, navigation.ekf)
        for number in sorted(self._begun)[:-DIRECTIONS]:
            del self._begun[number]
        self.restored(navigation, self._count)

    def heading_confirmed(self, navigation: Navigation) -> None:
        """Hold the present trace for the right one."""
        if self._number not in self._begun:  # memory was put back that knows of none
            self.heading_found(navigation)
        self._begun[self._number].confirmed = True

    def heading_lost(self, navigation: Navigation) -> None:
        """End the present trace."""
        self._ended = self.traces
        self._begun.clear()
        self.restored(navigation, 0)

    def stepped(self, navigation: Navigation, standing: bool) -> None:
        """Keep the state ten times a second."""
        trace, ekf = self._begun.get(self._number), navigation.ekf
        # What is no number begins anew elsewhere; the smoother begins before it.
        if trace is not None and trace.due(ekf.stamp_ns) and sound(ekf.x[:, 0], ekf.P):
            mode = navigation.mode(ekf.stamp_ns)
            trace.instant(ekf.stamp_ns, mode, standing, ekf.memory, navigation.between)

    def mark(self, navigation: Navigation) -> int:
        """Give the number of the present trace."""
        return self._number

    def restored(self, navigation: Navigation, mark: int) -> None:
        """Go on with the trace of that number."""
        self._number, navigation.ekf.watcher = mark, self._begun.get(mark)

    def restarted(self) -> None:
        """End the present trace: what comes has another memory."""
        self._ended = self.traces
        self._begun.clear()
        self._number = self._count = 0
