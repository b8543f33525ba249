"""Every message is recorded once or named lost, whatever bus, publishers and recorder do."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from hypothesis import example, given, settings
from hypothesis import strategies as st

from tramstream import keys
from tramstream.clock import S
from tramstream.proto.health_pb2 import Loss
from tramstream.proto.resend_pb2 import ResendAnswer, ResendRequest
from tramstream.recorder.file.layout import Entry
from tramstream.recorder.gaps import AGAIN_NS, ORPHANED_NS, GapBook
from tramstream.recorder.previous import summarise
from tramstream.transport.bus import Envelope
from tramstream.transport.resend import History

OWN = 99
NONE: Counter[str] = Counter()
TOPICS = tuple(key.on("v") for key in (keys.EST_STATE, keys.GNSS_FIX))
BEAT = keys.HEARTBEAT.at("recorder").on("v")
LOSSES = keys.LOSS.at("recorder").on("v")


class Publisher:
    """One session on the topics, with a history of `limit_bytes`."""

    def __init__(self, session: int, world: World, limit_bytes: int) -> None:
        self.session = session
        self.history = History(session, limit_bytes=limit_bytes)
        self.sequences: Counter[str] = Counter()
        self.world = world

    def publish(self, topic: str) -> Envelope:
        self.world.now_ns += 1000
        self.sequences[topic] += 1
        publish_ns, sequence = self.world.now_ns, self.sequences[topic]
        self.history.keep(topic, b"x" * 20, "e", sequence, publish_ns)
        return Envelope(topic, b"", "", publish_ns, sequence, self.session, 0)


class World:
    """A bus that may lose, a recorder that may die, and the ledger over all."""

    def __init__(self, limit_bytes: int = 10_000) -> None:
        self.now_ns = 1000 * S
        self.limit_bytes = limit_bytes
        self.publisher = Publisher(1, self, limit_bytes)
        self.flying: list[Envelope] = []
        self.published: set[tuple[str, int]] = set()
        # Topic, log time, publication, sequence; every recorder's own first word is in its record.
        self.record = [(BEAT, self.now_ns, self.now_ns, 1)]
        self.losses: list[Loss] = []
        self.book = GapBook("recorder", OWN, self.now_ns)

    def publish(self, topic: str) -> None:
        envelope = self.publisher.publish(topic)
        self.published.add((topic, envelope.publish_ns))
        self.flying.append(envelope)

    def deliver(self) -> None:
        if self.flying:
            envelope = self.flying.pop(0)
            self.now_ns += 10
            self.offer(envelope._replace(arrival_ns=self.now_ns))

    def lose(self) -> None:
        if self.flying:
            self.flying.pop(0)

    def offer(self, envelope: Envelope) -> None:
        log_ns = self.book.offer(envelope, NONE)
        if log_ns is not None:
            self.record.append((envelope.topic, log_ns, envelope.publish_ns, envelope.sequence))

    def ask(self, arrives: bool = True) -> bool:
        """One round of questions; their answers may be lost. Whether there were any."""
        requests = self.book.requests(self.now_ns, at_once=True)
        for session, request in requests:
            if session == self.publisher.session and arrives:
                self.answer(request)
        return bool(requests)

    def sweep(self) -> None:
        self.now_ns += 2 * S
        self.answer(self.book.sweep("tram/v/**", self.now_ns))

    def answer(self, request: ResendRequest) -> None:
        data = self.publisher.history.answer(request.SerializeToString())
        if data is None:
            return
        answer = ResendAnswer.FromString(data)
        for stretch in answer.stretches:
            for message in stretch.messages:
                self.offer(
                    Envelope(
                        stretch.topic,
                        message.payload,
                        message.encoding,
                        message.publish_ns,
                        message.sequence,
                        answer.session,
                        message.publish_ns,
                    )
                )
            self.losses += self.book.settle(answer.session, stretch)

    def restart_recorder(self) -> None:
        """Killed and started again: what was on its way is gone, only the record is known."""
        self.flying.clear()
        self.now_ns += 1000
        self.book = GapBook("recorder", OWN, self.now_ns)
        self.book.remember(summarise(self.entries(), self.now_ns - 30 * S, "recorder"))

    def entries(self) -> Iterable[Entry]:
        entries = [
            Entry(topic, b"", log_ns, publish_ns, sequence, 1)
            for topic, log_ns, publish_ns, sequence in self.record
        ]
        entries += [
            Entry(LOSSES, loss.SerializeToString(), self.now_ns, self.now_ns, number, 1)
            for number, loss in enumerate(self.losses, 1)
        ]
        return iter(sorted(entries, key=lambda entry: (entry.log_ns, entry.sequence)))

    def end(self) -> None:
        """A last message on every topic, then ask until nothing is open."""
        self.flying.clear()
        for topic in TOPICS:
            self.publish(topic)
        while self.flying:
            self.deliver()
        for _ in range(100):
            if not self.ask():
                break
        else:
            raise AssertionError("questions without end")
        self.losses += self.book.give_up(self.now_ns, at_once=True)

    def check(self) -> None:
        recorded = [(topic, publish_ns) for topic, _, publish_ns, _ in self.record]
        assert len(recorded) == len(set(recorded)), "recorded twice"
        missing = Counter(topic for topic, _ in self.published - set(recorded))
        named: Counter[str] = Counter()
        for loss in self.losses:
            named[loss.key] += loss.count
            inside = [
                publish_ns
                for topic, publish_ns in self.published - set(recorded)
                if topic == loss.key and loss.after_publish_ns < publish_ns < loss.before_publish_ns
            ]
            assert len(inside) == loss.count, "a loss names what it does not hold"
        assert named == missing
        for topic in TOPICS:
            rows = sorted(
                (log_ns, sequence, publish_ns)
                for name, log_ns, publish_ns, sequence in self.record
                if name == topic
            )
            times = [publish_ns for _, _, publish_ns in rows]
            assert times == sorted(times), "the record does not sort as it was published"


STEPS = ("publish 0", "publish 1", "deliver", "lose", "ask", "ask in vain", "sweep", "restart")


@settings(deadline=None, max_examples=400)
@example(
    # The answer to the sweep fills the gap in the record before.
    ["publish 0"] * 3 + ["deliver", "lose", "deliver", "restart", "sweep"],
    700,
)
@example(
    # Its publisher has forgotten part of that gap, and the rest is told once.
    ["publish 0"] * 8 + ["deliver", "lose", "deliver", "restart", "sweep"],
    1500,
)
@given(st.lists(st.sampled_from(STEPS), max_size=70), st.sampled_from([700, 1500, 100_000]))
def test_every_message_is_recorded_once_or_named_lost(steps: list[str], limit_bytes: int) -> None:
    world = World(limit_bytes)
    for step in steps:
        match step.split():
            case ["publish", index]:
                world.publish(TOPICS[int(index)])
            case ["deliver"]:
                world.deliver()
            case ["lose"]:
                world.lose()
            case ["ask", *vain]:
                world.ask(arrives=not vain)
            case ["sweep"]:
                world.sweep()
            case ["restart"]:
                world.restart_recorder()
    world.end()
    world.check()
    if limit_bytes == 100_000:
        assert world.losses == []


def test_gap_is_filled_and_sorts_in_its_place() -> None:
    world = World()
    for _ in range(10):
        world.publish(TOPICS[0])
    world.deliver()
    for _ in range(6):
        world.lose()
    while world.flying:
        world.deliver()
    assert world.book.holes == 1
    assert world.ask()
    world.check()
    rows = sorted(world.record[1:], key=lambda row: row[1])
    assert [row[3] for row in rows] == list(range(1, 11))


def test_lost_tail_that_no_later_message_shows_is_found_by_asking_everybody() -> None:
    world = World()
    world.publish(TOPICS[0])
    world.deliver()
    world.publish(TOPICS[0])
    world.publish(TOPICS[1])
    world.flying.clear()
    world.sweep()
    assert len(world.record) == 4
    world.check()


def test_end_is_asked_for_although_a_hole_is_open() -> None:
    """As of a publisher that ends: no later question will find what it sent last."""
    world = World()
    for _ in range(5):
        world.publish(TOPICS[0])
    world.deliver()
    world.lose()
    world.deliver()
    world.flying.clear()
    world.now_ns += 1000
    world.answer(world.book.sweep("tram/v/**", world.now_ns, all_of_it=True))
    assert world.ask()
    world.check()
    assert len(world.record) == 6


def test_restarted_recorder_gets_what_was_published_meanwhile() -> None:
    world = World()
    for _ in range(5):
        world.publish(TOPICS[0])
        world.deliver()
    world.restart_recorder()
    for _ in range(5):
        world.publish(TOPICS[0])
    world.flying.clear()
    world.publish(TOPICS[0])
    world.deliver()
    assert world.book.holes == 1
    world.end()
    world.check()
    assert world.losses == []


def test_what_a_restarted_recorder_cannot_have_is_named_with_its_cause() -> None:
    world = World(limit_bytes=600)
    for _ in range(5):
        world.publish(TOPICS[0])
        world.deliver()
    world.restart_recorder()
    for _ in range(50):
        world.publish(TOPICS[0])
    world.flying.clear()
    world.end()
    world.check()
    assert {loss.cause for loss in world.losses} == {Loss.ABSENT}
    assert world.book.total == sum(loss.count for loss in world.losses) > 40


def holed_record_of_a_publisher_that_is_gone() -> World:
    """A recorder dies with a hole, and its publisher with it."""
    world = World()
    for _ in range(6):
        world.publish(TOPICS[0])
    world.deliver()
    world.lose()
    world.lose()
    while world.flying:
        world.deliver()
    assert world.book.holes == 1
    world.restart_recorder()
    return world


def test_hole_that_nobody_living_can_fill_is_named() -> None:
    world = holed_record_of_a_publisher_that_is_gone()
    world.publisher = Publisher(2, world, 10_000)
    world.publish(TOPICS[0])
    world.deliver()
    assert world.book.give_up(world.now_ns) == []
    world.losses += world.book.give_up(world.now_ns + ORPHANED_NS + S)
    assert [(loss.cause, loss.count) for loss in world.losses] == [(Loss.ABSENT, 2)]
    world.check()
    assert world.book.give_up(world.now_ns, at_once=True) == []


def test_publisher_that_counts_on_for_a_dead_one_hides_nothing() -> None:
    """As the processors do, whose numbers are part of their memory."""
    world = holed_record_of_a_publisher_that_is_gone()
    for _ in range(3):
        world.publish(TOPICS[0])
    world.flying.clear()
    dead, world.publisher = world.publisher, Publisher(2, world, 10_000)
    world.publisher.sequences = dead.sequences
    world.publish(TOPICS[0])
    world.deliver()
    world.end()
    world.losses += world.book.give_up(world.now_ns + ORPHANED_NS + S)
    world.check()
    assert sum(loss.count for loss in world.losses) == 5


def test_new_ride_asks_for_nothing_old() -> None:
    world = World()
    for _ in range(5):
        world.publish(TOPICS[0])
        world.deliver()
    old = world.publisher
    world.restart_recorder()
    world.publisher = Publisher(2, world, 10_000)
    world.publish(TOPICS[0])
    world.deliver()
    assert world.book.holes == 0
    world.end()
    world.check()
    assert old.session != world.publisher.session


def test_fresh_recorder_beside_a_running_vehicle_asks_for_nothing_from_before() -> None:
    world = World()
    for _ in range(5):
        world.publish(TOPICS[0])
    world.flying.clear()
    world.published.clear()
    world.book = GapBook("recorder", OWN, world.now_ns)
    world.publish(TOPICS[0])
    world.deliver()
    world.end()
    world.check()
    assert len(world.record) == 4
    assert world.losses == []


def test_unanswered_hole_is_given_up_and_named_after_a_few_seconds() -> None:
    world = World()
    for _ in range(4):
        world.publish(TOPICS[0])
    world.deliver()
    world.lose()
    world.lose()
    world.deliver()
    begin_ns = world.now_ns
    while not world.losses:
        assert world.now_ns - begin_ns < 60 * S
        world.now_ns += S // 10
        world.book.requests(world.now_ns)
        world.publish(TOPICS[1])
        world.deliver()
        world.losses += world.book.give_up(world.now_ns)
    assert sum(AGAIN_NS) <= world.now_ns - begin_ns < sum(AGAIN_NS) + 3 * S
    assert [loss.count for loss in world.losses] == [2]


def test_silence_of_the_bus_is_not_held_against_the_publisher() -> None:
    world = World()
    for _ in range(3):
        world.publish(TOPICS[0])
    world.deliver()
    world.lose()
    world.deliver()
    for _ in range(1000):
        world.now_ns += S // 10
        world.book.requests(world.now_ns)
        assert world.book.give_up(world.now_ns) == []
    assert world.ask()
    world.check()


def test_drops_of_the_own_queue_are_named_as_such_when_they_are_gone() -> None:
    world = World(limit_bytes=100_000)
    envelopes = [world.publisher.publish(TOPICS[0]) for _ in range(7)]
    world.book.offer(envelopes[0], NONE)
    world.book.offer(envelopes[6], Counter({TOPICS[0]: 3}))
    losses = world.book.give_up(world.now_ns, at_once=True)
    assert [(loss.cause, loss.count) for loss in losses] == [(Loss.QUEUE, 3), (Loss.BUS, 2)]


def test_strangers_without_a_header_are_recorded_as_they_come() -> None:
    book = GapBook("recorder", OWN, 0)
    stranger = Envelope("x", b"", "", 5, 0, 0, 6)
    assert [book.offer(stranger, NONE), book.offer(stranger, NONE)] == [6, 6]
    assert book.holes == 0


def test_publishers_that_come_and_go_are_not_remembered_for_ever() -> None:
    book = GapBook("recorder", OWN, 0)
    for session in range(1, 200):
        now_ns = session * 10 * S
        book.offer(Envelope("x", b"", "", now_ns, 1, session, now_ns), NONE)
        request = book.sweep("**", now_ns)
    assert len(request.stretches) < 20
