"""The one contract of tramstream: a processor turns a sample into samples.

Bridges (device bytes to messages), the resampler, filters and everything after them keep it. A
processor has memory but no bus, clock, thread, file or logger; time enters only through stamps.
The live loop, reprocessing and the tests call the same `step`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import msgspec
from google.protobuf.message import Message

from tramstream import keys
from tramstream.config import Vehicle
from tramstream.config_file import settings
from tramstream.events.kinds import Event, Kind
from tramstream.events.messages import log_of, message_of
from tramstream.events.repeats import Repeats
from tramstream.keys import Key
from tramstream.memory.stage import State as State
from tramstream.memory.stage import assign, check, from_plain, to_plain
from tramstream.proto.sync_pb2 import LateSample

_SAID = "said"


class Sample(NamedTuple):
    """One message on its way: its key, when it was true, its number on that key.

    `publish_ns` is when its publisher sent it, strictly increasing per key; 0 while it has not been
    sent. `message` is shared by everybody who gets the sample: nobody may change it.
    """

    key: Key
    message: Any
    stamp_ns: int
    sequence: int
    publish_ns: int = 0


@dataclass(slots=True)
class Ledger:
    """What became of everything a stage received: received = delivered + dropped + pending."""

    stage: str
    unit: str
    received: int = 0
    delivered: int = 0
    dropped: int = 0
    pending: int = 0

    @property
    def balanced(self) -> bool:
        return self.received == self.delivered + self.dropped + self.pending


@dataclass
class NoMemory:
    """The memory of a processor that has none."""


class Processor(ABC):
    """A pure stage: `step(sample) -> [sample]` with memory that can be copied out and put back.

    Subclasses declare `name`, `inputs` and `outputs`, and number their outputs with `emit`. Their
    memory is one dataclass, `Memory`, of which `self.memory` is an instance; settings are no part
    of it. Parts of a stage hold their part of it.
    """

    name: ClassVar[str]
    inputs: tuple[Key, ...]
    """Of the class; where they hang on the settings, an instance has its own."""
    outputs: ClassVar[tuple[Key, ...]]
    events: ClassVar[tuple[Kind, ...]] = ()
    """Kinds of events that it raises; `outputs` then have the keys for them as well."""
    Settings: ClassVar[type[msgspec.Struct] | None] = None
    """Its section of the configuration: `[<name>]`, checked strictly while loading; who calls
    `super().__init__(vehicle)` has it as `self.settings`."""
    pacing: ClassVar[tuple[Key, ...]] = ()
    """Inputs that move the processor's horizon on; all others may come early: no difference."""
    demanding: ClassVar[bool] = False
    """Takes about as long as all others together: reprocessing gives it a core of its own."""

    Memory: ClassVar[type[Any]] = NoMemory
    """Dataclass whose fields have defaults, as at a start; see `tramstream.memory.stage`."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if cls.events:
            said = (keys.EVENT.at(cls.name), keys.LOG.at(cls.name))
            cls.outputs = (*cls.outputs, *(key for key in said if key not in cls.outputs))

    def __init__(self, vehicle: Vehicle | None = None) -> None:
        self._next_sequence: dict[str, int] = {}
        check(self.Memory)
        self._repeats = Repeats(self.events)
        self.memory: Any = self.Memory()
        if vehicle is not None and self.Settings is not None:
            self.settings: Any = settings(vehicle, self.name, self.Settings)

    @abstractmethod
    def step(self, sample: Sample) -> list[Sample]:
        """Take one sample, return what follows from it, in the order of publication."""

    def snapshot(self) -> State:
        """Memory as plain data that share nothing with the processor; `restore` takes them back."""
        return {"memory": to_plain(self.memory), "sequences": self.sequences()}

    def restore(self, state: State) -> None:
        """Go on from `state`, which `snapshot` of the same class gave.

        Raises
        ------
        TypeError
            If it is of another version, with other fields.
        """
        memory, sequences = state.get("memory"), state.get("sequences")
        if memory is None or sequences is None:
            raise TypeError("memory of another version: not a memory and its sequence numbers")
        assign(self.memory, from_plain(self.Memory, memory))
        self.restore_sequences(sequences)
        self.restored()

    def restored(self) -> None:  # noqa: B027  most derive nothing
        """Memory was put back: make anew what is derived from it, if anything is."""

    def ledgers(self) -> list[Ledger]:
        """What became of all that came in, one entry for each unit the stage counts in."""
        return []

    def device_counters(self) -> dict[str, Any]:
        """Figures of `DeviceHealth`, under its field names, of a bridge's device."""
        return {}

    def device_troubles(self) -> list[Event]:
        """What is wrong now with a bridge's device, by what it says itself."""
        return []

    def emit(self, key: Key, message: Message, stamp_ns: int) -> Sample:
        """Number and stamp `message` as the next sample on `key`."""
        path = key.path
        sequence = self._next_sequence.get(path, 1)
        self._next_sequence[path] = sequence + 1
        stamp(message, stamp_ns, sequence)
        return Sample(key, message, stamp_ns, sequence)

    def raise_event(self, event: Event, stamp_ns: int) -> list[Sample]:
        """Say what happened; the same again only now and then (`tramstream.events.repeats`)."""
        unsaid = self._repeats.take(event, stamp_ns)
        return [] if unsaid is None else self._said(event, unsaid, stamp_ns)

    def overdue_events(self, stamp_ns: int) -> list[Sample]:
        """Say how often what was said last has happened since; for whoever steps now and then."""
        found = self._repeats.overdue(stamp_ns)
        return [each for event, more in found for each in self._said(event, more, stamp_ns)]

    def _said(self, event: Event, unsaid: int, stamp_ns: int) -> list[Sample]:
        if event.kind not in self.events:
            raise ValueError(f"{self.name} raises {event.kind}, which is none of its events")
        message = message_of(event, self.name, unsaid)
        return [
            self.emit(keys.EVENT.at(self.name), message, stamp_ns),
            self.emit(keys.LOG.at(self.name), log_of(message), stamp_ns),
        ]

    def sequences(self) -> State:
        """Next sequence number per key, and what was said when: belongs into every snapshot."""
        return {**self._next_sequence, _SAID: self._repeats.snapshot()}

    def restore_sequences(self, state: State) -> None:
        self._next_sequence = {path: state[path] for path in state if path != _SAID}
        self._repeats.restore(state.get(_SAID, {}))


@runtime_checkable
class Ordering(Protocol):
    """A processor that decides what is late; reprocessing tells it what was late live."""

    late_recorded: Mapping[tuple[str, int], LateSample] | None
    """By (key path, publish_ns); what a processor made itself has none, and is there by its number,
    negative. None while live."""


@runtime_checkable
class Smoothing(Protocol):
    """A processor that can go over a ride again with all of it known; for reprocessing."""

    offline: ClassVar[tuple[Key, ...]]
    """What `smoothed` says; no output of a live ride."""

    def keep(self) -> None:
        """Remember from now on what that takes; before the first sample, and never live."""

    def smoothed(self) -> Iterator[Sample]:
        """What it says now of the ride, in order of stamps; once, after the last sample."""


def stamp(message: Any, stamp_ns: int, sequence: int) -> None:
    """Write stamp and sequence into a message of ours; Foxglove's own types have a timestamp."""
    try:
        message.stamp_ns = stamp_ns
        message.sequence = sequence
    except AttributeError:  # cheaper than to look first, for what is nearly always there
        message.timestamp.FromNanoseconds(stamp_ns)
