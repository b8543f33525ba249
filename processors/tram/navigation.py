"""One frame of the fusion horizon through the model `tram`, once the filter runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import attrgetter
from typing import Any, Protocol

import numpy as np

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Vehicle, takes_track
from tramstream.estimation.fixes import antenna_l, unusable
from tramstream.estimation.kalman import Array
from tramstream.estimation.localiser import Learned, Verdict
from tramstream.estimation.track import LocalTrack, OnTrack, Pose, Trail
from tramstream.events.kinds import Event
from tramstream.geodesy import LocalLevel, normal_gravity_mps2
from tramstream.memory.stage import assign, copied
from tramstream.processors.tram.navigation_memory import NavigationMemory
from tramstream.processors.tram_filter.estimate import learned
from tramstream.processors.tram_filter.events import ASTRAY
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_filter.modes import RUNNING, published_mode
from tramstream.processors.tram_filter.start import PITCH_STD_RAD, ROLL_STD_RAD, first_deviations
from tramstream.processors.tram_model.lateral_force import LateralForce
from tramstream.processors.tram_model.level_force import LevelForce
from tramstream.processors.tram_model.measurement import SCALAR_GATE
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.track import TrackDistance, TrackGrade, TrackHeading
from tramstream.processors.tram_model.vertical_constraint import VerticalConstraint
from tramstream.processors.tram_model.zero_angular_rate import ZeroAngularRate
from tramstream.processors.tram_sources.course import Course
from tramstream.processors.tram_sources.divergence import Divergence, Heard
from tramstream.processors.tram_sources.gnss import Fixes
from tramstream.processors.tram_sources.readings import (
    BELIEVED,
    FOR_GOOD_NS,
    FOUND_STUCK,
    Readings,
)
from tramstream.processors.tram_sources.wheels import WheelPair
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.sync_pb2 import SyncFrame

LEAVING_STD_MPS = 0.01
"""Speed that standing may hide in its last moment, with wheels; chosen by hand."""
BLIND_LEAVING_STD_MPS = 0.3
"""The same speed without wheels; chosen by hand."""
ALONE_LEAVING_STD_MPS = 1.5
"""The same where nothing but places of fixes tells: a second's worth of it; chosen by hand."""
SURE_MPS, SURE_SIGMA = 1.0, 4.0
"""Least speed that the filter is sure of, less so many deviations; chosen by hand."""
ASTRAY_NS = S // 2
"""A measurement so far outside of its frame has a stamp that is wrong."""
_EAST, _NORTH, _YAW, _PITCH = (int(each) for each in (Ix.EAST, Ix.NORTH, Ix.YAW, Ix.PITCH))


class Watcher(Protocol):
    """Whoever wants to know what becomes of a navigation, as a smoother does."""

    def heading_found(self, navigation: Navigation) -> None:
        """Learn that the heading is known from here on."""

    def heading_lost(self, navigation: Navigation) -> None:
        """Learn that it is not, from here on."""

    def stepped(self, navigation: Navigation, standing: bool) -> None:
        """Learn that a frame has been gone through."""

    def mark(self, navigation: Navigation) -> int:
        """Give the number by which `restored` finds this place again."""

    def restored(self, navigation: Navigation, mark: int) -> None:
        """Learn that the memory is again that of a marked place; 0: of an unmarked one."""

    def heading_confirmed(self, navigation: Navigation) -> None:
        """Learn that the heading is held to be the right one."""

    def restarted(self) -> None:
        """Learn that there is another navigation from here on."""


