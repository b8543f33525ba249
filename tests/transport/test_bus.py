"""One contract for every bus; then what only zenoh between processes can do."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import live
import psutil
import pytest
import zenoh
from live import HANG_S, short_folder, until

from tramstream.clock import S, VehicleClock
from tramstream.errors import BusError
from tramstream.proto.resend_pb2 import ResendAnswer, ResendRequest, ResendStretch
from tramstream.transport import bus as bus_module
from tramstream.transport.bus import Bus, Envelope, LocalBus, ZenohBus, router_listens, socket_path
from tramstream.transport.header import HEADER, read_header

ENCODING = "application/protobuf;tramstream.ImuMean"
CLOCK = VehicleClock(offset_ns=1_600_000_000_000_000_000)


class Contract:
    """What every bus keeps. `sender` and `reader` may be the same object."""

    sender: Bus
    reader: Bus

    def hear(self, expression: str) -> list[Envelope]:
        """Subscribe, and wait until the sender's messages arrive."""
        got: list[Envelope] = []
        probes: list[Envelope] = []
        probe = f"probe/{os.urandom(4).hex()}"
        self.reader.subscribe(expression, got.append)
        self.reader.subscribe(probe, probes.append)  # declared later, known later
        until(lambda: self.sender.publish(probe, b"", ENCODING, 1) and probes, "the probe")
        return got

    def send(self, topic: str, sequence: int, payload: bytes = b"") -> int:
        return self.sender.publish(topic, payload, ENCODING, sequence)

    def test_message_arrives_whole_with_its_header(self) -> None:
        got = self.hear("a/b")
        publish_ns = self.send("a/b", 7, b"\x00payload\xff")
        until(lambda: got, "the message")
        (envelope,) = got
        assert envelope.topic == "a/b"
        assert envelope.payload == b"\x00payload\xff"
        assert envelope.encoding == ENCODING
        assert (envelope.sequence, envelope.session) == (7, self.sender.session)
        assert envelope.publish_ns == publish_ns
        assert publish_ns <= envelope.arrival_ns <= CLOCK.now_ns()

    def test_empty_payload_arrives(self) -> None:
        got = self.hear("a/b")
        self.send("a/b", 1)
        until(lambda: got, "the message")
        assert got[0].payload == b""

    def test_encoding_is_that_of_each_message(self) -> None:
        got = self.hear("a/b")
        for number, encoding in enumerate(("application/x", "application/y", "application/x"), 1):
            self.sender.publish("a/b", b"", encoding, number)
        until(lambda: len(got) == 3, "three messages")
        assert [e.encoding for e in got] == ["application/x", "application/y", "application/x"]

    def test_order_is_kept_per_key(self) -> None:
        got = self.hear("a/*")
        for number in range(300):
            self.send(f"a/{number % 3}", number)
        until(lambda: len(got) == 300, "all messages")
        for topic in ("a/0", "a/1", "a/2"):
            sequences = [e.sequence for e in got if e.topic == topic]
            assert sequences == sorted(sequences)

    def test_order_is_kept_per_key_from_several_threads(self) -> None:
        got = self.hear("a/b")

        def work() -> None:
            for _ in range(100):
                self.send("a/b", 1)

        threads = [threading.Thread(target=work) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        until(lambda: len(got) == 400, "all messages")
        times = [e.publish_ns for e in got]
        assert times == sorted(set(times))

    def test_publication_times_rise_strictly_per_key(self) -> None:
        times = [self.send("a/b", number) for number in range(500)]
        assert times == sorted(set(times))

    def test_wanted_publication_time_is_kept_unless_it_would_fall(self) -> None:
        wanted_ns = [5000, 6000, 6000, 1000]
        times = [self.sender.publish("old/b", b"", ENCODING, 1, wanted) for wanted in wanted_ns]
        assert times == [5000, 6000, 6001, 6002]

    @pytest.mark.parametrize(
        ("expression", "expected"),
        [
            ("t/v/raw/gnss/fix", ["t/v/raw/gnss/fix"]),
            ("t/*/raw/gnss/fix", ["t/v/raw/gnss/fix", "t/w/raw/gnss/fix"]),
            ("t/v/**", ["t/v/raw/gnss/fix", "t/v/raw/imu/batch", "t/v"]),
            ("**/batch", ["t/v/raw/imu/batch"]),
            ("t/v/*/*", []),
        ],
    )
    def test_expression_includes_what_it_says(self, expression: str, expected: list[str]) -> None:
        got = self.hear(expression)
        topics = ["t/v/raw/gnss/fix", "t/w/raw/gnss/fix", "t/v/raw/imu/batch", "t/v", "t/x"]
        last = self.hear("end")
        for topic in topics:
            self.send(topic, 1)
        self.send("end", 1)
        until(lambda: last and len(got) >= len(expected), "the expected messages")
        assert [e.topic for e in got] == [topic for topic in topics if topic in expected]

    def test_closed_subscription_hears_no_more_and_may_be_closed_again(self) -> None:
        got: list[Envelope] = []
        other = self.hear("a/b")
        subscription = self.reader.subscribe("a/b", got.append)
        until(lambda: self.send("a/b", 1) and got and other, "the first message on both")
        subscription.close()
        self.send("a/b", 2)
        until(lambda: other[-1].sequence == 2, "the message on the other subscription")
        assert {envelope.sequence for envelope in got} == {1}  # some were on their way
        subscription.close()

    def test_announced_topics_are_alive(self) -> None:
        self.sender.announce("t/v/health/imu/alive")
        self.sender.announce("t/v/health/gnss/alive")
        self.reader.announce("t/w/health/imu/alive")
        until(lambda: len(self.reader.alive("t/*/health/*/alive")) == 3, "three nodes")
        wanted = ["t/v/health/gnss/alive", "t/v/health/imu/alive"]
        until(lambda: self.reader.alive("t/v/health/*/alive") == wanted, "those of one vehicle")
        assert self.reader.alive("t/x/health/*/alive") == []

    def test_who_is_announced_is_known_by_session_also_after_a_new_start(self) -> None:
        topic = "t/v/health/replay/alive"
        self.sender.announce(topic)
        (first,) = until(lambda: self.reader.announced(topic), "the token")
        assert (first.topic, first.session) == (topic, self.sender.session)
        assert 0 < first.since_ns <= self.reader.clock.now_ns()
        self.sender.renew_session()
        until(
            lambda: (
                [each.session for each in self.reader.announced(topic)] == [self.sender.session]
            ),
            "the new session instead of the old one",
        )
        assert self.sender.session not in (0, first.session)

    def test_questions_are_answered_and_silence_is_none(self) -> None:
        self.reader.answer("t/schema/*", lambda t: t.encode() if t.endswith("known") else None)
        answers = until(lambda: self.sender.ask("t/schema/known"), "the answer")
        assert answers == [b"t/schema/known"]
        assert self.sender.ask("t/schema/other", timeout_s=0.5) == []
        assert self.sender.ask("t/nobody", timeout_s=0.5) == []

    def ask_again(self, *stretches: ResendStretch, session: int | None = None) -> list[bytes]:
        """Payloads of what is sent once more."""
        request = ResendRequest(stretches=stretches).SerializeToString()
        answers = map(ResendAnswer.FromString, self.reader.ask_again(request, session, HANG_S))
        return [m.payload for a in answers for part in a.stretches for m in part.messages]

    def test_what_was_published_can_be_had_again(self) -> None:
        self.hear("a/b")
        times = [self.send("a/b", number, bytes([number])) for number in range(1, 6)]
        session = self.sender.session
        wanted = ResendStretch(
            topic="a/b",
            session=session,
            after_publish_ns=times[0],
            before_publish_ns=times[4],
        )
        until(lambda: self.ask_again(wanted, session=session), "the publisher's answer")
        assert self.ask_again(wanted, session=session) == [b"\2", b"\3", b"\4"]
        assert self.ask_again(wanted) == [b"\2", b"\3", b"\4"]
        assert self.ask_again(wanted, session=session ^ 1) == []

    def test_question_that_nobody_can_read_has_no_answer(self) -> None:
        assert list(self.reader.ask_again(b"\xff\xff", timeout_s=0.5)) == []

    def test_new_session_keeps_nothing_of_the_old_one(self) -> None:
        self.hear("a/b")
        self.send("a/b", 1, b"old")
        self.sender.renew_session()
        self.send("a/b", 1, b"new")
        wanted = ResendStretch(topic="a/b")
        until(lambda: self.ask_again(wanted, session=self.sender.session), "the new session")
        assert self.ask_again(wanted) == [b"new"]

    def test_new_session_has_another_number(self) -> None:
        before = self.sender.session
        self.sender.renew_session()
        assert self.sender.session != before

    def test_close_may_be_called_twice(self) -> None:
        self.sender.close()
        self.sender.close()


class TestLocalBus(Contract):
    @pytest.fixture(autouse=True)
    def _bus(self) -> Iterator[None]:
        self.sender = self.reader = LocalBus(CLOCK)
        yield
        self.sender.close()


@pytest.fixture
def runtime_dir() -> Iterator[Path]:
    with short_folder() as folder:
        yield folder


@pytest.mark.live
class TestZenohBusBetweenClients(Contract):
    @pytest.fixture(autouse=True)
    def _bus(self, runtime_dir: Path) -> Iterator[None]:
        router = ZenohBus.route(runtime_dir, CLOCK)
        self.sender = ZenohBus.connect(runtime_dir, CLOCK)
        self.reader = ZenohBus.connect(runtime_dir, CLOCK)
        yield
        for each in (self.sender, self.reader, router):
            each.close()


@pytest.mark.live
class TestZenohBusFromRouterToClient(Contract):
    @pytest.fixture(autouse=True)
    def _bus(self, runtime_dir: Path) -> Iterator[None]:
        self.sender = ZenohBus.route(runtime_dir, CLOCK)
        self.reader = ZenohBus.connect(runtime_dir, CLOCK)
        yield
        for each in (self.reader, self.sender):
            each.close()


# Between processes --------------------------------------------------------------------------------
Settings = Callable[[Path], dict[str, Any]]


def trusting(settings: Settings) -> Settings:
    """The settings, but nobody is thrown off the bus for standing still, however long it lasts.

    By itself zenoh gives a peer up that is mute for ten seconds, or that a message which may not
    be dropped has waited five seconds for.
    """

    def changed(path: Path) -> dict[str, Any]:
        made = settings(path)
        tx = made["transport"]["link"]["tx"]
        tx["lease"] = int(2 * HANG_S * 1e3)
        tx["queue"]["congestion_control"]["block"] = {"wait_before_close": int(2 * HANG_S * 1e6)}
        return made

    return changed


TRUSTED = f"""
import sys
from pathlib import Path
from tramstream.transport import bus
sys.path[:0] = {[str(Path(__file__).parent), str(Path(live.__file__).parent)]!r}
from test_bus import trusting
bus.client_settings = trusting(bus.client_settings)
bus.router_settings = trusting(bus.router_settings)
"""

ROUTER = """
import sys
from pathlib import Path
from tramstream.transport.bus import ZenohBus
from tramstream.clock import S, VehicleClock
bus = ZenohBus.route(Path(sys.argv[1]), VehicleClock())
print("up", flush=True)
sys.stdin.read()
bus.close()
"""

SUBSCRIBER = """
import sys
from pathlib import Path
from tramstream.transport.bus import ZenohBus
from tramstream.clock import S, VehicleClock
bus = ZenohBus.connect(Path(sys.argv[1]), VehicleClock())
bus.subscribe("a/*", lambda envelope: None)
bus.announce("alive/other")
print("up", flush=True)
sys.stdin.read()
bus.close()
"""


class Other:
    """A process of its own that is up; killed at the end."""

    def __init__(self, program: str, runtime_dir: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", program, str(runtime_dir)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == b"up\n"

    def send_signal(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def freeze(self) -> None:
        self.process.send_signal(signal.SIGSTOP)
        until(lambda: self.frozen, "the process to stand still")

    @property
    def frozen(self) -> bool:
        return psutil.Process(self.process.pid).status() == psutil.STATUS_STOPPED

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(HANG_S)
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()


@pytest.fixture
def start(runtime_dir: Path) -> Iterator[Callable[[str], Other]]:
    others: list[Other] = []

    def start_one(program: str) -> Other:
        others.append(Other(program, runtime_dir))
        return others[-1]

    yield start_one
    for other in others:
        other.kill()


@pytest.fixture
def no_peer_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """For the buses of this process as `TRUSTED` is for those of others."""
    for settings in ("client_settings", "router_settings"):
        monkeypatch.setattr(bus_module, settings, trusting(getattr(bus_module, settings)))


def sentence(error: pytest.ExceptionInfo[BusError], *parts: str) -> None:
    for part in parts:
        assert part in str(error.value)


@pytest.mark.live
def test_client_without_router_says_what_to_start(runtime_dir: Path) -> None:
    with pytest.raises(BusError) as caught:
        ZenohBus.connect(runtime_dir, CLOCK)
    sentence(caught, str(runtime_dir), "tramstream run", "TRAMSTREAM_RUNTIME_DIR")


@pytest.mark.live
def test_client_with_a_stop_waits_for_the_router(runtime_dir: Path) -> None:
    found: list[ZenohBus] = []
    stop = threading.Event()
    waiting = threading.Thread(
        target=lambda: found.append(ZenohBus.connect(runtime_dir, CLOCK, stop))
    )
    waiting.start()
    router = ZenohBus.route(runtime_dir, CLOCK)
    waiting.join(HANG_S)
    assert found
    found[0].close()
    router.close()


@pytest.mark.live
def test_waiting_client_ends_when_told(runtime_dir: Path) -> None:
    stop = threading.Event()
    stop.set()
    with pytest.raises(BusError):
        ZenohBus.connect(runtime_dir, CLOCK, stop)


@pytest.mark.live
def test_second_router_is_refused_with_a_sentence_and_the_first_goes_on(
    runtime_dir: Path,
) -> None:
    router = ZenohBus.route(runtime_dir, CLOCK)
    for _ in range(2):
        with pytest.raises(BusError) as caught:
            ZenohBus.route(runtime_dir, CLOCK)
        sentence(caught, "a router is listening already", "$.bus.runtime_dir")
    client = ZenohBus.connect(runtime_dir, CLOCK)
    client.close()
    router.close()
    ZenohBus.route(runtime_dir, CLOCK).close()


@pytest.mark.live
def test_of_routers_that_start_at_once_one_wins(runtime_dir: Path) -> None:
    won: list[ZenohBus] = []
    refused: list[BusError] = []
    begin = threading.Barrier(4)

    def work() -> None:
        begin.wait()
        try:
            won.append(ZenohBus.route(runtime_dir, CLOCK))
        except BusError as error:
            refused.append(error)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(HANG_S)
    assert (len(won), len(refused)) == (1, 3)
    ZenohBus.connect(runtime_dir, CLOCK).close()
    won[0].close()


@pytest.mark.live
def test_frozen_router_is_not_replaced(runtime_dir: Path, start: Callable[[str], Other]) -> None:
    other = start(ROUTER)
    other.freeze()
    with pytest.raises(BusError, match="listening already"):
        ZenohBus.route(runtime_dir, CLOCK)


@pytest.mark.live
def test_stale_socket_of_a_killed_router_is_replaced(
    runtime_dir: Path, start: Callable[[str], Other]
) -> None:
    start(ROUTER).kill()
    assert socket_path(runtime_dir).exists()
    assert not router_listens(runtime_dir)
    router = ZenohBus.route(runtime_dir, CLOCK)
    ZenohBus.connect(runtime_dir, CLOCK).close()
    router.close()


@pytest.mark.live
def test_clients_meet_again_after_the_router_was_killed(
    runtime_dir: Path, start: Callable[[str], Other]
) -> None:
    first = start(ROUTER)
    sender = ZenohBus.connect(runtime_dir, CLOCK)
    reader = ZenohBus.connect(runtime_dir, CLOCK)
    got: list[Envelope] = []
    reader.subscribe("a/b", got.append)
    sender.announce("alive/sender")
    until(lambda: sender.publish("a/b", b"", ENCODING, 1) and got, "a message")
    first.kill()
    start(ROUTER)
    got.clear()
    until(lambda: sender.publish("a/b", b"", ENCODING, 2) and got, "a message after the restart")
    until(lambda: reader.alive("alive/*") == ["alive/sender"], "the sender's token")
    for each in (sender, reader):
        each.close()


@pytest.mark.live
def test_token_of_a_killed_process_goes(runtime_dir: Path, start: Callable[[str], Other]) -> None:
    router = ZenohBus.route(runtime_dir, CLOCK)
    other = start(SUBSCRIBER)
    until(lambda: router.alive("alive/*") == ["alive/other"], "the token")
    other.kill()
    until(lambda: router.alive("alive/*") == [], "the token's end")
    router.close()


@pytest.mark.live
@pytest.mark.usefixtures("no_peer_is_given_up")
def test_frozen_subscriber_does_not_stall_the_others(
    runtime_dir: Path, start: Callable[[str], Other]
) -> None:
    """The publisher is never further ahead of the living reader than queues hold.

    So all that the reader misses, or waits for in vain, it misses because of the frozen one.
    """
    router = ZenohBus.route(runtime_dir, CLOCK)
    sender = ZenohBus.connect(runtime_dir, CLOCK)
    reader = ZenohBus.connect(runtime_dir, CLOCK)
    got: list[int] = []
    reader.subscribe("a/b", lambda envelope: got.append(envelope.sequence))
    frozen = start(TRUSTED + SUBSCRIBER)
    until(lambda: router.alive("alive/*") == ["alive/other"], "the other subscriber")
    until(lambda: sender.publish("a/b", b"", ENCODING, 0) and got, "a message")
    frozen.freeze()
    count = 1200  # 24 MB: more than any socket buffers

    def publish() -> None:
        for number in range(1, count + 1):
            sender.publish("a/b", bytes(20_000), ENCODING, number)
            if number % 10 == 0:  # a fifth of a queue
                until(lambda sent=number: got[-1] == sent, "the reader's messages")

    publishing = threading.Thread(target=publish, daemon=True)
    publishing.start()
    until(lambda: not publishing.is_alive(), "all to be published and read", lambda: got[-1])
    assert [number for number in got if number] == list(range(1, count + 1))
    assert frozen.frozen
    for each in (sender, reader, router):
        each.close()


@pytest.mark.live
@pytest.mark.parametrize("patient", [False, True])
def test_publisher_is_declared_to_drop_and_only_a_patient_one_to_wait(
    runtime_dir: Path, monkeypatch: pytest.MonkeyPatch, patient: bool
) -> None:
    """Read from what zenoh made, not from what it was asked for."""
    bus = ZenohBus.route(runtime_dir, CLOCK, patient)
    bus.publish("a/b", b"", ENCODING, 1)
    (publisher,) = bus._publishers.values()
    wanted = zenoh.CongestionControl.BLOCK if patient else zenoh.CongestionControl.DROP
    assert publisher.congestion_control == wanted
    bus.close()


@pytest.mark.live
def test_zenoh_is_really_given_queues_and_patience(
    runtime_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Read out of the configurations that sessions were opened with, not out of our constants."""
    given: list[dict[str, Any]] = []
    opened = zenoh.open

    def remember(config: zenoh.Config) -> zenoh.Session:
        names = ("mode", "transport/link/tx/queue", "transport/shared_memory", "scouting")
        given.append({name: json.loads(config.get_json(name)) for name in names})
        return opened(config)

    monkeypatch.setattr(zenoh, "open", remember)
    router = ZenohBus.route(runtime_dir, CLOCK)
    client = ZenohBus.connect(runtime_dir, CLOCK)
    for each in (client, router):
        each.close()
    by_mode = {each["mode"]: each for each in given}
    assert set(by_mode) == {"router", "client"}
    for mode, patience_us in (("router", 1000), ("client", 200_000)):
        queue = by_mode[mode]["transport/link/tx/queue"]
        assert queue["size"]["data"] == 16
        assert queue["congestion_control"]["drop"]["wait_before_drop"] == patience_us
        assert not by_mode[mode]["transport/shared_memory"]["enabled"]
        assert not by_mode[mode]["scouting"]["multicast"]["enabled"]
        assert not by_mode[mode]["scouting"]["gossip"]["enabled"]


@pytest.mark.live
@pytest.mark.usefixtures("no_peer_is_given_up")
@pytest.mark.parametrize("halt_s", [2.0, 4.0])
def test_router_that_is_halted_for_seconds_loses_nothing(
    runtime_dir: Path, start: Callable[[str], Other], halt_s: float
) -> None:
    """Five publishers with a vehicle's 700 messages a second; with zenoh's own queues 683, 1417."""
    router = start(TRUSTED + ROUTER)
    senders = [ZenohBus.connect(runtime_dir, CLOCK) for _ in range(5)]
    reader = ZenohBus.connect(runtime_dir, CLOCK)
    got: list[Envelope] = []
    reader.subscribe("a/*", got.append)
    for index, sender in enumerate(senders):
        topic = f"a/{index}"
        until(
            lambda sender=sender, topic=topic: (
                sender.publish(topic, b"", ENCODING, 1)
                and any(envelope.topic == topic for envelope in got)
            ),
            f"messages on {topic}",
        )
    router.freeze()
    begin_s, count = time.monotonic(), int(140 * halt_s)
    for number in range(count):
        time.sleep(max(0.0, begin_s + number / 140 - time.monotonic()))
        for index, sender in enumerate(senders):
            sender.publish(f"a/{index}", bytes(310), ENCODING, 2 + number)
    router.send_signal(signal.SIGCONT)

    def last_of_all() -> bool:
        for index, sender in enumerate(senders):
            sender.publish(f"a/{index}", b"", ENCODING, count + 2)
        return len({e.topic for e in got if e.sequence == count + 2}) == len(senders)

    until(last_of_all, "the last messages")
    for index in range(len(senders)):
        came = {e.sequence for e in got if e.topic == f"a/{index}"}
        assert came == set(range(1, count + 3))
    for each in (*senders, reader):
        each.close()


class Lasting:
    """A zenoh session whose close lasts until it is let go, as zenoh's does with a frozen peer."""

    def __init__(self, session: zenoh.Session, let_go: threading.Event) -> None:
        self._session = session
        self._let_go = let_go

    def close(self) -> None:
        self._session.close()
        self._let_go.wait(2 * HANG_S)


@pytest.mark.live
@pytest.mark.usefixtures("no_peer_is_given_up")
def test_close_returns_while_a_reader_is_still_frozen(
    runtime_dir: Path, start: Callable[[str], Other]
) -> None:
    """By itself zenoh gives a frozen peer up after some seconds; here it never does."""
    router = ZenohBus.route(runtime_dir, CLOCK)
    sender = ZenohBus.connect(runtime_dir, CLOCK)
    frozen = start(TRUSTED + SUBSCRIBER)
    until(lambda: router.alive("alive/*") == ["alive/other"], "the subscriber")
    frozen.freeze()
    for number in range(200):
        sender.publish("a/b", bytes(20_000), ENCODING, number)
    let_go = threading.Event()
    for each in (sender, router):
        each._session = Lasting(each._session, let_go)
        closing = threading.Thread(target=each.close, daemon=True)
        closing.start()
        closing.join(HANG_S)
        assert not closing.is_alive()
        assert frozen.frozen
    let_go.set()


def test_socket_path_that_is_too_long_is_refused_with_the_cure() -> None:
    with pytest.raises(BusError) as caught:
        socket_path(Path("/tmp") / ("x" * 100))
    sentence(caught, "longer than", "TRAMSTREAM_RUNTIME_DIR")


def test_router_without_its_folder_is_refused_with_the_cure(tmp_path: Path) -> None:
    with pytest.raises(BusError) as caught:
        ZenohBus.route(tmp_path / "no", CLOCK)
    sentence(caught, "$.bus.runtime_dir")


def test_local_subscription_that_publishes_itself_does_not_hang() -> None:
    bus = LocalBus(CLOCK)
    got: list[str] = []
    bus.subscribe("a", lambda envelope: bus.publish("b", b"", ENCODING, 1) and None)
    bus.subscribe("b", lambda envelope: got.append(envelope.topic))
    bus.publish("a", b"", ENCODING, 1)
    assert got == ["b"]


@pytest.mark.parametrize(
    "header",
    [
        b"",
        b"x" * 19,
        b"x" * 21,
        HEADER.pack((1 << 64) - 1, 1, 7),
        HEADER.pack(1_000 * S + 2 * S, 1, 7),
        HEADER.pack(1_000 * S, (1 << 64) - 1, 7),
    ],
)
def test_header_that_cannot_be_ours_is_none(header: bytes) -> None:
    """A time after the arrival would hold up all who go on behind it, for good."""
    assert read_header(header, 1_000 * S) == (1_000 * S, 0, 0)


def test_header_of_ours_is_read() -> None:
    assert read_header(HEADER.pack(999 * S, 5, 7), 1_000 * S) == (999 * S, 5, 7)
