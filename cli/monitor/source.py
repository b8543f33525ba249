"""Where messages to look at come from: the live bus or a record, behind one interface.

What users write as KEY is a path (`raw/gnss/fix`), an expression (`raw/gnss/*`, `raw/**`) or a full
key (`tram/<vehicle>/raw/gnss/fix`); `read_key` makes one thing of them.
"""

from __future__ import annotations

import difflib
import json
import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from google.protobuf.message import Message

from tramstream import keys
from tramstream.boundary import Undecodable
from tramstream.cli.terminal import session
from tramstream.errors import ConfigError, DamagedRecordError, RecordError
from tramstream.recorder.reader import Entry, Record, open_record
from tramstream.shown import shown_json
from tramstream.transport.bus import Bus, Envelope
from tramstream.transport.descriptions import Decoder
from tramstream.transport.ring import Ring

WAIT_S = 0.1
"""The live source looks at `stop` this often."""
RING_CAPACITY = 8192
UNKNOWN_WAIT_S = 1.5
"""So long a key that nobody defined may take to show up on the bus."""
WAITING_HINT_S = 3.0
ANY = "**"
_FORBIDDEN = set("#?$ \t\n")


class Wanted(NamedTuple):
    """What to look at: a key expression below `tram/<vehicle>/`; no vehicle means the only one."""

    vehicle: str
    pattern: str

    @property
    def exact(self) -> bool:
        return "*" not in self.pattern


def read_key(text: str, vehicle: str = "") -> Wanted:
    """Make sense of KEY and --vehicle.

    Raises
    ------
    ConfigError
        If it cannot be a key, or the two name different vehicles.
    """
    parts = text.strip("/").split("/")
    if (
        not all(parts)
        or _FORBIDDEN & set(text)
        or any("*" in p and p not in ("*", ANY) for p in parts)
    ):
        raise ConfigError(
            f"{text!r} is no key; write a path (raw/gnss/fix), an expression (raw/gnss/*, raw/**) "
            "or a full key (tram/<vehicle>/raw/gnss/fix)"
        )
    if parts[0] != keys.ROOT or len(parts) < 2:
        return Wanted(vehicle, "/".join(parts))
    if parts[1] == ANY:
        return Wanted(vehicle or "*", "/".join(parts[1:]))
    if vehicle not in ("", parts[1]):
        raise ConfigError(f"{text} is a key of vehicle {parts[1]}, --vehicle says {vehicle}")
    return Wanted(parts[1], "/".join(parts[2:]) or ANY)


class Source(ABC):
    """Messages on the wanted keys."""

    live: bool

    def __init__(self, wanted: Wanted) -> None:
        self.wanted = wanted

    @abstractmethod
    def messages(self, stop: threading.Event) -> Iterator[Envelope | None]:
        """Messages until `stop` is set or there are no more; None when none came for a while."""

    @abstractmethod
    def decode(self, envelope: Envelope) -> Message | None:
        """The message inside, or None if it is not what its key and encoding promise."""

    @abstractmethod
    def now_ns(self) -> int:
        """Now, on the clock of the arrivals; of a record its end."""

    def shown(self, topic: str) -> str:
        """A topic as people write it: its path, where the vehicle goes without saying."""
        vehicle, path = keys.split(topic)
        return path if path and vehicle == self.wanted.vehicle else topic

    @property
    def topic(self) -> str:
        """The one topic wanted; empty if an expression is wanted."""
        vehicle, pattern = self.wanted
        return f"{keys.ROOT}/{vehicle}/{pattern}" if self.wanted.exact and vehicle != "*" else ""


class LiveSource(Source):
    """The bus. Subscribed from the start, so that nothing of a short listening is missed."""

    live = True

    def __init__(self, bus: Bus, wanted: Wanted) -> None:
        super().__init__(wanted)
        self.ring: Ring[Envelope] = Ring(RING_CAPACITY)
        self._bus = bus
        self._decode = Decoder(bus)
        self._first: Envelope | None = None
        expression = f"{keys.ROOT}/{wanted.vehicle}/{wanted.pattern}"
        self.subscription = bus.subscribe(expression, lambda e: self.ring.put(e.topic, e))
        if not is_defined(wanted.pattern):
            self._first = self.ring.get(UNKNOWN_WAIT_S)  # somebody's own key, perhaps
            if self._first is None:
                raise ConfigError(nothing_at(wanted.pattern, defined_paths()))

    def messages(self, stop: threading.Event) -> Iterator[Envelope | None]:
        first, self._first = self._first, None
        if first is not None:
            yield first
        while not stop.is_set():
            yield self.ring.get(WAIT_S)

    def decode(self, envelope: Envelope) -> Message | None:
        message: Message | None = self._decode(envelope)
        return message

    def now_ns(self) -> int:
        return self._bus.clock.now_ns()


