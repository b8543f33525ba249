"""Figures of the stages that need no bus: medians of repeated runs on bytes made here."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tramstream import keys
from tramstream.bridges.gnss import framer as framing
from tramstream.bridges.gnss.bridge import GnssBridge
from tramstream.bridges.imu import framer as adis
from tramstream.bridges.imu.bridge import ImuBridge
from tramstream.bridges.simulators import receiver, streams
from tramstream.clock import S
from tramstream.config import Gnss, Imu, Vehicle
from tramstream.lines.line import built_in_line
from tramstream.processor import Sample
from tramstream.processors.distance.processor import DistanceFilter
from tramstream.processors.resampling.resampler import Resampler
from tramstream.proto.raw_pb2 import ImuBatch, Odometry, RawBytes, WheelReading
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import open_record
from tramstream.simulation.ride import Ride

REPEATS = 5
VEHICLE = Vehicle(
    vehicle="bench", imu=Imu(device="/dev/null"), gnss=Gnss(device="/dev/null", baud_rate=460800)
)


@dataclass(frozen=True)
class Figure:
    """One measured figure; its unit stands at the end of its name."""

    name: str
    value: float
    goal: float | None = None
    more_is_better: bool = True

    @property
    def met(self) -> bool:
        if self.goal is None:
            return True
        return self.value >= self.goal if self.more_is_better else self.value <= self.goal


def median_s(work: Callable[[], Any], repeats: int = REPEATS) -> float:
    """Median duration of `work`, after one run that does not count."""
    work()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def gnss_bytes(seconds: float = 120.0) -> bytes:
    """What the simulated receiver says on a ride: PVT, COV, TIMEGPS, SAT, …"""
    ride = Ride(built_in_line())
    rng = np.random.default_rng(1)
    device = receiver.GnssDevice()
    parts = []
    for chunk in receiver.gnss_stream(ride, rng, 0, device, streams.NO_FAULTS):
        if chunk.due_ns > seconds * S:
            break
        parts.append(chunk.data)
    return b"".join(parts)


def imu_bytes(seconds: float = 20.0) -> bytes:
    """What the simulated IMU says on a ride."""
    ride = Ride(built_in_line())
    rng = np.random.default_rng(1)
    stream = streams.imu_stream(
        streams.riding(ride), rng, 0, seconds, streams.ImuDevice(), streams.NO_FAULTS
    )
    return b"".join(chunk.data for chunk in stream)


def _reads(data: bytes, size: int) -> list[RawBytes]:
    return [
        RawBytes(stamp_ns=S + begin * 1000, data=data[begin : begin + size])
        for begin in range(0, len(data), size)
    ]


def ubx(capture: Path | None = None) -> list[Figure]:
    """Framing, and the whole bridge, on `capture` or on what the simulated receiver says."""
    data = capture.read_bytes() if capture is not None else gnss_bytes() * 4

    def frame() -> None:
        framer = framing.Framer()
        for begin in range(0, len(data), 4096):
            framer.feed(data[begin : begin + 4096])

    reads = _reads(data, 4096)

    def decode() -> None:
        bridge = GnssBridge(VEHICLE)
        for read in reads:
            bridge.step(Sample(keys.GNSS_BYTES, read, read.stamp_ns, 0))

    megabytes = len(data) / 1e6
    return [
        Figure("ubx_framing_mb_s", megabytes / median_s(frame), 30.0),
        Figure("ubx_bridge_mb_s", megabytes / median_s(decode)),
        Figure("ubx_worst_input_ms", 1e3 * max(map(_input_s, nasty_inputs())), 5.0, False),
    ]


def nasty_inputs() -> list[bytes]:
    """What has broken parsers: noise, lone starts, a huge frame, a short one."""
    rng = np.random.default_rng(1)
    return [
        rng.bytes(4096),
        b"$G\xff",
        b"\xd3\x00\x00",
        framing.ubx_frame(0x0A27, bytes(65535)),
        framing.ubx_frame(0x0A27, rng.bytes(65535)),
        framing.ubx_frame(0x0107, bytes(20)),
    ]


def _input_s(data: bytes) -> float:
    """Time to take `data` and a good epoch after it."""
    reads = _reads(data + gnss_bytes(2.0), 1 << 17)

    def decode() -> None:
        bridge = GnssBridge(VEHICLE)
        for read in reads:
            bridge.step(Sample(keys.GNSS_BYTES, read, read.stamp_ns, 0))

    return median_s(decode)


def imu() -> list[Figure]:
    data = imu_bytes()
    bursts = len(data) / adis.FRAME_LENGTH

    def frame() -> None:
        framer = adis.AdisFramer()
        for begin in range(0, len(data), 4096):
            framer.feed(data[begin : begin + 4096])

    live_read = 10 * adis.FRAME_LENGTH  # 5 ms at 2 kHz
    reads = _reads(data, live_read)

    def decode() -> None:
        bridge = ImuBridge(VEHICLE)
        for read in reads:
            bridge.step(Sample(keys.IMU_BYTES, read, read.stamp_ns, 0))

    return [
        Figure("adis_framing_bursts_s", bursts / median_s(frame), 100_000.0),
        Figure("imu_bridge_samples_s", bursts / median_s(decode)),
    ]


def imu_batches(count: int = 5000) -> list[Sample]:
    rng = np.random.default_rng(1)
    samples = []
    for index in range(count):
        columns = rng.integers(-4000, 4000, (6, 20))
        batch = ImuBatch(
            stamp_ns=S + index * S // 100,
            sequence=index + 1,
            first_sample_sequence=20 * index,
            period_ns=5e5,
            gyro_scale_radps=1e-4,
            accel_scale_mps2=2.45e-3,
            temperature_scale_degc=0.1,
        )
        names = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
        for name, column in zip(names, columns, strict=True):
            getattr(batch, name).extend(column.tolist())
        samples.append(Sample(keys.IMU_BATCH, batch, batch.stamp_ns, batch.sequence, index + 1))
    return samples


def processors() -> list[Figure]:
    batches = imu_batches()
    wheels = [
        Sample(
            keys.ODO_WHEELS,
            Odometry(
                stamp_ns=S + index * S // 50,
                sequence=index + 1,
                wheels=[
                    WheelReading(wheel="left", pulses=200 * index),
                    WheelReading(wheel="right", pulses=200 * index),
                ],
            ),
            S + index * S // 50,
            index + 1,
            index + 1,
        )
        for index in range(len(batches) // 2)
    ]
    frames: list[Sample] = []

    def resample() -> None:
        resampler = Resampler(VEHICLE)
        frames.clear()
        for index, batch in enumerate(batches):
            if index % 2 == 0:
                resampler.step(wheels[index // 2])
            frames.extend(s for s in resampler.step(batch) if s.key is keys.SYNC_FRAME)

    resample_s = median_s(resample)
    updates = sum(len(frame.message.odometry) for frame in frames)

    def travel() -> None:
        distance = DistanceFilter(VEHICLE)
        for frame in frames:
            distance.step(frame)

    return [
        Figure("resampler_samples_s", 20 * len(batches) / resample_s, 500_000.0),
        Figure("distance_step_us", 1e6 * median_s(travel) / updates),
    ]


def record() -> list[Figure]:
    batches = imu_batches(20_000)
    payloads = [batch.message.SerializeToString() for batch in batches]
    topic = keys.IMU_BATCH.on("bench")
    megabytes = sum(map(len, payloads)) / 1e6
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.mcap"

        def write() -> None:
            path.unlink(missing_ok=True)
            with RecordFile(path, "bench") as target:
                for batch, payload in zip(batches, payloads, strict=True):
                    target.append(topic, keys.IMU_BATCH, payload, batch.stamp_ns, batch.stamp_ns, 1)

        def read() -> None:
            with open_record(path) as source:
                for _ in source.messages():
                    pass

        write_s = median_s(write)
        read_s = median_s(read)
    return [
        Figure("record_write_mb_s", megabytes / write_s),
        Figure("record_write_messages_s", len(payloads) / write_s),
        Figure("record_read_messages_s", len(payloads) / read_s),
    ]


STAGES: dict[str, Callable[[], list[Figure]]] = {
    "ubx": ubx,
    "imu": imu,
    "processors": processors,
    "record": record,
}
