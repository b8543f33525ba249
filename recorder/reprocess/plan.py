"""What a record tells about the live run of its processors: sessions, late samples, losses."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import accumulate

from tramstream import keys
from tramstream.live import snapshots
from tramstream.processor import Processor
from tramstream.proto.health_pb2 import Loss
from tramstream.proto.sync_pb2 import LateSample, Snapshot
from tramstream.recorder.reader import Record

RECORDER = "recorder"


@dataclass
class Session:
    """One start of the live processors, as far as it is in the record."""

    snapshot: Snapshot
    publish_ns: int
    """When the snapshot was published: outputs published later are repeated."""


@dataclass
class Plan:
    """What the record tells about the live run."""

    sessions: list[Session] = field(default_factory=list)
    late: dict[tuple[str, int], LateSample] = field(default_factory=dict)
    skip: dict[str, list[tuple[int, int]]] = field(default_factory=dict)
    """Per key path: publication times (exclusive) of what the live processors never got or used."""
    recorder_lost: dict[str, int] = field(default_factory=dict)
    read: set[str] = field(default_factory=set)
    """Paths of the keys that the live processors read, as snapshots tell."""
    settings: frozenset[str] | None = None
    """Digests of the settings that the processors have now; None: nobody looks at them."""
    unfit: set[int] = field(default_factory=set)
    """Sessions whose memory is of other processors than ours, or of another version of them."""

    def remembers(self, snapshot: Snapshot) -> bool:
        """Whether the memory in `snapshot` is of the processors and settings of now."""
        return self._settings_fit(snapshot) and snapshot.session not in self.unfit

    def see_what_fits(self, processors: Sequence[Processor]) -> None:
        """Try the memory of each session on `processors`, which keep their own."""
        for snapshot in (session.snapshot for session in self.sessions):
            asked = self._settings_fit(snapshot) and not is_fresh(snapshot)
            if asked and not snapshots.fits(snapshot, processors):
                self.unfit.add(snapshot.session)

    def _settings_fit(self, snapshot: Snapshot) -> bool:
        made_with = snapshot.configuration
        return self.settings is None or not made_with or made_with in self.settings

    @property
    def forgotten(self) -> int:
        """Sessions that begin with memory of other settings, which is left out."""
        return sum(
            not self._settings_fit(session.snapshot) and not is_fresh(session.snapshot)
            for session in self.sessions
        )

    @property
    def anchored(self) -> bool:
        return bool(self.sessions)


def is_fresh(snapshot: Snapshot) -> bool:
    """Whether a snapshot is the beginning of a ride: there is nothing to remember in it."""
    return snapshot.start and snapshot.tick_sequence == 0


class Spans:
    """Open intervals, asked whether an instant lies in one of them."""

    def __init__(self, spans: Iterable[tuple[int, int]]) -> None:
        ordered = sorted(spans)
        self._after_ns = [after_ns for after_ns, _ in ordered]
        # The furthest end so far: intervals may overlap.
        self._before_ns = list(accumulate((before_ns for _, before_ns in ordered), max))

    def __contains__(self, stamp_ns: int) -> bool:
        index = bisect_left(self._after_ns, stamp_ns) - 1
        return index >= 0 and stamp_ns < self._before_ns[index]


def read_plan(record: Record, consumers: Collection[str]) -> Plan:
    """Collect snapshots, late samples and losses; `consumers` are the nodes that run processors."""
    plan = Plan()
    controls = {
        keys.SYNC_SNAPSHOT.path,
        keys.SYNC_LATE.path,
        *(keys.LOSS.at(node).path for node in (RECORDER, *consumers)),
    }
    for entry, message in record.decoded(lambda topic: keys.split(topic)[1] in controls):
        if isinstance(message, Snapshot):
            _see_snapshot(plan, message, entry.publish_ns)
        elif isinstance(message, LateSample):
            if message.source_publish_ns:
                plan.late[message.key, message.source_publish_ns] = message
        elif isinstance(message, Loss):
            _see_loss(plan, message)
    return plan


def _see_snapshot(plan: Plan, snapshot: Snapshot, publish_ns: int) -> None:
    plan.read.update(position.key for position in snapshot.positions)
    if any(known.snapshot.session == snapshot.session for known in plan.sessions):
        return
    plan.sessions.append(Session(snapshot, publish_ns))


def _see_loss(plan: Plan, loss: Loss) -> None:
    path = keys.split(loss.key)[1]
    if loss.consumer != RECORDER:
        plan.skip.setdefault(path, []).append((loss.after_publish_ns, loss.before_publish_ns))
    else:
        plan.recorder_lost[path] = plan.recorder_lost.get(path, 0) + loss.count
