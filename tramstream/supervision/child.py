"""One node's process as its supervisor knows it, and when it is to be started again."""

from __future__ import annotations

from dataclasses import dataclass

from tramstream.live import router
from tramstream.supervision.process import Running

BACKOFF_FIRST_S = 0.2
BACKOFF_ROUTER_S = 0.0
"""Nobody hears anybody while the router is away: the first time it comes back at once."""
BACKOFF_MAX_S = 10.0
GOOD_RUN_S = 30.0
"""Who lived so long is started again at once."""


@dataclass
class Child:
    """One node's process; `running` is None while there is none."""

    name: str
    running: Running | None = None
    started_s: float = 0.0
    starts: int = 0
    backoff_s: float = BACKOFF_FIRST_S
    again_s: float = 0.0

    def __post_init__(self) -> None:
        self._trust()

    @property
    def lives(self) -> bool:
        """Whether its process is there."""
        return self.running is not None and not self.running.ended()

    def lived_until(self, now_s: float) -> None:
        """It runs: after a good run its next pause is the first again."""
        if now_s - self.started_s > GOOD_RUN_S:
            self._trust()

    def died(self, now_s: float) -> float:
        """It ended by itself; the pause after which it is to be started again, s."""
        pause_s = self.backoff_s
        self.again_s = now_s + pause_s
        self.backoff_s = min(max(2 * pause_s, BACKOFF_FIRST_S), BACKOFF_MAX_S)
        return pause_s

    def _trust(self) -> None:
        self.backoff_s = BACKOFF_ROUTER_S if self.name == router.NAME else BACKOFF_FIRST_S