class Navigation:
    """Filter, wheels and fixes of a vehicle whose place is known."""

    def __init__(self, vehicle: Vehicle, level: LocalLevel, watcher: Watcher | None = None) -> None:
        self.level = level
        self._watcher = watcher
        gravity = float(normal_gravity_mps2(level.latitude_rad, level.height_m))
        self.ekf = TramFilter(vehicle, gravity)
        self.complaints: list[Event] = []
        self.readings = Readings(vehicle, self.complaints)
        self.inertial = self.readings.inertial
        """The inertial readings, see `records.Inertial`."""
        self.reading, self.between = self.readings.now, self.readings.between
        self.memory = memory = NavigationMemory(self.ekf.remembered, self.readings.memory)
        self.wheels = WheelPair(vehicle, memory.wheels)
        self.fixes = Fixes(vehicle, memory.fixes)
        self._course = Course(self.fixes.tau_s, memory.course)
        self._divergence = Divergence(vehicle, self.fixes.tau_s, memory.divergence)
        self._lateral, self._vertical = LateralForce(self.readings.numbers), VerticalConstraint()
        imu = vehicle.imu
        self._inside_m2 = vehicle.ekf.bogie_distance_m**2 / 8
        """Times a curvature, how far inside of the rail the chord is midway."""
        self._heaves = bool(self.ekf.parameters["vertical_density"][0] > 0.0)
        self._white_rate = imu.gyro_noise_radps_rthz**2 if imu is not None else 0.0
        self._white_force = imu.accel_noise_mps2_rthz**2 if imu is not None else 0.0
        span_s = vehicle.ekf.track_delay_s
        self._trail = Trail(span_s, memory.trail) if takes_track(vehicle) else None
        self._begin(vehicle)

    def _begin(self, vehicle: Vehicle) -> None:
        """First values and deviations of all states but the position's."""
        self.ekf.P = np.diag(first_deviations(vehicle) ** 2)
        delay_s, pivot_m = vehicle.wheels.delay_s, vehicle.ekf.pivot_m
        self.ekf.set_states(Ix.WHEEL_DELAY, (delay_s, pivot_m))

    @property
    def alone(self) -> bool:
        """Whether nothing but fixes tells of the motion."""
        return self.readings.coasting and not self.wheels.known

    def read(self, frame: SyncFrame) -> bool:
        """Take over the frame's inertial reading, or the bus' yaw rate; False without a reading."""
        became = self.readings.read(frame, self.ekf)
        if became == FOUND_STUCK:
            self.wheels.trust_again(self.ekf)
        return became == BELIEVED

    # One frame -----------------------------------------------------------------------------------
    def run(self, frame: SyncFrame, standing: bool, noise: Array | None) -> list[Verdict]:
        """Go to the frame's stamp with all that is in it; `read` has been called.

        Parameters
        ----------
        standing : bool
            Whether the vehicle stands.
        noise : ndarray, shape (6,), or None
            Variance that rates and specific forces scatter by, if they are there.
        """
        memory, ekf = self.memory, self.ekf
        now = memory.filter
        if memory.stood and not standing:
            ekf.widen(Ix.SPEED, LEAVING_STD_MPS if self.wheels.known else BLIND_LEAVING_STD_MPS)
        memory.stood = standing
        verdicts, memory.given = memory.given, []
        frame_ns = frame.stamp_ns
        # Copies: to go through what protobuf holds takes three times as long.
        measurements: list[Any] = frame.gnss[:] + frame.odometry[:]
        go_to = ekf.go_to if self._trail is None else self._go_on
        if len(measurements) > 1:
            measurements.sort(key=_stamp)
        for measurement in measurements:
            stamp_ns = measurement.stamp_ns
            if not now.stamp_ns - ASTRAY_NS < stamp_ns < frame_ns + ASTRAY_NS:
                self.complaints.append(_astray(measurement, frame_ns))
                continue
            if stamp_ns < frame_ns:
                go_to(stamp_ns, self.between, standing)
            elif now.stamp_ns < frame_ns:
                go_to(frame_ns, self.between, standing)
            verdicts += self._measure(measurement, standing)
        if now.stamp_ns < frame_ns:
            go_to(frame_ns, self.between, standing)
        if self._trail is not None:
            self._trail.pass_by(frame_ns)
        if noise is None:
            if standing:
                ekf.zero_velocity()
        else:
            if standing:
                self._stand(noise)
            verdicts += self._constrain()
        if self._watcher is not None:
            self._watcher.stepped(self, standing)
        return verdicts

    def _go_on(self, stamp_ns: int, u: Array, standing: bool) -> None:
        """Go to an instant as the filter does, and leave a trail."""
        assert self._trail is not None
        carried, x = self._trail.carried, self.ekf.state
        east, north, yaw, pitch = x[_EAST], x[_NORTH], x[_YAW], x[_PITCH]
        self.ekf.go_to(stamp_ns, u, standing)
        carried[0] += x[_EAST] - east
        carried[1] += x[_NORTH] - north
        carried[2] += x[_YAW] - yaw
        carried[3] += x[_PITCH] - pitch

    def _pose(self) -> Pose:
        x = self.ekf.state
        return x[_EAST], x[_NORTH], x[_YAW], x[_PITCH]

    def _constrain(self) -> list[Verdict]:
        """Take that the vehicle slips sideways no more than it flies."""
        ekf = self.ekf
        refused = ekf.apply(self._lateral)
        if refused:
            if ekf.log_likelihood_sum is None:
                self._divergence.refuse_force(ekf.stamp_ns)
                self._doubt(self._divergence.without_fix(ekf, self.wheels, ekf.stamp_ns))
            (verdict,) = refused
            variance = float(ekf.parameters["lateral_variance"][0])
            distance = verdict.innovation * verdict.innovation / verdict.variance
            refused = [Verdict("lateral_force", math.sqrt(distance * variance), variance, False)]
        if self._heaves:
            ekf.apply(self._vertical)
        return refused

    def _stand(self, noise: Array) -> None:
        """Take what a vehicle that stands shows: no speed, biases as rates, gravity along x."""
        # The floor is the white noise of a 10 ms mean; shaking comes on top of it.
        rate, force = 100.0 * self._white_rate, 100.0 * self._white_force
        roll, pitch, yaw, along, _, _ = noise.tolist()
        ekf = self.ekf
        ekf.zero_velocity()
        variances = max(roll, rate), max(pitch, rate), max(yaw, rate)
        ekf.apply(ZeroAngularRate(self.reading, *variances))
        ekf.apply(LevelForce(self.reading, max(along, force)))

    def _measure(self, measurement: Any, standing: bool) -> list[Verdict]:
        if isinstance(measurement, GnssFix):
            if not measurement.valid or unusable(measurement, self.level):
                return []
            return self._apply_fix(measurement, standing)
        if not self.wheels.known:
            self.wheels.assign(measurement, self.ekf)
        verdicts = self.wheels.apply(measurement, self.ekf)
        for verdict in verdicts:
            if not verdict.accepted:
                self.complaints += self.wheels.refusal(verdict)
        return verdicts

    def _apply_fix(self, fix: GnssFix, standing: bool) -> list[Verdict]:
        """Apply a usable fix, and hear what it says of the filter."""
        judging = not standing and self.ekf.log_likelihood_sum is None
        if judging:
            east, north, _ = antenna_l(fix, self.level)
            self._divergence.before_fix(self.ekf, fix.stamp_ns, east, north)
        verdicts, found = self.fixes.apply(fix, self.ekf, self.level, standing)
        self.complaints += found
        if self.alone and not standing:
            self._course.follow(fix, verdicts, self.ekf, self.fixes, self.level)
        heard = self.fixes.heard
        if not judging or heard is None:
            self._divergence.forget()
            return verdicts
        if heard.velocity_accepted:
            self.wheels.back(fix.stamp_ns)
        self._doubt(self._divergence.after_fix(self.ekf, self.wheels, heard), heard)
        return verdicts

    def catch_up(self, way: complex, velocity: complex) -> None:
        """Go where a vehicle has gone that was taken to stand, and whose fixes alone tell.

        `way` and `velocity` are to the east and, imaginary, to the north.
        """
        ekf, yaw = self.ekf, self.ekf.state[Ix.YAW]
        ekf.shift(Ix.EAST, way.real)
        ekf.shift(Ix.NORTH, way.imag)
        ekf.shift(Ix.GNSS_EAST, -way.real)
        ekf.shift(Ix.GNSS_NORTH, -way.imag)
        ahead = velocity.real * math.cos(yaw) + velocity.imag * math.sin(yaw)
        ekf.reset(Ix.SPEED, max(ahead, 0.0), ALONE_LEAVING_STD_MPS)

    def leave_imu_out(self, for_good: bool) -> None:
        """Do without the IMU for good, whose mounting is wrong, or take it up again."""
        memory, ekf = self.memory, self.ekf
        until_ns = FOR_GOOD_NS if for_good else 0
        if memory.readings.out_ns == until_ns:
            return
        self.readings.leave_out(ekf, until_ns)
        memory.divergence.out_ns = until_ns
        for angle, std in ((Ix.ROLL, ROLL_STD_RAD), (Ix.PITCH, PITCH_STD_RAD)):
            ekf.reset(angle, 0.0, std)
        self.doubt()

    def doubt(self) -> None:
        """Doubt what has moved unseen: attitude, biases, slips."""
        self._divergence.doubt(self.ekf, self.wheels)

    def _doubt(self, found: list[Event], heard: Heard | None = None) -> None:
        """Say that the filter was wrong, where it was; `heard` is the fix that showed it."""
        if not found:
            return
        memory = self.memory
        self.complaints += found
        memory.contradicted = True
        if heard is not None:
            self.fixes.take_place(self.ekf, heard)
        if self.ekf.stamp_ns < memory.divergence.out_ns:
            self.readings.leave_out(self.ekf, memory.divergence.out_ns)

    # Changes of the situation --------------------------------------------------------------------
    def follow(self, track: LocalTrack) -> bool:
        """Take what a map tells of a moment ago; False if that cannot be used."""
        now = self._pose()
        then = self._trail.at(track.stamp_ns, now) if self._trail is not None else None
        told = track.told(*self.ekf.on_map(*then[:2]), then[2]) if then is not None else None
        if then is None or told is None:
            return False
        # What the pitch has turned by since is the grade of another place.
        self.on_track(told._replace(grade_rad=told.grade_rad + then[3] - now[3]))
        return True

    def on_track(self, on_track: OnTrack, gate: float = SCALAR_GATE) -> None:
        """Take that the vehicle is on a track, of which the state as it is is off."""
        memory = self.memory
        ekf, told = self.ekf, on_track
        ekf.walk_map()
        yaw = ekf.state[_YAW]
        east, north = ekf.on_map(ekf.state[_EAST], ekf.state[_NORTH])
        n = told.normal_east, told.normal_north
        across_m = told.across_m - self._inside_m2 * told.bend_per_m
        across = ekf.apply(TrackDistance(*n, across_m, told.across_variance, gate))
        if across and not across[0].accepted:
            self._divergence.refuse_track(ekf.stamp_ns)
        memory.given += across
        self.fixes.noise.on_track(ekf, n, told.across_variance)
        heading = (told.yaw_off_rad, told.bend_per_m, east, north, yaw, told.yaw_variance)
        memory.given += ekf.apply(TrackHeading(*n, *heading, gate))
        if not math.isnan(told.grade_rad):
            memory.given += ekf.apply(TrackGrade(told.grade_rad, told.grade_variance, gate))

    def reset_place(self, fix: GnssFix | None, way_m: float) -> None:
        """Forget the place but for the last fix, and how far that may be."""
        ekf, std, std_up = self.ekf, 1000.0, 1000.0
        if fix is not None:
            ekf.set_states(Ix.EAST, antenna_l(fix, self.level))
            std, std_up = (math.hypot(3.0 * each, way_m) for each in self.accuracies_m(fix))
        ekf.forget((Ix.EAST, Ix.NORTH, Ix.UP), (std, std, std_up))
        ekf.reset(Ix.SPEED, 0.0, 0.0)

    def set_heading(self, yaw_rad: float, std_rad: float) -> None:
        """Set the heading; see `TramFilter.set_heading`."""
        self.ekf.set_heading(yaw_rad, std_rad)
        self.announce_heading()

    def announce_heading(self) -> None:
        """Tell the watcher that the heading is known from here on, found or remembered."""
        if self._watcher is not None:
            self._watcher.heading_found(self)

    def forget_heading(self) -> None:
        """Go on without a heading; see `TramFilter.forget_heading`."""
        self.ekf.forget_heading()
        if self._watcher is not None:
            self._watcher.heading_lost(self)

    def mode(self, stamp_ns: int) -> int:
        """What is published of the place at `stamp_ns`, once the heading is known."""
        return published_mode(RUNNING, (stamp_ns - self.memory.fixes.accepted_ns) / S)

    @property
    def sure_mps(self) -> float:
        """Speed without a sign that the vehicle surely has; 0 where that is little."""
        speed, variance = self.ekf.state[Ix.SPEED], self.ekf.variances[Ix.SPEED]
        sure: float = abs(speed) - SURE_SIGMA * math.sqrt(variance)
        return sure if sure > SURE_MPS else 0.0

    def learned(self) -> list[Learned]:
        """Give what has been learned of the sensors."""
        return learned(self.ekf.state, self.ekf.variances)

    def accuracy_m(self, fix: GnssFix) -> float:
        """Deviation of a fix on each horizontal axis."""
        return self.accuracies_m(fix)[0]

    def accuracies_m(self, fix: GnssFix) -> tuple[float, float]:
        """Deviation of a fix on each horizontal axis, and of its height."""
        return self.fixes.noise.deviations(fix)

    # Memory --------------------------------------------------------------------------------------
    def mark(self) -> None:
        """Note in memory by which number a watcher finds this place again."""
        self.memory.watched = 0 if self._watcher is None else self._watcher.mark(self)

    def kept(self) -> NavigationMemory:
        """Give a copy of the memory, to go back to."""
        self.mark()
        return copied(self.memory)

    def go_back(self, kept: NavigationMemory) -> None:
        """Go on from a copy."""
        assign(self.memory, kept)
        if self._watcher is not None:
            self._watcher.restored(self, kept.watched)


def _astray(measurement: Any, frame_ns: int) -> Event:
    key = keys.GNSS_FIX if isinstance(measurement, GnssFix) else keys.ODO_WHEELS
    off_s = abs(measurement.stamp_ns - frame_ns) / S
    return ASTRAY(key=key.path, off_s=off_s, limit_s=ASTRAY_NS / S)


_stamp: Callable[[Any], int] = attrgetter("stamp_ns")
