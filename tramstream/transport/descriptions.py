"""Message types of other packages, as whoever publishes them describes them.

A message declares its type in its encoding. The types of this package are known; any other is asked
for under `tram/schema/<type>`, where the node that makes its key answers.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from google.protobuf.message import Message

from tramstream import boundary, keys
from tramstream.boundary import Undecodable
from tramstream.transport.bus import Bus
from tramstream.transport.envelope import Envelope

ASK_TIMEOUT_S = 1.0
AGAIN_S = 10.0
"""Who had no answer asks again after so long."""


@dataclass(frozen=True)
class Described:
    """What came of the question for a type; without a class nobody could tell, for `reason`."""

    name: str
    type: type[Message] | None
    reason: str = ""


def describe(bus: Bus, name: str, tries: int = 1) -> Described:
    """Ask what a message type is; blocks for `tries` seconds at most.

    A full link drops a question or its answer: it may be put again.
    """
    reason = "nobody describes it"
    for _ in range(tries):
        for answer in bus.ask(keys.schema(name), ASK_TIMEOUT_S):
            found = boundary.described(answer, name)
            if not isinstance(found, str):
                return Described(name, found)
            reason = found
    return Described(name, None, reason)


def tell(bus: Bus, types: Iterable[type[Message]]) -> None:
    """Answer whoever asks what these message types are, or (`tram/schema/**`) which there are."""
    for type_ in types:
        data = keys.descriptor_set(type_).SerializeToString()
        bus.answer(keys.schema(type_.DESCRIPTOR.full_name), _saying(data))


def _saying(data: bytes) -> Callable[[str], bytes]:
    return lambda _: data


class Decoder:
    """Decodes messages off the bus, ours and others'.

    Parameters
    ----------
    bus : Bus or None
        Where types that are not ours are asked for; without one they stay unknown.
    """

    def __init__(self, bus: Bus | None = None) -> None:
        self._bus = bus
        self._types: dict[str, type[Message]] = dict(keys.TYPES)
        self._asked_s: dict[str, float] = {}

    def type_of(self, encoding: str) -> type[Message] | None:
        """The type that an encoding declares; asks for one that is not known, and waits."""
        name = boundary.type_name(encoding)
        known = self._types.get(name)
        if known is not None or self._bus is None or not name:
            return known
        asked_s = self._asked_s.get(name)
        if asked_s is not None and time.monotonic() - asked_s < AGAIN_S:
            return None
        self._asked_s[name] = time.monotonic()
        found = describe(self._bus, name).type
        if found is not None:
            self._types[name] = found
        return found

    def __call__(self, envelope: Envelope) -> Any | None:
        """The message in `envelope`; None if it is not what its encoding promises."""
        type_ = self.type_of(envelope.encoding)
        if type_ is None:
            return None
        message = boundary.decode(type_, envelope.payload, envelope.topic)
        return None if isinstance(message, Undecodable) else message
