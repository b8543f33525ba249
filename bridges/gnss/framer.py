"""Cut a receiver's mixed stream into UBX, NMEA and RTCM3 frames.

The stream is read from left to right. At each place where a frame may start, one of three things
holds: the frame is whole and its check value agrees (it is delivered), something in it cannot be
(a *false start*: reading resumes one byte further on, so that an intact frame behind a corrupt
header is never lost), or more bytes are needed (the framer waits). None of the three depends on
where the stream was cut, so any cutting gives the same list. Inside a whole frame no other frame
is looked for: the outer one wins, unless what lies inside is a *chain* of three whole frames.

A frame may only be as long as its type allows, and may not contradict its own count of entries, so
that a flipped length bit is noticed in the header. A false start may still claim up to 8 kB, for
which a receiver that says little needs a minute. It does not hold the stream up for so long: where
a chain has come behind it, it is a false start, whatever its check value. So it is in a file that
is read at once, for the verdict hangs on the bytes alone, not on when they came.

An NMEA sentence is whole with its checksum. Its line end may be any: CR LF, LF alone, LF LF or
CR CR LF behind a terminal that was not raw, none at all at the end of a file. One line end belongs
to the frame; what follows of CR and LF is counted with it and reported neither as frame nor as
rejected.

Frames are judged by `frame_checks`, in linear time whatever comes.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import reduce
from operator import xor
from typing import NamedTuple

from tramstream.bridges.gnss import ubx_layouts
from tramstream.bridges.gnss.frame_checks import (
    LINE_ENDS,
    REASONS,
    SYNC,
    SYNC_FIRST,
    WAIT,
    Chains,
    Window,
    crc24q,
    fletcher_prefix,
)

UBX, NMEA, RTCM3 = "UBX", "NMEA", "RTCM3"

NOISE = "noise"
"""Reason of bytes in which no frame starts: text headers, another device's words, line noise."""

_SLICE = 1 << 20
"""A long `feed` is worked through in slices of this many bytes, to bound the memory."""


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
    _chains: Chains = field(default_factory=Chains)

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
        window, deliver = Window(data, final), out.append
        check, check_ubx = window.check, window.check_ubx
        self.bytes_in += len(news)
        chains = self._chains
        frames = framed = at = 0  # everything before `at` is settled
        if self._line_ends:
            at = framed = LINE_ENDS.match(data).end()  # type: ignore[union-attr]
            self._line_ends = at == size
        while True:
            found = SYNC.search(data, at)
            if found is None:
                half_sync = not final and size > at and data[-1] in SYNC_FIRST
                self._reject(base + at, size - half_sync - at)
                at = size - half_sync
                break
            start = found.start()
            if start > at:
                self._reject(base + at, start - at)
                at = start
            if self._run is not None:
                self._close_run(base + start, out)
            protocol = _PROTOCOLS[data[start]]
            kind, end = check_ubx(start) if protocol == UBX else check(start)
            if window.claimed and chains.are_inside(
                window, base, base + start, base + window.claimed
            ):
                reason = f"{protocol} overtaken"
            elif end > 0:
                deliver(Frame(protocol, kind, data[start:end], base + end - 1))
                frames += 1
                at = end
                if protocol == NMEA:
                    at = LINE_ENDS.match(data, end).end()  # type: ignore[union-attr]
                    self._line_ends = at == size
                framed += at - start
                continue
            elif end == WAIT and not final:
                break
            else:
                reason = f"{protocol} truncated" if end == WAIT else REASONS[end]
            self._run = (reason, base + start)
            self.false_starts[reason] += 1
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


_PROTOCOLS = {0xB5: UBX, 0x24: NMEA, 0x21: NMEA, 0xD3: RTCM3}


def ubx_frame(kind: int, payload: bytes) -> bytes:
    """Wrap `payload` as UBX of class and identifier `kind`."""
    body = kind.to_bytes(2, "big") + len(payload).to_bytes(2, "little") + payload
    sums, sums_of_sums = fletcher_prefix(body)
    return b"\xb5\x62" + body + bytes((sums[-1], sums_of_sums[-1]))


def nmea_frame(sentence: str) -> bytes:
    """Wrap `GNGGA,…` (no start, no checksum) as an NMEA sentence."""
    body = sentence.encode("ascii")
    return b"$%s*%02X\r\n" % (body, reduce(xor, body, 0))


def rtcm3_frame(payload: bytes) -> bytes:
    """Wrap `payload` of at most 1023 bytes as RTCM3."""
    body = b"\xd3" + len(payload).to_bytes(2, "big") + payload
    return body + crc24q(body).to_bytes(3, "big")
