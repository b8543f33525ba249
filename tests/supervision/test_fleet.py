"""An orderly stop alone ends a vehicle."""

from __future__ import annotations

import threading
from typing import Any

from scripted import VEHICLE, Ear, ManualClock

from tramstream import keys
from tramstream.events.messages import facts_of
from tramstream.supervision import vehicle
from tramstream.supervision.events import NODE_ENDED
from tramstream.supervision.voice import Voice
from tramstream.transport.bus import LocalBus


class Turns(threading.Event):
    """A stop event that lets the loop turn so often, without waiting."""

    def __init__(self, turns: int) -> None:
        super().__init__()
        self._left = turns

    def wait(self, timeout: float | None = None) -> bool:
        self._left -= 1
        if self._left <= 0:
            self.set()
        return self.is_set()


class Failing:
    """Supervisor and voice with a bug each."""

    def __init__(self) -> None:
        self.turns = 0
        self.lost = 0

    def end_at(self, ends_s: float) -> None:
        pass

    def watch(self) -> None:
        self.turns += 1
        raise RuntimeError("a bug in the watch")

    def speak(self) -> None:
        self.turns += 1
        raise ValueError("a bug in the voice")


def test_bugs_in_voice_watch_and_screen_are_told_and_end_nothing() -> None:
    failing: Any = Failing()
    said: list[str] = []
    running = vehicle.Fleet(LocalBus(ManualClock()), failing, failing, said.append)
    screens = []

    def screen() -> None:
        screens.append(1)
        raise KeyError("a bug in the screen")

    running.until(Turns(50), each=screen)
    assert failing.turns == 100
    assert len(screens) == 50
    assert len(said) == 1  # with its trace, once in a while
    assert "ValueError: a bug in the voice" in said[0]
    assert "Traceback" in said[0]


def test_what_the_supervisor_does_is_said_once_and_stands_on_the_bus() -> None:
    bus, said, ended = LocalBus(ManualClock()), [], NODE_ENDED(node="imu", status=-9, again_s=0.2)
    ear = Ear(bus)
    voice = Voice(bus, VEHICLE, said.append, Failing(), lambda: 0.0)  # type: ignore[arg-type]
    teller = vehicle.Teller(VEHICLE, said.append)
    teller.tell(ended)  # there is no bus yet
    teller.bus = bus
    teller.tell(ended)
    voice.speak()
    assert said == [str(ended)] * 2
    (event,) = ear.heard(keys.EVENT.at("supervisor"))
    (log,) = ear.heard(keys.LOG.at("supervisor"))
    assert (event.kind, facts_of(event)) == (ended.kind.name, ended.facts)
    assert (log.message, log.line) == (str(ended), event.sequence)
    assert log.timestamp.ToNanoseconds() == event.stamp_ns > 0
