"""The filter of the slope, compiled: eight states that move with the way, scalar measurements.

States x (`Ix`): slope α of the track at the point midway between the bogies, its bend α' a metre,
the springs' coefficient κ, the error e of the localiser's pitch, height h, error ε of the fixes'
height, mass by that of the settings, rolling resistance.

The slope changes with the way and with nothing else, so a vehicle that stands, or runs backwards,
is no special case. Errors are additive. Equations: docs/theory.md, section 18.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np

from tramstream.estimation.encode import Bytes, fill
from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.grade.said import PLACES, Of


class Ix(IntEnum):
    """Where each state stands."""

    SLOPE = 0
    BEND = 1
    SPRING = 2
    OFFSET = 3
    HEIGHT = 4
    FIX_ERROR = 5
    MASS = 6
    ROLLING = 7


STATES = len(Ix)
SCATTER, FELT = range(2)
"""Of what is remembered beside them; see `follow`."""
BEND_STD_PER_M = 3e-4
"""How tracks bend up and down: Prague's lines 7 and 20 have 2.0e-4 and 2.3e-4 (SRTM heights), and
rails more than a terrain model shows."""
BEND_LENGTH_M = 60.0
"""Over which a bend is forgotten; on these lines it is half after 55 m."""
OFFSET_TAU_S = 100.0
"""Over which the error of the localiser's pitch is forgotten: its accelerometer's bias walks."""
PITCH_VARIANCES = 2.0
"""The localiser's pitch is trusted by half of what it says."""
LEAST_OFFSET_STD_RAD = 3e-4
"""A localiser that is surer of its pitch knows no cross-axis and no scale of its accelerometer."""
LEVEL_WALK_RAD = 1e-5
"""Within √s, of an accelerometer's level: its bias warms up by 4e-4 rad in a quarter of an hour."""
SPRINGS_S = 0.1
"""By which springs follow a force: 2 ζ/ω is 0.07 s of those of the scenario `tram`. A little more
smooths away the shaking of the case, which is in the acceleration and moves no body: it would make
springs look stiff (κ = 0.260 instead of 0.280 ± 0.008 of 0.3°, line 20, seed 101)."""
NOD_MPS2 = 0.25
"""A localiser that takes the body's nod for slope errs by what springs do under so much: a quarter
of what they do in braking (`reproduce grade`, world body)."""
SPRING_WALK_RAD = 2e-5
"""What κ changes by within √s, per m/s²: temperature, load."""
LEAST_PITCH_STD_RAD = 2e-4
"""White noise of the pitch in a step of a hundredth of a second, where nothing shakes the body."""
SCATTER_S = 20.0
"""Over which it is learned how much the body shakes."""
SHAKES_S = 0.3
"""A body shakes with 1 to 2 Hz: so long apart two of its pitches tell anything new."""
LEAST_STD_RAD = 1e-4
"""A rail is no line: slopes of neighbouring metres differ by a hundredth of a percent."""
GRAVITY = 9.81
MASS_KNOWN = 0.05
"""A mass that is known by this part of itself makes the force tell the slope."""
PUSHED_MPS2 = 0.25
"""Departure or braking: a force that holds the speed on a slope tells the mass no better than the
slope is known."""
ROLLING_WALK = 1e-4
"""Within √s; it bears what the slope is wrong by for a minute."""
LEAST_MASS = 0.05
"""Of that of the settings."""


@compiled
def carry(
    x: Array, P: Array, dt_s: float, way_m: float, shift_m: float, fix: tuple[float, float]
) -> None:
    """Predict over a step of time and way; `fix` is variance and fading of the fixes' error."""
    slope, bend, height = Ix.SLOPE, Ix.BEND, Ix.HEIGHT
    n = x.shape[0]
    x[height] += way_m * (x[slope] + shift_m * x[bend])
    x[slope] += way_m * x[bend]
    for j in range(n):
        P[height, j] += way_m * (P[slope, j] + shift_m * P[bend, j])
    for j in range(n):
        P[slope, j] += way_m * P[bend, j]
    for i in range(n):
        P[i, height] += way_m * (P[i, slope] + shift_m * P[i, bend])
    for i in range(n):
        P[i, slope] += way_m * P[i, bend]
    far = abs(way_m)
    fade = math.exp(-far / BEND_LENGTH_M)
    _fade(x, P, bend, fade, BEND_STD_PER_M * BEND_STD_PER_M)
    _fade(x, P, Ix.FIX_ERROR, fix[1], fix[0])
    P[Ix.SPRING, Ix.SPRING] += SPRING_WALK_RAD * SPRING_WALK_RAD * dt_s
    if way_m != 0.0:
        P[Ix.ROLLING, Ix.ROLLING] += ROLLING_WALK * ROLLING_WALK * dt_s
    for i in range(n):  # the two halves differ by rounding
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])


