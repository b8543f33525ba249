"""What the filter `tram` does, written down so that a smoother can go back over it.

A `TracedLocaliser` gives what a `TramLocaliser` gives, to the bit. Every change of state and
covariance goes on a tape: the entries of A of each prediction; innovation, S, gain and row of H of
each scalar that was taken; the slot of each state that was made independent of all others. Noise
that is added and known shifts of the state mean nothing to a smoother and are not on it. Ten times
a second stand beside the tape what the filter had: an `Instant`.

A `Trace` begins where the filter gets a heading, with the departure that it goes through again, and
ends where the vehicle is looked for again: nothing is smoothed across that. Two directions of
travel that are tried side by side have a trace each; only the one that is believed counts. A ride
takes about 0.6 GB an hour.
"""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np

from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.kalman import Array, compiled, sound
from tramstream.estimation.localiser import Estimate, OnTrack, Verdict
from tramstream.geodesy import LocalLevel
from tramstream.processor import State
from tramstream.processors.tram import motion as kernels
from tramstream.processors.tram.filter import TramFilter
from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.processors.tram.motion import ENTRY_COUNT, ENTRY_VALUES, MOST_SCALARS, STATE, TAKEN
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram.states import SIZE, Ix
from tramstream.proto.sync_pb2 import SyncFrame

EVERY_NS = S // 10
"""Between smoothed states: a vehicle's motion holds nothing that is faster."""
PREDICTION, SCALAR, ANEW, INSTANT = range(4)
"""What an entry of the tape is, in its last place, for the tape is read backwards. Before that

- PREDICTION: the values of A, as in `tram_states.ENTRIES`;
- SCALAR: gain, values of H, their columns; their number, innovation, S;
- ANEW: the slot;
- INSTANT: nothing.
"""
SCALAR_TAIL = 4
"""Places of a scalar behind its arrays."""
TRIANGLE = SIZE * (SIZE + 1) // 2
INPUTS = 10
ROW = SIZE + TRIANGLE + INPUTS
"""Of an instant: state, lower triangle of the covariance row by row, inertial reading."""
BLOCK = 1 << 17
"""Places of the tape that are allocated at a time: 1 MB."""
ROWS = 512
LONGEST = max(ENTRY_COUNT + 1, MOST_SCALARS * (SIZE + 2 * kernels.ROW_LENGTH + SCALAR_TAIL))
"""Most places that one call fills."""
DIRECTIONS = 2
"""In which a departure is gone through, each with a trace."""


@compiled
def write_prediction(tape: Array, at: int, m: Array) -> int:
    """Add the last prediction of the filter's memory; gives where the tape goes on."""
    values = m[ENTRY_VALUES]
    for k in range(ENTRY_COUNT):
        tape[at + k] = values[k]
    tape[at + ENTRY_COUNT] = PREDICTION
    return at + ENTRY_COUNT + 1


@compiled
def write_scalars(tape: Array, at: int, m: Array) -> int:
    """Add the scalars of the last call; those that were refused have changed nothing."""
    seen, columns = m[kernels.SEEN], m[kernels.H_COLUMNS]
    for k in range(int(m[TAKEN])):
        y, variance, count = seen[3 * k], seen[3 * k + 1], int(seen[3 * k + 2])
        if not variance > 0.0:
            continue
        gain, row = kernels.gain(m, k), kernels.row(m, k)
        for i in range(SIZE):
            tape[at + i] = gain[i]
        at += SIZE
        for i in range(count):
            tape[at + i] = row[i]
            tape[at + count + i] = columns[k * kernels.ROW_LENGTH + i]
        at += 2 * count
        tape[at], tape[at + 1], tape[at + 2], tape[at + 3] = count, y, variance, SCALAR
        at += SCALAR_TAIL
    return at


@compiled
def write_instant(rows: Array, k: int, m: Array, u: Array) -> None:
    """Fill row `k` with the filter's state and covariance, and the reading that acts."""
    x, P = m[STATE], m[kernels.COVARIANCE].reshape((SIZE, SIZE))
    for i in range(SIZE):
        rows[k, i] = x[i]
    at = SIZE
    for i in range(SIZE):
        for j in range(i + 1):
            rows[k, at] = P[i, j]
            at += 1
    for i in range(INPUTS):
        rows[k, at + i] = u[i]


class Trace:
    """Tape and instants from one start of the filter on.

    Parameters
    ----------
    level : LocalLevel
        Frame `l` of the positions.
    parameters : ndarray
        Of the model (`tram_states.Pm`), as they are; those that change later are not for here.
    """

    def __init__(self, level: LocalLevel, parameters: Array) -> None:
        self.level = level
        self.parameters = parameters.copy()
        self.believed = False
        """Whether its heading is the one that was taken."""
        self.rows: list[Array] = []
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
        return sum(each.nbytes for each in (*self._tape, *self.rows))

    def predicted(self, m: Array) -> None:
        """The filter has moved on; `m` is its memory."""
        self._at = write_prediction(self._room(), self._at, m)

    def updated(self, m: Array) -> None:
        """It has taken one or more scalars."""
        self._at = write_scalars(self._room(), self._at, m)

    def made_anew(self, slot: int) -> None:
        """A state has become independent of all that was before."""
        block = self._room()
        block[self._at], block[self._at + 1] = slot, ANEW
        self._at += 2

    def due(self, stamp_ns: int) -> bool:
        """Whether the state at `stamp_ns` is wanted."""
        return not self.stamp_ns or stamp_ns // EVERY_NS != self.stamp_ns[-1] // EVERY_NS

    def instant(self, stamp_ns: int, mode: int, standing: bool, m: Array, u: Array) -> None:
        """Keep the state as it is."""
        block = self._room()
        block[self._at] = INSTANT
        self._at += 1
        self._last = len(self._tape), self._at
        row = len(self.stamp_ns) % ROWS
        if row == 0:
            self.rows.append(np.empty((ROWS, ROW)))
        write_instant(self.rows[-1], row, m, u)
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


