"""Track geometry on its way into a localisation filter: used at a stated delay, or late.

What speaks of the instant t is used at the first frame at or after t + D (`ekf.track_delay_s`),
whether the matcher runs in the same process and says it at once, or in another and says it some
milliseconds later. What comes when that frame has gone by is late: not used, counted, and named on
`est/ekf/late`, so that reprocessing, where nothing is late, leaves it out as well.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter

from tramstream import keys
from tramstream.clock import S
from tramstream.processor import Ledger, Sample
from tramstream.proto.estimate_pb2 import TrackGeometry
from tramstream.proto.sync_pb2 import LateSample

MOST = 1000
"""So many wait at a time; ours are twenty."""
Late = Mapping[tuple[str, int], LateSample]
_STAMP = attrgetter("stamp_ns")


@dataclass
class DelayedMemory:
    """What is on its way."""

    waiting: list[TrackGeometry] = field(default_factory=list)
    """In the order of their stamps."""
    frame_ns: int = 0
    """Stamp of the last frame."""
    ledger: Ledger = field(default_factory=lambda: Ledger("ekf", "track geometries"))


class Delayed:
    """Geometry that waits for its frame.

    Parameters
    ----------
    delay_s : float
        D.
    memory : DelayedMemory or None
        Part of its owner's memory; one of its own by default.
    """

    def __init__(self, delay_s: float, memory: DelayedMemory | None = None) -> None:
        self.memory = DelayedMemory() if memory is None else memory
        self._delay_ns = int(delay_s * S)
        self._recorded: dict[tuple[int, int], LateSample] | None = None

    def repeat(self, late: Late | None) -> None:
        """Hold for late what was late in the live run, and nothing else; None: by the frames."""
        self._recorded = None
        if late is not None:
            own = (each for each in late.values() if each.key == keys.MAP_TRACK.path)
            self._recorded = {(each.stamp_ns, each.source_sequence): each for each in own}

    def take(self, sample: Sample) -> LateSample | None:
        """Take a geometry; gives what names it if it is late."""
        memory, recorded = self.memory, self._recorded
        memory.ledger.received += 1
        if recorded is not None:
            known = recorded.get((sample.stamp_ns, sample.sequence))
            if known is not None:
                memory.ledger.dropped += 1
                return known
        elif sample.stamp_ns + self._delay_ns <= memory.frame_ns or len(memory.waiting) >= MOST:
            memory.ledger.dropped += 1
            return LateSample(
                key=keys.MAP_TRACK.path,
                source_sequence=sample.sequence,
                source_publish_ns=sample.publish_ns,
                horizon_ns=memory.frame_ns,
            )
        insort(memory.waiting, sample.message, key=_STAMP)
        return None

    def due(self, frame_ns: int) -> list[TrackGeometry]:
        """Give those that are used at a frame, in the order of their stamps."""
        memory = self.memory
        memory.frame_ns, waiting = frame_ns, memory.waiting
        count, limit_ns = 0, frame_ns - self._delay_ns
        while count < len(waiting) and waiting[count].stamp_ns <= limit_ns:
            count += 1
        if not count:
            return []
        due = waiting[:count]
        del waiting[:count]
        memory.ledger.delivered += count
        return due

    @property
    def ledger(self) -> Ledger:
        """What became of all that came."""
        return replace(self.memory.ledger, pending=len(self.memory.waiting))
