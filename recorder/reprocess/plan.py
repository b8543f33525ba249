"""What a record tells about the live run of its processors: sessions, late samples, losses."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

from tramstream import keys
from tramstream.live import snapshots
from tramstream.processor import Processor, Sample
from tramstream.proto.health_pb2 import Loss
from tramstream.proto.sync_pb2 import LateSample, Snapshot
from tramstream.recorder.reader import Record
from tramstream.recorder.reprocess.restarts import (
    Door,
    Spans,
    Start,
    find_lasts,
    find_lost,
    see_memory,
)

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
    """See `tramstream.processor.Ordering`."""
    skip: dict[str, list[tuple[int, int]]] = field(default_factory=dict)
    """Per key path: publication times (exclusive) of what the live processors never got or used."""
    recorder_lost: dict[str, int] = field(default_factory=dict)
    read: set[str] = field(default_factory=set)
    """Paths of the keys that the live processors read, as snapshots tell."""
    losses: dict[str, dict[str, list[tuple[int, int]]]] = field(default_factory=dict)
    """The same by the node that did not get it."""
    starts: dict[str, list[Start]] = field(default_factory=dict)
    """By processor: of the processes that it had of its own."""
    lost: dict[str, dict[str, set[int]]] = field(default_factory=dict)
    """By processor and path: numbers of what others made and it never got."""
    settings: frozenset[str] | None = None
    """Digests of the settings that the processors have now; None: nobody looks at them."""
    unfit: set[int] = field(default_factory=set)
    """Sessions whose memory is of other processors than ours, or of another version of them."""

    def remembers(self, snapshot: Snapshot) -> bool:
        """Whether the memory in `snapshot` is of the processors and settings of now."""
        return self._settings_fit(snapshot) and snapshot.session not in self.unfit

    def see_what_fits(self, processors: Sequence[Processor]) -> None:
        """Try the memory of each session on `processors`, which keep their own."""
        apart = [each for known in self.starts.values() for each in known]
        for snapshot in (
            *(each.snapshot for each in self.sessions if not is_fresh(each.snapshot)),
            *(each.memory for each in apart if each.memory is not None and not each.fresh),
        ):
            if self._settings_fit(snapshot) and not snapshots.fits(snapshot, processors):
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

    def step_of(self, processor: Processor) -> Callable[[Sample], list[Sample]]:
        """What steps a processor as its process did: see `Door`.

        With other settings, or in another version, there is nothing to repeat: then it takes all.
        """
        starts = self.starts.get(processor.name, [])
        if not all(each.fresh or self.remembers(each.memory) for each in starts if each.memory):
            return processor.step
        lost = self.lost.get(processor.name, {})
        return Door(processor, starts, lost).step if starts or lost else processor.step

    def settle(
        self, record: Record, processors: list[Processor], nodes: dict[str, list[str]]
    ) -> None:
        """Look up in the record what was made by whom and lost by whom.

        Parameters
        ----------
        processors : list of Processor
            Those that run again.
        nodes : dict
            Names of nodes, each with those of its processors.
        """
        made = {key.path: each.name for each in processors for key in each.outputs}
        own = {path: self.starts[name] for path, name in made.items() if name in self.starts}
        if own:
            find_lasts(record, own)
        for node, losses in self.losses.items():
            spans = {path: Spans(each) for path, each in losses.items() if path in made}
            lost = find_lost(record, spans) if spans else {}
            if lost:
                self.lost.update(dict.fromkeys(nodes.get(node, ()), lost))

    @property
    def anchored(self) -> bool:
        return bool(self.sessions)


def is_fresh(snapshot: Snapshot) -> bool:
    """Whether a snapshot is the beginning of a ride: there is nothing to remember in it."""
    return snapshot.start and snapshot.tick_sequence == 0


def read_plan(record: Record, consumers: Collection[str]) -> Plan:
    """Collect snapshots, late samples and losses; `consumers` are the nodes that run processors."""
    plan = Plan()
    memories = {keys.MEMORY.at(node).path for node in consumers}
    controls = {
        keys.SYNC_SNAPSHOT.path,
        *memories,
        *(keys.LOSS.at(node).path for node in (RECORDER, *consumers)),
    }
    wanted = {
        topic
        for topic, info in record.channels.items()
        if keys.split(topic)[1] in controls
        or (info.schema == LateSample.DESCRIPTOR.full_name and not keys.is_apart(topic))
    }
    for entry, message in record.decoded(wanted.__contains__):
        if isinstance(message, Snapshot) and keys.split(entry.topic)[1] in memories:
            see_memory(plan.starts, message, entry.publish_ns)
        elif isinstance(message, Snapshot):
            _see_snapshot(plan, message, entry.publish_ns)
        elif isinstance(message, LateSample):
            # What a processor made itself has no publication: it is known by its number.
            source = message.source_publish_ns or -message.source_sequence
            plan.late[message.key, source] = message
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
        span = loss.after_publish_ns, loss.before_publish_ns
        plan.skip.setdefault(path, []).append(span)
        plan.losses.setdefault(loss.consumer, {}).setdefault(path, []).append(span)
    else:
        plan.recorder_lost[path] = plan.recorder_lost.get(path, 0) + loss.count
