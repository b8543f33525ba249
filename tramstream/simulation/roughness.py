"""What shakes the vehicle: waviness of the rails, joints, jolts, and its own machines.

Specific force and angular rate that are added to what the inertial sensor feels, resolved in the
axes of its part. All of it is the second derivative of a small displacement, or the first of a
small angle, that comes back: nothing of it adds up to a speed or a turn. Those displacements
(millimetres, hundredths of a degree) are in no truth: that is the vehicle's smooth motion.

**Waves** of the rails are sinusoids of the arc length, drawn once a ride, so that their frequency
is the speed over their length: y = B sin(ks + φ) gives the force B (k a cos − k² v² sin), which
grows with the square of the speed, an angle likewise the rate A k v cos. **Knocks** are joints at
even distances, felt once for each pivot, and jolts at places of chance (switches, crossings); each
is the second derivative of τ³ e^(pτ), τ = ωt, which begins and ends at rest, as strong as
the speed.
**Idling** is two tones while the vehicle hardly moves.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.random import Generator
from numpy.typing import NDArray

from tramstream.config import NotNegative, Positive, Struct, Vector
from tramstream.simulation.ride import Motion, Ride

Array = NDArray[np.float64]

REFERENCE_MPS = 10.0
"""Speed at which waves and knocks are as strong as their figures."""
WAVES = 24
"""On each axis: their sum is normal to a few percent."""
NODES_HZ = 50.0
"""Of the table in which passages are looked up: 1e-4 s."""
LAST = 4
"""Knocks that are still felt."""
DECAY = 0.5
"""Of a knock, per radian of its own frequency: it is over after four periods."""
IDLE_MPS = 0.5
STILL: Vector = (0.0, 0.0, 0.0)


class Roughness(Struct, frozen=True, kw_only=True):
    """Rails and machines; by default there is nothing to be felt of them.

    Vectors are of the axes forward, left, up.
    """

    waves_mps2: Vector = STILL
    """RMS of the force at 10 m/s."""
    waves_radps: Vector = STILL
    """RMS of the rate at 10 m/s."""
    wave_length_m: tuple[Positive, Positive] = (0.5, 10.0)
    """Shortest and longest: 20 to 1 Hz at 10 m/s."""
    joint_m: NotNegative = 0.0
    """Length of a rail from joint to joint; 0: they are welded."""
    joint_mps2: Vector = STILL
    """Largest force of a joint at 10 m/s."""
    joint_radps: Vector = STILL
    jolts_per_km: NotNegative = 0.0
    jolt_mps2: Vector = STILL
    """Deviation of the largest force of a jolt at 10 m/s."""
    jolt_radps: Vector = STILL
    knock_hz: Positive = 10.0
    """At which the body answers joints and jolts."""
    idle_mps2: Vector = STILL
    """RMS of the force while the vehicle stands."""
    idle_radps: Vector = STILL
    idle_hz: tuple[Positive, Positive] = (25.0, 30.0)
    waves: Annotated[int, Meta(ge=1, le=200)] = WAVES
    """Sinusoids on each axis."""

    @property
    def felt(self) -> bool:
        """Whether there is anything."""
        vectors = (
            self.waves_mps2,
            self.waves_radps,
            self.idle_mps2,
            self.idle_radps,
            *((self.joint_mps2, self.joint_radps) if self.joint_m else ()),
            *((self.jolt_mps2, self.jolt_radps) if self.jolts_per_km else ()),
        )
        return any(any(vector) for vector in vectors)


class Shaking:
    """What a sensor feels of a ride's roughness.

    Parameters
    ----------
    roughness : Roughness
    ride : Ride
    pivots_m : tuple of float
        x of the pivots that pass a joint one after another.
    rng : Generator
    """

    def __init__(
        self, roughness: Roughness, ride: Ride, pivots_m: tuple[float, ...], rng: Generator
    ) -> None:
        self._roughness = roughness
        self._direction = ride.direction
        waves_rng, jolts_rng, idle_rng = rng.spawn(3)
        self._draw_waves(waves_rng)
        self._draw_knocks(ride, pivots_m, jolts_rng)
        low, high = roughness.idle_hz
        self._tones_hz = idle_rng.uniform(low, high, (2, 6))
        self._tone_phases = idle_rng.uniform(0.0, math.tau, (2, 6))

    def _draw_waves(self, rng: Generator) -> None:
        roughness = self._roughness
        shortest, longest = np.log(roughness.wave_length_m)
        length_m = np.exp(rng.uniform(shortest, longest, (roughness.waves, 6)))
        self._k = math.tau / length_m
        self._phases = rng.uniform(0.0, math.tau, length_m.shape)
        strength = np.array([*roughness.waves_mps2, *roughness.waves_radps])
        even = strength * math.sqrt(2.0 / roughness.waves)
        self._waves = even / (self._k * REFERENCE_MPS)
        self._waves[:, :3] /= self._k[:, :3] * REFERENCE_MPS

    def _draw_knocks(self, ride: Ride, pivots_m: tuple[float, ...], rng: Generator) -> None:
        roughness = self._roughness
        stops_m = ride.line.stops_m
        first, last = float(stops_m[0]), float(stops_m[-1])
        count = int(rng.poisson(roughness.jolts_per_km * (last - first) / 1000.0))
        jolts_m = rng.uniform(first, last, count)
        jolts = rng.standard_normal((count, 6)) * [*roughness.jolt_mps2, *roughness.jolt_radps]
        joints_m = np.arange(first, last, roughness.joint_m) if roughness.joint_m else np.zeros(0)
        joint = np.array([*roughness.joint_mps2, *roughness.joint_radps])
        places = np.concatenate([jolts_m, joints_m])
        sizes = np.concatenate([jolts, np.tile(joint, (len(joints_m), 1))])
        # the first pivot passes at its own place, those behind it, as x points, one after another
        at_m = np.concatenate([places - ride.direction * x for x in pivots_m])
        sizes = np.tile(sizes, (len(pivots_m), 1))
        passed_m, knocks = [], []
        for leg in ride.legs:
            gone_m = leg.fold_m + leg.along * at_m
            inside = (gone_m > leg.ends_m[0]) & (gone_m < leg.ends_m[1])
            passed_m.append(gone_m[inside])
            knocks.append(sizes[inside])
        gone_m, sizes = np.concatenate(passed_m), np.concatenate(knocks)
        order = np.argsort(gone_m)
        time_s = np.arange(0.0, ride.duration_s, 1.0 / NODES_HZ)
        self._knocks_s = np.interp(gone_m[order], ride.gone_m(time_s), time_s)
        speed = np.interp(self._knocks_s, time_s, np.abs(ride.motion(time_s).speed_mps))
        self._knocks = sizes[order] * (speed / REFERENCE_MPS)[:, None]

    def felt(self, motion: Motion, time_s: Array) -> tuple[Array, Array]:
        """Force in m/s² and rate in rad/s at instants of the ride, (n, 3) each."""
        total = self._waved(motion) + self._knocked(time_s) + self._idled(motion, time_s)
        return total[:, :3], total[:, 3:]

    def _waved(self, motion: Motion) -> Array:
        if not np.any(self._waves):
            return np.zeros((len(motion.arc_length_m), 6))
        speed, change = motion.speed_mps, motion.acceleration_mps2
        way = motion.arc_length_m * self._direction
        total = np.zeros((len(way), 6))
        for k, phases, sizes in zip(self._k, self._phases, self._waves, strict=True):
            angle = np.outer(way, k) + phases
            sine, cosine = np.sin(angle), np.cos(angle)
            total[:, :3] += (sizes * k * cosine)[:, :3] * change[:, None]
            total[:, :3] -= (sizes * k**2 * sine)[:, :3] * speed[:, None] ** 2
            total[:, 3:] += (sizes * k * cosine)[:, 3:] * speed[:, None]
        return total

    def _knocked(self, time_s: Array) -> Array:
        total = np.zeros((len(time_s), 6))
        if not len(self._knocks_s):
            return total
        last = np.searchsorted(self._knocks_s, time_s, side="right")
        for back in range(1, LAST + 1):
            index = last - back
            since = np.where(index >= 0, time_s - self._knocks_s[index], np.inf)
            total += (
                knock(since * math.tau * self._roughness.knock_hz)[:, None] * self._knocks[index]
            )
        return total

    def _idled(self, motion: Motion, time_s: Array) -> Array:
        roughness = self._roughness
        strength = np.array([*roughness.idle_mps2, *roughness.idle_radps])
        if not np.any(strength):
            return np.zeros((len(time_s), 6))
        total = np.zeros((len(time_s), 6))
        for tones, phases in zip(self._tones_hz, self._tone_phases, strict=True):
            total += np.sin(math.tau * np.outer(time_s, tones) + phases)
        slow = np.exp(-((motion.speed_mps / IDLE_MPS) ** 2))
        idled: Array = total * strength * slow[:, None]
        return idled


def knock(tau: Array) -> Array:
    """Second derivative of Im τ³ e^(pτ) with p = −`DECAY` + i, its largest value 1; 0 before."""
    tau = np.where((tau >= 0.0) & (tau < 60.0), tau, 0.0)
    scaled: Array = _knock(tau) / _KNOCK_MAX
    return scaled


def _knock(tau: Array) -> Array:
    p = complex(-DECAY, 1.0)
    felt: Array = (np.exp(p * tau) * (6.0 * tau + 6.0 * p * tau**2 + p**2 * tau**3)).imag
    return felt


_KNOCK_MAX = float(np.abs(_knock(np.linspace(0.0, 60.0, 6001))).max())
