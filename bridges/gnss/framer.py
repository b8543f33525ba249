"""Cut a receiver's mixed stream into UBX, NMEA and RTCM3 frames.

The stream is read from left to right. At each place where a frame may start, one of three things
holds: the frame is whole and its check value agrees (it is delivered), something in it cannot be
(a *false start*: reading resumes one byte further on, so that an intact frame behind a corrupt
header is never lost), or more bytes are needed (the framer waits). None of the three depends on
where the stream was cut, so any cutting gives the same list. Inside a whole frame no other frame
is looked for: the outer one wins.

A frame may only be as long as its type allows, and may not contradict its own count of entries, so
that a flipped length bit is noticed in the header or after a wait that is bounded by the type's
longest message (`ubx_layouts.LIMITS`), never after 64 KiB.

An NMEA sentence is whole with its checksum. Its line end may be any: CR LF, LF alone, LF LF or
CR CR LF behind a terminal that was not raw, none at all at the end of a file. One line end belongs
to the frame; what follows of CR and LF is counted with it and reported neither as frame nor as
rejected.

Check values come from prefix sums of what lies in the buffer, made once for each `feed`: whether a
frame of n bytes agrees is then told in constant time, and no input, however hostile, makes the
framer slower than linear.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from functools import cache, reduce
from operator import xor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.bridges.gnss import ubx_layouts

UBX, NMEA, RTCM3 = "UBX", "NMEA", "RTCM3"

NOISE = "noise"
"""Reason of bytes in which no frame starts: text headers, another device's words, line noise."""

RTCM3_OVERHEAD = 6
"""Preamble, two of length, three of CRC."""
_SYNC = re.compile(rb"\xb5\x62|\$[A-Z]|![A-Z]|\xd3[\x00-\x03]")
_SYNC_FIRST = b"\xb5$!\xd3"
# Start and at most 1024 characters up to the asterisk, none of them a control character or another
# start. The standard allows 79; PUBX,03 with 60 satellites has 900.
_BODY = rb"[$!][A-Z][ -#%-)+-~]{0,1023}+"
_SENTENCE = re.compile(_BODY + rb"\*([0-9A-Fa-f]{2})((?:\r{0,2}\n)?)")
_SENTENCE_SO_FAR = re.compile(_BODY + rb"(?:\*[0-9A-Fa-f]?)?\Z")
_LINE_END_SO_FAR = re.compile(rb"\r{0,2}\Z")
_LINE_ENDS = re.compile(rb"[\r\n]*")

_SLICE = 1 << 20
"""A long `feed` is worked through in slices of this many bytes, to bound the memory."""

_WAIT = 0
# Why a frame cannot be, as negative verdicts.
_LENGTH, _COUNT, _FLETCHER, _UBX_CUT, _MALFORMED, _XOR, _NMEA_CUT, _CRC, _RTCM3_CUT = range(-9, 0)
_REASONS = {
    _LENGTH: "UBX length",
    _COUNT: "UBX count",
    _FLETCHER: "UBX checksum",
    _UBX_CUT: "UBX truncated",
    _MALFORMED: "NMEA malformed",
    _XOR: "NMEA checksum",
    _NMEA_CUT: "NMEA truncated",
    _CRC: "RTCM3 CRC",
    _RTCM3_CUT: "RTCM3 truncated",
}


class Frame(NamedTuple):
    """One whole frame with a check value that agrees.

    `kind` is class and identifier of UBX (`class << 8 | id`), the message number of RTCM3, 0 for
    NMEA. `end` is the place of its last byte in the stream, the first byte ever fed being 0.
    """

    protocol: str
    kind: int
    raw: bytes
    end: int

    @property
    def start(self) -> int:
        """Place of the first byte in the stream."""
        return self.end + 1 - len(self.raw)

    @property
    def name(self) -> str:
        """NAV-PVT, GNGGA or 1077."""
        if self.protocol == UBX:
            return ubx_layouts.name_of(self.kind)
        if self.protocol == NMEA:
            return self.raw[1 : self.raw.index(b"*")].split(b",", 1)[0].decode("ascii")
        return str(self.kind)

    @property
    def payload(self) -> bytes:
        """What the frame carries; the sentence between start and asterisk for NMEA."""
        if self.protocol == UBX:
            return self.raw[6:-2]
        if self.protocol == NMEA:
            return self.raw[1 : self.raw.index(b"*")]
        return self.raw[3:-3]


