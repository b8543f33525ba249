"""Inertial samples of a record as whole counts, thousands of messages at a time.

Hours of 2 kHz are millions of messages: their columns are read straight out of the bytes by a
compiled function, which takes what a protobuf writer makes of an `ImuBatch` and leaves everything
else (an unknown layout, a torn message) to `Record.decode`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream import keys
from tramstream.boundary import Undecodable
from tramstream.machine.kernels import compiled
from tramstream.proto.raw_pb2 import ImuBatch
from tramstream.recorder.reader import Entry, Record

Array = NDArray[np.float64]

BATCH = 4096
"""Messages that are read together."""
_HEADS = 7
"""Words of a message beside its samples: stamp, number of the first sample, period, the scales of
gyroscope, accelerometer and temperature, the temperature."""
_FIXED = {1: 0, 5: 2, 6: 3, 7: 4, 8: 5}
_FIXED_SLOT = np.array([_FIXED.get(number, -1) for number in range(17)])
"""Where fields of eight bytes go."""


class Samples(NamedTuple):
    """Consecutive messages, one row each, and their samples side by side."""

    stamp_ns: NDArray[np.int64]
    """Of the first sample of each message."""
    first: NDArray[np.int64]
    """The device's number of that sample."""
    length: NDArray[np.int64]
    """Samples of each message."""
    period_ns: Array
    gyro_scale_radps: Array
    accel_scale_mps2: Array
    temperature_degc: Array
    counts: NDArray[np.int32]
    """Shape (6, n): gyroscopes x y z, accelerometers x y z, of all messages."""


@compiled
def _varint(data: NDArray[np.uint8], at: int, end: int) -> tuple[int, int]:
    """An integer and where it ends; −1 if it does not."""
    value = np.uint64(0)
    for place in range(10):
        if at >= end:
            return 0, -1
        byte = data[at]
        at += 1
        value |= np.uint64(byte & 0x7F) << np.uint64(7 * place)
        if byte < 0x80:
            return int(np.int64(value)), at
    return 0, -1


@compiled
def _packed(data: NDArray[np.uint8], at: int, end: int, row: NDArray[np.int32]) -> int:
    """Zigzag integers until `end`; how many, −1 if they do not fit."""
    count = 0
    while at < end:
        byte = data[at]
        if byte < 0x80:
            at += 1
            value = int(byte)
        else:
            value, at = _varint(data, at, end)
            if at < 0 or value < 0 or value > 0xFFFFFFFF:
                return -1
        if count >= len(row):
            return -1
        row[count] = (value >> 1) ^ -(value & 1)
        count += 1
    return count


@compiled
def _message(
    data: NDArray[np.uint8],
    at: int,
    end: int,
    head: NDArray[np.uint64],
    samples: NDArray[np.int32],
) -> int:
    """Read one message into its head and the columns; its samples, −1 where it is another kind."""
    sizes = np.zeros(6, np.int64)
    while at < end:
        tag, at = _varint(data, at, end)
        if at < 0:
            return -1
        number, wire = tag >> 3, tag & 7
        if wire == 1:
            if at + 8 > end:
                return -1
            slot = _FIXED_SLOT[number] if number < len(_FIXED_SLOT) else -1
            if slot >= 0:
                word = np.uint64(0)
                for place in range(8):
                    word |= np.uint64(data[at + place]) << np.uint64(8 * place)
                head[slot] = word
            at += 8
        elif wire == 0:
            value, at = _varint(data, at, end)
            if at < 0 or (9 <= number <= 14):
                return -1
            if number == 4:
                head[1] = np.uint64(value)
            if number == 15:
                head[6] = np.uint64((value >> 1) ^ -(value & 1))
        elif wire == 2:
            length, at = _varint(data, at, end)
            if at < 0 or length < 0 or at + length > end:
                return -1
            if 9 <= number <= 14:
                axis = number - 9
                if sizes[axis]:
                    return -1
                sizes[axis] = _packed(data, at, at + length, samples[axis])
                if sizes[axis] < 0:
                    return -1
            at += length
        else:
            return -1
    for axis in range(1, 6):
        if sizes[axis] != sizes[0]:
            return -1
    return int(sizes[0])


