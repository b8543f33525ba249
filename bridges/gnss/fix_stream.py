"""Which solution of a receiver is the fix, and its stamp; see the head of `bridge.py`."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tramstream.bridges.gnss.clock import MS, ArrivalClock
from tramstream.clock import S
from tramstream.proto.gnss_pb2 import GnssFix

PLACE, NMEA_RANK, COMBINED, HIGH_RATE, NAVIGATION = range(1, 6)
"""Ranks: a place without a word on its quality, NMEA, several messages of UBX, HNR-PVT, NAV-PVT."""
_CROWDED_NS = MS
"""Fixes that came at one instant are told apart by nanoseconds; there are not so many."""
_SAME_EPOCH_NS = S // 2
"""Times of one time of week that lie further apart are of two weeks."""


@dataclass(frozen=True)
class LastFix:
    """What must be known of the fix that was published last."""

    source: str
    rank: int
    itow_ms: int
    utc_ns: int
    device_ns: int | None
    """Its time by the clock that it was stamped with; None if another clock has taken over."""
    stamp_ns: int
    payload: bytes = b""
    """Of the message that it was made of, where that was one."""


def is_told(last: LastFix | None, fix: GnssFix, rank: int, payload: bytes) -> bool:
    """Whether an epoch's solution has been published already.

    A receiver may send one twice (its ports joined, a message asked for besides), or NAV-PVT and
    NAV-PVAT. Where it knows no time, its time of week stands still: then only the same bytes, or
    another message, tell the same again.
    """
    if last is None or last.rank != rank or last.itow_ms != fix.itow_ms:
        return False
    if last.device_ns is not None and fix.HasField("gps_time_ns"):
        return abs(fix.gps_time_ns - last.device_ns) < _SAME_EPOCH_NS
    return last.source != fix.source or last.payload == payload


def takes_over_early(last: LastFix | None, fix: GnssFix, rank: int) -> bool:
    """Whether a better solution tells of an epoch that a worse one has told of."""
    if last is None or rank <= last.rank:
        return False
    behind_ns = last.utc_ns - fix.utc_ns
    return bool(fix.utc_ns) and -MS <= behind_ns < ArrivalClock.REORDERED_NS


def stamp_after(
    last: LastFix | None, rank: int, stamp_ns: int, device_ns: int | None, arrival_ns: int
) -> int:
    """The stamp of a fix, later than its predecessor's unless times or arrivals go back."""
    if last is not None and rank > last.rank:
        last = replace(last, device_ns=None)  # its time may have been UTC
    if last is not None and stamp_ns <= last.stamp_ns <= arrival_ns + _CROWDED_NS:
        before_ns = last.device_ns
        if device_ns is None or before_ns is None or device_ns >= before_ns:
            return last.stamp_ns + 1
    return stamp_ns
