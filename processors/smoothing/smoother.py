"""The model `tram` with the whole ride known: a fixed-interval smoother over a `Trace`.

It is that of Rauch, Tung and Striebel in the form of Bryson and Frazier as modified by Bierman:
instead of gains with the inverse of a predicted covariance it carries an adjoint λ and its
covariance Λ backwards over what the filter did, so that it takes scalars one by one, as the filter
has, and states without variance, which an inverse would not bear. From zeros at the end,

    scalar with gain K, row H, innovation y of variance S:
        λ ← (I − K H)ᵀ λ − Hᵀ y / S,      Λ ← (I − K H)ᵀ Λ (I − K H) + Hᵀ H / S
    prediction with F:
        λ ← Fᵀ λ,                         Λ ← Fᵀ Λ F
    state made independent of all before: as F with that row zero.

Anywhere in between, x − P λ is the smoothed state and P − P Λ P its covariance, x and P being the
filter's. Noise that was added, and known shifts of the state, are in P and x alone. All derivatives
are the filter's own, taken at its estimates; nothing is linearised again.

Equations: docs/theory.md, section 12.

References
----------
G. J. Bierman, "Fixed interval smoothing with discrete measurements", International Journal of
Control 18 (1973) 65-75. A. E. Bryson, M. Frazier, "Smoothing for linear and nonlinear dynamic
systems", ASD-TDR-63-119 (1963) 353-364.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tramstream.estimation.kalman import Array, Pattern, compiled, predict_covariance
from tramstream.estimation.localiser import Estimate
from tramstream.estimation.records import Records, numbers, one
from tramstream.geodesy import LocalLevel
from tramstream.processors.smoothing.trace import (
    ANEW,
    INSTANT,
    INSTANTS,
    PREDICTION,
    SCALAR,
    SCALAR_TAIL,
    Instant,
    Trace,
)
from tramstream.processors.tram_filter.estimate import estimate_of
from tramstream.processors.tram_model.motion import move
from tramstream.processors.tram_model.records import MEMORY, PARAMETERS, SITUATION
from tramstream.processors.tram_model.states import COLUMNS, ENTRY_COUNT, ROWS, SIZE

TRANSPOSED = Pattern.of(COLUMNS, ROWS)
"""Of Fᵀ."""


@compiled
def _over_prediction(adjoint: Array, Lambda: Array, values: Array, work: Array) -> None:
    for i in range(SIZE):
        work[0, i] = adjoint[i]
    for k in range(ENTRY_COUNT):
        adjoint[COLUMNS[k]] += values[k] * work[0, ROWS[k]]
    # The algebra of a covariance with Fᵀ in the place of F.
    predict_covariance(Lambda, TRANSPOSED, values, ENTRY_COUNT, work)


@compiled
def _over_scalar(
    adjoint: Array, Lambda: Array, K: Array, h: Array, columns: Array, y: float, S: float
) -> None:
    along = 0.0
    spread = 1.0 / S
    moved = np.empty(SIZE)  # Λ K
    for i in range(SIZE):
        along += K[i] * adjoint[i]
        total = 0.0
        for j in range(SIZE):
            total += Lambda[i, j] * K[j]
        moved[i] = total
        spread += K[i] * total
    for k in range(h.shape[0]):
        j = int(columns[k])
        adjoint[j] -= h[k] * (along + y / S)
        for i in range(SIZE):
            change = h[k] * moved[i]
            Lambda[i, j] -= change
            Lambda[j, i] -= change
    for k in range(h.shape[0]):
        j = int(columns[k])
        Lambda[j, j] += spread * h[k] * h[k]
        for n in range(k):
            i, change = int(columns[n]), spread * h[k] * h[n]
            Lambda[i, j] += change
            Lambda[j, i] += change


@compiled
def go_back(tape: Array, at: int, adjoint: Array, Lambda: Array, work: Array) -> int:
    """Carry the adjoint back from place `at` of a tape to the instant before, or the beginning.

    Parameters
    ----------
    tape : ndarray
        See `trace`.
    adjoint, Lambda : ndarray, shapes (SIZE,) and (SIZE, SIZE)
        λ and Λ; changed in place.
    work : ndarray, shape (SIZE, SIZE)
        Scratch.

    Returns
    -------
    int
        Where the tape goes on behind the instant; −1 at the beginning.
    """
    while at > 0:
        at -= 1
        kind = tape[at]
        if kind == INSTANT:
            return at
        if kind == PREDICTION:
            at -= ENTRY_COUNT
            _over_prediction(adjoint, Lambda, tape[at : at + ENTRY_COUNT], work)
        elif kind == SCALAR:
            at -= SCALAR_TAIL - 1
            count, y, S = int(tape[at]), tape[at + 1], tape[at + 2]
            h, columns = tape[at - 2 * count : at - count], tape[at - count : at]
            at -= 2 * count + SIZE
            _over_scalar(adjoint, Lambda, tape[at : at + SIZE], h, columns, y, S)
        elif kind == ANEW:
            at -= 1
            slot = int(tape[at])
            adjoint[slot] = 0.0
            for i in range(SIZE):
                Lambda[slot, i] = Lambda[i, slot] = 0.0
    return -1


@compiled
def smooth_instant(
    instants: Records, number: int, adjoint: Array, Lambda: Array, P: Array, work: Array
) -> None:
    """Turn the filter's state and covariance of an instant into smoothed ones."""
    instant = instants[number]
    unfold(instant, P)
    for i in range(SIZE):
        for j in range(SIZE):
            instant.x[i] -= P[i, j] * adjoint[j]
            work[i, j] = 0.0
    for i in range(SIZE):
        for k in range(SIZE):
            factor = P[i, k]
            if factor != 0.0:
                for j in range(SIZE):
                    work[i, j] += factor * Lambda[k, j]
    at = 0
    for i in range(SIZE):
        for j in range(i + 1):
            gained = 0.0
            for k in range(SIZE):
                gained += work[i, k] * P[k, j]
            instant.triangle[at] -= gained
            at += 1
        # What is known to the last digit may come out below nothing by rounding.
        instant.triangle[at - 1] = max(instant.triangle[at - 1], 0.0)