@compiled
def _messages(
    data: NDArray[np.uint8],
    ends: NDArray[np.int64],
    heads: NDArray[np.uint64],
    counts: NDArray[np.int32],
) -> NDArray[np.int64]:
    """Read messages that lie behind each other; samples of each, −1 where it is another kind."""
    lengths = np.empty(len(ends), np.int64)
    begin = filled = 0
    for row in range(len(ends)):
        lengths[row] = _message(data, begin, ends[row], heads[row], counts[:, filled:])
        filled += max(lengths[row], 0)
        begin = ends[row]
    return lengths


def inertial_topic(record: Record) -> str:
    """The topic of the vehicle's inertial samples; empty if there is none."""
    name = keys.IMU_BATCH.type.DESCRIPTOR.full_name
    found = [
        topic
        for topic in record.channels
        if keys.split(topic)[1] == keys.IMU_BATCH.path and record.type_of(topic) == name
    ]
    return found[0] if found else ""


def inertial_samples(record: Record) -> Iterator[Samples]:
    """All inertial samples of a record in the order of their arrival.

    Messages that are none are left out and counted (`Record.undecodable`).
    """
    topic = inertial_topic(record)
    entries = record.messages(topic.__eq__)
    while batch := list(itertools.islice(entries, BATCH)):
        yield from _read(record, batch)


def _read(record: Record, entries: list[Entry]) -> Iterator[Samples]:
    payloads = [entry.payload for entry in entries]
    sizes = np.fromiter(map(len, payloads), np.int64, len(payloads))
    data = np.frombuffer(b"".join(payloads), np.uint8)
    heads = np.zeros((len(payloads), _HEADS), np.uint64)
    # A sample takes six bytes at least.
    counts = np.empty((6, len(data) // 6 + 1), np.int32)
    lengths = _messages(data, np.cumsum(sizes), heads, counts)
    begin = filled = 0
    for row in [*np.flatnonzero(lengths < 0).tolist(), len(entries)]:
        end = filled + int(lengths[begin:row].sum())
        if row > begin:
            yield _of_heads(heads[begin:row], lengths[begin:row], counts[:, filled:end])
        begin, filled = row + 1, end
        if row < len(entries):
            message = record.decode(entries[row])
            if not isinstance(message, Undecodable) and (odd := _of_message(message)) is not None:
                yield odd


def _of_heads(
    heads: NDArray[np.uint64], lengths: NDArray[np.int64], counts: NDArray[np.int32]
) -> Samples:
    number = heads.view(np.float64)
    temperature = heads[:, 6].astype(np.int64) * number[:, 5]
    signed = heads.view(np.int64)
    return Samples(
        signed[:, 0], signed[:, 1], lengths, number[:, 2], number[:, 3], number[:, 4],
        temperature, counts,
    )  # fmt: skip


def _of_message(message: ImuBatch) -> Samples | None:
    """One message that another writer laid out; None if its columns are not of one length."""
    columns = (
        message.gyro_x, message.gyro_y, message.gyro_z,
        message.accel_x, message.accel_y, message.accel_z,
    )  # fmt: skip
    if len({len(column) for column in columns}) != 1 or message.first_sample_sequence >= 1 << 62:
        return None

    def row(value: float) -> Array:
        return np.array([value], dtype=float)

    return Samples(
        np.array([message.stamp_ns]),
        np.array([message.first_sample_sequence]),
        np.array([len(message.gyro_x)]),
        row(message.period_ns),
        row(message.gyro_scale_radps),
        row(message.accel_scale_mps2),
        row(message.temperature * message.temperature_scale_degc),
        np.array([list(column) for column in columns], dtype=np.int32),
    )
