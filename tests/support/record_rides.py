"""A short ride, message by message, and what a recorder makes of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
from scripted import START_NS, VEHICLE, ManualClock, Sender

from tramstream import config_file, keys
from tramstream.clock import S
from tramstream.config import Imu, Vehicle
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import ImuBatch, Odometry, WheelReading
from tramstream.recorder.file.writer import RecordFile
from tramstream.transport.bus import Envelope, LocalBus

CONFIG = Vehicle(vehicle=VEHICLE, imu=Imu(device="none"))


def batch(step: int) -> ImuBatch:
    counts = np.random.default_rng(step).integers(-40, 40, (6, 20)).tolist()
    names = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
    return ImuBatch(
        stamp_ns=START_NS + step * S // 100,
        first_sample_sequence=20 * step + 7,
        period_ns=5e5,
        gyro_scale_radps=1e-4,
        accel_scale_mps2=2.5e-3,
        temperature_scale_degc=0.1,
        **dict(zip(names, counts, strict=True)),
    )


def wheels(step: int, late_s: float = 0.0) -> Odometry:
    stamp_ns = START_NS + step * S // 100 - round(late_s * S)
    readings = [WheelReading(wheel=name, pulses=9 * step) for name in ("left", "right")]
    return Odometry(stamp_ns=stamp_ns, wheels=readings)


def fix(step: int) -> GnssFix:
    return GnssFix(
        stamp_ns=START_NS + step * S // 100 - S // 10,
        valid=True,
        fix_type=GnssFix.FIX_3D,
        latitude_deg=50.0,
        longitude_deg=14.4,
        height_ellipsoid_m=250.0,
        horizontal_std_m=1.0,
        vertical_std_m=2.0,
        speed_mps=0.8,
        speed_std_mps=0.1,
    )


def drive(
    sender: Sender, clock: ManualClock, steps: range, fixes: bool = True
) -> Iterator[Callable[[], None]]:
    """One message each, so that the loop takes it before the next one."""

    def inertial(step: int) -> None:
        clock.advance(0.01)
        sender.send(keys.IMU_BATCH, batch(step))

    def odometry(step: int) -> None:
        late_s = 1.0 if step == 200 else 0.0
        sender.send(keys.ODO_WHEELS, wheels(step, late_s), skip=int(step == 260))

    for step in steps:
        yield partial(inertial, step)
        if step % 2 == 0:
            yield partial(odometry, step)
        if fixes and step % 20 == 0:
            yield partial(sender.send, keys.GNSS_FIX, fix(step))


@contextmanager
def written(path: Path, bus: LocalBus) -> Iterator[None]:
    """Write everything that is on `bus` meanwhile into a record."""
    metadata = {config_file.RECORD_ENTRY: config_file.to_json(CONFIG)}
    with RecordFile(path, VEHICLE, metadata) as record:

        def write(envelope: Envelope) -> None:
            key = keys.find(keys.split(envelope.topic)[1])
            assert key is not None
            sent = envelope.arrival_ns, envelope.publish_ns, envelope.sequence
            record.append(envelope.topic, key, envelope.payload, *sent)

        bus.subscribe("tram/**", write)
        yield