class Rejected(NamedTuple):
    """Bytes of the stream, or a whole frame, that were refused, and why."""

    reason: str
    start: int
    size: int


@dataclass
class Framer:
    """Bytes in, frames out; see the head of the module. It is its own memory.

    `bytes_in == bytes_in_frames + bytes_rejected + bytes_pending` at any time. A run of rejected
    bytes is counted at once and reported, as one `Rejected`, when the next possible frame start
    ends it.
    """

    bytes_in: int = 0
    bytes_in_frames: int = 0
    bytes_rejected: int = 0
    frames: int = 0
    false_starts: Counter[str] = field(default_factory=Counter)
    _pending: bytes = b""
    _run: tuple[str, int] | None = None
    """Reason and start of the open rejected run."""
    _line_ends: bool = False
    """CR and LF that come next belong to the sentence before."""

    @property
    def bytes_pending(self) -> int:
        return len(self._pending)

    @property
    def position(self) -> int:
        """Place in the stream of the first byte that is not settled yet."""
        return self.bytes_in - len(self._pending)

    def feed(self, data: bytes) -> list[Frame | Rejected]:
        """Take the next bytes of the stream, return what they settle."""
        out: list[Frame | Rejected] = []
        for cut in range(0, len(data), _SLICE):
            self._scan(data[cut : cut + _SLICE], out, final=False)
        return out

    def flush(self) -> list[Frame | Rejected]:
        """End of the stream: settle what waits, and the frames that are hidden in it."""
        out: list[Frame | Rejected] = []
        self._scan(b"", out, final=True)
        self._close_run(self.position, out)
        return out

    def _scan(self, news: bytes, out: list[Frame | Rejected], final: bool) -> None:
        base = self.position
        data = self._pending + news
        size = len(data)
        window, deliver = _Window(data, final), out.append
        check, check_ubx = window.check, window.check_ubx
        self.bytes_in += len(news)
        frames = framed = at = 0  # everything before `at` is settled
        if self._line_ends:
            at = framed = _LINE_ENDS.match(data).end()  # type: ignore[union-attr]
            self._line_ends = at == size
        while True:
            found = _SYNC.search(data, at)
            if found is None:
                half_sync = not final and size > at and data[-1] in _SYNC_FIRST
                self._reject(base + at, size - half_sync - at)
                at = size - half_sync
                break
            start = found.start()
            if start > at:
                self._reject(base + at, start - at)
                at = start
            if self._run is not None:
                self._close_run(base + start, out)
            protocol, kind, end = check_ubx(start) if data[start] == 0xB5 else check(start)
            if end > 0:
                deliver(Frame(protocol, kind, data[start:end], base + end - 1))
                frames += 1
                at = end
                if protocol == NMEA:
                    at = _LINE_ENDS.match(data, end).end()  # type: ignore[union-attr]
                    self._line_ends = at == size
                framed += at - start
                continue
            if end == _WAIT:
                if not final:
                    break
                end = _CUT_SHORT[protocol]
            self._run = (_REASONS[end], base + start)
            self.false_starts[_REASONS[end]] += 1
            self.bytes_rejected += 1
            at = start + 1
        self.frames += frames
        self.bytes_in_frames += framed
        self._pending = data[at:]

    def _reject(self, start: int, size: int) -> None:
        """Settle `size` bytes in which no frame starts; they prolong the open run."""
        if size > 0:
            self.bytes_rejected += size
            if self._run is None:
                self._run = (NOISE, start)

    def _close_run(self, end: int, out: list[Frame | Rejected]) -> None:
        if self._run is not None:
            reason, start = self._run
            out.append(Rejected(reason, start, end - start))
            self._run = None


_CUT_SHORT = {UBX: _UBX_CUT, NMEA: _NMEA_CUT, RTCM3: _RTCM3_CUT}
_Verdict = tuple[str, int, int]
"""Protocol, kind, and where the frame ends in the window, `_WAIT`, or a negative reason."""


