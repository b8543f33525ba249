"""What simulated devices say, and when: streams of chunks, without any terminal or clock.

A stream is an iterator of `Chunk` in the order of their due times. Everything in it follows from
the ride, the seed, the schedule of faults and the instant the ride starts, so that the same seed
gives the same bytes. Streams are worked out block by block, a few hundredths of a second ahead of
whoever asks for the next chunk.

Faults are part of the streams, and each is counted in the chunk that carries it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from importlib import resources
from types import MappingProxyType
from typing import Any, NamedTuple

import cantools
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tramstream.attitude import C_vl
from tramstream.bridges.imu import bridge, framer
from tramstream.bridges.odometer import slcan
from tramstream.clock import S
from tramstream.config import Vector
from tramstream.geodesy import normal_gravity_mps2
from tramstream.simulation.imu import ORIGIN, Imu, ImuScales, inertial
from tramstream.simulation.ride import Ride
from tramstream.simulation.wheels import Wheels, motor_force_n

Array = NDArray[np.float64]

BITS_PER_BYTE = 10
"""On a serial line: start bit, eight data bits, stop bit."""
BLOCK_S = 0.05
SILENCE_AFTER_S = 5.0
"""The devices of a ride go on for so long after standstill at the last stop."""


class Cable(Enum):
    """What happens to the device's plug after a chunk."""

    AS_BEFORE = 0
    PULLED = 1
    PLUGGED = 2


class Chunk(NamedTuple):
    """Bytes that leave a device at `due_ns` of the vehicle clock, and what is in them."""

    due_ns: int
    data: bytes = b""
    counts: Mapping[str, int] = MappingProxyType({})
    faults: Mapping[str, int] = MappingProxyType({})
    cable: Cable = Cable.AS_BEFORE


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong and when, in seconds of the ride; the defaults fit a demo of a minute."""

    gnss_unplugged_s: tuple[tuple[float, float], ...] = ((30.0, 33.0),)
    gnss_bad_checksum_s: tuple[float, ...] = (16.0,)
    imu_corrupted_s: tuple[float, ...] = (12.0, 27.0, 41.0)
    """One bit of one frame is flipped, behind the header, so that the CRC must catch it."""
    imu_gap_s: tuple[float, ...] = (21.0,)
    imu_gap_samples: int = 7
    can_damaged_s: tuple[float, ...] = (24.0, 38.0)
    """One character of a line is lost: of the motor force, so that no way is lost with it."""


NO_FAULTS = Faults((), (), (), (), 0, ())


@dataclass(frozen=True, slots=True)
class ImuDevice:
    """The sensor and its microcontroller."""

    rate_hz: float = 2000.0
    model: str = "ADIS16465-1"
    baud_rate: int = 2_000_000
    clump_s: float = 0.005
    """The microcontroller's USB hands frames over in clumps of so long."""
    skew: float = 30e-6
    """The device's clock is fast by so much."""
    start_us: int = 2**32 - 24_000_000
    """Device time at the ride's start: the stamp wraps in the first minute."""
    jitter_s: float = 0.0003


Inertial = Callable[[Array], tuple[Array, Array]]
"""Specific force and angular rate of the case at instants of the ride, (n, 3) each."""


def riding(ride: Ride, p_vb_v: Vector = ORIGIN, mounting_deg: Vector = ORIGIN) -> Inertial:
    """Give what an IMU feels on a ride, mounted as a configuration says."""
    level = ride.line.level
    gravity = float(normal_gravity_mps2(level.latitude_rad, level.height_m))
    C_bv = C_vl(*np.radians(mounting_deg))

    def feel(time_s: Array) -> tuple[Array, Array]:
        motion = ride.motion(time_s)
        f_v, omega_v = inertial(motion, gravity, p_vb_v, ride.up_l(motion))
        return f_v @ C_bv.T, omega_v @ C_bv.T

    return feel


def still(time_s: Array) -> tuple[Array, Array]:
    """Give what an IMU feels that stands level in Prague (docs/theory.md, section 1.4)."""
    f_b = np.zeros((len(time_s), 3))
    f_b[:, 2] = 9.81009
    return f_b, np.zeros((len(time_s), 3))


