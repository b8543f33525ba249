"""Inertial batches, fixes, wheels and ticks for tests of processors, and a way to step them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Imu, Resampler, Vehicle
from tramstream.processor import Processor, Sample
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import ImuBatch, Odometry, WheelReading
from tramstream.proto.sync_pb2 import SyncFrame, Tick

MS = S // 1000
START_NS = 1_700_000_000 * S
PERIOD_NS = 500_000
"""2 kHz."""
GYRO_SCALE_RADPS = 1e-4
ACCEL_SCALE_MPS2 = 2.5e-3
COLUMNS = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")

Counts = NDArray[np.int64]


def vehicle(**resampler: object) -> Vehicle:
    """A vehicle with a 2 kHz IMU, and fields of the resampler other than their defaults."""
    return Vehicle(vehicle="test", imu=Imu(device="none"), resampler=Resampler(**resampler))


def noise(count: int, seed: int = 1) -> Counts:
    """Counts of `count` samples, shape (6, count)."""
    return np.random.default_rng(seed).integers(-4000, 4000, (6, count))


def batch(
    counts: Counts,
    stamp_ns: int,
    first: int,
    publish_ns: int = 0,
    period_ns: float = PERIOD_NS,
) -> Sample:
    """One batch of consecutive samples, shape (6, n); the first is taken at `stamp_ns`."""
    message = ImuBatch(
        stamp_ns=stamp_ns,
        sequence=first + 1,
        first_sample_sequence=first,
        period_ns=period_ns,
        gyro_scale_radps=GYRO_SCALE_RADPS,
        accel_scale_mps2=ACCEL_SCALE_MPS2,
        temperature_scale_degc=0.1,
        temperature=250,
    )
    for name, column in zip(COLUMNS, counts, strict=True):
        getattr(message, name).extend(column.tolist())
    return Sample(keys.IMU_BATCH, message, stamp_ns, first + 1, publish_ns or stamp_ns)


def stamp_of(index: int) -> int:
    """When sample `index` was taken."""
    return START_NS + index * PERIOD_NS


def batches(counts: Counts, sizes: Iterable[int] | None = None, first: int = 0) -> list[Sample]:
    """Cut a run of samples into batches of `sizes` (default: 20 each), the rest into one more."""
    total = counts.shape[1]
    result = []
    begin = 0
    for size in sizes if sizes is not None else [20] * (total // 20):
        end = min(begin + size, total)
        if end > begin:
            result.append(batch(counts[:, begin:end], stamp_of(first + begin), first + begin))
        begin = end
    if begin < total:
        result.append(batch(counts[:, begin:], stamp_of(first + begin), first + begin))
    return result


def fix(stamp_ns: int, speed_mps: float = 0.0, sequence: int = 1, valid: bool = True) -> Sample:
    """A GNSS fix that reaches the bus 120 ms after its epoch."""
    message = GnssFix(
        stamp_ns=stamp_ns,
        sequence=sequence,
        valid=valid,
        speed_mps=speed_mps,
        speed_std_mps=0.1,
        latitude_deg=50.0,
        longitude_deg=14.4,
    )
    return Sample(keys.GNSS_FIX, message, stamp_ns, sequence, stamp_ns + 120 * MS)


def wheels(stamp_ns: int, pulses: Sequence[int] = (), sequence: int = 1) -> Sample:
    """Accumulated pulses of one or more wheels."""
    readings = [WheelReading(wheel=f"w{i}", pulses=value) for i, value in enumerate(pulses)]
    message = Odometry(stamp_ns=stamp_ns, sequence=sequence, wheels=readings)
    return Sample(keys.ODO_WHEELS, message, stamp_ns, sequence, stamp_ns + 5 * MS)


def tick(stamp_ns: int) -> Sample:
    return Sample(keys.SYNC_TICK, Tick(stamp_ns=stamp_ns), stamp_ns, 1, stamp_ns)


def frame(stamp_ns: int, *measurements: Sample) -> Sample:
    """What the resampler makes of measurements."""
    message = SyncFrame(stamp_ns=stamp_ns)
    for sample in measurements:
        field = message.gnss if sample.key is keys.GNSS_FIX else message.odometry
        field.append(sample.message)
    return Sample(keys.SYNC_FRAME, message, stamp_ns, 1)


def step_all(processor: Processor, samples: Iterable[Sample]) -> list[Sample]:
    """Step every sample; after each, the ledgers balance and the inputs are what they were."""
    outputs: list[Sample] = []
    for sample in samples:
        before = sample.message.SerializeToString()
        outputs += processor.step(sample)
        assert sample.message.SerializeToString() == before, "a processor changed its input"
        for ledger in processor.ledgers():
            assert ledger.balanced, ledger
    return outputs


def encoded(outputs: Iterable[Sample]) -> dict[str, list[bytes]]:
    """Outputs as bytes by key."""
    result: dict[str, list[bytes]] = {}
    for sample in outputs:
        result.setdefault(sample.key.path, []).append(sample.message.SerializeToString())
    return result


def messages(outputs: Iterable[Sample], key: keys.Key) -> list:
    """Messages of one key."""
    return [sample.message for sample in outputs if sample.key is key]
