"""Stamps of inputs are bounded: nothing was true long after it arrived.

One sample from the future would move the event time of everybody behind it, and all that is true
would be late until then. So a message whose newest instant lies further ahead of its arrival than
clocks can be off is not used. Old stamps harm nobody (what comes behind the horizon is late, and
`sync/fusion/late` says so) and are legitimate: a replayed record is as old as it likes, paused,
continued and from the beginning again.
"""

from __future__ import annotations

from typing import Any

from tramstream.clock import S
from tramstream.proto.raw_pb2 import ImuBatch

MAX_AHEAD_S = 0.5
"""Transport only delays, so a right stamp is ahead of its arrival by no more than the fit of the
device's clock is off: below 50 ms in tests/test_clock.py while it settles. Ten times that; the
horizon that such a sample could move is back within one tick of a bus that is silent."""
MAX_BATCH_S = 10.0
"""A batch of samples lasts 10 ms, or a second where a file is imported."""


def ahead_ns(message: Any, arrival_ns: int) -> float:
    """How far the newest instant of `message` is ahead of its arrival; infinite if it has none."""
    newest_ns: float = message.stamp_ns
    if type(message) is ImuBatch:
        lasts_ns = message.period_ns * max(len(message.gyro_x) - 1, 0)
        if not 0 <= lasts_ns <= MAX_BATCH_S * S:  # NaN as well
            return float("inf")
        newest_ns += lasts_ns
    return newest_ns - arrival_ns