def imu_stream(
    feel: Inertial,
    rng: Generator,
    start_ns: int,
    end_s: float,
    device: ImuDevice,
    faults: Faults = NO_FAULTS,
) -> Iterator[Chunk]:
    """Frames of the IMU in clumps, until `end_s` of the ride (which may be infinite)."""
    noise_rng, line_rng = rng.spawn(2)
    scales = ImuScales(gyro_radps=bridge.GYRO_SCALE_RADPS[device.model])
    sensor = Imu(noise_rng, device.rate_hz, scales=scales)
    clump = max(round(device.clump_s * device.rate_hz), 1)
    block = clump * max(round(BLOCK_S / device.clump_s), 1)
    true_period_s = 1 / device.rate_hz / (1 + device.skew)
    corrupted = {round(at / true_period_s) for at in faults.imu_corrupted_s}
    dropped = {
        round(at / true_period_s) + offset
        for at in faults.imu_gap_s
        for offset in range(faults.imu_gap_samples)
    }
    last_frame_ns = round(framer.FRAME_LENGTH * BITS_PER_BYTE / device.baud_rate * S)
    first = 0
    while first * true_period_s < end_s:
        sequence = np.arange(first, first + block)
        counts = sensor.measure(*feel(np.asarray(sequence * true_period_s, dtype=float)))
        stamp_us = device.start_us + np.floor(sequence * (1e6 / device.rate_hz)).astype(np.int64)
        frames = bytearray(
            framer.encode(stamp_us, sequence, counts.gyro, counts.accel, counts.temperature)
        )
        jitter_ns = line_rng.uniform(0, device.jitter_s * S, block // clump).astype(np.int64)
        for at in range(0, block, clump):
            numbers = range(first + at, first + at + clump)
            piece = frames[at * framer.FRAME_LENGTH : (at + clump) * framer.FRAME_LENGTH]
            data, bad = _damage(bytes(piece), numbers, corrupted, dropped, line_rng)
            due_ns = start_ns + round(numbers[-1] * true_period_s * S) + last_frame_ns
            counted = {"samples": clump - sum(bad.values())}
            yield Chunk(due_ns + int(jitter_ns[at // clump]), data, counted, bad)
        first += block


def _damage(
    data: bytes, numbers: range, corrupted: set[int], dropped: set[int], rng: Generator
) -> tuple[bytes, dict[str, int]]:
    """Flip a bit of the corrupted frames, leave out the dropped ones; tell how many of each."""
    hit = {number for number in numbers if number in corrupted or number in dropped}
    if not hit:
        return data, {}
    frames: list[bytes] = []
    bad = {"frames_corrupted": 0, "samples_dropped": 0}
    for index, number in enumerate(numbers):
        frame = bytearray(data[index * framer.FRAME_LENGTH : (index + 1) * framer.FRAME_LENGTH])
        if number in dropped:
            bad["samples_dropped"] += 1
            continue
        if number in corrupted:
            bit = int(rng.integers(len(framer.HEADER) * 8, framer.FRAME_LENGTH * 8))
            frame[bit // 8] ^= 1 << bit % 8
            bad["frames_corrupted"] += 1
        frames.append(bytes(frame))
    return b"".join(frames), {kind: count for kind, count in bad.items() if count}


DBC_PATH = str(resources.files("tramstream") / "data" / "tram.dbc")
"""The simulated vehicle's bus."""


@dataclass(frozen=True, slots=True)
class CanDevice:
    """The vehicle's bus as an slcan adapter hears it."""

    rate_hz: float = 50.0
    delay_s: float = 0.0005
    """From counting the pulses until the frames are on the line."""
    wheels: Wheels = field(default_factory=Wheels)


def can_stream(
    ride: Ride,
    rng: Generator,
    start_ns: int,
    device: CanDevice | None = None,
    faults: Faults = NO_FAULTS,
) -> Iterator[Chunk]:
    """Doors, motor force and wheel pulses as slcan lines, one chunk for each message period."""
    device = device or CanDevice()
    encode = _frame_encoder()
    damaged = {round(at * device.rate_hz) for at in faults.can_damaged_s}
    block = max(round(2 * BLOCK_S * device.rate_hz), 1)
    first, end = 0, (ride.duration_s + SILENCE_AFTER_S) * device.rate_hz
    while first < end:
        time_s = np.arange(first, first + block) / device.rate_hz
        motion = ride.motion(time_s)
        pulses = device.wheels.measure(motion).tolist()
        force = motor_force_n(motion).tolist()
        opened = ride.doors_open(time_s).tolist()
        for index, (left, right) in enumerate(pulses):
            number = first + index
            drive = encode("DRIVE", {"MOTOR_FORCE": force[index]})
            bad: dict[str, int] = {}
            if number in damaged:
                drive, bad = _lose_character(drive, rng), {"lines_damaged": 1}
            data = (
                encode("DOORS", {"DOORS_OPEN": int(opened[index])})
                + drive
                + encode(
                    "WHEELS",
                    {"PULSES_LEFT": left, "PULSES_RIGHT": right, "COUNTER": number & 0xFF},
                )
            )
            counts = {"frames": 3 - len(bad), "pulses_left": left, "pulses_right": right}
            due_ns = start_ns + round((time_s[index] + device.delay_s) * S)
            yield Chunk(due_ns, data, counts, bad)
        first += block


def _frame_encoder() -> Callable[[str, dict[str, Any]], bytes]:
    database: Any = cantools.database.load_file(DBC_PATH)
    messages = {message.name: message for message in database.messages}

    def encode(name: str, signals: dict[str, Any]) -> bytes:
        message = messages[name]
        data: bytes = message.encode(signals)
        return slcan.encode_frame(message.frame_id, data)

    return encode


def _lose_character(line: bytes, rng: Generator) -> bytes:
    """Lose one character of the data: what is left is no whole number of bytes."""
    at = int(rng.integers(len(b"t1202"), len(line) - 1))
    return line[:at] + line[at + 1 :]