class FileSource(Source):
    """A record. A key that is not in it is refused at once."""

    live = False

    def __init__(self, record: Record, wanted: Wanted) -> None:
        # A foreign file has other topics than ours: those are wanted by their whole name.
        super().__init__(Wanted(wanted.vehicle or record.vehicle, wanted.pattern))
        self.record = record
        self.channels = [
            info for topic, info in record.channels.items() if info.count and self._wants(topic)
        ]
        if not self.channels:
            known = sorted({self.shown(topic) for topic in record.channels})
            file = record.paths[0]
            if wanted.pattern in known or is_defined(wanted.pattern):
                raise RecordError(
                    f"{file}: has no messages on {wanted.pattern}"
                    + (f" of vehicle {wanted.vehicle}" if wanted.vehicle else "")
                    + (f"; it has {_some(known)}" if known else "; it has none at all")
                )
            raise ConfigError(nothing_at(wanted.pattern, known))

    def _wants(self, topic: str) -> bool:
        vehicle, path = keys.split(topic)
        if not path:
            return keys.matches(self.wanted.pattern, topic.strip("/"))
        return keys.matches(self.wanted.vehicle, vehicle) and keys.matches(
            self.wanted.pattern, path
        )

    def messages(self, stop: threading.Event) -> Iterator[Envelope | None]:
        encodings = {
            info.topic: f"application/protobuf;{info.schema}"
            for info in self.record.channels.values()
        }
        wanted = {info.topic for info in self.channels}
        for entry in self.record.messages(wanted.__contains__):
            if stop.is_set():
                return
            yield Envelope(
                entry.topic,
                entry.payload,
                encodings[entry.topic],
                entry.publish_ns,
                entry.sequence,
                0,
                entry.log_ns,
            )

    def decode(self, envelope: Envelope) -> Message | None:
        entry = Entry(
            envelope.topic,
            envelope.payload,
            envelope.arrival_ns,
            envelope.publish_ns,
            envelope.sequence,
            self.record.channels[envelope.topic].channel_id,
        )
        message = self.record.decode(entry)
        return None if isinstance(message, Undecodable) else message

    def now_ns(self) -> int:
        return self.record.end_ns


@contextmanager
def look(key: str, file: Path | None, vehicle: str = "") -> Iterator[Source]:
    """The record `file`, or else the live bus, at the keys that `key` names.

    Raises
    ------
    BusError, RecordError, ConfigError
        Without a bus; with a file that cannot be read; with a key that nobody knows.
    DamagedRecordError
        At the end, if something of the file was lost; everything else has been shown by then.
    """
    wanted = read_key(key, vehicle)
    if file is not None:
        with open_record(file) as record:
            yield FileSource(record, wanted)
            if record.damaged:
                raise DamagedRecordError(record.damaged)
        return
    with session.client(wanted.vehicle) as bus:
        if not wanted.vehicle:
            wanted = Wanted(session.vehicle_on(bus), wanted.pattern)
        yield LiveSource(bus, wanted)


def defined_paths() -> list[str]:
    """All paths of `tramstream.keys`; `*` stands for any source."""
    return [key.path for key in keys.ALL]


def is_defined(pattern: str) -> bool:
    """Whether some key of `tramstream.keys` can match `pattern`."""
    return any(_meet(pattern.split("/"), path.split("/")) for path in defined_paths())


def _meet(pattern: list[str], parts: list[str]) -> bool:
    """Whether two expressions have a key in common; `parts` has no `**`."""
    if not pattern:
        return not parts
    if pattern[0] == ANY:
        return any(_meet(pattern[1:], parts[skip:]) for skip in range(len(parts) + 1))
    if not parts:
        return False
    return (pattern[0] == parts[0] or "*" in (pattern[0], parts[0])) and _meet(
        pattern[1:], parts[1:]
    )


def nothing_at(pattern: str, known: list[str]) -> str:
    """The sentence for a key that is not there, with those that were perhaps meant."""
    wanted = [part for part in pattern.split("/") if "*" not in part]
    near = difflib.get_close_matches(pattern, known, n=3, cutoff=0.6)
    if any(path.startswith(f"{pattern}/") for path in known):
        near.insert(0, f"{pattern}/{ANY}")
    near += [path for path in known if wanted and set(wanted) & set(path.split("/")[1:])]
    near = list(dict.fromkeys(near))[:4]
    return f"no key is called {pattern}; " + (
        f"near: {', '.join(near)}" if near else f"there are {_some(known)}"
    )


def _some(names: list[str], most: int = 6) -> str:
    more = f" and {len(names) - most} more (`tramstream list`)" if len(names) > most else ""
    return ", ".join(names[:most]) + more


class Waiting:
    """Says once on standard error that nothing has come yet."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._due_s = time.monotonic() + WAITING_HINT_S

    def see(self, envelope: Envelope | None) -> None:
        if envelope is not None:
            self._due_s = float("inf")
        elif self._source.live and time.monotonic() > self._due_s:
            self._due_s = float("inf")
            vehicle, pattern = self._source.wanted
            session.say(f"nothing on {pattern} of vehicle {vehicle} yet; waiting (Ctrl-C ends)")


def line(figures: dict[str, Any]) -> str:
    """One line of JSON; what is not a number becomes null."""
    try:
        return _dump(figures)
    except ValueError:
        return _dump(_finite(figures))


def _dump(figures: Any) -> str:
    text = json.dumps(figures, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return shown_json(text)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
