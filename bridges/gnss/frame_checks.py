"""Judge a possible frame at a place of a receiver's stream: whole, impossible, or not yet there.

Check values come from prefix sums of what lies in the window, made once: whether a frame of n bytes
agrees is then told in constant time, and no input, however hostile, makes it slower than linear.

A *chain* is three whole frames that follow one another at once. No receiver sends one inside of
another frame, so what claims to go on around a chain is a false start, whatever its check value.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from dataclasses import dataclass, field
from functools import cache
from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from tramstream.bridges.gnss import ubx_layouts

RTCM3_OVERHEAD = 6
"""Preamble, two of length, three of CRC."""
SYNC = re.compile(rb"\xb5\x62|\$[A-Z]|![A-Z]|\xd3[\x00-\x03]")
SYNC_FIRST = b"\xb5$!\xd3"
# Start and at most 1024 characters up to the asterisk, none of them a control character or another
# start. The standard allows 79; PUBX,03 with 60 satellites has 900.
_BODY = rb"[$!][A-Z][ -#%-)+-~]{0,1023}+"
_SENTENCE = re.compile(_BODY + rb"\*([0-9A-Fa-f]{2})")
_SENTENCE_SO_FAR = re.compile(_BODY + rb"(?:\*[0-9A-Fa-f]?)?\Z")
_LINE_END = re.compile(rb"\r{0,2}\n")
_LINE_END_SO_FAR = re.compile(rb"\r{0,2}\Z")
LINE_ENDS = re.compile(rb"[\r\n]*")

WAIT = 0
# Why a frame cannot be, as negative verdicts.
_LENGTH, _COUNT, _FLETCHER, _MALFORMED, _XOR, _CRC = range(-6, 0)
REASONS = {
    _LENGTH: "UBX length",
    _COUNT: "UBX count",
    _FLETCHER: "UBX checksum",
    _MALFORMED: "NMEA malformed",
    _XOR: "NMEA checksum",
    _CRC: "RTCM3 CRC",
}


Verdict = tuple[int, int]
"""Kind, and where the frame ends in the window, `WAIT`, or a negative reason."""
_UBX_FIRST, _RTCM3_FIRST = 0xB5, 0xD3
_CHAIN = 3
"""Frames of a chain."""
_CHAIN_BEGINS = re.compile(rb"\xb5\x62|\$[A-Z]")
_LEAST = 2
"""Bytes that show a start."""
_FAR = 2**63
_ROOM = 32
"""A frame that is shorter is not looked into."""


class Window:
    """The bytes at hand, with prefix sums made when the first frame needs them."""

    def __init__(self, data: bytes, final: bool) -> None:
        self.data = data
        self._final = final
        self._fletcher: tuple[bytes, bytes] | None = None
        self._xor: bytes | None = None
        self.claimed = 0
        """Where the frame that was judged last says that it ends; 0: it does not say."""

    def check(self, start: int) -> Verdict:
        """Judge the possible frame at `start`, where the sync pattern of one of the others lies."""
        return (
            self._check_rtcm3(start)
            if self.data[start] == _RTCM3_FIRST
            else self._check_nmea(start)
        )

    def check_ubx(self, start: int) -> Verdict:
        data = self.data
        size = len(data)
        self.claimed = 0
        payload = start + 6
        if payload > size:
            return 0, WAIT
        kind = data[start + 2] << 8 | data[start + 3]
        length = data[start + 4] | data[start + 5] << 8
        fixed, step, longest, count_at = _LIMITS.get(kind, _ANY)
        extra = length - fixed
        if extra < 0 or length > longest or (extra % step if step else extra):
            if length and length not in _OTHER_LENGTHS.get(kind, ()):  # 0 is a request
                return kind, _LENGTH
        elif count_at >= 0:
            if payload + count_at >= size:
                return kind, WAIT
            told = data[payload + count_at] * step
            if extra != told and length not in _OTHER_LENGTHS.get(kind, ()):
                return kind, _COUNT
        end = payload + length
        self.claimed = end + 2
        if end + 2 > size:
            return kind, WAIT
        if self._fletcher is None:
            self._fletcher = fletcher_prefix(data)
        sums, sums_of_sums = self._fletcher
        before, last = start + 1, end - 1
        a0 = sums[before]
        a = (sums[last] - a0) & 0xFF
        b = (sums_of_sums[last] - sums_of_sums[before] - (last - before) * a0) & 0xFF
        if a != data[end] or b != data[end + 1]:
            return kind, _FLETCHER
        return kind, end + 2

    def _check_nmea(self, start: int) -> Verdict:
        self.claimed = 0
        end = self._sentence(start)
        if end <= 0:
            return 0, end
        line_end = _LINE_END.match(self.data, end)
        if line_end is None and not self._final and _LINE_END_SO_FAR.match(self.data, end):
            return 0, WAIT  # its line end may be on its way
        return 0, end if line_end is None else line_end.end()

    def _sentence(self, start: int) -> int:
        """Where the sentence at `start` ends behind its check value; `WAIT`, or why it cannot."""
        data = self.data
        found = _SENTENCE.match(data, start)
        if found is None:
            return WAIT if _SENTENCE_SO_FAR.match(data, start) else _MALFORMED
        if self._xor is None:
            self._xor = np.bitwise_xor.accumulate(np.frombuffer(data, np.uint8)).tobytes()
        digits = found.start(1)
        agrees = self._xor[start] ^ self._xor[digits - 2] == int(found.group(1), 16)
        return found.end() if agrees else _XOR

    def _check_rtcm3(self, start: int) -> Verdict:
        data = self.data
        size = len(data)
        self.claimed = 0
        if start + 3 > size:
            return 0, WAIT
        length = (data[start + 1] & 3) << 8 | data[start + 2]
        end = self.claimed = start + length + RTCM3_OVERHEAD
        if end > size:
            return 0, WAIT
        kind = data[start + 3] << 4 | data[start + 4] >> 4 if length >= 2 else 0
        if crc24q(data[start : end - 3]) != int.from_bytes(data[end - 3 : end], "big"):
            return kind, _CRC
        return kind, end

    def end_of_chain(self, at: int) -> tuple[int, int]:
        """Where the chain that begins at `at` ends, 0 if none does; what has to be there to tell.

        The latter is 0 where it is known.
        """
        end, size = 0, len(self.data)
        for _ in range(_CHAIN):
            if at + _LEAST > size:
                return 0, size + 1
            if SYNC.match(self.data, at) is None:
                return 0, 0
            first = self.data[at]
            if first == _UBX_FIRST:
                end = self.check_ubx(at)[1]
            elif first == _RTCM3_FIRST:
                end = self._check_rtcm3(at)[1]
            else:  # a line end, which may be on its way, is no part of the chain
                self.claimed, end = 0, self._sentence(at)
            if end == WAIT:
                return 0, max(self.claimed, size + 1)
            if end < 0:
                return 0, 0
            between = LINE_ENDS.match(self.data, end)
            at = between.end() if between is not None else end
        return end, 0


@dataclass
class Chains:
    """Chains in a stream, each looked for once however the stream is cut: a memory.

    All places are those in the stream, the first byte ever fed being 0.
    """

    searched: int = 0
    """Before it, all beginnings are known."""
    found: list[tuple[int, int]] = field(default_factory=list)
    """Start and end; both rise: of two chains, one within the other, the outer tells nothing."""
    undecided: list[tuple[int, int]] = field(default_factory=list)
    """A heap of beginnings, by how far the stream has to have come to tell."""

    def are_inside(self, window: Window, base: int, start: int, end: int) -> bool:
        """Whether one lies between `start`, which only rises, and `end`.

        `base` is the place of the window's first byte.
        """
        if end - start < _ROOM:
            return False
        come = base + len(window.data)
        limit = min(end, come) - base
        at = max(self.searched, start + 1) - base
        while (beginning := _CHAIN_BEGINS.search(window.data, at, limit)) is not None:
            at = beginning.start() + 1
            self._judge(window, base, base + beginning.start())
        self.searched = max(self.searched, base + limit - 1)  # half of one may stand there
        while self.undecided and self.undecided[0][0] <= come:
            place = heappop(self.undecided)[1]
            if place > start:
                self._judge(window, base, place)
        del self.found[: bisect_right(self.found, (start, _FAR))]
        return bool(self.found) and self.found[0][1] < end

    def _judge(self, window: Window, base: int, place: int) -> None:
        end, needed = window.end_of_chain(place - base)
        if needed:
            heappush(self.undecided, (base + needed, place))
        if not end:
            return
        found, end = self.found, base + end
        at = bisect_right(found, (place, _FAR))
        if at < len(found) and found[at][1] <= end:
            return
        first = at
        while first and found[first - 1][1] >= end:
            first -= 1
        found[first:at] = [(place, end)]


_LIMITS = ubx_layouts.LIMITS
_OTHER_LENGTHS = ubx_layouts.OTHER_LENGTHS
_ANY = ubx_layouts.ANY_LIMIT


def fletcher_prefix(data: bytes) -> tuple[bytes, bytes]:
    """Running sums, and running sums of these, of all bytes modulo 256."""
    sums = np.cumsum(np.frombuffer(data, np.uint8), dtype=np.uint8)
    return sums.tobytes(), np.cumsum(sums, dtype=np.uint8).tobytes()


@cache
def _crc24q_table() -> NDArray[np.uint32]:
    """What byte b, followed by k more, adds to the CRC, at [k * 256 + b]; the CRC is linear."""
    byte = np.arange(256, dtype=np.uint32) << 16
    for _ in range(8):
        byte = np.where(byte & 0x800000, (byte << 1) ^ 0x1864CFB, byte << 1)
    rows = [byte]
    for _ in range(1023 + 2):
        rows.append((rows[-1] << 8 & 0xFFFFFF) ^ byte[rows[-1] >> 16])
    return np.concatenate(rows)


_ROW = np.arange(1025, -1, -1) * 256


def crc24q(data: bytes) -> int:
    """CRC-24Q (polynomial 0x1864CFB, start 0) of at most 1026 bytes.

    References
    ----------
    RTCM 10403, section 4 (transport layer); Qualcomm's CRC-24Q.
    """
    where = _ROW[len(_ROW) - len(data) :] + np.frombuffer(data, np.uint8)
    return int(np.bitwise_xor.reduce(_crc24q_table()[where], initial=0))
