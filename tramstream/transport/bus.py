"""The bus: one interface, two implementations, zenoh between processes and in-process for tests.

Every put declares its encoding and carries the time of publication, the sequence number on its key
and the publisher's session, so that a reader sees every loss without decoding. Streams are dropped,
never blocked, when a reader is slow (one frozen subscriber would stall everybody). Callbacks run on
the bus' threads: they may append to a queue and nothing else.
"""

from __future__ import annotations

import json
import os
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import zenoh

from tramstream import keys
from tramstream.clock import VehicleClock
from tramstream.errors import BusError
from tramstream.transport import tokens
from tramstream.transport.envelope import Deliver, Envelope
from tramstream.transport.header import HEADER, read_header
from tramstream.transport.resend import History
from tramstream.transport.router_socket import lock_router, router_listens, socket_path
from tramstream.transport.settings import LEAVE_S, client_settings, router_settings
from tramstream.transport.subscription import Subscription

CLOSE_TIMEOUT_S = 3.0  # zenoh's close may take ten seconds while a peer is frozen
_START_ONE = "start `tramstream run`, `demo` or `replay` first, or name its TRAMSTREAM_RUNTIME_DIR"
ROUTER_POLL_S = 0.1
__all__ = ["HEADER", "Bus", "Deliver", "Envelope", "LocalBus", "ZenohBus", "router_listens"]


class Bus(ABC):
    """What nodes see of the bus."""

    def __init__(self, clock: VehicleClock) -> None:
        self.clock = clock
        self._lock = threading.RLock()
        self._last_publish_ns: dict[str, int] = {}
        self._tokens: dict[str, Callable[[], None]] = {}
        self.renew_session()

    def renew_session(self) -> None:
        """Begin sequence numbers anew: readers take it for another start of the publisher."""
        self.session = int.from_bytes(os.urandom(4), "little") or 1
        self.history = History(self.session)
        for topic in list(self._tokens):
            self.announce(topic)

    def publish(
        self,
        topic: str,
        payload: bytes,
        encoding: str,
        sequence: int,
        publish_ns: int | None = None,
    ) -> int:
        """Put `payload` on `topic`; return the time of publication. Never blocks on a reader.

        That time is now (or `publish_ns`), but later than all published on `topic` before: it names
        the message.
        """
        with self._lock:  # until it is out: that keeps the order
            wanted_ns = self.clock.now_ns() if publish_ns is None else publish_ns
            publish_ns = max(wanted_ns, self._last_publish_ns.get(topic, 0) + 1)
            self._last_publish_ns[topic] = publish_ns
            self.history.keep(topic, payload, encoding, sequence, publish_ns)
            self._put(topic, payload, encoding, sequence, publish_ns)
        return publish_ns

    @abstractmethod
    def _put(
        self, topic: str, payload: bytes, encoding: str, sequence: int, publish_ns: int
    ) -> None:
        """Send a message; called with the lock held."""

    @abstractmethod
    def subscribe(self, expression: str, deliver: Deliver) -> Subscription:
        """Call `deliver` for every message on a key that `expression` includes."""

    def announce(self, topic: str) -> None:
        """Be alive under `topic`, with the session of all that is published, until closed."""
        announced = tokens.Announced(topic, self.clock.now_ns(), self.session)
        withdraw, self._tokens[topic] = self._tokens.get(topic), self._declare(announced.token)
        if withdraw is not None:
            withdraw()

    @abstractmethod
    def _declare(self, token: str) -> Callable[[], None]:
        """Be alive under `token` until closed, or what is returned is called."""

    def announced(self, expression: str) -> list[tokens.Announced]:
        """Who is announced now under topics that `expression` includes."""
        return tokens.read(self._alive(f"{expression}/*"))

    def alive(self, expression: str) -> list[str]:
        """Topics announced now."""
        return sorted({each.topic for each in self.announced(expression)})

    @abstractmethod
    def _alive(self, expression: str) -> list[str]:
        """Tokens declared now."""

    @abstractmethod
    def answer(self, expression: str, reply: Callable[[str], bytes | None]) -> None:
        """Answer queries for a key with bytes; None stays silent."""

    @abstractmethod
    def ask(self, topic: str, timeout_s: float = 2.0, payload: bytes = b"") -> list[bytes]:
        """Answers to a query on `topic`."""

    @abstractmethod
    def attend(self, topic: str, take: Callable[[bytes, Callable[[], None]], None]) -> None:
        """Give `take` what queries on `topic` carry, and a call that answers it at any time."""

    @abstractmethod
    def until_recorded(self, vehicle: str, timeout_s: float = LEAVE_S) -> bool:
        """Wait until the recorder of `vehicle`, if any, has all of this session; False if not."""

    @abstractmethod
    def ask_again(
        self, request: bytes, session: int | None = None, timeout_s: float = 2.0
    ) -> Iterator[bytes]:
        """Answers of publishers (`tramstream.transport.resend`), of all or the one with `session`.

        Blocks until all have answered, or for `timeout_s`: not for a bus' own threads.
        """

    @abstractmethod
    def close(self) -> None: ...


