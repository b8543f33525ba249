"""The bus: one interface, two implementations, zenoh between processes and in-process for tests.

Every put declares its encoding and carries a 20-byte attachment with the time of publication, the
sequence number on its key and the publisher's session, so that a reader sees every loss without
decoding. Streams are dropped, never blocked, when a reader is slow (one frozen subscriber would
stall everybody). Callbacks run on the bus' threads: they may append to a queue and nothing else.
"""

from __future__ import annotations

import fcntl
import json
import os
import socket
import struct
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import zenoh

from tramstream import keys
from tramstream.clock import VehicleClock
from tramstream.errors import BusError

HEADER = struct.Struct("<QQI")
"""Attachment of every put: publish_ns, sequence, session."""
CLOSE_TIMEOUT_S = 3.0
"""zenoh's close may take ten seconds while a peer is frozen; nobody waits that long."""
ROUTER_POLL_S = 0.1
CONNECT_TIMEOUT_MS = 2000
QUEUE_BATCHES = 16
"""Of 64 KiB; zenoh allows no more."""
WAIT_FOR_ROUTER_US = 200_000
SOCKET_PATH_MAX = 100
"""A Unix socket's path has 108 bytes; zenoh appends to it."""


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


class Subscription(ABC):
    """An open subscription."""

    @abstractmethod
    def close(self) -> None:
        """End it; may be called twice."""


class Bus(ABC):
    """What nodes see of the bus."""

    def __init__(self, clock: VehicleClock) -> None:
        self.clock = clock
        self._lock = threading.RLock()
        self._last_publish_ns: dict[str, int] = {}
        self.renew_session()

    def renew_session(self) -> None:
        """Begin sequence numbers anew: readers take it for another start of the publisher."""
        self.session = int.from_bytes(os.urandom(4), "little")

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

    @abstractmethod
    def announce(self, topic: str) -> None:
        """Be alive under `topic` until closed."""

    @abstractmethod
    def alive(self, expression: str) -> list[str]:
        """Topics announced now."""

    @abstractmethod
    def answer(self, expression: str, reply: Callable[[str], bytes | None]) -> None:
        """Answer queries for a key with bytes; None stays silent."""

    @abstractmethod
    def ask(self, topic: str, timeout_s: float = 2.0) -> list[bytes]:
        """Answers to a query on `topic`."""

    @abstractmethod
    def close(self) -> None: ...


class _Closing(Subscription):
    def __init__(self, close: Callable[[], None]) -> None:
        self._close: Callable[[], None] | None = close

    def close(self) -> None:
        close, self._close = self._close, None
        if close is not None:
            close()


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
        return _Closing(close)

    def announce(self, topic: str) -> None:
        self._announced.append(topic)

    def alive(self, expression: str) -> list[str]:
        return sorted(topic for topic in self._announced if keys.matches(expression, topic))

    def answer(self, expression: str, reply: Callable[[str], bytes | None]) -> None:
        self._answers.append((expression, reply))

    def ask(self, topic: str, timeout_s: float = 2.0) -> list[bytes]:
        answers = [reply(topic) for expr, reply in self._answers if keys.matches(expr, topic)]
        return [answer for answer in answers if answer is not None]

    def close(self) -> None:
        with self._lock:
            self._readers.clear()
            self._announced.clear()
            self._answers.clear()


