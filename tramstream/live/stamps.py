"""Stamps of inputs are bounded: nothing was true long after it arrived.

One sample from the future would move the event time of everybody behind it, and all that is true
would be late until then. So a message whose newest instant lies further ahead of its arrival than
clocks can be off is not used. Old stamps harm nobody (what comes behind the horizon is late, and
`sync/fusion/late` says so) and are legitimate: a replayed record is as old as it likes, paused,
continued and from the beginning again.
"""

from __future__ import annotations

from math import inf
from typing import Any

from tramstream.clock import S
from tramstream.proto.raw_pb2 import ImuBatch

MAX_AHEAD_NS = S // 2
"""Transport only delays, so a right stamp is ahead of its arrival by no more than the fit of the
device's clock is off. That is milliseconds; after a start on a stalled machine it may be up to the
step of 1 s at which `ClockFit` begins anew, slewed away by a tenth. Beyond half of it a sample
would hold up the horizon of all others for as long as it is wrong: it is rather not used."""
MAX_BATCH_NS = 10 * S
"""A batch of samples lasts 10 ms, or a second where a file is imported."""


def ahead_ns(message: Any, arrival_ns: int) -> float:
    """How far the newest instant of `message` is ahead of its arrival; infinite if it has none."""
    ahead: float = message.stamp_ns - arrival_ns
    if type(message) is ImuBatch:
        count = len(message.gyro_x)
        lasts_ns = message.period_ns * (count - 1) if count else 0.0
        if not 0.0 <= lasts_ns <= MAX_BATCH_NS:  # NaN as well
            return inf
        ahead += lasts_ns
    return ahead
