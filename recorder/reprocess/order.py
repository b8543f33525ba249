"""Reprocessing: the processors over a record, with no bus and no clock.

A live run leaves its order in the record. Ticks say how far every input had been read when they
were made, snapshots what the processors remembered; samples that came after the horizon, and
messages that the processors' process never got, are named. Between two ticks the processors do not
care about the order (see `Processor.pacing`), so feeding what belongs to each tick, then the tick,
repeats the ride bit for bit: from the start of a session, or from the first snapshot in a part of
a longer record.

A record without ticks (imported, or made without processors) gets them from its log times. Time
passes only where there are data: in a pause of more than a minute (a logger that was switched off,
a clock that was set by years) ticks end after ten seconds, and go on with what comes next.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, NamedTuple

from tramstream import boundary, keys
from tramstream.boundary import Undecodable
from tramstream.clock import S
from tramstream.graph import Graph
from tramstream.keys import Key
from tramstream.live import snapshots
from tramstream.processor import Processor, Sample
from tramstream.proto.sync_pb2 import Position, Snapshot, Tick
from tramstream.recorder.reader import PAUSE_NS, Entry, Record
from tramstream.recorder.reprocess.plan import Plan, is_fresh
from tramstream.recorder.reprocess.restarts import Spans

SETTLE_NS = 40 * S
"""A message that reaches the recorder so much later than a tick that counts it is lost. What waited
in the socket of a recorder that stood still comes that late, while what was had again stands at the
time of its publication: no longer ago than publishers keep (`transport.resend.SPAN_S`)."""
SYNTHETIC_TICK_NS = S // 10
EARLY_NS = S
"""How far ahead of the horizon measurements are fed where no tick says what the live run had."""
AFTER_NS = 10 * S
"""So much time passes after what came last before a pause: silence is noticed, horizons pass it."""
BEFORE_NS = 3 * S
"""So much before what comes first after one: it must not look as if it came from the future."""
_FOREVER_NS = 1 << 64
_ORDER = attrgetter("log_ns", "channel_id", "sequence")
_LOG_NS, _PUBLISH_NS = attrgetter("log_ns"), attrgetter("publish_ns")


Output = tuple[Sample, bytes]
"""What a processor made, and the same encoded."""
Take = Callable[[int, int, list[Output]], None]
"""Gets what followed from one input, in order: index of the repeated session, log time, outputs."""


class Shortfall(NamedTuple):
    """What a reprocessing run had to do without."""

    missing: dict[str, int]
    """Per key path: inputs that the live processors had and the record does not."""
    undecodable: dict[str, int]
    """Per topic: messages that cannot be decoded; live they were left out as well."""
    damaged: str = ""
    """What of the record is damaged, one sentence; empty if nothing is known to be."""
    paused_ns: int = 0
    """In which nothing came and no time passed, together."""


Expect = Callable[[int, str, int, bytes], None]
"""Gets one recorded output: index of the repeated session, key path, sequence, encoded message."""


@dataclass(slots=True)
class _Input:
    """One key that the processors read from the record."""

    key: Key
    paces: bool
    """Whether it moves a horizon on; what does not may be fed early."""
    lost: Spans
    """Publication times of what the live processors never got, or did not use."""
    queue: deque[Entry] = field(default_factory=deque)
    read_to_ns: int = 0
    """Newest publication read from the record."""
    fed: int = 0
    """In this session, what is missing in the record included."""

    def put(self, entry: Entry) -> None:
        self.read_to_ns = entry.publish_ns
        if entry.publish_ns not in self.lost:
            self.queue.append(entry)


class Reprocessor:
    """Runs processors over a record as the live run did.

    Parameters
    ----------
    record : Record
    processors : list of Processor
        Fresh ones.
    plan : Plan
        From `read_plan`; an empty one makes the ticks from the log times.
    take : callable
        Gets the outputs, in the order in which they follow from the inputs.
    others : collection of str
        Names of processors that run elsewhere: their memory in a snapshot is not looked at.
    """

    def __init__(
        self,
        record: Record,
        processors: list[Processor],
        plan: Plan,
        take: Take,
        others: Collection[str] = (),
    ) -> None:
        self._record = record
        self._memories = Memories(plan, processors, others)
        self._plan = plan
        self._take = take
        self._expect: Expect | None = None
        self._graph = Graph(processors, step_of=plan.step_of)
        self._compared = set(self._graph.outputs)
        pacing = {key.path for processor in processors for key in processor.pacing}
        self._inputs = {
            path: _Input(key, path in pacing, Spans(plan.skip.get(path, ())))
            for path, key in self._graph.inputs.items()
            if key is not keys.SYNC_TICK
        }
        self._topics: dict[str, _Input | str | None] = {}
        self._starts = [session.publish_ns for session in plan.sessions]
        self._read = set(plan.read)
        self._log_ns = 0
        self._session = 0
        self._paused_ns = 0
        self.missing: dict[str, int] = {}
        """Per key path: inputs that the live processors had and the record does not."""

    def compare(self, expect: Expect, others: Collection[str] = ()) -> None:
        """Hand recorded outputs of the repeated sessions to `expect`; of `others` (paths), too."""
        self._expect = expect
        self._compared.update(others)

    @property
    def shortfall(self) -> Shortfall:
        record = self._record
        return Shortfall(self.missing, record.undecodable, record.damaged, self._paused_ns)

    def run(self) -> None:
        """Read the record, step the processors, hand out what they make."""
        if self._plan.anchored:
            self._run_sessions()
        else:
            self._run_free()

    def _wanted(self, topic: str) -> bool:
        """Whether messages of `topic` are read; `_topics` then knows what they are."""
        if topic not in self._topics:
            path = keys.split(topic)[1]
            compared = self._expect is not None and path in self._compared
            control = compared or path == keys.SYNC_TICK.path
            self._topics[topic] = self._inputs.get(path) or (path if control else None)
        return self._topics[topic] is not None

    # With ticks ----------------------------------------------------------------------------------
    def _run_sessions(self) -> None:
        self._begin(0)
        ticks: deque[tuple[Tick, Entry]] = deque()
        topics = self._topics
        for entry in self._record.messages(self._wanted):
            known = topics[entry.topic]
            if isinstance(known, _Input):
                known.put(entry)
            elif known == keys.SYNC_TICK.path:
                tick = self._decoded(keys.SYNC_TICK, entry)
                if tick is not None:
                    ticks.append((tick, entry))
                while ticks and self._complete(*ticks[0], entry.log_ns):
                    self._feed_tick(*ticks.popleft())
            elif known is not None:
                self._offer(known, entry)
        for tick, entry in ticks:
            self._feed_tick(tick, entry)
        self._feed(_LOG_NS, dict.fromkeys(self._inputs, _FOREVER_NS))

    def _begin(self, index: int) -> None:
        snapshot = self._plan.sessions[index].snapshot
        self._memories.begin(snapshot)
        self._session = index
        self._snapshot = snapshot
        self._done = {position.key: position for position in snapshot.positions}
        for source in self._inputs.values():
            source.fed = 0

    def _offer(self, path: str, entry: Entry) -> None:
        """Hand a recorded output of a repeated session to whoever compares."""
        index = bisect_left(self._starts, entry.publish_ns) - 1
        if index >= 0 and self._expect is not None:
            self._expect(index, path, entry.sequence, entry.payload)

    def _complete(self, tick: Tick, entry: Entry, now_ns: int) -> bool:
        """Whether everything that the tick counts has been read from the record."""
        if now_ns - entry.log_ns > SETTLE_NS:
            return True
        return all(
            self._inputs[position.key].read_to_ns >= position.last_publish_ns
            for position in tick.positions
            if position.key in self._inputs
        )

    def _feed_tick(self, tick: Tick, entry: Entry) -> None:
        for index in range(self._session + 1, len(self._plan.sessions)):
            if self._plan.sessions[index].snapshot.session == tick.session:
                self._begin(index)
        snapshot = self._snapshot
        if tick.session != snapshot.session or tick.sequence <= snapshot.tick_sequence:
            return
        positions = [each for each in tick.positions if each.key in self._inputs]
        for position in positions:
            self._drop_unread(self._inputs[position.key], position)
        # What the live processors did not read, and these do, is fed as it was recorded.
        self._read.update(each.key for each in positions)
        unread = self._inputs.keys() - self._read
        self._feed(_LOG_NS, dict.fromkeys(unread, entry.log_ns))
        self._feed(_PUBLISH_NS, {each.key: each.last_publish_ns for each in positions})
        for position in positions:
            self._count_missing(self._inputs[position.key], position)
        self._log_ns = max(self._log_ns, entry.log_ns)
        self._dispatch(Sample(keys.SYNC_TICK, tick, tick.stamp_ns, tick.sequence, entry.publish_ns))

    def _drop_unread(self, source: _Input, position: Position) -> None:
        """Forget what this session never read, or had read before its snapshot."""
        if not source.queue or source.fed:
            return
        done = self._done.get(position.key)
        first_ns = max(position.first_publish_ns, done.last_publish_ns + 1 if done else 1)
        while source.queue and source.queue[0].publish_ns < first_ns:
            source.queue.popleft()

    def _count_missing(self, source: _Input, position: Position) -> None:
        done = self._done.get(position.key)
        short = position.count - (done.count if done else 0) - source.fed
        if short > 0:
            self.missing[position.key] = self.missing.get(position.key, 0) + short
            source.fed += short

    # Without ticks -------------------------------------------------------------------------------
    def _run_free(self) -> None:
        """A tick every tenth of a second of log time, one second behind what has been read."""
        next_ns = last_ns = 0
        sequence = 0
        for entry in self._record.messages(self._wanted):
            source = self._topics[entry.topic]
            if not isinstance(source, _Input):
                continue
            before_ns, last_ns = last_ns, entry.log_ns
            if next_ns == 0:
                next_ns = entry.log_ns + SYNTHETIC_TICK_NS
            elif last_ns - before_ns > PAUSE_NS:
                while next_ns <= before_ns + AFTER_NS:
                    sequence += 1
                    self._feed_until(next_ns, sequence)
                    next_ns += SYNTHETIC_TICK_NS
                self._paused_ns += last_ns - BEFORE_NS - next_ns
                next_ns = last_ns - BEFORE_NS
            source.put(entry)
            while entry.log_ns > next_ns + EARLY_NS:
                sequence += 1
                self._feed_until(next_ns, sequence)
                next_ns += SYNTHETIC_TICK_NS
        # The horizon lags: ticks go on until it has passed what came last.
        while last_ns and (
            next_ns <= last_ns + EARLY_NS or any(s.queue for s in self._inputs.values())
        ):
            sequence += 1
            self._feed_until(next_ns, sequence)
            next_ns += SYNTHETIC_TICK_NS

    def _feed_until(self, log_ns: int, sequence: int) -> None:
        # What does not pace may be fed early: then nothing is late.
        limits = {
            path: log_ns if source.paces else log_ns + EARLY_NS
            for path, source in self._inputs.items()
        }
        self._feed(_LOG_NS, limits)
        self._log_ns = max(self._log_ns, log_ns)
        tick = Tick(stamp_ns=log_ns, sequence=sequence)
        self._dispatch(Sample(keys.SYNC_TICK, tick, log_ns, sequence))

    # Stepping ------------------------------------------------------------------------------------
    def _feed(self, time_of: Callable[[Entry], int], limits: Mapping[str, int]) -> None:
        """Step what is due: first what may come early, then what moves the horizon on."""
        early: list[Entry] = []
        pacing: list[Entry] = []
        for path, limit_ns in limits.items():
            source = self._inputs[path]
            batch, queue = pacing if source.paces else early, source.queue
            while queue and time_of(queue[0]) <= limit_ns:
                batch.append(queue.popleft())
        for batch in (early, pacing):
            batch.sort(key=_ORDER)
            for entry in batch:
                known = self._topics[entry.topic]
                assert isinstance(known, _Input)
                key = known.key
                message = self._decoded(key, entry)
                if message is None:
                    continue
                known.fed += 1
                self._log_ns = max(self._log_ns, entry.log_ns)
                sample = Sample(key, message, message.stamp_ns, message.sequence, entry.publish_ns)
                self._dispatch(sample)

    def _decoded(self, key: Key, entry: Entry) -> Any:
        """The message of `entry`; None if it is none: the live processors left it out as well."""
        message = boundary.decode(key.type, entry.payload, key.path)
        if isinstance(message, Undecodable):
            self._record.decode(entry)  # counts it
            return None
        return message

    def _dispatch(self, sample: Sample) -> None:
        made = self._graph.step(sample)
        if made:
            self._take(self._session, self._log_ns, encoded(made))


def encoded(made: list[Sample]) -> list[Output]:
    """What processors made, each with its bytes."""
    return [(each, each.message.SerializeToString()) for each in made]


class Memories:
    """What processors remember when a session of the live ones begins.

    Processors with a process of their own are in no snapshot: they go on, as do those whose memory
    in the record is of no use here (`Plan.remembers`); see `restarts`.

    Parameters
    ----------
    plan : Plan
    processors : list of Processor
        Fresh ones.
    others : collection of str
        Names of processors that run elsewhere: their memory is not looked at.
    """

    def __init__(self, plan: Plan, processors: list[Processor], others: Collection[str]) -> None:
        self._plan, self._others = plan, others
        self._processors = [each for each in processors if each.name not in plan.starts]
        self._fresh = [processor.snapshot() for processor in self._processors]

    def begin(self, snapshot: Snapshot) -> None:
        """Put memory back as a session began with it."""
        if is_fresh(snapshot):  # whatever version of ours it is of
            for processor, state in zip(self._processors, self._fresh, strict=True):
                processor.restore(state)
        elif self._plan.remembers(snapshot):
            states = [state for state in snapshot.states if state.name not in self._others]
            fit = snapshots.restore(Snapshot(states=states), self._processors, some=True)
            assert fit  # or else the plan would not remember
