"""A simulated ride with truth: what the bridges of a vehicle would have published, and when.

`Simulation(line, scenario, seed).samples()` gives messages in the order of their publication,
without a bus, a clock or a file. Each sensor has generators of its own, so that the options of one
do not change the noise of another; the same seed gives the same messages. Positions, attitudes and
rates of the truth are exact at every instant.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from tramstream import config, keys
from tramstream.attitude import C_vl
from tramstream.clock import S
from tramstream.geodesy import C_nl, normal_gravity_mps2
from tramstream.lines.line import Line
from tramstream.processor import Sample
from tramstream.proto.raw_pb2 import ImuBatch, Odometry, WheelReading
from tramstream.simulation.body import Carriage, antenna_of, inertial_of
from tramstream.simulation.events import Happenings
from tramstream.simulation.faults import Timed, faulted
from tramstream.simulation.imu import Imu, inertial
from tramstream.simulation.receiver import Gnss, antenna_motion
from tramstream.simulation.ride import Motion, Ride
from tramstream.simulation.roughness import Shaking
from tramstream.simulation.scenario import SIDES, Scenario, Timing
from tramstream.simulation.scenario import Gnss as GnssSection
from tramstream.simulation.scenario import Imu as ImuSection
from tramstream.simulation.vehicle import FixWriter, configuration
from tramstream.simulation.wheels import Wheels, motor_force_n

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

EPOCH_NS = 1_790_000_000 * S
"""Vehicle clock at the start of every simulated ride: 2026-09-21T14:13:20Z as Unix time."""
MODEL = config.Imu(device="").model
BLOCK = 8192
"""Inertial samples that are worked out at a time: they fit into a processor's cache."""
BLOCK_S = 20.0
"""Of the slower sensors."""


class Truth(NamedTuple):
    """The vehicle at some instants, one row each."""

    motion: Motion
    p_l: Array
    """Of the vehicle's origin in `line.level`, m."""


