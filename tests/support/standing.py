"""Inertial sensors at rest for tests: blocks drawn from the noise model, and whole records."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tramstream import config_file, keys
from tramstream.analysis.calibration.blocks import Blocks
from tramstream.analysis.calibration.likelihood import step_of
from tramstream.analysis.calibration.noise import Noise
from tramstream.clock import S
from tramstream.config import Imu, Vehicle
from tramstream.proto.raw_pb2 import ImuBatch
from tramstream.recorder.file.writer import RecordFile

Array = NDArray[np.float64]
START_NS = 1_790_000_000 * S
GYRO_RADPS, ACCEL_MPS2 = 1e-4, 1e-3
"""Units of a count."""


def drawn(noise: Noise, block_s: float, count: int, rng: Generator, octaves: int = 6) -> Blocks:
    """Blocks of an axis with this noise: means by the model's own recursion, details white."""
    unit = noise._replace(white=1.0, instability=noise.instability / noise.white)
    unit = unit._replace(walk=noise.walk / noise.white)
    s = step_of(unit, block_s)
    spread = np.array(
        [
            [s.walk, 0.0, s.walk_mean],
            [0.0, s.unstable, s.unstable_mean],
            [s.walk_mean, s.unstable_mean, s.mean],
        ]
    )
    values, vectors = np.linalg.eigh(spread)
    gains = rng.standard_normal((count, 3)) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    walked, unstable = 0.0, math.sqrt(s.steady) * float(rng.standard_normal())
    mean = np.empty(count)
    for i, (walk, drive, own) in enumerate(gains.tolist()):
        mean[i] = walked + s.share * unstable + own
        walked += walk
        unstable = s.keep * unstable + drive
    half_s = block_s / 2.0 ** np.arange(octaves, 0, -1)
    details = np.array([count << (octaves - 1 - level) for level in range(octaves)])
    squares = 2 * noise.allan_variance(half_s) * rng.chisquare(details)
    first = np.zeros(count, bool)
    first[0] = True
    return Blocks(
        block_s, mean * noise.white, np.full(count, math.nan), first, half_s, squares, details
    )


def write_record(
    path: Path,
    counts: NDArray[np.int32],
    rate_hz: float,
    batch: int = 20,
    lost: Callable[[int], bool] = lambda _: False,
    degc: float = 25.0,
) -> None:
    """A record of inertial samples, shape (n, 6), as the bridge writes them.

    `lost` says which messages are missing.
    """
    vehicle = Vehicle(vehicle="still", imu=Imu(device="none", rate_hz=rate_hz, batch=batch))
    metadata = {config_file.RECORD_ENTRY: config_file.to_json(vehicle)}
    with RecordFile(path, vehicle.vehicle, metadata) as record:
        for number, first in enumerate(range(0, len(counts), batch)):
            if lost(number):
                continue
            rows = counts[first : first + batch].T.tolist()
            stamp_ns = START_NS + round(first / rate_hz * S)
            message = ImuBatch(
                stamp_ns=stamp_ns, sequence=number + 1, model="ADIS16465-1",
                first_sample_sequence=first, period_ns=S / rate_hz, gyro_scale_radps=GYRO_RADPS,
                accel_scale_mps2=ACCEL_MPS2, temperature_scale_degc=0.1,
                gyro_x=rows[0], gyro_y=rows[1], gyro_z=rows[2],
                accel_x=rows[3], accel_y=rows[4], accel_z=rows[5], temperature=round(degc * 10),
            )  # fmt: skip
            payload = message.SerializeToString()
            topic = keys.IMU_BATCH.on(vehicle.vehicle)
            record.append(topic, keys.IMU_BATCH, payload, stamp_ns, stamp_ns, number + 1)


def white(count: int, std: float, seed: int = 1) -> NDArray[np.int32]:
    """Six axes of white noise about biases of their own, whole counts."""
    rng = np.random.default_rng(seed)
    bias = np.array([52.0, -31.0, 12.0, 100.0, -50.0, 9810.0])
    found: NDArray[np.int32] = np.rint(bias + std * rng.standard_normal((count, 6))).astype(
        np.int32
    )
    return found