class _Window:
    """The bytes at hand, with prefix sums made when the first frame needs them."""

    def __init__(self, data: bytes, final: bool) -> None:
        self.data = data
        self._final = final
        self._fletcher: tuple[bytes, bytes] | None = None
        self._xor: bytes | None = None

    def check(self, start: int) -> _Verdict:
        """Judge the possible frame at `start`, where the sync pattern of one of the others lies."""
        return self._check_rtcm3(start) if self.data[start] == 0xD3 else self._check_nmea(start)

    def check_ubx(self, start: int) -> _Verdict:
        data = self.data
        size = len(data)
        payload = start + 6
        if payload > size:
            return UBX, 0, _WAIT
        kind = data[start + 2] << 8 | data[start + 3]
        length = data[start + 4] | data[start + 5] << 8
        fixed, step, longest, count_at = _LIMITS.get(kind, _ANY)
        extra = length - fixed
        if extra < 0 or length > longest or (extra % step if step else extra):
            if length and length not in _OTHER_LENGTHS.get(kind, ()):  # 0 is a request
                return UBX, kind, _LENGTH
        elif count_at >= 0:
            if payload + count_at >= size:
                return UBX, kind, _WAIT
            told = data[payload + count_at] * step
            if extra != told and length not in _OTHER_LENGTHS.get(kind, ()):
                return UBX, kind, _COUNT
        end = payload + length
        if end + 2 > size:
            return UBX, kind, _WAIT
        if self._fletcher is None:
            self._fletcher = _fletcher_prefix(data)
        sums, sums_of_sums = self._fletcher
        before, last = start + 1, end - 1
        a0 = sums[before]
        a = (sums[last] - a0) & 0xFF
        b = (sums_of_sums[last] - sums_of_sums[before] - (last - before) * a0) & 0xFF
        if a != data[end] or b != data[end + 1]:
            return UBX, kind, _FLETCHER
        return UBX, kind, end + 2

    def _check_nmea(self, start: int) -> _Verdict:
        data = self.data
        found = _SENTENCE.match(data, start)
        if found is None:
            waits = _SENTENCE_SO_FAR.match(data, start)
            return NMEA, 0, _WAIT if waits else _MALFORMED
        if self._xor is None:
            self._xor = np.bitwise_xor.accumulate(np.frombuffer(data, np.uint8)).tobytes()
        digits, told = found.start(1), found.group(1)
        if self._xor[start] ^ self._xor[digits - 2] != int(told, 16):
            return NMEA, 0, _XOR
        if not found.group(2) and not self._final and _LINE_END_SO_FAR.match(data, digits + 2):
            return NMEA, 0, _WAIT  # its line end may be on its way
        return NMEA, 0, found.end()

    def _check_rtcm3(self, start: int) -> _Verdict:
        data = self.data
        size = len(data)
        if start + 3 > size:
            return RTCM3, 0, _WAIT
        length = (data[start + 1] & 3) << 8 | data[start + 2]
        end = start + length + RTCM3_OVERHEAD
        if end > size:
            return RTCM3, 0, _WAIT
        kind = data[start + 3] << 4 | data[start + 4] >> 4 if length >= 2 else 0
        if crc24q(data[start : end - 3]) != int.from_bytes(data[end - 3 : end], "big"):
            return RTCM3, kind, _CRC
        return RTCM3, kind, end


_LIMITS = ubx_layouts.LIMITS
_OTHER_LENGTHS = ubx_layouts.OTHER_LENGTHS
_ANY = ubx_layouts.ANY_LIMIT


def _fletcher_prefix(data: bytes) -> tuple[bytes, bytes]:
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


def ubx_frame(kind: int, payload: bytes) -> bytes:
    """Wrap `payload` as UBX of class and identifier `kind`."""
    body = kind.to_bytes(2, "big") + len(payload).to_bytes(2, "little") + payload
    sums, sums_of_sums = _fletcher_prefix(body)
    return b"\xb5\x62" + body + bytes((sums[-1], sums_of_sums[-1]))


def nmea_frame(sentence: str) -> bytes:
    """Wrap `GNGGA,…` (no start, no checksum) as an NMEA sentence."""
    body = sentence.encode("ascii")
    return b"$%s*%02X\r\n" % (body, reduce(xor, body, 0))


def rtcm3_frame(payload: bytes) -> bytes:
    """Wrap `payload` of at most 1023 bytes as RTCM3."""
    body = b"\xd3" + len(payload).to_bytes(2, "big") + payload
    return body + crc24q(body).to_bytes(3, "big")
