"""A clock that stands still until told, a stop event that leads a loop by the hand, a device."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from tramstream import keys
from tramstream.clock import S, VehicleClock
from tramstream.keys import Key
from tramstream.live.ports import join_reads
from tramstream.proto.raw_pb2 import RawBytes
from tramstream.transport.bus import Bus, Envelope, LocalBus
from tramstream.transport.resend import History
from tramstream.transport.tokens import Announced

START_NS = 1_700_000_000 * S
VEHICLE = "t1"


class ManualClock(VehicleClock):
    """The vehicle clock over a monotonic clock that only `advance` moves."""

    def __init__(self) -> None:
        self._manual_ns = 0
        super().__init__(START_NS, monotonic_ns=lambda: self._manual_ns)

    def advance(self, dt_s: float) -> None:
        self._manual_ns += round(dt_s * S)


class Script(threading.Event):
    """A stop event of one loop: each time it is asked it does the next step, then it is set.

    A step that puts a message on the bus or advances the clock to a timer keeps the loop busy: it
    never waits.
    """

    def __init__(self, *steps: Callable[[], Any]) -> None:
        super().__init__()
        self._steps: Iterator[Callable[[], Any]] = iter(steps)

    def is_set(self) -> bool:
        step = next(self._steps, None)
        if step is None:
            return True
        step()
        return False


class Impatient(threading.Event):
    """An event whose `wait` takes no time, and remembers how long it would have been."""

    def __init__(self) -> None:
        super().__init__()
        self.waited_s: list[float] = []

    def wait(self, timeout: float | None = None) -> bool:
        self.waited_s.append(timeout or 0.0)
        return self.is_set()


class FakePort:
    """A device that does what the script says (message, None, exception), then stops all."""

    def __init__(
        self, script: Iterable[Any], stop: threading.Event, key: Key = keys.IMU_BYTES
    ) -> None:
        self.key = key
        self.device = "/dev/fake"
        self.is_open = False
        self._script = iter(script)
        self._stop = stop

    def open(self) -> None:
        assert not self.is_open, "opened twice"
        self.is_open = True

    def read(self) -> Any:
        assert self.is_open, "read while closed"
        item = next(self._script, self)
        if item is self:
            self._stop.set()
            return None
        if isinstance(item, BaseException):
            raise item
        return item

    def close(self) -> None:
        self.is_open = False

    def join(self, reads: Any) -> Any:
        return join_reads(reads)


def raw(data: bytes, at_s: float = 0.0) -> RawBytes:
    """One read of a device."""
    return RawBytes(stamp_ns=START_NS + round(at_s * S), device="/dev/fake", data=data)


class Ear:
    """Hears everything on a bus."""

    def __init__(self, bus: Bus) -> None:
        self.envelopes: list[Envelope] = []
        bus.subscribe("tram/**", self.envelopes.append)

    def heard(self, key: Key) -> list[Any]:
        """Messages of one key (`*` is any source), decoded, in order."""
        expression = key.on(VEHICLE)
        return [
            key.type.FromString(envelope.payload)
            for envelope in self.envelopes
            if keys.matches(expression, envelope.topic)
        ]

    def paths(self) -> list[str]:
        return [keys.split(envelope.topic)[1] for envelope in self.envelopes]


class Sender:
    """Publishes as another process would: with its own session and sequence numbers.

    Without a `session`, with the bus' own.
    """

    def __init__(self, bus: LocalBus, session: int | None = None) -> None:
        self.bus = bus
        self.session = session
        self._sequences: dict[str, int] = {}
        self._history = History(session or 0)
        self._end: Callable[[], None] | None = None

    def announce(self, node: str) -> None:
        """Be alive as a node is."""
        assert self.session is not None
        topic = keys.alive(VEHICLE, node)
        self._end = self.bus._declare(Announced(topic, self.bus.clock.now_ns(), self.session).token)

    def end(self) -> None:
        """Die: the token is gone."""
        assert self._end is not None
        self._end()

    def send(self, key: Key, message: Any, skip: int = 0) -> None:
        """Publish `message`; `skip` sequence numbers are lost before it."""
        message.sequence = self._number(key, skip)
        self._publish(key, message.SerializeToString())

    def send_bytes(self, key: Key, payload: bytes) -> None:
        """Publish what need not be a message."""
        self._number(key, 0)
        self._publish(key, payload)

    def _number(self, key: Key, skip: int) -> int:
        number = self._sequences[key.path] = self._sequences.get(key.path, 0) + 1 + skip
        return number

    def _publish(self, key: Key, payload: bytes) -> None:
        bus = self.bus
        ours = bus.session, bus.history
        try:
            if self.session is not None:
                bus.session, bus.history = self.session, self._history
            bus.publish(key.on(VEHICLE), payload, key.encoding, self._sequences[key.path])
        finally:
            bus.session, bus.history = ours
