"""Reprocessing: the processors over a record, with no bus and no clock.

A live run leaves its order in the record. Ticks say how far every input had been read when they
were made, snapshots what the processors remembered; samples that came after the horizon, and
messages that the processors' process never got, are named. Between two ticks the processors do not
care about the order (see `Processor.pacing`), so feeding what belongs to each tick, then the tick,
repeats the ride bit for bit: from the start of a session, or from the first snapshot in a part of
a longer record.

A record without ticks (imported, or made without processors) gets them from its log times.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from tramstream import keys, snapshots
from tramstream.clock import S
from tramstream.errors import RecordError
from tramstream.keys import Key
from tramstream.processor import Processor, Sample
from tramstream.proto.health_pb2 import Loss
from tramstream.proto.sync_pb2 import LateSample, Position, Snapshot, Tick
from tramstream.recorder.reader import Entry, Record

SETTLE_NS = 2 * S
"""A message that reaches the recorder so much later than a tick that counts it is lost."""
SYNTHETIC_TICK_NS = S // 10
EARLY_NS = S
"""How far ahead of the horizon measurements are fed where no tick says what the live run had."""
RECORDER = "recorder"


class Made(NamedTuple):
    """One output sample, encoded, and the log time of what it followed from."""

    key: Key
    payload: bytes
    log_ns: int
    sample: Sample
    session: int
    """Index of the repeated session."""


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
    """Per key path: publication times (exclusive) of what the live processors never got."""
    recorder_lost: dict[str, int] = field(default_factory=dict)

    @property
    def anchored(self) -> bool:
        return bool(self.sessions)


def read_plan(record: Record, consumers: Collection[str]) -> Plan:
    """Collect snapshots, late samples and losses; `consumers` are the nodes that run processors."""
    plan = Plan()
    controls = {
        keys.SYNC_SNAPSHOT.path,
        keys.SYNC_LATE.path,
        *(keys.LOSS.at(node).path for node in (RECORDER, *consumers)),
    }
    for entry in record.messages(lambda topic: keys.split(topic)[1] in controls):
        path = keys.split(entry.topic)[1]
        if path == keys.SYNC_SNAPSHOT.path:
            _see_snapshot(plan, Snapshot.FromString(entry.payload), entry.publish_ns)
        elif path == keys.SYNC_LATE.path:
            late = LateSample.FromString(entry.payload)
            if late.source_publish_ns:
                plan.late[late.key, late.source_publish_ns] = late
        else:
            _see_loss(plan, Loss.FromString(entry.payload))
    return plan


def _see_snapshot(plan: Plan, snapshot: Snapshot, publish_ns: int) -> None:
    if any(known.snapshot.session == snapshot.session for known in plan.sessions):
        return
    plan.sessions.append(Session(snapshot, publish_ns))


def _see_loss(plan: Plan, loss: Loss) -> None:
    path = keys.split(loss.key)[1]
    if loss.consumer != RECORDER:
        plan.skip.setdefault(path, []).append((loss.after_publish_ns, loss.before_publish_ns))
    else:
        plan.recorder_lost[path] = plan.recorder_lost.get(path, 0) + loss.count


class Reprocessor:
    """Runs processors over a record as the live run did.

    Parameters
    ----------
    record : Record
    processors : list of Processor
        Fresh ones.
    plan : Plan
        From `read_plan`; an empty one makes the ticks from the log times.
    expect : callable
        Gets every recorded output (session index, key path, entry) of the repeated sessions.
    """

    def __init__(
        self,
        record: Record,
        processors: list[Processor],
        plan: Plan,
        expect: Callable[[int, str, Entry], None] | None = None,
    ) -> None:
        self._record = record
        self._processors = processors
        self._plan = plan
        self._expect = expect
        made = {key.path for processor in processors for key in processor.outputs}
        wanted = {key.path for processor in processors for key in processor.inputs} - made
        self._inputs = wanted - {keys.SYNC_TICK.path}
        self._outputs = made
        self._pacing = {key.path for processor in processors for key in processor.pacing}
        self._consumers: dict[str, list[Processor]] = {}
        for processor in processors:
            for key in processor.inputs:
                self._consumers.setdefault(key.path, []).append(processor)
        self._keys: dict[str, Key | None] = {}  # by topic
        self._queues: dict[str, deque[tuple[Entry, Key]]] = {path: deque() for path in wanted}
        self._read_to: dict[str, int] = {}  # newest publish_ns read, per path
        self._fed: dict[str, int] = {}
        self._log_ns = 0
        self._session = 0
        self.missing: dict[str, int] = {}
        """Per key path: inputs that the live processors had and the record does not."""

    def run(self) -> Iterator[Made]:
        """Yield the outputs in the order in which they follow from the inputs."""
        if self._plan.anchored:
            yield from self._run_sessions()
        else:
            yield from self._run_free()

    # Reading -------------------------------------------------------------------------------------
    def _entries(self, control: str) -> Iterator[tuple[str, Entry, Key]]:
        wanted = self._inputs | {control} | (self._outputs if self._expect is not None else set())
        table = self._keys

        def match(topic: str) -> bool:
            path = keys.split(topic)[1]
            if topic not in table:
                table[topic] = keys.find(path) if path in wanted else None
            return table[topic] is not None

        for entry in self._record.messages(match):
            key = table[entry.topic]
            if key is not None:
                yield key.path, entry, key

    def _queue(self, path: str, entry: Entry, key: Key) -> None:
        self._read_to[path] = entry.publish_ns
        for after_ns, before_ns in self._plan.skip.get(path, ()):
            if after_ns < entry.publish_ns < before_ns:
                return
        self._queues[path].append((entry, key))

    # With ticks ----------------------------------------------------------------------------------
    def _run_sessions(self) -> Iterator[Made]:
        self._begin(0)
        ticks: deque[tuple[Tick, Entry]] = deque()
        for path, entry, key in self._entries(keys.SYNC_TICK.path):
            if path == keys.SYNC_TICK.path:
                ticks.append((Tick.FromString(entry.payload), entry))
            elif path in self._outputs:
                self._offer(path, entry)
            else:
                self._queue(path, entry, key)
            while ticks and self._complete(*ticks[0], entry.log_ns):
                yield from self._feed_tick(*ticks.popleft())
        for tick, entry in ticks:
            yield from self._feed_tick(tick, entry)
        yield from self._feed(lambda path, entry: True)

    def _begin(self, index: int) -> None:
        snapshot = self._plan.sessions[index].snapshot
        # With `run --separate` only the resampler's process makes snapshots; others begin fresh.
        if not snapshots.restore(snapshot, self._processors, some=True):
            recorded = ", ".join(state.name for state in snapshot.states)
            ours = ", ".join(processor.name for processor in self._processors)
            raise RecordError(
                f"the record's snapshot is of other processors ({recorded}) than ours ({ours}); "
                "use the version of tramstream that made it, or --fresh"
            )
        self._session = index
        self._snapshot = snapshot
        self._done = {position.key: position for position in snapshot.positions}
        self._fed = {}

    def _offer(self, path: str, entry: Entry) -> None:
        """Hand a recorded output of a repeated session to whoever compares."""
        starts = [session.publish_ns for session in self._plan.sessions]
        index = bisect_left(starts, entry.publish_ns) - 1
        if index >= 0 and self._expect is not None:
            self._expect(index, path, entry)

    def _complete(self, tick: Tick, entry: Entry, now_ns: int) -> bool:
        """Whether everything that the tick counts has been read from the record."""
        if now_ns - entry.log_ns > SETTLE_NS:
            return True
        return all(
            self._read_to.get(position.key, 0) >= position.last_publish_ns
            for position in tick.positions
            if position.key in self._queues
        )

    def _feed_tick(self, tick: Tick, entry: Entry) -> Iterator[Made]:
        for index in range(self._session + 1, len(self._plan.sessions)):
            if self._plan.sessions[index].snapshot.session == tick.session:
                self._begin(index)
        snapshot = self._snapshot
        if tick.session != snapshot.session or tick.sequence <= snapshot.tick_sequence:
            return
        last: dict[str, Position] = {position.key: position for position in tick.positions}
        for path, position in last.items():
            self._drop_unread(path, position)
        yield from self._feed(
            lambda path, entry: path in last and entry.publish_ns <= last[path].last_publish_ns
        )
        for path, position in last.items():
            self._count_missing(path, position)
        self._log_ns = max(self._log_ns, entry.log_ns)
        sample = Sample(keys.SYNC_TICK, tick, tick.stamp_ns, tick.sequence, entry.publish_ns)
        yield from self._dispatch(sample)

    def _drop_unread(self, path: str, position: Position) -> None:
        """Forget what this session never read, or had read before its snapshot."""
        queue = self._queues.get(path)
        if not queue or path in self._fed:
            return
        done_ns = self._done[path].last_publish_ns if path in self._done else 0
        first_ns = max(position.first_publish_ns, done_ns + 1)
        while queue and queue[0][0].publish_ns < first_ns:
            queue.popleft()

    def _count_missing(self, path: str, position: Position) -> None:
        before = self._done[path].count if path in self._done else 0
        short = position.count - before - self._fed.get(path, 0)
        if path in self._queues and short > 0:
            self.missing[path] = self.missing.get(path, 0) + short
            self._fed[path] = self._fed.get(path, 0) + short

    # Without ticks -------------------------------------------------------------------------------
    def _run_free(self) -> Iterator[Made]:
        """A tick every tenth of a second of log time, one second behind what has been read."""
        next_ns = 0
        sequence = 0
        for path, entry, key in self._entries(keys.SYNC_TICK.path):
            if path not in self._queues or path == keys.SYNC_TICK.path:
                continue
            if next_ns == 0:
                next_ns = entry.log_ns + SYNTHETIC_TICK_NS
            self._queue(path, entry, key)
            while entry.log_ns > next_ns + EARLY_NS:
                sequence += 1
                yield from self._feed_until(next_ns, sequence)
                next_ns += SYNTHETIC_TICK_NS
        while any(self._queues.values()):
            sequence += 1
            yield from self._feed_until(next_ns, sequence)
            next_ns += SYNTHETIC_TICK_NS

    def _feed_until(self, log_ns: int, sequence: int) -> Iterator[Made]:
        # What does not pace may be fed early: then nothing is late.
        yield from self._feed(
            lambda path, entry: (
                entry.log_ns <= (log_ns if path in self._pacing else log_ns + EARLY_NS)
            )
        )
        self._log_ns = max(self._log_ns, log_ns)
        tick = Tick(stamp_ns=log_ns, sequence=sequence)
        yield from self._dispatch(Sample(keys.SYNC_TICK, tick, log_ns, sequence))

    # Stepping ------------------------------------------------------------------------------------
    def _feed(self, due: Callable[[str, Entry], bool]) -> Iterator[Made]:
        """Step what is due: first what may come early, then what moves the horizon on."""
        batch: list[tuple[bool, int, int, int, Entry, Key]] = []
        for path, queue in self._queues.items():
            paces = path in self._pacing
            while queue and due(path, queue[0][0]):
                entry, key = queue.popleft()
                batch.append((paces, entry.log_ns, entry.channel_id, entry.sequence, entry, key))
                self._fed[path] = self._fed.get(path, 0) + 1
        batch.sort(key=lambda item: item[:4])
        for *_, entry, key in batch:
            message: Any = key.type.FromString(entry.payload)
            self._log_ns = max(self._log_ns, entry.log_ns)
            yield from self._dispatch(
                Sample(key, message, message.stamp_ns, message.sequence, entry.publish_ns)
            )

    def _dispatch(self, sample: Sample) -> Iterator[Made]:
        work = deque([sample])
        while work:
            current = work.popleft()
            for processor in self._consumers.get(current.key.path, ()):
                for result in processor.step(current):
                    payload = result.message.SerializeToString()
                    yield Made(result.key, payload, self._log_ns, result, self._session)
                    work.append(result)
