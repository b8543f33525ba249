"""The two cases of konecny2004: travelled distance from noisy positions, constant and irregular T.

True motion s = ½·a·t², a = 1 m/s²; position measured with σ = 40 m; Q = diag(0, 2) per step,
P0 = diag(1600, 0), x0 = (first measurement, 0). T = 0.5 s, or 0.2·T̄ + 1.6·T̄·U(0, 1) with T̄ = 0.5 s.
Both the prediction step and the data step are shown, as in the work; a third line shows what the
irregular case costs a filter that is told T̄ instead of the true interval.

References
----------
J. Konečný, Kalman filtering for transport, University of Pardubice, 2004.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tramstream.processors.distance import kalman1d

Array = NDArray[np.float64]

ACCELERATION_MPS2 = 1.0
POSITION_STD_M = 40.0
MEAN_INTERVAL_S = 0.5
STEPS = 200
RUNS = 200
PROCESS_NOISE: Array = np.diag([0.0, 2.0])
START_COVARIANCE: Array = np.diag([1600.0, 0.0])


@dataclass(frozen=True)
class Case:
    """Figures of one case over all runs."""

    name: str
    raw_rmse_m: float
    predicted_rmse_m: float
    filtered_rmse_m: float
    speed_rmse_mps: float
    gain: float
    """Raw over filtered: what the filter is good for."""
    within_two_sigma: float
    """Share of position errors inside the filter's own ±2σ; 0.954 for an honest one."""


def intervals(irregular: bool, rng: np.random.Generator) -> Array:
    """Times between measurements, shape (STEPS,), s."""
    if not irregular:
        return np.full(STEPS, MEAN_INTERVAL_S)
    uniform = rng.uniform(0.0, 1.0, STEPS)
    drawn: Array = 0.2 * MEAN_INTERVAL_S + 1.6 * MEAN_INTERVAL_S * uniform
    return drawn


def run(dt_s: Array, told_s: Array, rng: np.random.Generator) -> Array:
    """One run; rows: true s, true ṡ, measured s, predicted s, filtered s, filtered ṡ, σ of s."""
    time = np.cumsum(dt_s)
    truth = 0.5 * ACCELERATION_MPS2 * time**2
    measured = truth + rng.normal(0.0, POSITION_STD_M, STEPS)
    kalman = kalman1d.distance_filter(np.array([measured[0], 0.0]), START_COVARIANCE)
    rows = []
    for step in range(1, STEPS):
        kalman.predict(F=kalman1d.transition(told_s[step]), Q=PROCESS_NOISE)
        predicted = kalman.x[0, 0]
        kalman.update(measured[step], R=POSITION_STD_M**2, H=kalman1d.POSITION)
        rows.append(
            (
                truth[step],
                ACCELERATION_MPS2 * time[step],
                measured[step],
                predicted,
                kalman.x[0, 0],
                kalman.x[1, 0],
                np.sqrt(kalman.P[0, 0]),
            )
        )
    return np.array(rows)


def study(name: str, irregular: bool, told_mean: bool, seed: int, runs: int = RUNS) -> Case:
    """Root mean square errors over `runs` runs; `told_mean` gives the filter T̄ instead of T."""
    rng = np.random.default_rng(seed)
    results = []
    for _ in range(runs):
        dt_s = intervals(irregular, rng)
        results.append(run(dt_s, np.full_like(dt_s, MEAN_INTERVAL_S) if told_mean else dt_s, rng))
    rows = np.concatenate(results)
    truth, speed, measured, predicted, filtered, filtered_speed, std = rows.T

    def rmse(error: Array) -> float:
        return float(np.sqrt(np.mean(error**2)))

    raw, after = rmse(measured - truth), rmse(filtered - truth)
    return Case(
        name=name,
        raw_rmse_m=raw,
        predicted_rmse_m=rmse(predicted - truth),
        filtered_rmse_m=after,
        speed_rmse_mps=rmse(filtered_speed - speed),
        gain=raw / after,
        within_two_sigma=float(np.mean(np.abs(filtered - truth) <= 2.0 * std)),
    )


def cases(seed: int, runs: int = RUNS) -> list[Case]:
    """Constant T, irregular T, and irregular T with a filter that does not know it."""
    return [
        study("constant interval", False, False, seed, runs),
        study("irregular interval", True, False, seed, runs),
        study("irregular, told mean", True, True, seed, runs),
    ]
