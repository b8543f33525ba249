"""The slope of the track under a vehicle, out of the smoothed states of its ride.

A filter's pitch is that of the body, and the body nods on its springs against the force along it:

    −θ = α + κ f,        f = v̇ + g sin α        κ: nod, rad per m/s², nose up where it is pushed

(`tramstream.simulation.body`). κ is not known. Within a second a tram that brakes, stops or sets
off changes v̇ by 1 m/s² and α hardly at all, so κ is the regression of changes of −θ on those of v̇
(not of f, which has the slope in it), changes of α being noise that grows with the way.

`slope_of` is the one place that knows where the slope comes from.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tramstream.clock import S
from tramstream.estimation.series import Array, Slot, StateSeries

GRAVITY_MPS2 = 9.81
"""Good to a thousandth anywhere; it scales κ alone."""
LAG_S = 1.0
"""Between states whose differences tell κ: longer than a spring takes, shorter than a hill."""
GRADE_WALK = 1e-3
"""Change of the slope over a metre of way, rad/√m: 0.45 % over 20 m, a vertical curve's."""
PITCH_NOISE_RAD = 5e-4
"""Of a difference of pitches: springs that swing, and the filter's own."""
NOD_STD = 0.01
"""What is known of κ beforehand, rad per m/s²: 0.6 deg at 1 m/s², the softest springs."""
LEAST_LEFT = 0.1
"""Of what is left against what is allowed for, however smooth a line seems to be."""
STILL_M = 0.02
"""A vehicle that goes on by less within `LAG_S` tells nothing more about its springs."""


class Nod(NamedTuple):
    """κ of one ride, and its deviation; rad per m/s²."""

    value: float
    std: float


class Slope(NamedTuple):
    """Rows as the states have them."""

    grade_rad: Array
    """Of the track, uphill positive along x of the vehicle."""
    std_rad: Array
    nod: Nod


def slope_of(states: StateSeries) -> Slope:
    """Take the body's nod out of smoothed states."""
    pitch = states.attitude_rad[:, 1]
    nod = nod_of(states)
    force = states.acceleration_mps2 - GRAVITY_MPS2 * np.sin(pitch)
    grade = (-pitch - nod.value * states.acceleration_mps2) / (1 + nod.value * GRAVITY_MPS2)
    variance = np.maximum(states.covariance[:, Slot.PITCH, Slot.PITCH], 0.0)
    return Slope(grade, np.sqrt(variance + (nod.std * force) ** 2), nod)


def nod_of(states: StateSeries) -> Nod:
    """Estimate κ of a ride by weighted least squares; see the module."""
    if len(states) < 2:
        return Nod(0.0, NOD_STD)
    step_s = float(np.median(np.diff(states.stamp_ns))) / S
    lag = max(round(LAG_S / step_s), 1)
    pitch, acceleration = states.attitude_rad[:, 1], states.acceleration_mps2
    steps = np.abs(states.speed_mps[1:]) * np.diff(states.stamp_ns) / S
    way = np.concatenate([[0.0], np.cumsum(steps)])
    gone = way[lag:] - way[:-lag]
    change, rise = acceleration[lag:] - acceleration[:-lag], -(pitch[lag:] - pitch[:-lag])
    fits = np.isfinite(change + rise) & (gone > STILL_M)
    fits &= states.stamp_ns[lag:] - states.stamp_ns[:-lag] < 2 * LAG_S * S
    # Rows overlap `lag` times: so many fewer are independent.
    weight = 1.0 / (GRADE_WALK**2 * gone[fits] + PITCH_NOISE_RAD**2) / lag
    known = float(np.sum(weight * change[fits] ** 2)) + 1.0 / NOD_STD**2
    told = float(np.sum(weight * change[fits] * rise[fits]))
    value = told / known
    # The walk is that of a steep line: what is left says how steep this one is.
    left = weight * lag * (rise[fits] - value * change[fits]) ** 2
    usual = float(np.mean(left)) if len(left) > lag else 1.0
    return Nod(value, min(NOD_STD, math.sqrt(max(usual, LEAST_LEFT) / known)))