class ZenohBus(Bus):
    """A zenoh session on the vehicle's Unix socket, as a client or as the router itself."""

    def __init__(self, session: Any, clock: VehicleClock, patient: bool = False) -> None:
        super().__init__(clock)
        self._session = session
        self._congestion = (
            zenoh.CongestionControl.BLOCK if patient else zenoh.CongestionControl.DROP
        )
        self._publishers: dict[tuple[str, str], Any] = {}
        self._held: list[Any] = []
        self._router_lock: int | None = None

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
                    return cls(_open(_client_config(path)), clock, patient)
                except BusError:  # the router went in this instant
                    if stop is None:
                        raise
            if stop is None or stop.wait(ROUTER_POLL_S):
                raise BusError(
                    f"no bus at {path}; start `tramstream run`, `demo` or `replay` first, or set "
                    "TRAMSTREAM_RUNTIME_DIR to the folder that it uses"
                )

    @classmethod
    def route(cls, runtime_dir: Path, clock: VehicleClock, patient: bool = False) -> ZenohBus:
        """Be the router that clients meet at; also a full member of the bus.

        Raises
        ------
        BusError
            If a router is there already.
        """
        path = socket_path(runtime_dir)
        lock = _lock_router(runtime_dir)
        try:
            path.unlink(missing_ok=True)  # left by a router that was killed
            bus = cls(_open(_router_config(path)), clock, patient)
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
            if len(header) == HEADER.size:
                publish_ns, sequence, session = HEADER.unpack(header)
            else:  # a stranger on our keys: no header, so nothing to count losses by
                publish_ns, sequence, session = arrival_ns, 0, 0
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
        return _Closing(subscriber.undeclare)

    def announce(self, topic: str) -> None:
        self._held.append(self._session.liveliness().declare_token(topic))

    def alive(self, expression: str) -> list[str]:
        replies = self._session.liveliness().get(expression, timeout=1.0)
        return sorted({str(reply.ok.key_expr) for reply in replies if reply.ok is not None})

    def answer(self, expression: str, reply: Callable[[str], bytes | None]) -> None:
        def callback(query: Any) -> None:
            with query:
                data = reply(str(query.key_expr))
                if data is not None:
                    query.reply(query.key_expr, data)

        self._held.append(self._session.declare_queryable(expression, callback))

    def ask(self, topic: str, timeout_s: float = 2.0) -> list[bytes]:
        replies = self._session.get(topic, timeout=timeout_s)
        return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]

    def close(self) -> None:
        closer = threading.Thread(target=self._session.close, name="zenoh-close", daemon=True)
        closer.start()
        closer.join(CLOSE_TIMEOUT_S)
        if self._router_lock is not None:
            os.close(self._router_lock)
            self._router_lock = None


def socket_path(runtime_dir: Path) -> Path:
    """Where the router of `runtime_dir` listens."""
    path = runtime_dir / "bus.sock"
    if len(os.fsencode(path)) > SOCKET_PATH_MAX:
        raise BusError(
            f"{path}: longer than a Unix socket's path may be ({SOCKET_PATH_MAX} bytes); set "
            "$.bus.runtime_dir or TRAMSTREAM_RUNTIME_DIR to a shorter one"
        )
    return path


def _lock_router(runtime_dir: Path) -> int:
    """Be the only router of `runtime_dir` until the returned descriptor is closed, or we die.

    Not by looking whether somebody answers on the socket: two that start at once would both find
    nobody, and a frozen router does not answer.
    """
    path = runtime_dir / "router.lock"
    try:
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise BusError(
            f"{path}: cannot be written ({error.strerror}); set $.bus.runtime_dir or "
            "TRAMSTREAM_RUNTIME_DIR to a folder that you may write"
        ) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        raise BusError(
            f"{socket_path(runtime_dir)}: a router is listening already; stop the other "
            "`tramstream run`, `demo` or `replay`, or give this one another $.bus.runtime_dir"
        ) from error
    return lock


def router_listens(runtime_dir: Path) -> bool:
    """Whether something accepts connections on the socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(socket_path(runtime_dir)))
        except OSError:
            return False
    return True


LOG = "error,zenoh::api::session=off"
"""zenoh logs on stdout, where our JSON goes: a session that closes while data are on their way
calls them data for an unknown key. What is lost, sequence numbers tell. RUST_LOG overrides."""


def _open(config: dict[str, Any]) -> Any:
    zenoh.init_log_from_env_or(LOG)
    # Found by name only: opening takes 3 ms instead of 503, and nothing listens that need not.
    settings = config | {
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"shared_memory": {"enabled": False}},
    }
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))
    except zenoh.ZError as error:
        raise BusError(f"the bus cannot be opened: {error}") from error


def _router_config(path: Path) -> dict[str, Any]:
    return {"mode": "router", "listen": {"endpoints": [f"unixsock-stream/{path}"]}}


def _client_config(path: Path) -> dict[str, Any]:
    retry = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2}
    return {
        "mode": "client",
        "listen": {"endpoints": []},
        "connect": {
            "endpoints": [f"unixsock-stream/{path}"],
            "timeout_ms": CONNECT_TIMEOUT_MS,
            "retry": retry,
        },
    }
