"""Judge a possible frame at a place of a receiver's stream: whole, impossible, or not yet there.

Check values come from prefix sums of what lies in the window, made once: whether a frame of n bytes
agrees is then told in constant time, and no input, however hostile, makes it slower than linear.

A *chain* is three whole frames that follow one another at once. No receiver sends one inside of
another frame, so what claims to go on around a chain is a false start, whatever its check value.
"""

from __future__ import annotations

import re
from collections import deque
from functools import cache

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
_ROOM = 32
"""A frame that is shorter is not looked into."""


class Window:
    """The bytes at hand, with prefix sums made when the first frame needs them."""

    def __init__(self, data: bytes, final: bool) -> None:
        self.data = data
        self._final = final
        self._fletcher: tuple[bytes, bytes] | None = None
        self._xor: bytes | None = None
        self._claimed = 0  # where the frame that was judged last says it ends; 0: it does not say
        self._searched = 0
        self._chains: deque[tuple[int, int]] = deque()  # start and end, both rising

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
        self._claimed = 0
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
        self._claimed = end + 2
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
        self._claimed = 0
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
        self._claimed = 0
        if start + 3 > size:
            return 0, WAIT
        length = (data[start + 1] & 3) << 8 | data[start + 2]
        end = self._claimed = start + length + RTCM3_OVERHEAD
        if end > size:
            return 0, WAIT
        kind = data[start + 3] << 4 | data[start + 4] >> 4 if length >= 2 else 0
        if crc24q(data[start : end - 3]) != int.from_bytes(data[end - 3 : end], "big"):
            return kind, _CRC
        return kind, end

    def is_overtaken(self, start: int) -> bool:
        """Whether a chain lies inside of the frame at `start`, which was judged right before.

        It hangs on the bytes of that frame alone: whoever waits for its end and whoever has it at
        once come to the same. Starts only rise.
        """
        end = self._claimed
        if end - start < _ROOM:
            return False
        chains, limit = self._chains, min(end, len(self.data))
        at = max(self._searched, start + 1)
        while (found := _CHAIN_BEGINS.search(self.data, at, limit)) is not None:
            at = found.start() + 1
            chain_end = self._end_of_chain(found.start())
            if chain_end:
                while chains and chains[-1][1] >= chain_end:
                    chains.pop()  # it begins earlier and ends no earlier
                chains.append((found.start(), chain_end))
        self._searched = max(self._searched, limit - 1)  # half of a start may stand there
        while chains and chains[0][0] <= start:
            chains.popleft()
        return bool(chains) and chains[0][1] < end

    def _end_of_chain(self, at: int) -> int:
        """Where the chain that begins at `at` ends; 0 if none does, or not all of it is there."""
        end = 0
        for _ in range(_CHAIN):
            if SYNC.match(self.data, at) is None:
                return 0
            first = self.data[at]
            if first == _UBX_FIRST:
                end = self.check_ubx(at)[1]
            elif first == _RTCM3_FIRST:
                end = self._check_rtcm3(at)[1]
            else:  # a line end, which may be on its way, is no part of the chain
                end = self._sentence(at)
            if end <= 0:
                return 0
            between = LINE_ENDS.match(self.data, end)
            at = between.end() if between is not None else end
        return end


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
