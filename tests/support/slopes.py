"""Rides over a track of known slope, as a localiser and a resampler would tell of them.

No filter runs: states are the truth with a pitch that has the springs' nod and an error in it, so
that a ride takes a second, and what is told wrong is told on purpose.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter, lfilter_zi

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Ekf, Gnss, Vehicle, Wheels
from tramstream.processor import Sample
from tramstream.processors.grade.processor import GradeEstimator
from tramstream.proto.estimate_pb2 import MapMatch, MotionState
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import WheelReading
from tramstream.proto.sync_pb2 import SyncFrame

Array = NDArray[np.float64]
START_NS = 1_790_000_000 * S
FRAME_S = 0.02
"""Half as many frames as live: a ride of three minutes takes a second."""
FIX_FRAMES = 10
GRAVITY = 9.81
FOLLOWED_S = 0.1
"""By which springs follow a force; how they swing as well is in `reproduce grade`."""
M_PER_PULSE = 0.001
DRAG = 9.13


@dataclass(frozen=True)
class Slopes:
    """A ride from stop to stop, and what is told of it; fields are of the truth."""

    duration_s: float = 125.0
    direction: float = 1.0
    """-1: the vehicle runs backwards, along the same line."""
    nod: float = 0.005
    """Of the springs, rad per m/s²."""
    pitch_error_rad: float = 0.0
    pitch_std_rad: float = 3e-4
    mass_kg: float = 40_000.0
    rolling: float = 0.003
    cruise_mps: float = 12.0
    acceleration_mps2: float = 1.0
    run_s: float = 40.0
    dwell_s: float = 15.0
    pivot_m: float = 0.0
    localised: bool = True
    localised_until_s: float = math.inf
    localised_from_s: float = math.inf
    """Again."""
    forced: bool = True
    fixes: bool = True
    heights: bool = True
    height_jump_m: float = 0.0
    """From the middle on."""
    wheels: bool = True
    matched: bool = False
    seed: int = 1
    settings: dict[str, Any] = field(default_factory=dict)

    # The truth -----------------------------------------------------------------------------------
    @property
    def time_s(self) -> Array:
        return FRAME_S * np.arange(1, round(self.duration_s / FRAME_S))

    def motion(self) -> tuple[Array, Array, Array]:
        """Speed along x, acceleration, place."""
        time_s = self.time_s
        ramp = self.cruise_mps / self.acceleration_mps2
        phase = np.mod(time_s - self.dwell_s, self.run_s + self.dwell_s)
        moving = (time_s >= self.dwell_s) & (phase < self.run_s)
        braking = phase > self.run_s - ramp
        speed = np.minimum(phase, self.run_s - phase) * self.acceleration_mps2
        speed = np.where(moving, np.clip(speed, 0.0, self.cruise_mps), 0.0)
        pushing = moving & ((phase < ramp) | braking)
        change = np.where(pushing, np.where(braking, -1.0, 1.0) * self.acceleration_mps2, 0.0)
        speed, change = self.direction * speed, self.direction * change
        return speed, change, np.cumsum(speed) * FRAME_S

    def slope_rad(self, place_m: Array) -> Array:
        """Along x of the vehicle, which does not turn."""
        slope: Array = 0.03 * np.sin(place_m / 90.0) + 0.01 * np.sin(place_m / 37.0)
        return slope

    def followed(self, force: Array) -> Array:
        """The force that springs have followed."""
        keep = math.exp(-FRAME_S / FOLLOWED_S)
        start = lfilter_zi([1.0 - keep], [1.0, -keep]) * force[0]
        followed, _ = lfilter([1.0 - keep], [1.0, -keep], force, zi=start)
        felt: Array = np.asarray(followed)
        return felt

    # What is told --------------------------------------------------------------------------------
    @property
    def vehicle(self) -> Vehicle:
        return Vehicle(
            vehicle="slopes",
            gnss=Gnss(device="none"),
            wheels=Wheels(m_per_pulse=M_PER_PULSE),
            ekf=Ekf(pivot_m=self.pivot_m),
            sections={"grade": self.settings} if self.settings else {},
        )

    def samples(self) -> Iterator[Sample]:
        """Frames, each followed by the state (and the match) of its instant."""
        rng = np.random.default_rng(self.seed)
        speed, change, place = self.motion()
        slope, under = self.slope_rad(place - self.pivot_m), self.slope_rad(place)
        height = 250.0 + np.cumsum(speed * under) * FRAME_S
        force = change + GRAVITY * slope
        pitch = -slope - self.nod * self.followed(force) + self.pitch_error_rad
        pitch = pitch + 1e-4 * rng.standard_normal(len(pitch))
        error = 0.0
        motor = self.mass_kg * (change + GRAVITY * (under + self.rolling * np.sign(speed)))
        motor = np.where(speed == 0.0, 0.0, motor + DRAG * speed * np.abs(speed))
        for k, time_s in enumerate(self.time_s.tolist()):
            stamp_ns = START_NS + round(time_s * S)
            frame = SyncFrame(stamp_ns=stamp_ns, sequence=k + 1)
            if self.wheels:
                pulses = math.floor(place[k] / M_PER_PULSE)
                frame.odometry.add(
                    stamp_ns=stamp_ns, wheels=[WheelReading(wheel="middle", pulses=pulses)]
                )
                if self.forced:
                    frame.odometry[0].motor_force_n = motor[k]
            if k % FIX_FRAMES == 0 and self.fixes:
                error = 0.99 * error + 0.14 * rng.standard_normal()
                jump = self.height_jump_m if time_s > self.duration_s / 2 else 0.0
                climb = speed[k] * under[k] + 0.05 * rng.standard_normal()
                frame.gnss.append(self._fix(stamp_ns, height[k] + error + jump, climb, speed[k]))
            yield Sample(keys.SYNC_FRAME, frame, stamp_ns, k + 1)
            away = self.localised_until_s < time_s < self.localised_from_s
            if self.localised and not away:
                yield self._state(stamp_ns, k, speed[k], change[k], pitch[k])
            if self.matched:
                match = MapMatch(
                    stamp_ns=stamp_ns,
                    sequence=k + 1,
                    state=MapMatch.ON_TRACK,
                    edge="a-b",
                    run=0,
                    chainage_m=abs(place[k]),
                    probability=0.999,
                )
                yield Sample(keys.MAP_MATCH, match, stamp_ns, k + 1)

    def _fix(self, stamp_ns: int, height_m: float, climb_mps: float, speed: float) -> GnssFix:
        fix = GnssFix(
            stamp_ns=stamp_ns,
            valid=True,
            fix_type=GnssFix.FIX_3D,
            latitude_deg=50.0,
            longitude_deg=14.0,
            horizontal_std_m=1.0,
            vertical_std_m=1.0,
            vel_n_mps=abs(speed),
            vel_e_mps=0.0,
            speed_mps=abs(speed),
            speed_std_mps=0.05,
        )
        if self.heights:
            fix.height_ellipsoid_m = height_m
            fix.vel_d_mps = -climb_mps
        return fix

    def _state(self, stamp_ns: int, k: int, speed: float, change: float, pitch: float) -> Sample:
        covariance = np.zeros((7, 7))
        covariance[5, 5] = self.pitch_std_rad**2
        state = MotionState(
            stamp_ns=stamp_ns,
            sequence=k + 1,
            mode=MotionState.TRACKING,
            latitude_deg=50.0,
            longitude_deg=14.0,
            speed_mps=speed,
            acceleration_mps2=change,
            pitch_rad=pitch,
            standing=speed == 0.0,
            speed_std_mps=0.02,
            covariance=covariance[np.triu_indices(7)].tolist(),
        )
        return Sample(keys.EST_STATE, state, stamp_ns, k + 1)


class Found:
    """What the processor said of a ride, as columns beside the truth."""

    def __init__(self, ride: Slopes) -> None:
        self.ride = ride
        self.processor = GradeEstimator(ride.vehicle)
        self.said = [made for sample in ride.samples() for made in self.processor.step(sample)]
        self.states = [each.message for each in self.said if each.key is keys.EST_GRADE]
        self.stops = [each.message for each in self.said if each.key is keys.EST_STOPPING]
        stamps = np.array([each.stamp_ns for each in self.states])
        self.time_s = (stamps - START_NS) / S
        row = np.rint(self.time_s / FRAME_S).astype(int) - 1
        speed, _, place = ride.motion()
        self.speed, self.place = speed[row], place[row]
        self.slope = ride.slope_rad(self.place)
        self.error = np.array([each.grade_rad for each in self.states]) - self.slope
        self.std = np.array([each.grade_std_rad for each in self.states])

    @property
    def last(self) -> Any:
        """The last state."""
        return self.states[-1]

    def rms_percent(self, since_s: float = 60.0, until_s: float = math.inf) -> float:
        """RMS of the error over some time, in percent of slope."""
        chosen = (self.time_s >= since_s) & (self.time_s < until_s)
        return 100.0 * float(np.sqrt(np.mean(self.error[chosen] ** 2)))

    def nees(self, since_s: float = 60.0) -> float:
        """Mean of the squared error over its variance."""
        chosen = self.time_s >= since_s
        return float(np.mean((self.error[chosen] / self.std[chosen]) ** 2))

    def learned(self, name: str) -> tuple[float, float]:
        """The last value of a parameter, and its deviation."""
        (message,) = [e.message for e in self.said if e.key is keys.EST_GRADE_PARAMETERS][-1:]
        (row,) = [each for each in message.parameters if each.name == name]
        return row.value, row.std

    def events(self) -> list[str]:
        """Kinds that were raised, in order."""
        path = keys.EVENT.at("grade").path
        return [each.message.kind for each in self.said if each.key.path == path]
