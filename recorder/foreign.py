"""Keys of other packages: what their messages are is asked of whoever publishes them.

A message declares its type in its encoding. Types of ours are known; of any other the description
is asked for under `tram/schema/<type>`, where the node that makes the key answers. Until the answer
is there its messages are held, with the times at which they came; without one they are recorded as
the bytes that they are. Nothing waits: who asks is a thread of its own.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from queue import SimpleQueue
from typing import NamedTuple

from google.protobuf.message import Message

from tramstream import boundary, keys
from tramstream.transport.bus import Bus
from tramstream.transport.descriptions import Described, describe

TRIES = 3
"""A full link drops a question or its answer: it is put again."""
HELD_BYTES = 4_000_000
"""Held messages of all types together; what comes beyond is recorded as bytes."""
MOST_TYPES = 64
"""Types that are asked for; who makes up more of them has them recorded as bytes."""
UNDESCRIBED = "protobuf"
"""Message encoding of a channel whose type nobody has described."""


class Held(NamedTuple):
    """A message that waits for the description of its type."""

    topic: str
    payload: bytes
    log_ns: int
    publish_ns: int
    sequence: int


Kind = type[Message] | str
"""What a channel holds: a message type, or the encoding of bytes that nobody has described."""
PENDING = "pending"
"""The kind of messages whose description is being asked for."""


@dataclass
class ForeignTypes:
    """Message types that are not ours, by name.

    Parameters
    ----------
    bus : Bus
    deliver : callable
        Gets the answers, on the thread that asks.
    """

    bus: Bus
    deliver: Callable[[Described], None]
    _known: dict[str, Kind] = field(default_factory=lambda: dict(keys.TYPES))
    _held: dict[str, list[Held]] = field(default_factory=dict)
    _held_bytes: int = 0
    _questions: SimpleQueue[str | None] = field(default_factory=SimpleQueue)
    _thread: threading.Thread | None = None

    def kind(self, encoding: str) -> Kind:
        """What messages of `encoding` are; PENDING while that is being asked."""
        name = boundary.type_name(encoding)
        if not name:
            return encoding.partition(";")[0].rpartition("/")[2] or "bytes"
        known = self._known.get(name)
        if known is not None:
            return known
        if name not in self._held:
            if len(self._known) + len(self._held) >= MOST_TYPES + len(keys.TYPES):
                return UNDESCRIBED
            self._held[name] = []
            self._ask(name)
        return PENDING if self._held_bytes < HELD_BYTES else UNDESCRIBED

    def hold(self, encoding: str, message: Held) -> None:
        """Keep a message until the type that `kind` knows nothing of is described."""
        self._held[boundary.type_name(encoding)].append(message)
        self._held_bytes += len(message.payload)

    def settle(self, answer: Described) -> list[Held]:
        """Take an answer; gives the messages that waited for it, in the order of coming."""
        self._known[answer.name] = answer.type or UNDESCRIBED
        held = self._held.pop(answer.name, [])
        self._held_bytes -= sum(len(each.payload) for each in held)
        return held

    def give_up(self) -> list[Held]:
        """What still waits, at the end: to be recorded as bytes."""
        left = [each for name in list(self._held) for each in self.settle(Described(name, None))]
        if self._thread is not None:
            self._questions.put(None)
        return left

    def _ask(self, name: str) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="recorder-types", daemon=True)
            self._thread.start()
        self._questions.put(name)

    def _run(self) -> None:
        while (name := self._questions.get()) is not None:
            self.deliver(describe(self.bus, name, TRIES))
