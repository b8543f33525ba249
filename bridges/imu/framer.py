"""Frames of the microcontroller in front of an ADIS16465: one 20-byte burst each.

The layout is ours and written down for the firmware's author in docs/imu-framing.md:

    sync AD 65 | type 01 | length 1C | stamp u32 µs | sequence u32 | burst, 20 bytes | CRC-32

The microcontroller's own numbers are little-endian, the burst is as the sensor sent it, big-endian.
The CRC is zlib's over everything after the sync, sent little-endian, so that the CRC over that and
itself is a constant.

A frame starts where the sync is; whether it is one depends on the bytes alone, never on how the
stream was cut. A false start costs its first byte only: the search goes on one byte behind it. A
frame whose CRC holds is framed; if the burst in it is damaged (the sensor's own sum, or all zeros
from a dead SPI line) it is rejected as a whole.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

SYNC = b"\xad\x65"
TYPE_BURST = 0x01
PAYLOAD_LENGTH = 28
"""Stamp, sequence and burst: the bytes between length and CRC."""
HEADER = SYNC + bytes((TYPE_BURST, PAYLOAD_LENGTH))

# ADIS16465 data sheet, "Burst Read Function" (docs/theory.md, section 3.2).
FRAME = np.dtype(
    [
        ("header", "<u4"),
        ("stamp_us", "<u4"),
        ("sequence", "<u4"),
        ("diag_stat", ">u2"),
        ("gyro", ">i2", (3,)),
        ("accel", ">i2", (3,)),
        ("temperature", ">i2"),
        ("data_cntr", ">u2"),
        ("checksum", ">u2"),
        ("crc", "<u4"),
    ]
)
FRAME_LENGTH = FRAME.itemsize
SUMMED = slice(12, 30)
"""DIAG_STAT to DATA_CNTR: the bytes that the sensor's checksum adds up."""
RESIDUE = 0x2144DF1C
"""CRC-32 of anything followed by its own CRC-32, little-endian."""

REJECT_HEADER = "header"
REJECT_CRC = "crc"
REJECT_CHECKSUM = "checksum"
REJECT_EMPTY = "empty burst"


class Rejected(NamedTuple):
    """A start that was none, or a frame whose burst is damaged."""

    reason: str
    offset: int
    """Of its first byte in the stream since the framer was made."""
    length: int


class Bursts(NamedTuple):
    """What one `feed` completed."""

    frames: NDArray[np.void]
    """Good frames in order, of type `FRAME`; read-only."""
    rejected: list[Rejected]


