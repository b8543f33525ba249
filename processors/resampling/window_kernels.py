"""Columns of inertial batches into a block of memory, and weighted sums over it, compiled.

Reading 120 integers out of a protobuf message one by one costs twice what all the rest of a window
costs. So a batch is taken as the bytes it has on the wire, where its columns lie one after the
other as packed variable-length integers (https://protobuf.dev/programming-guides/encoding).
"""

from __future__ import annotations

import math

from tramstream.estimation.kalman import Array, compiled
from tramstream.proto.raw_pb2 import ImuBatch

CHANNELS = 6
"""gyro x y z, accelerometer x y z: the first rows of a block."""
STAMPS = CHANNELS
"""The last row of a block: instants, ns after the run's first stamp."""
_FIELDS = ImuBatch.DESCRIPTOR.fields_by_name
_FIRST = int(_FIELDS["gyro_x"].number)
_LAST = int(_FIELDS["accel_z"].number)
assert _LAST - _FIRST + 1 == CHANNELS


@compiled
def read_batch(payload: bytes, block: Array, begin: int, start_ns: float, period_ns: float) -> int:
    """Write the samples of an encoded ImuBatch into the columns of `block` from `begin` on.

    Parameters
    ----------
    payload : bytes
        As `SerializeToString` gave it: whole, and with packed columns.
    block : ndarray, shape (7, m)
    begin : int
    start_ns, period_ns : float
        Instant of the first sample, and from one to the next.

    Returns
    -------
    int
        Count of samples; negative if the columns differ in length or the block is too short.
    """
    room = block.shape[1] - begin
    count = -1
    seen = 0
    position = 0
    while position < len(payload):
        tag, position = _integer(payload, position)
        kind = tag & 7
        if kind == 0:
            _, position = _integer(payload, position)
        elif kind == 1:
            position += 8
        elif kind == 5:
            position += 4
        else:
            length, position = _integer(payload, position)
            end = position + length
            row = (tag >> 3) - _FIRST
            if 0 <= row < CHANNELS:
                size = 0
                while position < end and size < room:
                    value, position = _integer(payload, position)
                    block[row, begin + size] = (value >> 1) ^ -(value & 1)  # zigzag
                    size += 1
                if position < end or (seen and size != count):
                    return -1
                count = size
                seen += 1
            position = end
    if seen not in (0, CHANNELS):
        return -1
    count = max(count, 0)
    for index in range(count):
        block[STAMPS, begin + index] = index * period_ns + start_ns
    return count


@compiled
def _integer(payload: bytes, position: int) -> tuple[int, int]:
    """A variable-length integer, and where the next field begins."""
    value = 0
    shift = 0
    while True:
        byte = payload[position]
        position += 1
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return value, position


@compiled
def scatter(block: Array, begin: int, count: int) -> tuple[float, ...]:
    """Deviation of each channel's `count` samples from `begin` on about their mean; 0 of one.

    Returns
    -------
    tuple of 6 floats
    """
    if count < 2:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    a = _deviation(block[0], begin, count)
    b = _deviation(block[1], begin, count)
    c = _deviation(block[2], begin, count)
    d = _deviation(block[3], begin, count)
    e = _deviation(block[4], begin, count)
    f = _deviation(block[5], begin, count)
    return a, b, c, d, e, f


@compiled
def _deviation(row: Array, begin: int, count: int) -> float:
    """Root of the unbiased variance; from the first sample on, so that large counts keep digits."""
    origin = row[begin]
    total = squares = 0.0
    for index in range(begin, begin + count):
        off = row[index] - origin
        total += off
        squares += off * off
    variance = (squares - total * total / count) / (count - 1)
    return math.sqrt(max(variance, 0.0))


@compiled
def weigh(block: Array, begin: int, taps: Array) -> tuple[float, ...]:
    """Sum each channel from `begin` on, weighted by `taps`, in the order of the samples.

    Returns
    -------
    tuple of 8 floats
        The channels' sums, and the instants of the first and the last sample.
    """
    a = b = c = d = e = f = 0.0
    for index in range(len(taps)):
        weight, at = taps[index], begin + index
        a += block[0, at] * weight
        b += block[1, at] * weight
        c += block[2, at] * weight
        d += block[3, at] * weight
        e += block[4, at] * weight
        f += block[5, at] * weight
    return a, b, c, d, e, f, block[STAMPS, begin], block[STAMPS, begin + len(taps) - 1]
