"""Simulated rides at the rate of the ordered stream: frames without 2 kHz, a resampler, or GNSS.

A ride of half an hour takes seconds. What is lost is the scatter within a frame, which tells a
shaking vehicle from one that stands: so this is the harder case for stands by quiet alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import msgspec
import numpy as np

from tramstream import keys
from tramstream.lines.line import Line, built_in_line
from tramstream.processor import Sample
from tramstream.proto.raw_pb2 import ImuBatch
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame
from tramstream.simulation import scenario
from tramstream.simulation.scenario import Scenario
from tramstream.simulation.simulation import Simulation
from tramstream.simulation.track_rides import MapError, NetworkRide, lay, route_of
from tramstream.tracks import signature
from tramstream.tracks.network import Network
from tramstream.tracks.signature import Signature

RATE_HZ = 100.0
BATCH = 10
BUILT_IN = "built-in"


class World(NamedTuple):
    """What a ride is like."""

    base: str = "tram"
    """Scenario of the package."""
    wheels: bool = True
    scale: float = 0.0
    """By how much larger the wheels are than configured, as a part."""
    gyro_walk_radps2_rthz: float | None = None
    mounting_deg: tuple[float, float, float] | None = None
    """Of the true case, beside what the configuration says."""
    reverse: bool = False
    turns_back_m: tuple[float, ...] = ()
    """Not used where empty."""


class Ridden(NamedTuple):
    """A ride that is to be judged."""

    name: str
    simulation: Simulation
    laid: NetworkRide | None
    """Where the line was laid beside a network's."""

    def chainage_at(self, arc_length_m: np.ndarray) -> np.ndarray:
        """Chainage along the line of the map."""
        if self.laid is None:
            return np.asarray(arc_length_m, dtype=float)
        return self.laid.route_at(arc_length_m)


def scenario_of(world: World) -> Scenario:
    """The scenario of a world, at the rate of frames and without GNSS."""
    made = scenario.load(world.base)
    assert made.imu is not None
    errors = made.imu.errors
    if world.gyro_walk_radps2_rthz is not None:
        errors = msgspec.structs.replace(errors, gyro_walk_radps2_rthz=world.gyro_walk_radps2_rthz)
    imu = msgspec.structs.replace(made.imu, rate_hz=RATE_HZ, batch=BATCH, errors=errors)
    if world.mounting_deg is not None:
        imu = msgspec.structs.replace(imu, misalignment_deg=world.mounting_deg)
    wheels = made.wheels
    if not world.wheels:
        wheels = None
    elif wheels is not None:
        grown = tuple(world.scale * wheels.axle.radius_m for _ in range(2))
        axle = msgspec.structs.replace(wheels.axle, radius_error_m=grown)
        wheels = msgspec.structs.replace(wheels, axle=axle)
    return msgspec.structs.replace(
        made,
        imu=imu,
        gnss=None,
        wheels=wheels,
        events=(),
        truth_rate_hz=1.0,
        resampler=None,
        reverse=world.reverse,
    )


def ridden(
    world: World,
    seed: int,
    network: Network | None = None,
    line: str = BUILT_IN,
    duration_s: float | None = None,
) -> Ridden:
    """Lay a ride on a line of a network ("7/0"), beside the map as rails are, or the built-in."""
    if line == BUILT_IN or network is None:
        return Ridden(line, Simulation(built_in_line(), scenario_of(world), seed, duration_s), None)
    route = next(each for each in network.lines if f"{each.line}/{each.direction}" == line)
    laid = lay(network, route_of(route), np.random.default_rng(seed + 1000), MapError())
    return Ridden(line, Simulation(laid.line, scenario_of(world), seed, duration_s), laid)


def lines_of(network: Network | None) -> list[Signature]:
    """Signatures of a network's lines and of the built-in one."""
    built_in = signature.of_line(built_in_line(), BUILT_IN)
    return [*(signature.of_network(network) if network is not None else []), built_in]


def frames(simulation: Simulation) -> Iterator[Sample]:
    """Frames of a ride whose inertial samples come at the rate of frames."""
    waiting = SyncFrame()
    sequence = 0
    for sample in simulation.samples():
        if sample.key is keys.ODO_WHEELS:
            waiting.odometry.append(sample.message)
        elif sample.key is keys.IMU_BATCH:
            for mean in _means(sample.message):
                sequence += 1
                frame = SyncFrame(stamp_ns=mean.stamp_ns, sequence=sequence, imu=mean)
                while waiting.odometry and waiting.odometry[0].stamp_ns <= mean.stamp_ns:
                    frame.odometry.append(waiting.odometry.pop(0))
                yield Sample(keys.SYNC_FRAME, frame, mean.stamp_ns, sequence)


def _means(batch: ImuBatch) -> Iterator[ImuMean]:
    gyro, accel = batch.gyro_scale_radps, batch.accel_scale_mps2
    for k in range(len(batch.gyro_x)):
        yield ImuMean(
            stamp_ns=batch.stamp_ns + round(k * batch.period_ns),
            sample_count=1,
            interval_s=1.0 / RATE_HZ,
            gyro_x_radps=batch.gyro_x[k] * gyro,
            gyro_y_radps=batch.gyro_y[k] * gyro,
            gyro_z_radps=batch.gyro_z[k] * gyro,
            accel_x_mps2=batch.accel_x[k] * accel,
            accel_y_mps2=batch.accel_y[k] * accel,
            accel_z_mps2=batch.accel_z[k] * accel,
        )


def line_of(ride: Ridden) -> Line:
    """The line that the ride truly goes along."""
    return ride.simulation.line
