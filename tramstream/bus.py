"""The bus: one interface, two implementations, zenoh between processes and in-process for tests.

Every put declares its encoding and carries a 20-byte attachment with the time of publication, the
sequence number on its key and the publisher's session, so that a reader sees every loss without
decoding. Streams are dropped, never blocked, when a reader is slow (one frozen subscriber would
stall everybody). Callbacks run on the bus' threads: they may append to a queue and nothing else.
"""

from __future__ import annotations

import json
import os
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
    def close(self) -> None: ...


class Bus(ABC):
    """What nodes see of the bus."""

    def __init__(self, clock: VehicleClock) -> None:
        self.clock = clock
        self._last_publish_ns: dict[str, int] = {}
        self.renew_session()

    def renew_session(self) -> None:
        """Begin sequence numbers anew: readers take it for another start of the publisher."""
        self.session = int.from_bytes(os.urandom(4), "little")

    def publish_time(self, topic: str) -> int:
        """Now, but later than anything published on `topic` before: it names the message."""
        publish_ns = max(self.clock.now_ns(), self._last_publish_ns.get(topic, 0) + 1)
        self._last_publish_ns[topic] = publish_ns
        return publish_ns

    @abstractmethod
    def publish(
        self, topic: str, payload: bytes, encoding: str, sequence: int, publish_ns: int | None = None
    ) -> int:
        """Put `payload` on `topic`; return the time of publication. Never blocks on a reader."""

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
        self._close = close

    def close(self) -> None:
        self._close()


class LocalBus(Bus):
    """All within one process, delivered in the publisher's thread."""

    def __init__(self, clock: VehicleClock | None = None) -> None:
        super().__init__(clock or VehicleClock())
        self._lock = threading.RLock()
        self._readers: list[tuple[str, Deliver]] = []
        self._announced: list[str] = []
        self._answers: list[tuple[str, Callable[[str], bytes | None]]] = []

    def publish(
        self, topic: str, payload: bytes, encoding: str, sequence: int, publish_ns: int | None = None
    ) -> int:
        with self._lock:
            if publish_ns is None:
                publish_ns = self.publish_time(topic)
            readers = [deliver for expr, deliver in self._readers if keys.matches(expr, topic)]
        envelope = Envelope(
            topic, payload, encoding, publish_ns, sequence, self.session, self.clock.now_ns()
        )
        for deliver in readers:
            deliver(envelope)
        return publish_ns

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
        self._publishers: dict[str, Any] = {}
        self._held: list[Any] = []
        self._lock = threading.Lock()

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
        if router_listens(runtime_dir):
            raise BusError(
                f"{path}: a router is listening already; stop the other `tramstream run`, `demo` "
                "or `replay`, or give this one another $.bus.runtime_dir"
            )
        path.unlink(missing_ok=True)  # left by a router that was killed
        return cls(_open(_router_config(path)), clock, patient)

    def publish(
        self, topic: str, payload: bytes, encoding: str, sequence: int, publish_ns: int | None = None
    ) -> int:
        with self._lock:
            if publish_ns is None:
                publish_ns = self.publish_time(topic)
            publisher = self._publishers.get(topic)
            if publisher is None:
                publisher = self._session.declare_publisher(
                    topic,
                    encoding=encoding,
                    congestion_control=self._congestion,
                )
                self._publishers[topic] = publisher
            publisher.put(payload, attachment=HEADER.pack(publish_ns, sequence, self.session))
        return publish_ns

    def subscribe(self, expression: str, deliver: Deliver) -> Subscription:
        now_ns = self.clock.now_ns

        def callback(sample: Any) -> None:
            arrival_ns = now_ns()
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


def socket_path(runtime_dir: Path) -> Path:
    """Where the router of `runtime_dir` listens."""
    path = runtime_dir / "bus.sock"
    if len(os.fsencode(path)) > SOCKET_PATH_MAX:
        raise BusError(
            f"{path}: longer than a Unix socket's path may be ({SOCKET_PATH_MAX} bytes); set "
            "$.bus.runtime_dir or TRAMSTREAM_RUNTIME_DIR to a shorter one"
        )
    return path


def router_listens(runtime_dir: Path) -> bool:
    """Whether something accepts connections on the socket."""
    import socket

    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(socket_path(runtime_dir)))
        except OSError:
            return False
    return True


def _open(config: Any) -> Any:
    zenoh.init_log_from_env_or("error")
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise BusError(f"the bus cannot be opened: {error}") from error


def _base_config(mode: str) -> Any:
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")
    # Two batches a link, the default, are full when a reader is not scheduled for milliseconds.
    config.insert_json5("transport/link/tx/queue/size/data", str(QUEUE_BATCHES))
    return config


def _router_config(path: Path) -> Any:
    config = _base_config("router")
    config.insert_json5("listen/endpoints", json.dumps([f"unixsock-stream/{path}"]))
    return config


def _client_config(path: Path) -> Any:
    config = _base_config("client")
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5("connect/endpoints", json.dumps([f"unixsock-stream/{path}"]))
    # The router always reads on: waiting for it in a busy moment loses nothing. The router itself
    # keeps the default, 1 ms: it must not wait for a frozen subscriber.
    config.insert_json5(
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop", str(WAIT_FOR_ROUTER_US)
    )
    config.insert_json5("connect/timeout_ms", str(CONNECT_TIMEOUT_MS))
    config.insert_json5(
        "connect/retry",
        json.dumps({"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2}),
    )
    return config