class LocalBus(Bus):
    """All within one process, delivered in the publisher's thread."""

    def __init__(self, clock: VehicleClock | None = None) -> None:
        super().__init__(clock or VehicleClock())
        self._readers: list[tuple[str, Deliver]] = []
        self._announced: list[str] = []
        self._answers: list[tuple[str, Callable[[str], bytes | None]]] = []

    def _put(
        self, topic: str, payload: bytes, encoding: str, sequence: int, publish_ns: int
    ) -> None:
        envelope = Envelope(
            topic, payload, encoding, publish_ns, sequence, self.session, self.clock.now_ns()
        )
        for expression, deliver in list(self._readers):
            if keys.matches(expression, topic):
                deliver(envelope)

    def subscribe(self, expression: str, deliver: Deliver) -> Subscription:
        entry = (expression, deliver)

        def close() -> None:
            with self._lock:
                if entry in self._readers:
                    self._readers.remove(entry)

        with self._lock:
            self._readers.append(entry)
        return Subscription(close)

    def _declare(self, token: str) -> Callable[[], None]:
        self._announced.append(token)
        return lambda: self._announced.remove(token)

    def _alive(self, expression: str) -> list[str]:
        return [token for token in self._announced if keys.matches(expression, token)]

    def answer(self, expression: str, reply: Callable[[str], bytes | None]) -> None:
        self._answers.append((expression, reply))

    def ask(self, topic: str, timeout_s: float = 2.0, payload: bytes = b"") -> list[bytes]:
        answers = [reply(topic) for expr, reply in self._answers if keys.meet(expr, topic)]
        return [answer for answer in answers if answer is not None]

    def attend(self, topic: str, take: Callable[[bytes, Callable[[], None]], None]) -> None:
        """Nobody asks: see `until_recorded`."""

    def until_recorded(self, vehicle: str, timeout_s: float = LEAVE_S) -> bool:
        """Nothing is under way: what was published has been delivered."""
        return True

    def ask_again(
        self, request: bytes, session: int | None = None, timeout_s: float = 2.0
    ) -> Iterator[bytes]:
        answer = self.history.answer(request) if session in (None, self.session) else None
        if answer is not None:
            yield answer

    def close(self) -> None:
        with self._lock:
            self._readers.clear()
            self._announced.clear()
            self._answers.clear()