@compiled
def _fade(x: Array, P: Array, k: int, fade: float, variance: float) -> None:
    """Let a state forget itself towards its stationary variance (first-order Gauss-Markov)."""
    x[k] *= fade
    for j in range(x.shape[0]):
        P[k, j] *= fade
    for i in range(x.shape[0]):
        P[i, k] *= fade
    P[k, k] += (1.0 - fade * fade) * variance


@compiled
def update(
    x: Array, P: Array, H: Array, y: float, R: float, gate: float
) -> tuple[float, float, bool]:
    """Take a scalar with innovation `y`; gives innovation, its variance, and whether it fits."""
    n = x.shape[0]
    g = np.zeros(n)
    S = R
    for i in range(n):
        for j in range(n):
            g[i] += P[i, j] * H[j]
        S += H[i] * g[i]
    if not y * y <= gate * gate * S:  # refuses what is not a number, too
        return y, S, False
    for i in range(n):
        x[i] += g[i] * y / S
        for j in range(i + 1):
            P[i, j] = P[j, i] = P[i, j] - g[i] * g[j] / S
    return y, S, True


@compiled
def _offset_variance(x: Array, P: Array, pitch_variance: float) -> float:
    """Of the error of a localiser's pitch, by what it says of it."""
    spring = x[Ix.SPRING] * x[Ix.SPRING] + P[Ix.SPRING, Ix.SPRING]
    variance = PITCH_VARIANCES * pitch_variance + LEAST_OFFSET_STD_RAD * LEAST_OFFSET_STD_RAD
    return float(variance + NOD_MPS2 * NOD_MPS2 * spring)


@compiled
def _wander(x: Array, P: Array, dt_s: float, variance: float, learned: float) -> None:
    """Let the error of a pitch go on of which nothing is known but its variance."""
    offset = Ix.OFFSET
    if learned > 0.0:
        # What a localiser learns moves its pitch, and what it still errs by is independent of
        # how far: without this its first departure would be taken for the springs' nod.
        share = variance / (variance + learned)
        _fade(x, P, offset, share, variance / (1.0 + share))
    # An error that is seen to be larger than stated is no smaller than it is seen to be.
    variance = max(variance, x[offset] * x[offset] - P[offset, offset])
    _fade(x, P, offset, math.exp(-dt_s / OFFSET_TAU_S), variance)


@compiled
def _level(x: Array, P: Array, dt_s: float, variance: float, change: float) -> None:
    """Let the error of a pitch go on whose accelerometer's level is told.

    Pitch and level error together have that of the accelerometer, which hardly changes; what the
    localiser changes its mind by is no nod and no slope.
    """
    offset = Ix.OFFSET
    x[offset] += change
    P[offset, offset] += LEVEL_WALK_RAD * LEVEL_WALK_RAD * dt_s
    variance = max(variance, x[offset] * x[offset] - P[offset, offset])
    known = P[offset, offset]
    if known > variance:  # then the localiser knows better, and is taken at its word once
        H = np.zeros(x.shape[0])
        H[offset] = 1.0
        update(x, P, H, -x[offset], known * variance / (known - variance), math.inf)