class Simulation:
    """One ride of a scenario along a line.

    Parameters
    ----------
    line : Line
    scenario : Scenario
    seed : int
        Of all chance.
    duration_s : float, optional
        Ends the ride early; by default it lasts until `scenario.end_s` after the last stop, or
        for `scenario.duration_s`.

    Raises
    ------
    ConfigError
        For an event that does not fit the line.
    """

    def __init__(
        self, line: Line, scenario: Scenario, seed: int = 0, duration_s: float | None = None
    ) -> None:
        self.line = line if scenario.track.cant else line.without_cant()
        self.scenario = scenario
        self.seed = seed
        happenings_rng, driver_rng, roughness_rng = self._generators()[3:]
        self.ride = Ride(self.line, scenario.driver, scenario.reverse, driver_rng)
        ends = (self.ride.duration_s + scenario.end_s, scenario.duration_s, duration_s)
        self.duration_s = min(each for each in ends if each is not None)
        level = self.line.level
        self.gravity_mps2 = float(normal_gravity_mps2(level.latitude_rad, level.height_m))
        body = scenario.body
        self.carriage: Carriage | None = None
        """Of the body; None where the vehicle is a point that follows the rail."""
        if body is not None:
            self.carriage = Carriage(body, self.ride, self.gravity_mps2, self.duration_s)
        pivots_m = body.pivots_m if body is not None else (0.0,)
        roughness = scenario.track.roughness
        self.shaking: Shaking | None = None
        if roughness.felt:
            self.shaking = Shaking(roughness, self.ride, pivots_m, roughness_rng)
        self.happenings = Happenings(scenario, self.ride, happenings_rng)
        self.vehicle: config.Vehicle = configuration(scenario)
        """The configuration that a vehicle with these sensors would have."""

    def _generators(self) -> list[Generator]:
        """Of IMU, receiver, wheels, happenings, driver and roughness."""
        return np.random.default_rng(self.seed).spawn(6)

    def truth(self, stamp_ns: ArrayLike) -> Truth:
        """Give the exact state of the vehicle at instants of the vehicle clock."""
        time_s = (np.asarray(stamp_ns, dtype=np.int64) - EPOCH_NS) / S
        motion = self._motion(time_s)
        return Truth(motion, self.line.position_l(motion.arc_length_m))

    def _motion(self, time_s: Array) -> Motion:
        """Of the vehicle: its body, if it has one."""
        if self.carriage is None:
            return self.ride.motion(time_s)
        return self.carriage.motion(time_s)

    def samples(self) -> Iterator[Sample]:
        """All messages of the ride in the order of their publication."""
        imu_rng, gnss_rng, wheels_rng, *_ = self._generators()
        streams = [self._truths()]
        if self.scenario.imu is not None:
            streams.append(self._inertial(imu_rng))
        if self.scenario.gnss is not None:
            streams.append(self._fixes(gnss_rng))
        if self.scenario.wheels is not None:
            streams.append(self._readings(wheels_rng))
        faults = [
            Timed(each.fault, *stamps_ns(np.array([each.start_s, each.end_s])).tolist())
            for each in self.happenings.faults
        ]
        streams = [faulted(stream, faults) for stream in streams]
        return heapq.merge(*streams, key=attrgetter("publish_ns"))

    def _blocks(self, rate_hz: float, size: int) -> Iterator[Array]:
        """Instants of a rate, in blocks: whole ones, and what is left."""
        end = int(self.duration_s * rate_hz) + 1
        for first in range(0, end, size):
            yield np.arange(first, min(first + size, end)) / rate_hz

    def _truths(self) -> Iterator[Sample]:
        rate_hz = self.scenario.truth_rate_hz
        sequence = 0
        for time_s in self._blocks(rate_hz, round(BLOCK_S * rate_hz)):
            stamps = stamps_ns(time_s)
            vehicle = self._motion(time_s)
            for message in self.ride.truths(time_s, stamps.tolist(), vehicle):
                sequence += 1
                message.sequence = sequence
                stamp = message.stamp_ns
                yield Sample(keys.TRUTH_STATE, message, stamp, sequence, stamp)

    def _inertial(self, rng: Generator) -> Iterator[Sample]:
        section = self.scenario.imu
        assert section is not None
        sensor_rng, timing_rng = rng.spawn(2)
        sensor = Imu(sensor_rng, section.rate_hz, section.errors, section.scales)
        lever = _sum(section.lever_arm_m, section.lever_arm_error_m)
        C_bv = C_vl(*np.radians(section.misalignment_deg)) @ C_vl(*np.radians(section.mounting_deg))
        clock = _Publisher(section.timing, timing_rng)
        batch, period_s = section.batch, 1 / section.rate_hz
        sequence = 0
        for time_s in self._blocks(section.rate_hz, max(BLOCK // batch, 1) * batch):
            count = len(time_s) // batch
            if count == 0:
                return
            time_s = time_s[: count * batch]
            f_v, omega_v = self._felt(section, time_s, lever)
            counts = sensor.measure(f_v @ C_bv.T, omega_v @ C_bv.T)
            gyro, accel = (
                column.reshape(count, batch, 3).transpose(0, 2, 1).tolist()
                for column in (counts.gyro, counts.accel)
            )
            temperature = counts.temperature[batch - 1 :: batch].tolist()
            stamps, published = clock.times(time_s[::batch], (batch - 1) * period_s)
            for row, stamp in enumerate(stamps):
                message = ImuBatch(
                    stamp_ns=stamp,
                    sequence=sequence + 1,
                    model=MODEL,
                    first_sample_sequence=sequence * batch,
                    period_ns=period_s * S,
                    gyro_scale_radps=section.scales.gyro_radps,
                    accel_scale_mps2=section.scales.accel_mps2,
                    temperature_scale_degc=section.scales.temperature_degc,
                    gyro_x=gyro[row][0],
                    gyro_y=gyro[row][1],
                    gyro_z=gyro[row][2],
                    accel_x=accel[row][0],
                    accel_y=accel[row][1],
                    accel_z=accel[row][2],
                    temperature=temperature[row],
                )
                sequence += 1
                yield Sample(keys.IMU_BATCH, message, stamp, sequence, published[row])

    def _felt(
        self, section: ImuSection, time_s: Array, lever: config.Vector
    ) -> tuple[Array, Array]:
        """Give specific force and angular rate of the IMU, resolved in its part of the body."""
        motion = self.ride.motion(time_s)
        up_l = self.ride.up_l(motion)
        if self.carriage is None:
            felt = inertial(motion, self.gravity_mps2, lever, up_l)
        else:
            part = self.carriage.part(section.part, time_s)
            lever_v = self.carriage.lever_v(section.part, lever)
            felt = inertial_of(part, self.gravity_mps2, lever_v, up_l)
        if self.shaking is None:
            return felt
        force, rate = self.shaking.felt(motion, time_s)
        return felt[0] + force, felt[1] + rate

    def _antenna(
        self, section: GnssSection, time_s: Array, lever: config.Vector
    ) -> tuple[Array, Array, Motion]:
        """Give position and velocity of the antenna in `l`, and the track's motion."""
        motion = self.ride.motion(time_s)
        if self.carriage is None:
            p_l = self.line.position_l(motion.arc_length_m)
            return *antenna_motion(p_l, motion, np.array(lever)), motion
        part = self.carriage.part(section.part, time_s)
        return *antenna_of(part, self.carriage.lever_v(section.part, lever)), motion

    def _fixes(self, rng: Generator) -> Iterator[Sample]:
        section = self.scenario.gnss
        assert section is not None
        sensor_rng, timing_rng = rng.spawn(2)
        lever = _sum(section.lever_arm_m, section.lever_arm_error_m)
        receiver = Gnss(sensor_rng, section.rate_hz, section.errors)
        writer = FixWriter(section, self.scenario.track.geoid_m)
        clock = _Publisher(section.timing, timing_rng)
        sequence = 0
        for time_s in self._blocks(section.rate_hz, max(round(BLOCK_S * section.rate_hz), 1)):
            antenna_l, velocity_l, motion = self._antenna(section, time_s, lever)
            fixes = receiver.measured(antenna_l, velocity_l, motion.standing)
            p_l = fixes.p_l + self.happenings.gnss_offset_l(time_s)
            geodetic = self.line.level.to_geodetic(p_l)
            vel_l = fixes.vel_l + self.happenings.gnss_drift_l(time_s)
            velocity = np.einsum("nij,nj->ni", C_nl(self.line.level, geodetic), vel_l)
            lost = self.happenings.gnss_lost(time_s)
            stamps, published = clock.times(time_s)
            epochs = stamps_ns(time_s).tolist()
            for row, stamp in enumerate(stamps):
                sequence += 1
                message = writer.fix(geodetic[row], velocity[row], epochs[row], bool(lost[row]))
                message.stamp_ns, message.sequence = stamp, sequence
                yield Sample(keys.GNSS_FIX, message, stamp, sequence, published[row])

    def _readings(self, rng: Generator) -> Iterator[Sample]:
        section = self.scenario.wheels
        assert section is not None
        encoders = Wheels(section.axle, self.scenario.reverse)
        clock = _Publisher(section.timing, rng)
        columns = [(side, SIDES.index(side)) for side in section.wheels]
        total = np.zeros(2, dtype=np.int64)
        sequence = 0
        for time_s in self._blocks(section.rate_hz, max(round(BLOCK_S * section.rate_hz), 1)):
            motion = self.ride.motion(time_s)
            slipped = self.happenings.slipped_m(time_s)
            pulses = total + np.cumsum(encoders.measure(motion, slipped), axis=0)
            total = pulses[-1]
            counted = pulses.tolist()
            doors = self.ride.doors_open(time_s).tolist()
            force = motor_force_n(motion).tolist()
            stamps, published = clock.times(time_s)
            for row, stamp in enumerate(stamps):
                sequence += 1
                readings = [
                    WheelReading(wheel=side, pulses=counted[row][column])
                    for side, column in columns
                ]
                message = Odometry(
                    stamp_ns=stamp,
                    sequence=sequence,
                    wheels=readings,
                    doors_open=doors[row] if section.doors else None,
                    motor_force_n=force[row] if section.motor_force else None,
                )
                yield Sample(keys.ODO_WHEELS, message, stamp, sequence, published[row])


def stamps_ns(time_s: Array) -> Stamps:
    """Vehicle clock at times of the ride."""
    return EPOCH_NS + np.rint(time_s * S).astype(np.int64)


def _sum(first: config.Vector, second: config.Vector) -> config.Vector:
    x, y, z = (a + b for a, b in zip(first, second, strict=True))
    return (x, y, z)


class _Publisher:
    """Stamps and publication times of one key: never before the stamp, one after another."""

    def __init__(self, timing: Timing, rng: Generator) -> None:
        self._timing = timing
        self._rng = rng
        self._last_ns = 0

    def times(self, time_s: Array, gathered_s: float = 0.0) -> tuple[list[int], list[int]]:
        """Stamp and publication of messages that were true at `time_s` and complete later."""
        timing = self._timing
        noise, wait = self._rng.standard_normal(len(time_s)), self._rng.uniform(size=len(time_s))
        stamps = stamps_ns(time_s + timing.stamp_offset_s + timing.stamp_jitter_s * noise)
        ready_s = time_s + gathered_s + timing.latency_s + timing.latency_jitter_s * wait
        ready = np.maximum(stamps_ns(ready_s), stamps)
        order = np.arange(len(time_s))
        ready = np.maximum.accumulate(np.maximum(ready - order, self._last_ns + 1)) + order
        self._last_ns = int(ready[-1])
        return stamps.tolist(), ready.tolist()