class ZenohBus(Bus):
    """A zenoh session on the vehicle's Unix socket, as a client or as the router itself."""

    def __init__(self, session: Any, clock: VehicleClock, patient: bool = False) -> None:
        self._session = session
        self._resender: Any = None
        super().__init__(clock)
        self._congestion = (
            zenoh.CongestionControl.BLOCK if patient else zenoh.CongestionControl.DROP
        )
        self._publishers: dict[tuple[str, str], Any] = {}
        self._held: list[Any] = []
        self._router_lock: int | None = None

    def renew_session(self) -> None:
        super().renew_session()
        if self._resender is not None:
            self._resender.undeclare()
        history = self.history

        def callback(query: Any) -> None:  # on a thread of its own
            with query:
                asked = query.payload
                data = history.answer(asked.to_bytes()) if asked is not None else None
                if data is not None:
                    query.reply(query.key_expr, data)

        self._resender = self._session.declare_queryable(keys.resend(self.session), callback)

    @classmethod
    def connect(
        cls,
        runtime_dir: Path,
        clock: VehicleClock,
        stop: threading.Event | None = None,
        patient: bool = False,
    ) -> ZenohBus:
        """Join as a client; afterwards the router may go and come again.

        With `stop`, wait until there is a router or `stop` is set; without, fail at once. A
        `patient` publisher waits for a slow reader instead of dropping: for replays, never live.

        Raises
        ------
        BusError
            If there is no router, or `stop` was set while waiting for it.
        """
        path = socket_path(runtime_dir)
        while True:
            if router_listens(runtime_dir):
                try:
                    return cls(_open(client_settings(path)), clock, patient)
                except BusError:  # the router went in this instant
                    if stop is None:
                        raise
            if stop is None or stop.wait(ROUTER_POLL_S):
                raise BusError(f"no bus at {path}", cure=_START_ONE)

    @classmethod
    def route(cls, runtime_dir: Path, clock: VehicleClock, patient: bool = False) -> ZenohBus:
        """Be the router that clients meet at; also a full member of the bus.

        Raises
        ------
        BusError
            If a router is there already.
        """
        path = socket_path(runtime_dir)
        lock = lock_router(runtime_dir)
        try:
            path.unlink(missing_ok=True)  # left by a router that was killed
            bus = cls(_open(router_settings(path)), clock, patient)
        except BaseException:
            os.close(lock)
            raise
        bus._router_lock = lock
        return bus

    def _put(
        self, topic: str, payload: bytes, encoding: str, sequence: int, publish_ns: int
    ) -> None:
        publisher = self._publishers.get((topic, encoding))
        if publisher is None:
            publisher = self._publishers[topic, encoding] = self._session.declare_publisher(
                topic, encoding=encoding, congestion_control=self._congestion
            )
        publisher.put(payload, attachment=HEADER.pack(publish_ns, sequence, self.session))

    def subscribe(self, expression: str, deliver: Deliver) -> Subscription:
        now_ns = self.clock.now_ns

        def callback(sample: Any) -> None:
            arrival_ns = now_ns()
            if sample.kind != zenoh.SampleKind.PUT:
                return  # a stranger's delete; nothing of ours can be deleted
            attachment = sample.attachment
            header = attachment.to_bytes() if attachment is not None else b""
            publish_ns, sequence, session = read_header(header, arrival_ns)
            deliver(
                Envelope(
                    str(sample.key_expr),
                    sample.payload.to_bytes(),
                    str(sample.encoding),
                    publish_ns,
                    sequence,
                    session,
                    arrival_ns,
                )
            )

        subscriber = self._session.declare_subscriber(expression, callback)
        self._held.append(subscriber)
        return Subscription(subscriber.undeclare)

    def _declare(self, token: str) -> Callable[[], None]:
        withdraw: Callable[[], None] = self._session.liveliness().declare_token(token).undeclare
        return withdraw

    def _alive(self, expression: str) -> list[str]:
        replies = self._session.liveliness().get(expression, timeout=1.0)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    def answer(self, expression: str, reply: Callable[[str], bytes | None]) -> None:
        def callback(query: Any) -> None:
            with query:
                topic = str(query.key_expr) if "*" in expression else expression
                if (data := reply(topic)) is not None:
                    query.reply(topic, data)

        self._held.append(self._session.declare_queryable(expression, callback))

    def ask(self, topic: str, timeout_s: float = 2.0, payload: bytes = b"") -> list[bytes]:
        try:
            replies = self._session.get(topic, payload=payload, timeout=timeout_s)
            return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]
        except zenoh.ZError:  # closed meanwhile: nobody answers
            return []

    def attend(self, topic: str, take: Callable[[bytes, Callable[[], None]], None]) -> None:
        def callback(query: Any) -> None:
            def answer() -> None:
                with query:
                    query.reply(query.key_expr, b"")

            take(query.payload.to_bytes() if query.payload is not None else b"", answer)

        self._held.append(self._session.declare_queryable(topic, callback))

    def until_recorded(self, vehicle: str, timeout_s: float = LEAVE_S) -> bool:
        end_s = time.monotonic() + timeout_s
        while (rest_s := end_s - time.monotonic()) > 0.0:
            answered = self.ask(keys.farewell(vehicle), rest_s, self.session.to_bytes(4, "little"))
            if answered or not self.alive(keys.alive(vehicle, "recorder")):
                return True
            time.sleep(ROUTER_POLL_S)  # a full link drops question or answer: it is put again
        return False

    def ask_again(
        self, request: bytes, session: int | None = None, timeout_s: float = 2.0
    ) -> Iterator[bytes]:
        try:
            replies = self._session.get(
                keys.resend(session),
                payload=request,
                timeout=timeout_s,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                # Answers too: one that finds no room is asked for again, and stalls nobody.
                congestion_control=zenoh.CongestionControl.DROP,
            )
        except zenoh.ZError:  # closed meanwhile: nobody answers
            return
        for reply in replies:
            if reply.ok is not None:
                yield reply.ok.payload.to_bytes()

    def close(self) -> None:
        closer = threading.Thread(target=self._session.close, name="zenoh-close", daemon=True)
        closer.start()
        closer.join(CLOSE_TIMEOUT_S)
        if self._router_lock is not None:
            os.close(self._router_lock)
            self._router_lock = None


LOG = "error,zenoh::api::session=off"
"""zenoh logs on stdout, where our JSON goes: a session that closes while data are on their way
calls them data for an unknown key. What is lost, sequence numbers tell. RUST_LOG overrides."""


def _open(config: dict[str, Any]) -> Any:
    zenoh.init_log_from_env_or(LOG)
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    except zenoh.ZError as error:
        raise BusError(f"the bus cannot be opened: {error}") from error
