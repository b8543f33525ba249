"""Everything that a vehicle publishes, counted as it comes; for `top` and the live page."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tramstream import keys
from tramstream.monitor.board import Board, board
from tramstream.monitor.stats import Stats
from tramstream.transport.bus import Bus, Envelope
from tramstream.transport.descriptions import Decoder
from tramstream.transport.ring import Ring

WINDOW_S = 5.0
RING_CAPACITY = 16384


class Watch:
    """What `vehicle` publishes, from now on.

    Parameters
    ----------
    bus : Bus
    vehicle : str
    patterns : sequence of str
        Key expressions below `tram/<vehicle>/` that are listened to.
    each : callable, optional
        Gets each message when `update` counts it, in the order of arrival on its key.
    """

    def __init__(
        self,
        bus: Bus,
        vehicle: str,
        patterns: Sequence[str] = ("**",),
        each: Callable[[Envelope], None] | None = None,
    ) -> None:
        self.vehicle = vehicle
        self.stats = Stats(WINDOW_S)
        self.decode = Decoder(bus)
        self._bus = bus
        self._each = each
        self._ring: Ring[Envelope] = Ring(RING_CAPACITY)
        self._subscriptions = [
            bus.subscribe(keys.full(vehicle, each), lambda e: self._ring.put(e.topic, e))
            for each in patterns
        ]

    def update(self) -> int:
        """Count what has come; return the time now."""
        for _ in range(len(self._ring)):
            envelope = self._ring.get(0.0)
            if envelope is not None:
                self.stats.add(envelope)
                if self._each is not None:
                    self._each(envelope)
        return self._bus.clock.now_ns()

    def board(self) -> Board:
        """All rows, now."""
        now_ns = self.update()
        return board(self.stats, self.vehicle, now_ns, self.decode)

    def close(self) -> None:
        for each in self._subscriptions:
            each.close()