@compiled
def follow(
    x: Array,
    P: Array,
    shaking: Array,
    shift_m: float,
    fix_tau_s: float,
    out: Array,
    dt_s: float,
    way_m: float,
    acceleration_mps2: float,
    pitch_rad: float,
    pitch_variance: float,
    pitch_variance_before: float,
    level_change: float,
    level_variance: float,
    fix_variance: float,
) -> None:
    """Go on by a frame and take the localiser's pitch: −θ = α + κ f + e.

    Parameters
    ----------
    shaking : ndarray, shape (2,)
        Mean square of what the pitch shows beside the prediction, and the acceleration that springs
        have followed; changed in place.
    shift_m : float
        How far the vehicle's origin is ahead of the point that α is of.
    out : ndarray
        Gets what is said, see `said.Of`: at the vehicle's origin; of the body against the track,
        nose down positive; a metre; by the mass of the settings; by the weight.
    acceleration_mps2 : float
        v̇; the springs follow the specific force f = v̇ + g α along the track.
    pitch_rad : float
        θ of the body, nose down positive; NaN where there is none.
    pitch_variance, pitch_variance_before : float
        Of the pitch as the localiser states it, rad², and stated it a frame ago.
    level_change : float
        By which the localiser has changed its mind of its accelerometer's level since the last
        pitch, rad; NaN where it does not say.
    level_variance : float
        Of pitch and level error together, rad².
    """
    slope, spring, offset = Ix.SLOPE, Ix.SPRING, Ix.OFFSET
    carry(x, P, dt_s, way_m, shift_m, (fix_variance, math.exp(-dt_s / fix_tau_s)))
    late = 1.0 - math.exp(-dt_s / SPRINGS_S)
    shaking[FELT] += late * (acceleration_mps2 - shaking[FELT])
    felt = shaking[FELT]
    if not math.isnan(pitch_rad):
        variance = _offset_variance(x, P, pitch_variance)
        if math.isnan(level_change):
            learned = PITCH_VARIANCES * (pitch_variance_before - pitch_variance)
            _wander(x, P, dt_s, variance, learned)
        else:
            _level(x, P, dt_s, variance, level_change)
        H = np.zeros(x.shape[0])
        force = felt + GRAVITY * x[slope]
        H[slope], H[spring], H[offset] = 1.0 + GRAVITY * x[spring], force, 1.0
        y = -pitch_rad - (x[slope] + force * x[spring] + x[offset])
        R = LEAST_PITCH_STD_RAD * LEAST_PITCH_STD_RAD
        R += (shaking[SCATTER] + level_variance) * SHAKES_S / max(dt_s, 1e-3)
        y, S, _ = update(x, P, H, y, R, math.inf)
        if way_m != 0.0:
            known = max(S - R, 0.0)
            share = min(dt_s / SCATTER_S, 1.0)
            shaking[SCATTER] += share * (max(y * y - known, 0.0) - shaking[SCATTER])
    swings = shaking[SCATTER] if way_m != 0.0 else 0.0
    _say(x, P, shift_m, felt, swings, out)


@compiled
def _say(x: Array, P: Array, shift_m: float, felt_mps2: float, swings: float, out: Array) -> None:
    """Fill in what is said of the vehicle's origin; `swings` is the variance of what springs do."""
    slope, bend, spring = Ix.SLOPE, Ix.BEND, Ix.SPRING
    least = LEAST_STD_RAD * LEAST_STD_RAD
    ahead = P[slope, slope] + 2.0 * shift_m * P[slope, bend] + shift_m * shift_m * P[bend, bend]
    out[Of.SLOPE], out[Of.BEND], out[Of.VARIANCE] = x[slope] + shift_m * x[bend], x[bend], ahead
    out[Of.SLOPE_STD] = math.sqrt(max(ahead, 0.0) + least)
    # Against the track under the origin: what springs do, and the chord between the bogies.
    force = felt_mps2 + GRAVITY * x[slope]
    out[Of.NOD] = shift_m * x[bend] - x[spring] * force
    a, b, k = -GRAVITY * x[spring], shift_m, -force
    variance = a * (a * P[slope, slope] + 2.0 * (b * P[slope, bend] + k * P[slope, spring]))
    variance += b * (b * P[bend, bend] + 2.0 * k * P[bend, spring]) + k * k * P[spring, spring]
    out[Of.NOD_STD] = math.sqrt(max(variance, 0.0) + least + swings)
    out[Of.MASS], out[Of.MASS_STD] = x[Ix.MASS], math.sqrt(P[Ix.MASS, Ix.MASS])
    out[Of.ROLLING], out[Of.ROLLING_STD] = x[Ix.ROLLING], math.sqrt(P[Ix.ROLLING, Ix.ROLLING])


