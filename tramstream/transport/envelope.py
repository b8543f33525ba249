"""One message on the bus as readers get it; its header is `tramstream.transport.header`'s."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


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
