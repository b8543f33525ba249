"""Messages and small records for the recorder's tests."""

from __future__ import annotations

import random
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from tramstream import keys
from tramstream.keys import Key
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import ImuBatch, RawBytes
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import Entry, open_record

VEHICLE = "4711"
START_NS = 1_790_000_000_000_000_000
MS = 1_000_000


class Sent(NamedTuple):
    """One message as it was handed to the writer."""

    key: Key
    payload: bytes
    log_ns: int
    publish_ns: int
    sequence: int

    @property
    def topic(self) -> str:
        return self.key.on(VEHICLE)


def traffic(count: int, seed: int = 1, start_ns: int = START_NS) -> list[Sent]:
    """A bit of everything a tram records, about 500 messages a second."""
    chance = random.Random(seed)
    sent, numbers = [], dict.fromkeys((keys.IMU_BATCH, keys.GNSS_FIX, keys.IMU_BYTES), 0)
    for step in range(count):
        log_ns = start_ns + step * 2 * MS
        key = (
            keys.GNSS_FIX
            if step % 100 == 7
            else keys.IMU_BYTES
            if step % 20 == 3
            else keys.IMU_BATCH
        )
        numbers[key] += 1
        payload = _message(key, chance, log_ns, numbers[key]).SerializeToString()
        sent.append(Sent(key, payload, log_ns, log_ns - MS, numbers[key]))
    return sent


def _message(key: Key, chance: random.Random, stamp_ns: int, number: int):
    if key is keys.GNSS_FIX:
        return GnssFix(
            stamp_ns=stamp_ns,
            sequence=number,
            source="NAV-PVT",
            valid=True,
            latitude_deg=50 + number * 1e-5,
            longitude_deg=14.4,
            height_ellipsoid_m=250.0,
            horizontal_std_m=1.5,
        )
    if key is keys.IMU_BYTES:
        data = chance.randbytes(chance.randrange(50, 400))
        return RawBytes(stamp_ns=stamp_ns, sequence=number, device="imu", data=data)
    return ImuBatch(
        stamp_ns=stamp_ns,
        sequence=number,
        gyro_x=[chance.randrange(-60, 60) for _ in range(5)],
        accel_z=[chance.randrange(8100, 8300) for _ in range(5)],
    )


def write(path: Path, sent: Iterable[Sent], flush_every: int = 0, **options) -> Path:
    """A finished record of `sent` at `path`, a chunk each `flush_every` messages."""
    with RecordFile(path, VEHICLE, options.pop("metadata", None), **options) as record:
        append(record, sent, flush_every)
    return path


def append(record, sent: Iterable[Sent], flush_every: int = 0) -> None:
    for number, one in enumerate(sent, 1):
        record.append(one.topic, one.key, one.payload, one.log_ns, one.publish_ns, one.sequence)
        if flush_every and number % flush_every == 0:
            record.flush()


def active(path: Path, sent: Iterable[Sent], flush_every: int) -> Path:
    """A record as a killed recorder leaves it: all flushed, not finished."""
    record = RecordFile(path, VEHICLE, {"config": "# none"})
    append(record, sent, flush_every)
    record.flush()
    record.abandon()
    return path.with_name(path.name + ".active")


def plain(entries: Iterable[Entry | Sent]) -> list[tuple]:
    """What must be equal on both sides of a file."""
    return [(e.topic, e.payload, e.log_ns, e.publish_ns, e.sequence) for e in entries]


def read(path: Path) -> list[tuple]:
    with open_record(path) as record:
        return plain(record.messages())
