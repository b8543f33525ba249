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

from tramstream.estimation.kalman import Array, compiled, predict_covariance
from tramstream.estimation.localiser import Estimate
from tramstream.geodesy import LocalLevel
from tramstream.processors.tram import motion as kernels
from tramstream.processors.tram.estimate import estimate_of
from tramstream.processors.tram.motion import ENTRY_COUNT
from tramstream.processors.tram.states import COLUMNS, ROWS, SIZE
from tramstream.processors.tram.trace import (
    ANEW,
    INPUTS,
    INSTANT,
    PREDICTION,
    ROW,
    SCALAR,
    SCALAR_TAIL,
    TRIANGLE,
    Trace,
)

_COVARIANCE = slice(SIZE, SIZE + TRIANGLE)


@compiled
def _over_prediction(adjoint: Array, Lambda: Array, values: Array, work: Array) -> None:
    for i in range(SIZE):
        work[0, i] = adjoint[i]
    for k in range(ENTRY_COUNT):
        adjoint[COLUMNS[k]] += values[k] * work[0, ROWS[k]]
    # The algebra of a covariance with Fᵀ in the place of F.
    predict_covariance(Lambda, COLUMNS, ROWS, values, ENTRY_COUNT, work)


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
        for n in range(h.shape[0]):
            Lambda[int(columns[k]), int(columns[n])] += spread * h[k] * h[n]


@compiled
def go_back(tape: Array, at: int, adjoint: Array, Lambda: Array, work: Array) -> int:
    """Carry the adjoint back from place `at` of a tape to the instant before, or the beginning.

    Parameters
    ----------
    tape : ndarray
        See `tram_trace`.
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
def smooth_instant(row: Array, adjoint: Array, Lambda: Array, P: Array, work: Array) -> None:
    """Turn the filter's state and covariance in `row` (`tram_trace.ROW`) into smoothed ones."""
    at = SIZE
    for i in range(SIZE):
        for j in range(i + 1):
            P[i, j] = P[j, i] = row[at]
            at += 1
    for i in range(SIZE):
        for j in range(SIZE):
            row[i] -= P[i, j] * adjoint[j]
            work[i, j] = 0.0
    for i in range(SIZE):
        for k in range(SIZE):
            factor = P[i, k]
            if factor != 0.0:
                for j in range(SIZE):
                    work[i, j] += factor * Lambda[k, j]
    at = SIZE
    for i in range(SIZE):
        for j in range(i + 1):
            gained = 0.0
            for k in range(SIZE):
                gained += work[i, k] * P[k, j]
            row[at] -= gained
            at += 1
        # What is known to the last digit may come out below nothing by rounding.
        row[at - 1] = max(row[at - 1], 0.0)


@compiled
def recall(row: Array, c: Array, standing: bool, m: Array) -> None:
    """Put a smoothed row where the filter keeps its state, with what follows from it."""
    x, P = m[kernels.STATE], m[kernels.COVARIANCE].reshape((SIZE, SIZE))
    at = SIZE
    for i in range(SIZE):
        x[i] = row[i]
        for j in range(i + 1):
            P[i, j] = P[j, i] = row[at]
            at += 1
    m[kernels.ACCELERATION] = m[kernels.YAW_RATE] = 0.0
    if not standing:
        # `move` works on a copy: its derivatives are wanted, not its step.
        m[kernels.ACCELERATION], m[kernels.YAW_RATE] = kernels.move(
            x.copy(), c, row[at : at + INPUTS], 0.0
        )


@dataclass(frozen=True)
class Smoothed:
    """Smoothed states of one trace, in order of time."""

    level: LocalLevel
    """Frame `l` of the positions."""
    stamp_ns: NDArray[np.int64]
    mode: NDArray[np.int8]
    """As the filter had it."""
    standing: NDArray[np.bool_]
    rows: Array
    """(n, ROW) of `tram_trace`, smoothed."""
    parameters: Array

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def x(self) -> Array:
        """(n, SIZE): the states of `tram_states.Ix`."""
        return self.rows[:, :SIZE]

    def covariance(self, k: int) -> Array:
        """(SIZE, SIZE): of the state at instant `k`."""
        P = np.zeros((SIZE, SIZE))
        P[np.tril_indices(SIZE)] = self.rows[k, _COVARIANCE]
        full: Array = P + np.tril(P, -1).T
        return full

    def estimates(self) -> Iterator[Estimate]:
        """The same as the filter says it: motion of the vehicle's origin, no verdicts."""
        m = np.zeros(kernels.MEMORY)
        for k, stamp_ns in enumerate(self.stamp_ns.tolist()):
            standing = bool(self.standing[k])
            recall(self.rows[k], self.parameters, standing, m)
            yield estimate_of(m, self.parameters, stamp_ns, int(self.mode[k]), standing, [])


def smooth(trace: Trace) -> Smoothed:
    """Go back over a trace; what came after its last instant is left out."""
    count = len(trace)
    rows = np.concatenate(trace.rows)[:count] if count else np.empty((0, ROW))
    adjoint, Lambda = np.zeros(SIZE), np.zeros((SIZE, SIZE))
    P, work = np.empty((SIZE, SIZE)), np.empty((SIZE, SIZE))
    k = count
    for block, end in reversed(trace.tape):
        at = go_back(block, end, adjoint, Lambda, work)
        while at >= 0:
            k -= 1
            smooth_instant(rows[k], adjoint, Lambda, P, work)
            at = go_back(block, at, adjoint, Lambda, work)
    return Smoothed(
        level=trace.level,
        stamp_ns=np.array(trace.stamp_ns, dtype=np.int64),
        mode=np.array(trace.mode, dtype=np.int8),
        standing=np.array(trace.standing, dtype=np.bool_),
        rows=rows,
        parameters=trace.parameters,
    )
