"""The one loop, on a bus within the process and a clock that stands still."""

from __future__ import annotations

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from scripted import START_NS, VEHICLE, Ear, ManualClock, Script, Sender

from tramstream import keys
from tramstream.clock import S
from tramstream.events import define
from tramstream.events.repeats import AGAIN_NS
from tramstream.live.node import Node
from tramstream.processor import Ledger
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.health_pb2 import Loss, NodeHealth
from tramstream.transport.bus import Envelope, LocalBus
from tramstream.transport.ring import Ring


class Listener(Node):
    """Remembers the sequence numbers of fixes; number 13 is one too many for it."""

    def __init__(self, bus: LocalBus, script: Script) -> None:
        super().__init__("listener", VEHICLE, bus, script)
        self.heard: list[int] = []
        self.told: list[str] = []

    def expressions(self) -> list[str]:
        return [keys.GNSS_FIX.path]

    def handle(self, envelope: Envelope) -> None:
        if envelope.sequence == 13:
            raise ValueError("thirteen")
        self.heard.append(envelope.sequence)

    def begin(self) -> None:
        self.told.append("begin")

    def finish(self) -> None:
        self.told.append("finish")

    def ledgers(self) -> list[Ledger]:
        return [Ledger("ears", "fixes", len(self.heard), len(self.heard))]


class World:
    """A bus with a sender, an ear and a clock."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.bus = LocalBus(self.clock)
        self.sender = Sender(self.bus)
        self.ear = Ear(self.bus)

    def send(self, skip: int = 0) -> None:
        self.sender.send(keys.GNSS_FIX, GnssFix(), skip)

    def run(self, *steps) -> Listener:
        listener = Listener(self.bus, Script(*steps))
        listener.run()
        return listener

    def health(self) -> list[NodeHealth]:
        return self.ear.heard(keys.HEARTBEAT)


@pytest.fixture
def world() -> World:
    return World()


def test_messages_are_handled_in_order_between_begin_and_finish(world: World) -> None:
    listener = world.run(*[world.send] * 5)
    assert listener.heard == [1, 2, 3, 4, 5]
    assert listener.told == ["begin", "finish"]


def test_what_is_queued_at_the_stop_is_still_handled(world: World) -> None:
    def many() -> None:
        for _ in range(12):
            world.send()

    assert world.run(many).heard == list(range(1, 13))


def test_node_is_alive_on_the_bus_from_its_start(world: World) -> None:
    alive: list[str] = []
    world.run(lambda: alive.extend(world.bus.alive(keys.alive("*", "*"))) or world.send())
    assert alive == [keys.alive(VEHICLE, "listener")]


def test_ledger_in_the_heartbeat_balances(world: World) -> None:
    world.run(*[world.send] * 5)
    for health in world.health():
        assert [stage.stage for stage in health.stages] == ["queue", "ears"]
        for stage in health.stages:
            assert stage.received == stage.delivered + stage.dropped + stage.pending
    last = world.health()[-1]
    assert last.stages[0].delivered == last.stages[1].delivered == 5
    assert (last.state, last.text, last.messages_lost) == (NodeHealth.OK, "", 0)


def test_overflow_of_the_queue_is_counted_published_and_blamed_on_the_queue(
    world: World,
) -> None:
    def flood() -> None:
        for _ in range(30):
            world.send()

    listener = Listener(world.bus, Script(world.send, flood))
    listener.ring = Ring(10)
    listener.run()
    assert listener.heard == [1, *range(22, 32)]
    (loss,) = world.ear.heard(keys.LOSS)
    assert (loss.count, loss.cause, loss.key) == (20, Loss.QUEUE, keys.GNSS_FIX.on(VEHICLE))
    queue = world.health()[-1].stages[0]
    assert (queue.received, queue.delivered, queue.dropped, queue.pending) == (31, 11, 20, 0)
    assert world.health()[-1].messages_lost == 20


def test_loss_on_the_bus_is_published_with_its_place(world: World) -> None:
    world.run(world.send, lambda: world.send(skip=4), world.send)
    (loss,) = world.ear.heard(keys.LOSS)
    assert (loss.count, loss.cause, loss.consumer) == (4, Loss.BUS, "listener")
    fixes = [e for e in world.ear.envelopes if e.topic == keys.GNSS_FIX.on(VEHICLE)]
    assert loss.after_publish_ns == fixes[0].publish_ns
    assert loss.before_publish_ns == fixes[1].publish_ns


def test_stage_that_raises_is_told_in_health_and_the_loop_goes_on(world: World) -> None:
    listener = world.run(*[world.send] * 15)
    assert listener.heard == [number for number in range(1, 16) if number != 13]
    (log,) = world.ear.heard(keys.LOG)
    assert log.level == Log.ERROR
    assert "ValueError: thirteen" in log.message
    assert "in handle" in log.message
    last = world.health()[-1]
    assert (last.state, last.faults) == (NodeHealth.DEGRADED, 1)
    assert "thirteen" in last.text
    assert last.stages[0].delivered == 15


def test_fault_that_repeats_is_counted_each_time_and_told_now_and_then(world: World) -> None:
    def fault() -> None:
        raise KeyError("again")

    def every_tenth_of_a_second() -> None:
        world.clock.advance(0.1)

    listener = Listener(world.bus, Script(*[every_tenth_of_a_second] * 250))
    listener.every(0.1, fault)
    listener.run()
    assert listener.faults == 250
    assert len(world.ear.heard(keys.LOG)) == 1 + int(25 * S / AGAIN_NS)


def test_event_takes_names_that_are_no_text(world: World) -> None:
    gone = define("test.gone", "{device} is gone", device=str)(device="\udcff")
    listener = Listener(world.bus, Script())
    listener.tell(gone)
    listener.troubles = [gone]
    listener.run()
    assert world.ear.heard(keys.LOG)[0].message == "\\udcff is gone"
    assert world.health()[-1].state == NodeHealth.DEGRADED


def test_timers_run_by_the_vehicle_clock_and_skip_what_they_missed(world: World) -> None:
    ran: list[float] = []
    steps = [lambda dt_s=dt_s: world.clock.advance(dt_s) for dt_s in (0.5, 0.5, 0.5, 3.2, 0.3, 0.5)]
    listener = Listener(world.bus, Script(*steps))
    listener.every(0.5, lambda: ran.append((world.clock.now_ns() - START_NS) / S))
    listener.run()
    assert ran == [0.5, 1.0, 1.5, 4.7, 5.0, 5.5]


def test_timer_that_raises_neither_ends_the_loop_nor_the_timer(world: World) -> None:
    listener = Listener(world.bus, Script(*[lambda: world.clock.advance(1.0)] * 3))
    listener.every(1.0, lambda: 1 / 0)
    listener.run()
    assert listener.faults == 3
    assert "ZeroDivisionError" in world.ear.heard(keys.LOG)[0].message


def test_heart_beats_once_a_second_and_at_both_ends(world: World) -> None:
    world.run(*[lambda: world.clock.advance(1.0)] * 5)
    assert len(world.health()) == 7
    assert [health.sequence for health in world.health()] == list(range(1, 8))


def test_finish_runs_when_begin_raises(world: World) -> None:
    listener = Listener(world.bus, Script())
    listener.begin = lambda: 1 / 0  # type: ignore[method-assign]
    with pytest.raises(ZeroDivisionError):
        listener.run()
    assert listener.told == ["finish"]


def test_item_that_no_node_asked_for_is_a_fault(world: World) -> None:
    listener = Listener(world.bus, Script(world.send))
    listener.ring.put("", object())
    listener.run()
    assert listener.faults == 1
    assert listener.heard == [1]
