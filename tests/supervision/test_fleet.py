"""An orderly stop alone ends a vehicle."""

from __future__ import annotations

import threading
from typing import Any

from scripted import ManualClock

from tramstream.supervision import vehicle
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
