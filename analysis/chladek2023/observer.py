"""The Luenberger observer of chladek2023: speed and slope against time, from force and speed.

States (v, α), linearised at rest on the level: v̇ = u − g α, α̇ = 0, where u is the force that is
left of the motor's after drag and rolling resistance, over the mass. The measured speed corrects
both with the gain that puts the poles of the error where the work has them.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import place_poles

from tramstream.analysis.chladek2023.ride import (
    GRAVITY_MPS2,
    STEP_S,
    VEHICLE,
    Array,
)

POLES_PER_S = (-0.6, -0.7)
NOISE_MPS_RTS = 0.1**0.5
"""The walk of the measured speed: a density of 0.1 (m/s)²/s, 0.1 m/s in a cell of 0.1 s."""


def gain() -> Array:
    """L of v̂ and α̂; [1.3, −0.0428] in the work."""
    A = np.array([[0.0, -GRAVITY_MPS2], [0.0, 0.0]])
    C = np.array([[1.0, 0.0]])
    found: Array = np.ravel(place_poles(A.T, C.T, POLES_PER_S).gain_matrix)
    return found


def observe(speed_mps: Array, force_n: Array) -> Array:
    """Slope at each step, from the measured speed and the force that then begins to act.

    Parameters
    ----------
    speed_mps, force_n : ndarray, shape (n,)
        Every `STEP_S`.

    Returns
    -------
    grade_rad : ndarray, shape (n,)
    """
    of_speed, of_grade = gain().tolist()
    speed, grade = float(speed_mps[0]), 0.0
    level = np.zeros(())
    said = np.empty(len(speed_mps))
    pushed = VEHICLE.acceleration_mps2(force_n, speed_mps, level).tolist()
    for step, (measured, push) in enumerate(zip(speed_mps.tolist(), pushed, strict=True)):
        said[step] = grade
        error = measured - speed
        speed += STEP_S * (push - GRAVITY_MPS2 * grade + of_speed * error)
        grade += STEP_S * of_grade * error
    return said


def walk(count: int, rng: np.random.Generator) -> Array:
    """Error of the measured speed, every `STEP_S`, m/s."""
    walked: Array = np.cumsum(rng.normal(0.0, NOISE_MPS_RTS * STEP_S**0.5, count))
    return walked