@compiled
def step(
    x: Array,
    P: Array,
    shaking: Array,
    constants: Array,
    out: Array,
    encoded: Bytes,
    dt_s: float,
    way_m: float,
    speed_mps: float,
    acceleration_mps2: float,
    pitch_rad: float,
    pitch_variance: float,
    pitch_variance_before: float,
    level_change: float,
    level_variance: float,
    fix_variance: float,
    chainage_m: float,
    probability: float,
) -> None:
    """Go on by a frame as `follow` does, and encode what is said.

    Parameters
    ----------
    constants : ndarray, shape (3,)
        `shift_m`, correlation time of the fixes' error, s, and the mass of the settings, kg.
    encoded : ndarray of bytes
        Of `out`, see `said.Said`.
    chainage_m, probability : float
        Of the match, to be said.
    """
    told = pitch_rad, pitch_variance, pitch_variance_before, level_change, level_variance
    shift_m, tau_s = constants[0], constants[1]
    follow(x, P, shaking, shift_m, tau_s, out, dt_s, way_m, acceleration_mps2, *told, fix_variance)
    out[Of.MASS] *= constants[2]
    out[Of.MASS_STD] *= constants[2]
    out[Of.SPEED], out[Of.CHAINAGE], out[Of.PROBABILITY] = speed_mps, chainage_m, probability
    fill(encoded, PLACES, out)


@compiled
def take_height(
    x: Array, P: Array, height_m: float, lever_m: float, R: float, gate: float
) -> tuple[float, float, bool]:
    """Take a fix's height: z = h + l α + ε, with the antenna l ahead of the origin."""
    H = np.zeros(x.shape[0])
    H[Ix.SLOPE], H[Ix.HEIGHT], H[Ix.FIX_ERROR] = lever_m, 1.0, 1.0
    y = height_m - (x[Ix.HEIGHT] + lever_m * x[Ix.SLOPE] + x[Ix.FIX_ERROR])
    return update(x, P, H, y, R, gate)


@compiled
def take_climb(
    x: Array, P: Array, climb_mps: float, speed_mps: float, ahead_m: float, R: float, gate: float
) -> tuple[float, float, bool]:
    """Take a vertical speed: z = v (α + l α'), with the antenna l ahead of the point of α."""
    H = np.zeros(x.shape[0])
    H[Ix.SLOPE], H[Ix.BEND] = speed_mps, speed_mps * ahead_m
    y = climb_mps - speed_mps * (x[Ix.SLOPE] + ahead_m * x[Ix.BEND])
    return update(x, P, H, y, R, gate)


@compiled
def take_force(
    x: Array,
    P: Array,
    force_mps2: float,
    acceleration: float,
    way: float,
    R: float,
    gate: float,
    led: bool,
) -> tuple[float, float, bool]:
    """Take the motor force, less drag, over the settings' mass: z = u (v̇ + g α + g c sign v).

    A mass that is not known makes a force no slope. Then, and where a localiser tells the slope
    better than the rolling resistance is known (`led`), slope and all else are considered with what
    is not known of them, and not changed (Schmidt-Kalman filter).

    Parameters
    ----------
    force_mps2 : float
        z.
    way : float
        Sign of v.
    """
    H = np.zeros(x.shape[0])
    u = x[Ix.MASS]
    lacking = acceleration + GRAVITY * (x[Ix.SLOPE] + way * x[Ix.ROLLING])
    H[Ix.MASS], H[Ix.SLOPE], H[Ix.ROLLING] = lacking, u * GRAVITY, u * GRAVITY * way
    y = force_mps2 - u * lacking
    if led or P[Ix.MASS, Ix.MASS] > MASS_KNOWN * MASS_KNOWN * u * u:
        return _consider(x, P, H, y, R, abs(acceleration) > PUSHED_MPS2)
    return update(x, P, H, y, R, gate)


@compiled
def _consider(
    x: Array, P: Array, H: Array, y: float, R: float, pushed: bool
) -> tuple[float, float, bool]:
    """Take a scalar that changes rolling resistance and, where it is `pushed`, mass alone."""
    g = P @ H
    S = R + float(H @ g)
    K = np.zeros(x.shape[0])
    K[Ix.ROLLING] = g[Ix.ROLLING] / S
    if pushed:
        K[Ix.MASS] = g[Ix.MASS] / S
    x += K * y
    x[Ix.MASS] = max(x[Ix.MASS], LEAST_MASS)
    for i in range(x.shape[0]):
        for j in range(i + 1):
            P[i, j] = P[j, i] = P[i, j] - K[i] * g[j] - g[i] * K[j] + K[i] * K[j] * S
    return y, S, True
