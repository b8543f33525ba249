"""One message on the bus as readers get it, and the header that every put carries."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import NamedTuple

HEADER = struct.Struct("<QQI")
"""Attachment of every put: publish_ns, sequence, session."""


class Envelope(NamedTuple):
    """One message as it came off the bus, still encoded."""

    topic: str
    payload: bytes
    encoding: str
    publish_ns: int
    sequence: int
    session: int
    arrival_ns: int


Deliver = Callable[[Envelope], None]
