"""Rides with an IMU that is mounted anyhow, for tests: four quiet minutes, and records of them."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from rides import laid

from tramstream import config_file, keys
from tramstream.analysis.mounting.drive import NODE_S, Drive
from tramstream.analysis.studies.mounting_rides import Drawn, World, draw, world
from tramstream.attitude import C_vl
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.geodesy import LocalLevel
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import ImuBatch
from tramstream.recorder.file.writer import RecordFile
from tramstream.simulation import scenario
from tramstream.simulation.vehicle import configuration

Array = NDArray[np.float64]
RIDE_S = 240.0
START_NS = 1_790_000_000 * S
GYRO_RADPS, ACCEL_MPS2 = 1e-5, 1e-4
"""Units of a count."""
LEVEL = LocalLevel.at_deg(50.08, 14.42, 280.0)
TURN = C_vl(*np.radians([30.0, 60.0, 90.0]))


@lru_cache(maxsize=2)
def ride(plan: str = "") -> tuple[World, Vehicle]:
    """Four minutes of the work's ride, with the sensor of `tram` without scale errors.

    On the built-in line, or on one of a plan (`tramstream.lines.line.parse_plan`).
    """
    line = laid(plan) if plan else None
    chosen = scenario.load("melenovsky2023")
    sensor = scenario.load("tram").imu
    assert sensor is not None
    errors = msgspec.structs.replace(
        sensor.errors, gyro_scale=(0.0,) * 3, accel_scale=(0.0,) * 3, gyro_cross_axis=0.0,
        accel_cross_axis=0.0,
    )  # fmt: skip
    chosen = msgspec.structs.replace(chosen, imu=msgspec.structs.replace(sensor, errors=errors))
    vehicle = configuration(chosen)
    assert vehicle.imu is not None
    imu = msgspec.structs.replace(
        vehicle.imu, lever_arm_m=(0.0, 0.0, 0.0), mounting_deg=(0.0, 0.0, 0.0), rate_hz=10.0
    )
    return world(chosen, RIDE_S, line=line), msgspec.structs.replace(vehicle, imu=imu)


def drawn(C_bv: Array = TURN, seed: int = 1) -> Drawn:
    """One seed's ride."""
    return draw(ride()[0], C_bv, np.random.default_rng(seed))


def write_record(path: Path, drive: Drive, fixes: bool = True) -> None:
    """A record of ten inertial samples a second and of all fixes."""
    vehicle = ride()[1]
    metadata = {config_file.RECORD_ENTRY: config_file.to_json(vehicle)}
    gyro = np.rint(drive.inertial.omega_b / GYRO_RADPS).astype(int)
    accel = np.rint(drive.inertial.f_b / ACCEL_MPS2).astype(int)
    step_ns = round(NODE_S * S)
    with RecordFile(path, vehicle.vehicle, metadata) as record:
        for number, first in enumerate(range(0, drive.length - 1, 10), 1):
            rows = slice(first, min(first + 10, drive.length - 1))
            w, f = gyro[rows].T.tolist(), accel[rows].T.tolist()
            stamp_ns = START_NS + first * step_ns
            message = ImuBatch(
                stamp_ns=stamp_ns, sequence=number, model="ADIS16465-1",
                first_sample_sequence=first, period_ns=step_ns, gyro_scale_radps=GYRO_RADPS,
                accel_scale_mps2=ACCEL_MPS2, temperature_scale_degc=0.1,
                gyro_x=w[0], gyro_y=w[1], gyro_z=w[2],
                accel_x=f[0], accel_y=f[1], accel_z=f[2], temperature=250,
            )  # fmt: skip
            topic = keys.IMU_BATCH.on(vehicle.vehicle)
            payload = message.SerializeToString()
            record.append(topic, keys.IMU_BATCH, payload, stamp_ns, stamp_ns, number)
        if fixes:
            _write_fixes(record, drive, vehicle.vehicle)


def _write_fixes(record: RecordFile, drive: Drive, vehicle: str) -> None:
    geodetic = LEVEL.to_geodetic(drive.fixes.p_l)
    for number, node in enumerate(drive.fixes.node.tolist()):
        stamp_ns = START_NS + node * round(NODE_S * S)
        east, north, up = drive.fixes.vel_l[number].tolist()
        latitude, longitude, height = geodetic[number].tolist()
        fix = GnssFix(
            stamp_ns=stamp_ns, sequence=number + 1, source="NAV-PVT", valid=True,
            fix_type=GnssFix.FIX_3D, latitude_deg=math.degrees(latitude),
            longitude_deg=math.degrees(longitude), height_ellipsoid_m=height,
            horizontal_std_m=1.8 * math.sqrt(2), vertical_std_m=2.2,
            vel_e_mps=east, vel_n_mps=north, vel_d_mps=-up, speed_mps=math.hypot(east, north),
            speed_std_mps=0.5,
        )  # fmt: skip
        topic = keys.GNSS_FIX.on(vehicle)
        payload = fix.SerializeToString()
        record.append(topic, keys.GNSS_FIX, payload, stamp_ns, stamp_ns, number + 1)
