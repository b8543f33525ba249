"""What is remembered of one wheel of the model `tram`, and of the pair."""

from __future__ import annotations

from dataclasses import dataclass, field

CUSUM_SLACK = 0.75
CUSUM_LIMIT = 10.0
"""Page's test (CUSUM): normalised innovations are added up, less the slack each, and a sum above
the limit is a slip. White ones come so far once a day; a mean of 1.5 deviations is seen in a
quarter of a second (docs/theory.md, section 7.5)."""


@dataclass
class Wheel:
    """What is remembered of one wheel."""

    slot: int
    pulses: int | None = None
    stamp_ns: int = 0
    slipping: bool = False
    slip_ns: int = 0  # since when
    agrees_since_ns: int = 0  # since when it agrees again; later than now while it is excluded
    agreed_path_m: float = 0.0  # way since then
    speed_mps: float = 0.0  # smoothed, while it slips
    refused: bool = False  # its last reading
    cusum_up: float = 0.0  # upper and lower sum of Page's test on its normalised innovations
    cusum_down: float = 0.0
    signed: bool = False  # has counted down
    down: int = 0  # readings in a row in which it has

    @property
    def cusum(self) -> float:
        """The greater sum of Page's test; the lower one counts negative."""
        return self.cusum_up if self.cusum_up > self.cusum_down else -self.cusum_down

    @property
    def fits(self) -> bool:
        """Whether neither the innovation gate nor Page's test tells of a slip."""
        return not (self.refused or self.cusum_up > CUSUM_LIMIT or self.cusum_down > CUSUM_LIMIT)


@dataclass
class PairMemory:
    """What a `WheelPair` remembers."""

    wheels: dict[str, Wheel] = field(default_factory=dict)
    slips: int = 0
    backed_ns: int = 0
    """When the receiver last measured the filter's speed."""
