"""The localisation filter of kaspar2023 behind the contract of every localiser.

Each frame is a step: prediction, then accelerometer along x and gyroscopes, wheels, fixes, each as
it is there. As in the work, GNSS noise counts as white, nothing is gated, standing still is nothing
special, acceleration and rates are measured anew each step, and a wheel's message tells the speed
at its own instant. The noise of a fix is what the receiver says.

The work starts from a known place and heading. Here nobody knows them: the filter starts as if the
vehicle stood, at yaw 0, and reckons in that turned frame until the fixes have moved 5 m away from
the last one taken standing. The angle between what the fixes and what the filter moved by is the
heading that was missing; curves on the way do no harm. Until then (HEADING_UNKNOWN) the newest fix
is all there is to say about the position. Where the two distances do not agree, the waiting starts
anew with that fix.

Left out: the lever arm of the IMU and the time between a wheel's reading and the frame (at most a
step). A gap in the inertial data makes place, motion and heading unknown; what was learned stays.

Equations: docs/theory.md, section 8.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tramstream.attitude import C_bv_of
from tramstream.clock import S
from tramstream.config import Vehicle, takes_track
from tramstream.errors import ConfigError
from tramstream.estimation.fixes import antenna_l, deviations, place_deg, unusable
from tramstream.estimation.localiser import Array, Estimate, Learned, Verdict, values_of
from tramstream.estimation.track import LocalTrack, Pose, Trail, TrailMemory
from tramstream.events.kinds import Event
from tramstream.geodesy import LocalLevel, normal_gravity_mps2
from tramstream.memory.annotations import Varying
from tramstream.memory.stage import assign, from_plain, to_plain
from tramstream.processor import State
from tramstream.processors.kaspar2023 import model
from tramstream.processors.kaspar2023.events import HEADING_LOST
from tramstream.processors.kaspar2023.filter import Kaspar2023Filter, warm_up
from tramstream.processors.kaspar2023.model import SIZE, STEP_S, Ix
from tramstream.processors.kaspar2023.predictor import Ahead, AheadMemory
from tramstream.processors.kaspar2023.start import start_std
from tramstream.processors.kaspar2023.wheels import PairMemory, Reading, Refused, WheelPair
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame

HEADING_DISTANCE_M = 5.0
AGREEMENT = 0.5
"""Fixes and filter may differ by so much of what the filter has moved, to give a heading."""
STANDING_MPS = 0.05
OUTAGE_S = 5.0
"""Without a fix for so long the filter is dead reckoning."""
MAX_GAP_S = 1.0
"""Longest inertial gap that is predicted over, with the last acceleration and rates."""
POSITION = (Ix.EAST, Ix.NORTH, Ix.UP)
GNSS = ("gnss_east", "gnss_north", "gnss_up")
TRACK = ("track_across",)

_MOTION = np.array([Ix.EAST, Ix.NORTH, Ix.UP, Ix.SPEED, Ix.ROLL, Ix.PITCH, Ix.YAW])
_MOTION_IN_P = (_MOTION[:, None] * SIZE + _MOTION).ravel()
_NAMES: tuple[tuple[Ix, str, str], ...] = (
    (Ix.ACCEL_SCALE, "accel_scale_x", "1"),
    (Ix.GYRO_SCALE_X, "gyro_scale_x", "1"),
    (Ix.GYRO_SCALE_Y, "gyro_scale_y", "1"),
    (Ix.GYRO_SCALE_Z, "gyro_scale_z", "1"),
    (Ix.ACCEL_INSTABILITY, "accel_instability_x", "m/s²"),
    (Ix.ACCEL_WALK, "accel_bias_x", "m/s²"),
    (Ix.GYRO_INSTABILITY_X, "gyro_instability_x", "rad/s"),
    (Ix.GYRO_INSTABILITY_Y, "gyro_instability_y", "rad/s"),
    (Ix.GYRO_INSTABILITY_Z, "gyro_instability_z", "rad/s"),
    (Ix.GYRO_WALK_X, "gyro_bias_x", "rad/s"),
    (Ix.GYRO_WALK_Y, "gyro_bias_y", "rad/s"),
    (Ix.GYRO_WALK_Z, "gyro_bias_z", "rad/s"),
    (Ix.WHEEL_LEFT, "wheel_left", "pulses/(m/s)"),
    (Ix.WHEEL_RIGHT, "wheel_right", "pulses/(m/s)"),
)


@dataclass
class LocaliserMemory:
    """What a `Kaspar2023Localiser` remembers."""

    x: Varying
    P: Varying
    """Of the filter, which replaces them with every step: as they were when last asked for."""
    level: LocalLevel | None = None
    stamp_ns: int = 0
    heading_known: bool = False
    fix: Array = field(default_factory=lambda: np.zeros((3, 3)))
    """The newest: antenna in `l`, variances, where the filter had it."""
    start_fix: Array = field(default_factory=lambda: np.zeros((3, 3)))
    """Likewise, the last taken standing."""
    fix_ns: int = 0
    wheels: PairMemory = field(default_factory=PairMemory)
    ahead: AheadMemory = field(default_factory=AheadMemory)
    trail: TrailMemory = field(default_factory=TrailMemory)
    given: list[Verdict] = field(default_factory=list)
    """Verdicts on what was taken since the last frame."""


class Kaspar2023Localiser:
    """The 25 states of the work on the frames of the resampler.

    Parameters
    ----------
    vehicle : tramstream.config.Vehicle

    Raises
    ------
    ConfigError
        For a vehicle without an IMU.
    """

    name = "kaspar2023"

    def __init__(self, vehicle: Vehicle) -> None:
        imu = vehicle.imu
        if imu is None:
            raise ConfigError(
                "$.imu: the model kaspar2023 needs an IMU", cure="$.ekf.model may be tram"
            )
        C_vb = C_bv_of(imu).T
        self._axes = np.zeros((4, 6))  # of accelerometer and gyroscopes, case axes, to (f_x, ω_v)
        self._axes[0, :3], self._axes[1:, 3:] = C_vb[0], C_vb
        densities = [imu.accel_noise_mps2_rthz**2] + 3 * [imu.gyro_noise_radps_rthz**2]
        self._inertial_variance = np.diag(densities) / STEP_S
        gnss = vehicle.gnss
        self._p_va_v = np.array(gnss.lever_arm_m if gnss else (0.0, 0.0, 0.0), dtype=float)
        self._floor_m = gnss.error_floor_m if gnss else 0.0
        self._start_std = start_std(vehicle)
        Q = model.process_noise(imu.accel_walk_mps3_rthz, imu.gyro_walk_radps2_rthz)
        self._filter = Kaspar2023Filter(Q)
        self.memory = memory = LocaliserMemory(self._filter.x, self._filter.P)
        self._ahead = Ahead(Q, memory.ahead)
        self._wheels = WheelPair(vehicle, memory.wheels)
        self._gravity_mps2 = 0.0
        self._complaints: list[Event] = []
        self._pivot_m = vehicle.ekf.pivot_m
        span_s = vehicle.ekf.track_delay_s
        self._trail = Trail(span_s, memory.trail) if takes_track(vehicle) else None
        warm_up(Q)

    @property
    def level(self) -> LocalLevel | None:
        return self.memory.level

    def take(self, frame: SyncFrame) -> Estimate | None:
        """See `Localiser`; frames without an inertial mean are left out."""
        if not frame.HasField("imu") or frame.stamp_ns <= self.memory.stamp_ns:
            return None
        if self.memory.level is None and not self._begin(frame.gnss):
            return None
        self._advance(frame.stamp_ns)
        verdicts, self.memory.given = self.memory.given, []
        verdicts += self._take_inertial(frame.imu)
        for odometry in frame.odometry:
            verdicts += self._take_wheels(odometry)
        for fix in frame.gnss:
            if self._usable(fix):
                verdicts += self._take_fix(fix)
        return self._estimate(self._filter, frame.stamp_ns, verdicts)

    def _pose(self) -> Pose:
        x = self._filter.x
        east, north, yaw, pitch = x[[Ix.EAST, Ix.NORTH, Ix.YAW, Ix.PITCH], 0].tolist()
        pivot = self._pivot_m
        return east - pivot * math.cos(yaw), north - pivot * math.sin(yaw), yaw, pitch

    def follow(self, track: LocalTrack) -> bool:
        """The work's map: the distance to the track, in normal form (errata of 3.35)."""
        then = self._trail.at(track.stamp_ns, self._pose()) if self._trail is not None else None
        told = track.told(*then[:3]) if then is not None and self.memory.heading_known else None
        if told is None:
            return False
        H = np.zeros((1, SIZE))
        H[0, Ix.EAST], H[0, Ix.NORTH] = told.normal_east, told.normal_north
        across = np.array([[told.across_m]])
        R = np.array([[told.across_variance]])
        self._filter.update(np.zeros((1, 1)), lambda _: H, lambda _: across, R)
        self.memory.given += _verdicts(self._filter, TRACK)
        return True

    def see(self, mean: ImuMean) -> None:
        """See `Localiser`."""
        self._ahead.append(mean.stamp_ns, self._reading(mean)[:, 0].tolist())

    def ahead(self) -> Estimate | None:
        """See `Localiser`."""
        newest_ns = self._ahead.newest_ns
        if self.memory.level is None or newest_ns <= self.memory.stamp_ns:
            return None
        kalman = self._ahead.predict(self._filter, self.memory.stamp_ns, self._gravity_mps2)
        return self._estimate(kalman, newest_ns, [])

    # Start ---------------------------------------------------------------------------------------
    def _begin(self, fixes: Sequence[GnssFix]) -> bool:
        """Lay the origin of `l` at the first usable fix, if there is one."""
        first = next((fix for fix in fixes if self._usable(fix)), None)
        if first is None:
            return False
        self._lay(LocalLevel.at_deg(*place_deg(first)))
        self.memory.stamp_ns = first.stamp_ns
        self._filter.x = np.zeros((SIZE, 1))
        self._filter.P = np.diag(self._start_std**2)
        return True

    def _usable(self, fix: GnssFix) -> bool:
        reason = unusable(fix, self.memory.level) if fix.valid else None
        if reason is not None:
            self._complaints.append(reason)
        return fix.valid and reason is None

    def _lay(self, level: LocalLevel) -> None:
        self.memory.level = level
        self._gravity_mps2 = float(normal_gravity_mps2(level.latitude_rad, level.height_m))

    def _lose(self) -> None:
        """Forget place, motion and attitude; keep what was learned about the sensors."""
        x, P = self._filter.x.copy(), self._filter.P.copy()
        moving = slice(Ix.EAST, Ix.RATE_Z + 1)
        x[moving] = 0.0
        P[moving, :] = P[:, moving] = 0.0
        P[moving, moving] = np.diag(self._start_std[moving] ** 2)
        self._filter.x, self._filter.P = x, P
        self.memory.heading_known = False
        self.memory.start_fix = np.zeros((3, 3))
        self._wheels.forget()

    def _find_heading(self, age_s: float) -> None:
        """Turn the filter's frame so that it has moved as the fixes have."""
        kalman, (z, variance, reckoned) = self._filter, self.memory.fix
        start_z, start_variance, start_reckoned = self.memory.start_fix
        moved, reckoned_way = (z - start_z)[:2], (reckoned - start_reckoned)[:2]
        way_m, reckoned_m = math.hypot(*moved), math.hypot(*reckoned_way)
        started = start_variance[0] > 0.0
        waiting = reckoned_m < HEADING_DISTANCE_M or way_m < HEADING_DISTANCE_M
        standing = waiting and abs(kalman.x[Ix.SPEED, 0]) < STANDING_MPS
        if started and waiting and not standing:
            return
        if not started or standing or abs(way_m - reckoned_m) > AGREEMENT * reckoned_m:
            self.memory.start_fix = self.memory.fix.copy()
            return
        x, P = kalman.x.copy(), kalman.P.copy()
        x[Ix.YAW, 0] += math.atan2(moved[1], moved[0]) - math.atan2(*reckoned_way[::-1])
        x[list(POSITION), 0] += z - model.antenna(x, self._p_va_v, age_s)[:, 0]
        for slot, known in zip(POSITION, variance, strict=True):
            P[slot, :] = P[:, slot] = 0.0
            P[slot, slot] = known
        P[Ix.YAW, Ix.YAW] += (variance[0] + start_variance[0]) / way_m**2
        kalman.x, kalman.P = x, P
        self.memory.heading_known = True

    # Steps ---------------------------------------------------------------------------------------
    def _advance(self, stamp_ns: int) -> None:
        """Predict in steps of about `STEP_S`; over too long a gap nothing is known."""
        dt_s, self.memory.stamp_ns = (stamp_ns - self.memory.stamp_ns) / S, stamp_ns
        before = self._pose()
        if dt_s > MAX_GAP_S:
            self._complaints.append(HEADING_LOST(silence_s=dt_s, limit_s=MAX_GAP_S))
            self._lose()
            return
        steps = max(1, round(dt_s / STEP_S))
        for _ in range(steps):
            self._filter.predict(dt_s=dt_s / steps)
        if self._trail is not None:
            self._trail.carry(before, self._pose())
            self._trail.pass_by(stamp_ns)

    def _reading(self, mean: ImuMean) -> Array:
        """(f_x, ω_v), shape (4, 1)."""
        accel = (mean.accel_x_mps2, mean.accel_y_mps2, mean.accel_z_mps2)
        gyro = (mean.gyro_x_radps, mean.gyro_y_radps, mean.gyro_z_radps)
        reading: Array = self._axes @ np.array((*accel, *gyro)).reshape(6, 1)
        return reading

    def _take_inertial(self, mean: ImuMean) -> list[Verdict]:
        z, gravity = self._reading(mean), (self._gravity_mps2,)
        R = self._inertial_variance
        self._filter.update(z, model.inertial_jacobian, model.inertial, R, gravity, gravity)
        return _verdicts(self._filter, model.INERTIAL)

    def _take_wheels(self, odometry: Odometry) -> list[Verdict]:
        reading = self._wheels.read(odometry)
        if isinstance(reading, Refused):
            self._complaints.append(reading.why)
        if not isinstance(reading, Reading):
            return []
        self._filter.update(
            reading.z,
            reading.jacobian,
            reading.function,
            reading.R,
            reading.arguments,
            reading.arguments,
        )
        return _verdicts(self._filter, reading.names)

    def _take_fix(self, fix: GnssFix) -> list[Verdict]:
        assert self.memory.level is not None  # laid at the first fix
        z = np.array(antenna_l(fix, self.memory.level))
        level_std, up_std = deviations(fix, self._floor_m)
        variance = np.array((level_std, level_std, up_std)) ** 2
        age_s = (self.memory.stamp_ns - fix.stamp_ns) / S
        arguments = (self._p_va_v, age_s)
        reckoned = model.antenna(self._filter.x, *arguments)[:, 0]
        self.memory.fix, self.memory.fix_ns = np.array((z, variance, reckoned)), fix.stamp_ns
        if not self.memory.heading_known:
            self._find_heading(age_s)
            return []
        self._filter.update(
            z.reshape(3, 1),
            model.antenna_jacobian,
            model.antenna,
            np.diag(variance),
            arguments,
            arguments,
        )
        return _verdicts(self._filter, GNSS)

    # What it says --------------------------------------------------------------------------------
    def _estimate(
        self, kalman: Kaspar2023Filter, stamp_ns: int, verdicts: list[Verdict]
    ) -> Estimate:
        x = kalman.x[:, 0].tolist()
        covariance = kalman.P.take(_MOTION_IN_P).reshape(7, 7)
        age_s = (stamp_ns - self.memory.fix_ns) / S
        speed = x[Ix.SPEED]
        if self.memory.heading_known:
            p_l = x[Ix.EAST], x[Ix.NORTH], x[Ix.UP]
            mode = MotionState.TRACKING if age_s <= OUTAGE_S else MotionState.DEAD_RECKONING
        else:
            (east, north, up), variance, _ = self.memory.fix.tolist()
            p_l, mode = (east, north, up), MotionState.HEADING_UNKNOWN
            covariance[:3, :] = covariance[:, :3] = 0.0
            covariance[:3, :3] = np.diag(variance) + np.eye(3) * (speed * age_s) ** 2
            covariance[6, 6] += math.pi**2 / 3.0  # any direction
        return Estimate(
            stamp_ns=stamp_ns,
            mode=mode,
            values=values_of(
                (*p_l, speed, x[Ix.ROLL], x[Ix.PITCH], x[Ix.YAW]),
                covariance,
                x[Ix.ACCELERATION],
                x[Ix.RATE_Z],
            ),
            standing=abs(speed) < STANDING_MPS,
            verdicts=verdicts,
        )

    def learned(self) -> list[Learned]:
        """See `Localiser`."""
        x, P = self._filter.x, self._filter.P
        return [
            Learned(name, float(x[slot, 0]), math.sqrt(max(P[slot, slot], 0.0)), unit)
            for slot, name, unit in _NAMES
        ]

    def complaints(self) -> list[Event]:
        """See `tramstream.estimation.localiser.Localiser`."""
        found, self._complaints = self._complaints, []
        return found

    # Memory --------------------------------------------------------------------------------------
    def snapshot(self) -> State:
        """See `Localiser`."""
        memory = self.memory
        memory.x, memory.P = self._filter.x, self._filter.P
        return to_plain(memory)

    def restore(self, state: State) -> None:
        """See `Localiser`."""
        memory = self.memory
        assign(memory, from_plain(LocaliserMemory, state))
        self._filter.x, self._filter.P = memory.x, memory.P
        if memory.level is not None:
            self._lay(memory.level)
        self._complaints = []


def _verdicts(kalman: Kaspar2023Filter, names: Sequence[str]) -> list[Verdict]:
    """What became of the rows of the last measurement."""
    return [
        Verdict(name, innovation, abs(variance), variance > 0.0)
        for name, (innovation, variance) in zip(names, kalman.taken.tolist(), strict=True)
    ]
