"""Forward filter and backward smoother over the nodes of a ride: a step of a Gauss-Newton search.

The model is linearised along a whole trajectory (`Point`); the filter's states are its errors. The
trajectory need not obey the equations of motion: what it misses from node to node drives the
errors' mean. The smoother is Bryson's and Frazier's, which inverts no covariance.
docs/theory.md, section 19.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.mounting.measurements import use_constraints, use_fix, use_stand
from tramstream.analysis.mounting.motion import drift_from, predict, step_from, transposed
from tramstream.analysis.mounting.passes import Log, Model, State
from tramstream.analysis.mounting.states import (
    SIZE,
    Point,
)
from tramstream.machine.kernels import compiled

Array = NDArray[np.float64]


@compiled
def forward(model: Model, point: Point, state: State, log: Log) -> None:
    """Filter the errors of a trajectory; `state` ends at the last node, `log` is filled."""
    drive, noise = model.drive, model.noise
    drift = np.zeros(SIZE)
    fix, fixes = 0, len(drive.fixes.node)
    last = len(drive.standing) - 1
    for k in range(last + 1):
        log.x[k] = state.x
        log.P[k] = state.P
        use_constraints(k, model, point, state, log)
        if drive.standing[k]:
            use_stand(k, model, point, state, log)
        while fix < fixes and drive.fixes.node[fix] == k:
            use_fix(fix, model, point, state, log)
            fix += 1
        if k < last:
            step = step_from(k, model, point)
            drift_from(k, drive, point, step, drift)
            predict(state, step, noise, drive.dt_s, drift)


@compiled
def backward(model: Model, point: Point, log: Log, used: int) -> Array:
    """Smooth the errors of a trajectory; (n, SIZE)."""
    drive = model.drive
    count = len(drive.standing)
    smoothed = np.empty((count, SIZE))
    costate = np.zeros(SIZE)
    at = used
    for k in range(count - 1, -1, -1):
        while at > 0 and log.node[at - 1] == k:
            at -= 1
            pull = log.innovation[at] / abs(log.variance[at])
            for i in range(SIZE):
                pull += log.K[at, i] * costate[i]
            for i in range(SIZE):
                costate[i] -= log.H[at, i] * pull
        for i in range(SIZE):
            total = log.x[k, i]
            for j in range(SIZE):
                total -= log.P[k, i, j] * costate[j]
            smoothed[k, i] = total
        if k > 0:
            transposed(costate, step_from(k - 1, model, point), drive.dt_s)
    return smoothed
