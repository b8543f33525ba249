"""The header of every message on the bus: when, which number, by whom."""

from __future__ import annotations

import struct

from tramstream.clock import S

HEADER = struct.Struct("<QQI")
"""Attachment of every put: publish_ns, sequence, session."""
AHEAD_NS = S
"""All processes share one clock, so publication is never later than arrival; this is slack."""
SEQUENCE_MAX = 1 << 40
"""A thousand messages a second for 34 years."""


def is_possible(publish_ns: int, sequence: int, now_ns: int) -> bool:
    """Whether a message can have been published so: not in the future, nor with a number too high.

    All that is reckoned with others would go wrong: holes, questions, counts of what is lost.
    """
    return publish_ns <= now_ns + AHEAD_NS and sequence <= SEQUENCE_MAX


def read_header(data: bytes, arrival_ns: int) -> tuple[int, int, int]:
    """Time of publication, sequence number and session of a message that arrived at `arrival_ns`.

    Without a header, or with an impossible one, it is a stranger's and nothing can be counted:
    number and session are 0.
    """
    if len(data) == HEADER.size:
        publish_ns, sequence, session = HEADER.unpack(data)
        if is_possible(publish_ns, sequence, arrival_ns):
            return publish_ns, sequence, session
    return arrival_ns, 0, 0