class TracedFilter(TramFilter):
    """Writes on its trace, while it has one, what the vehicle's sensors make it do."""

    trace: Trace | None = None

    def predict(self, u: Array, dt: float) -> None:
        super().predict(u, dt)
        if self.trace is not None:
            self.trace.predicted(self.memory)

    def inertial(self, u: Array, steady: Array) -> Verdict | None:
        verdict = super().inertial(u, steady)
        self._updated()
        return verdict

    def stop(self) -> bool:
        return self._stopped(super().stop())

    def standing(self, u: Array) -> bool:
        return self._stopped(super().standing(u))

    def _stopped(self, stopped: bool) -> bool:
        if not stopped and self.trace is not None:
            self.trace.made_anew(Ix.SPEED)
        self._updated()
        return stopped

    def position(self, z: Any, std: float, std_up: float) -> list[Verdict]:
        verdicts = super().position(z, std, std_up)
        self._updated()
        return verdicts

    def velocity(self, z: Any, std: float) -> list[Verdict]:
        verdicts = super().velocity(z, std)
        self._updated()
        return verdicts

    def path(self, wheel: int, way: float, variance: float) -> Verdict:
        verdict = super().path(wheel, way, variance)
        self._updated()
        return verdict

    def rim(self, wheel: int, speed: float, std: float) -> Verdict:
        verdict = super().rim(wheel, speed, std)
        self._updated()
        return verdict

    def track(self, on_track: OnTrack) -> list[Verdict]:
        verdicts = super().track(on_track)
        self._updated()
        return verdicts

    def tie(self, wheel: int, variance: float) -> None:
        super().tie(wheel, variance)
        if self.trace is not None:
            self.trace.made_anew(Ix.PATH_A + wheel)

    def forget(self, slots: Any, stds: Any) -> None:
        super().forget(slots, stds)
        if self.trace is not None:
            for slot in slots:
                self.trace.made_anew(slot)

    def _updated(self) -> None:
        if self.trace is not None:
            self.trace.updated(self.memory)


class TracedNavigation(Navigation):
    """Keeps the traces: a heading begins one, and whatever goes through frames goes on with it."""

    filter_type = TracedFilter
    ekf: TracedFilter

    def __init__(self, vehicle: Vehicle, level: LocalLevel) -> None:
        self.ended: list[Trace] = []
        self._begun: dict[int, Trace] = {}
        self._number = 0  # of the present one; 0: none
        self._count = 0
        super().__init__(vehicle, level)

    def begin(self) -> None:
        self._count += 1
        self._begun[self._count] = Trace(self.level, self.ekf.parameters)
        for number in sorted(self._begun)[:-DIRECTIONS]:
            del self._begun[number]
        self._go_on(self._count)

    def believe(self) -> None:
        """The heading is the right one."""
        if self.ekf.trace is None:  # memory was put back that knows of none
            self.begin()
        assert self.ekf.trace is not None
        self.ekf.trace.believed = True

    def _go_on(self, number: int) -> None:
        self._number, self.ekf.trace = number, self._begun.get(number)

    @property
    def traces(self) -> list[Trace]:
        """All that have ended, and the present one."""
        present = self.ekf.trace
        return [*self.ended, present] if present is not None and present.believed else self.ended

    def run(self, frame: SyncFrame, standing: bool, noise: Array | None) -> list[Verdict]:
        verdicts = super().run(frame, standing, noise)
        trace, ekf, stamp_ns = self.ekf.trace, self.ekf, frame.stamp_ns
        # What is no number begins anew elsewhere; the smoother begins before it.
        if trace is not None and trace.due(stamp_ns) and sound(ekf.x[:, 0], ekf.P):
            trace.instant(stamp_ns, self.mode(stamp_ns), standing, ekf.memory, self.inputs[2])
        return verdicts

    def face(self, yaw_rad: float, std_rad: float, vehicle: Vehicle) -> None:
        super().face(yaw_rad, std_rad, vehicle)
        self.begin()

    def unface(self) -> None:
        super().unface()
        self.ended = self.traces
        self._begun.clear()
        self._go_on(0)

    def snapshot(self) -> dict[str, Any]:
        return super().snapshot() | {"trace": self._number}

    def restore(self, state: dict[str, Any]) -> None:
        super().restore(state)
        self._go_on(state.get("trace", 0))


class TracedLocaliser(TramLocaliser):
    """A `TramLocaliser` that remembers all the way that it has gone."""

    navigation_type = TracedNavigation

    def __init__(self, vehicle: Vehicle) -> None:
        self._ended: list[Trace] = []
        super().__init__(vehicle)

    @property
    def traces(self) -> list[Trace]:
        """In order of time."""
        navigation = self._navigation
        if not isinstance(navigation, TracedNavigation):
            return self._ended
        return self._ended + navigation.traces

    def take(self, frame: SyncFrame) -> Estimate | None:
        estimate = super().take(frame)
        if self._aligned and isinstance(self._navigation, TracedNavigation):
            self._navigation.believe()
        return estimate

    def restore(self, state: State) -> None:
        self._ended = self.traces
        super().restore(state)