@compiled
def unfold(instant: Instant, P: Array) -> None:
    """Make a covariance out of its lower triangle."""
    at = 0
    for i in range(SIZE):
        for j in range(i + 1):
            P[i, j] = P[j, i] = instant.triangle[at]
            at += 1


@compiled
def recall(
    instants: Records,
    k: int,
    parameters: Array,
    situation: Array,
    standing: bool,
    memory: Array,
) -> None:
    """Put a smoothed instant where the filter keeps its state, with what follows from it."""
    f, instant = memory.view(MEMORY)[0], instants[k]
    c, s = parameters.view(PARAMETERS)[0], situation.view(SITUATION)[0]
    unfold(instant, f.P)
    for i in range(SIZE):
        f.x[i] = instant.x[i]
    f.acceleration = f.yaw_rate = 0.0
    if not standing:
        # `move` works on a copy: its derivatives are wanted, not its step.
        f.acceleration, f.yaw_rate = move(f.x.copy(), c, s, instant.reading, 0.0)


@dataclass(frozen=True)
class Smoothed:
    """Smoothed states of one trace, in order of time."""

    level: LocalLevel
    """Frame `l` of the positions."""
    stamp_ns: NDArray[np.int64]
    mode: NDArray[np.int8]
    """As the filter had it."""
    standing: NDArray[np.bool_]
    instants: Records
    """`trace.Instant` of each, smoothed."""
    parameters: Array
    situation: Array

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def x(self) -> Array:
        """(n, SIZE): the states of `Ix`."""
        states: Array = self.instants["x"]
        return states

    def covariance(self, k: int) -> Array:
        """(SIZE, SIZE): of the state at instant `k`."""
        P = np.zeros((SIZE, SIZE))
        P[np.tril_indices(SIZE)] = self.instants["triangle"][k]
        full: Array = P + np.tril(P, -1).T
        return full

    def estimates(self) -> Iterator[Estimate]:
        """The same as the filter says it: motion of the vehicle's origin, no verdicts."""
        memory, given = numbers(one(MEMORY)), (self.parameters, self.situation)
        for k, stamp_ns in enumerate(self.stamp_ns.tolist()):
            standing, mode = bool(self.standing[k]), int(self.mode[k])
            recall(self.instants, k, *given, standing, memory)
            yield estimate_of(memory, self.parameters, stamp_ns, mode, standing, [])


def smooth(trace: Trace) -> Smoothed:
    """Go back over a trace; what came after its last instant is left out."""
    count = len(trace)
    instants = np.concatenate(trace.instants)[:count] if count else np.empty(0, INSTANTS)
    adjoint, Lambda = np.zeros(SIZE), np.zeros((SIZE, SIZE))
    P, work = np.empty((SIZE, SIZE)), np.empty((SIZE, SIZE))
    k = count
    for block, end in reversed(trace.tape):
        at = go_back(block, end, adjoint, Lambda, work)
        while at >= 0:
            k -= 1
            smooth_instant(instants, k, adjoint, Lambda, P, work)
            at = go_back(block, at, adjoint, Lambda, work)
    return Smoothed(
        level=trace.level,
        stamp_ns=np.array(trace.stamp_ns, dtype=np.int64),
        mode=np.array(trace.mode, dtype=np.int8),
        standing=np.array(trace.standing, dtype=np.bool_),
        instants=instants,
        parameters=trace.parameters,
        situation=trace.situation,
    )