@dataclass
class AdisFramer:
    """Find frames in a stream of bytes; equal results for any split of it. It is its own memory.

    Bytes fed = `bytes_framed` + `bytes_rejected` + bytes pending, at any instant.
    """

    bytes_framed: int = 0
    bytes_rejected: int = 0
    rejected_by_reason: dict[str, int] = field(default_factory=dict)
    _buffer: bytes = b""

    @property
    def bytes_pending(self) -> int:
        return len(self._buffer)

    @property
    def bytes_fed(self) -> int:
        return self.bytes_framed + self.bytes_rejected + self.bytes_pending

    def feed(self, data: bytes) -> Bursts:
        """Take the next bytes, return the frames that end in them."""
        offset = self.bytes_framed + self.bytes_rejected
        buffer = self._buffer + data if self._buffer else bytes(data)
        runs: list[NDArray[np.void]] = []
        rejected: list[Rejected] = []
        start, decided = 0, False
        while not decided:
            end = _end_of_run(buffer, start)
            if end > start:
                runs.append(self._check_bursts(buffer, start, end, offset, rejected))
                start = end
            next_start, decided, reason = _skip(buffer, start)
            self.bytes_rejected += next_start - start
            if reason:
                rejected.append(Rejected(reason, offset + start, 1))
            start = next_start
        self._buffer = buffer[start:]
        for reject in rejected:
            count = self.rejected_by_reason.get(reject.reason, 0)
            self.rejected_by_reason[reject.reason] = count + 1
        if len(runs) == 1:
            return Bursts(runs[0], rejected)
        return Bursts(join(runs), rejected)

    def _check_bursts(
        self, buffer: bytes, start: int, end: int, offset: int, rejected: list[Rejected]
    ) -> NDArray[np.void]:
        """Frames of a run, without those whose burst is damaged."""
        frames = np.frombuffer(buffer, FRAME, (end - start) // FRAME_LENGTH, start)
        octets = np.frombuffer(buffer, np.uint8, end - start, start).reshape(-1, FRAME_LENGTH)
        sums = octets[:, SUMMED].sum(axis=1, dtype=np.uint16)
        good = (sums == frames["checksum"]) & (sums != 0)  # only 18 zeros add up to zero
        if good.all():
            self.bytes_framed += end - start
            return frames
        for index in np.flatnonzero(~good).tolist():
            reason = REJECT_CHECKSUM if octets[index, 12:32].any() else REJECT_EMPTY
            position = offset + start + index * FRAME_LENGTH
            rejected.append(Rejected(reason, position, FRAME_LENGTH))
        self.bytes_framed += int(good.sum()) * FRAME_LENGTH
        self.bytes_rejected += int((~good).sum()) * FRAME_LENGTH
        kept: NDArray[np.void] = frames[good]
        return kept


def join(runs: list[NDArray[np.void]]) -> NDArray[np.void]:
    """One array of several, bytes untouched; numpy alone would turn them to native byte order."""
    return np.concatenate(runs, dtype=FRAME) if runs else np.empty(0, FRAME)


def _end_of_run(buffer: bytes, start: int) -> int:
    """End of the frames with a good CRC that follow each other from `start`."""
    view, crc32 = memoryview(buffer), zlib.crc32
    while (
        buffer.startswith(HEADER, start)
        and start + FRAME_LENGTH <= len(buffer)
        and crc32(view[start + len(SYNC) : start + FRAME_LENGTH]) == RESIDUE
    ):
        start += FRAME_LENGTH
    return start


def _skip(buffer: bytes, start: int) -> tuple[int, bool, str]:
    """Leave what cannot start a frame: new start, whether to wait for more bytes, reason.

    Called where no good frame starts. The reason is empty for noise without a sync.
    """
    head = buffer[start : start + len(HEADER)]
    if HEADER.startswith(head):
        if start + FRAME_LENGTH > len(buffer):
            return start, True, ""  # may become a frame
        return start + 1, False, REJECT_CRC
    if head.startswith(SYNC):
        return start + 1, False, REJECT_HEADER
    found = buffer.find(SYNC, start)
    if found < 0:
        found = len(buffer) - buffer.endswith(SYNC[:1])
        return found, True, ""
    return found, False, ""


def encode(
    stamp_us: ArrayLike,
    sequence: ArrayLike,
    gyro: ArrayLike,
    accel: ArrayLike,
    temperature: ArrayLike = 250,
    diag_stat: ArrayLike = 0,
    data_cntr: ArrayLike | None = None,
) -> bytes:
    """Frames as the microcontroller sends them.

    Parameters
    ----------
    stamp_us, sequence : array_like of int, shape (n,)
        Wrapped to 32 bits here.
    gyro, accel : array_like of int, shape (n, 3)
        Counts; clipped to 16 bits, as the sensor does.
    temperature : array_like of int, shape () or (n,)
        Counts of 0.1 °C.
    diag_stat : array_like of int, shape () or (n,)
    data_cntr : array_like of int, shape (n,), optional
        The sensor's counter; the sequence by default. Wrapped to 16 bits here.
    """
    sequence = np.atleast_1d(np.asarray(sequence, np.int64))
    counter = sequence if data_cntr is None else np.asarray(data_cntr, np.int64)
    frames = np.zeros(len(sequence), FRAME)
    frames["header"] = int.from_bytes(HEADER, "little")
    frames["stamp_us"] = np.asarray(stamp_us, np.int64) & 0xFFFFFFFF
    frames["sequence"] = sequence & 0xFFFFFFFF
    frames["diag_stat"] = diag_stat
    frames["gyro"] = np.clip(gyro, -32768, 32767)
    frames["accel"] = np.clip(accel, -32768, 32767)
    frames["temperature"] = np.clip(temperature, -32768, 32767)
    frames["data_cntr"] = counter & 0xFFFF
    octets = frames.view(np.uint8).reshape(-1, FRAME_LENGTH)
    frames["checksum"] = octets[:, SUMMED].sum(axis=1, dtype=np.uint16)
    view = memoryview(octets.tobytes())
    ends = range(FRAME_LENGTH, len(view) + 1, FRAME_LENGTH)
    frames["crc"] = [zlib.crc32(view[end - FRAME_LENGTH + len(SYNC) : end - 4]) for end in ends]
    return frames.tobytes()
