"""Whether the recorder hears: asked before publishers end and take with them what they hold."""

from __future__ import annotations

import time
from collections.abc import Callable

from tramstream import keys
from tramstream.transport.bus import Bus

ASK_S = 2.5
ASKED = 3
"""It answers within milliseconds. Full links may drop a question, but not one after the other."""
PATIENCE_S = ASK_S * ASKED
"""The router may have given up on one that stands still: then questions come back at once."""
READY_S = 30.0
"""So long one that has just been started may need for the record of its predecessor."""
PAUSE_S = 0.05
TRIES, AGAIN_S = 20, 0.5
NOTHING = b""
"""To a question that no publisher asks the recorder answers at once."""


def hears(
    bus: Bus,
    vehicle: str,
    wait: Callable[[float], bool],
    patience_s: float = PATIENCE_S,
    now_s: Callable[[], float] = time.monotonic,
) -> bool:
    """Ask the recorder of `vehicle` whether it hears; blocks until it is known.

    `wait` is called between two questions, with the seconds to be waited; it says whether there is
    still one to be asked. A question to which nobody listens comes back at once: the recorder is
    not ready yet, or the router is away.
    """
    end_s = now_s() + patience_s
    asked = 0
    while asked < ASKED and now_s() < end_s:
        begin_s = now_s()
        if bus.ask(keys.farewell(vehicle), ASK_S, NOTHING):
            return True
        silent = now_s() - begin_s >= ASK_S / 2
        asked += silent
        if not wait(0.0 if silent else PAUSE_S):
            return False
    return False


def carries(bus: Bus, vehicle: str, wait: Callable[[float], bool]) -> bool:
    """Whether anybody of `vehicle` is on the bus.

    It is asked again for some seconds: the router closes a link that a frozen node has jammed, and
    it is opened anew.
    """
    for _ in range(TRIES):
        if bus.alive(keys.alive(vehicle, keys.ANY_SOURCE)):
            return True
        if not wait(AGAIN_S):
            break
    return False
