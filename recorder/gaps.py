"""What the recorder has of every publisher's messages, and what is missing between them.

A message is named by its publisher, its topic and its time of publication, whichever way it comes:
live, late, or asked for again. So none is recorded twice, and a gap in the sequence numbers is a
*hole* until the publisher has said what it still holds of it; what it does not hold is then named
lost. In front of the first message of a publisher there may be a hole too: since the recorder was
made, or since the last message that the record of a recorder that died holds.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from tramstream.clock import S
from tramstream.proto.health_pb2 import Loss
from tramstream.proto.resend_pb2 import ResendRequest, ResendStretch, ResentStretch
from tramstream.recorder.previous import NOTHING, Previous, Remembered
from tramstream.transport.bus import Envelope
from tramstream.transport.losses import LossCounter

AGAIN_NS = (S // 4, S // 2, S, S, S, S, 2 * S, 2 * S, 2 * S, 2 * S)
"""Pauses between questions that nobody answers; after the last a hole is given up. They count only
while messages of others arrive: no answer through a router that is away means nothing. On a busy
machine links are full for seconds, and answers dropped; publishers keep what is asked for 30 s."""
ORPHANED_NS = 20 * S
"""So long after a start nobody has answered for a gap in the record before: nobody will."""
STRETCHES = 400
"""Of one request."""
SWEEP_BEHIND_NS = S
"""What was published since may still be on its way."""
MOST_HOLES = 2000
"""Open at a time on one topic of one publisher; the oldest of more are given up."""
STALE_NS = 120 * S
"""A publisher that has been silent for so long, and has a successor on its topic, is over."""


@dataclass(slots=True)
class Hole:
    """Messages of one publisher on one topic that have not come, between two that have.

    `after_sequence` is None while it is not known where the publisher's numbering stood.
    `done_ns`: up to here the publisher has said all.
    """

    after_ns: int
    after_sequence: int | None
    after_log_ns: int
    before_ns: int
    before_sequence: int
    before_log_ns: int
    queued: int
    done_ns: int
    first: bool = False
    filled: dict[int, int] = field(default_factory=dict)
    """Sequence numbers by time of publication."""
    asked: int = 0
    due_ns: int = 0
    heard: int = 0


@dataclass(slots=True)
class _Stream:
    """How far one publisher has come on one topic."""

    topic: str
    session: int
    sequence: int
    publish_ns: int
    log_ns: int
    holes: list[Hole] = field(default_factory=list)


class GapBook(LossCounter):
    """Decides what is recorded, what is asked for again, and what is lost.

    Parameters
    ----------
    consumer : str
        Name of the node.
    session : int
        The node's own bus session: hearing itself is no sign that the bus carries.
    since_ns : int
        Nothing that was published earlier is asked for, unless `remember` says more.
    """

    def __init__(self, consumer: str, session: int, since_ns: int) -> None:
        super().__init__(consumer)
        self.duplicates = 0
        self._session = session
        self._since_ns = since_ns
        self._previous: Previous = NOTHING
        self._streams: dict[tuple[str, int], _Stream] = {}
        self._open: dict[tuple[str, int], _Stream] = {}
        self._after_ns: dict[str, int] = {}
        self._heard = 0
        self._begun_ns = since_ns
        self._refilled: dict[str, dict[int, int]] = {}
        self._told: dict[str, list[tuple[int, int]]] = {}  # remembered gaps that are named lost
        self._orphans: set[str] = set()  # topics whose remembered gaps nobody has accounted for

    def remember(self, previous: Previous) -> None:
        """Go on from what the record of a predecessor holds; before the first message."""
        self._previous = previous
        self._orphans = set(previous.topics)
        if previous.topics:
            self._since_ns = previous.since_ns

    def see(self, envelope: Envelope, dropped: Counter[str]) -> list[Loss]:
        """Nothing is lost before the publisher was asked: see `offer`."""
        return []

    # What comes ----------------------------------------------------------------------------------
    def offer(self, envelope: Envelope, dropped: Counter[str]) -> int | None:
        """Log time of a message that is to be recorded; None if the record has it.

        That is its arrival; of one that comes later than its successors, its publication, but not
        before its predecessor nor after its successor: a topic's messages sort as published.
        """
        if envelope.sequence == 0:
            return envelope.arrival_ns
        if envelope.session != self._session:
            self._heard += 1
        name = envelope.topic, envelope.session
        stream = self._streams.get(name)
        if stream is None:
            stream = self._streams[name] = self._begin(envelope, dropped)
        publish_ns = envelope.publish_ns
        if publish_ns <= stream.publish_ns:
            return self._fill(stream, publish_ns, envelope.sequence)
        known = self._previous.has(envelope.topic, publish_ns)
        missing = envelope.sequence - stream.sequence - 1
        if missing > 0 and not known:
            self._open_hole(stream, envelope, missing, dropped)
        log_ns = max(envelope.arrival_ns, stream.log_ns)
        stream.sequence, stream.publish_ns = envelope.sequence, publish_ns
        if known:
            self.duplicates += 1
            remembered = self._previous.topics[envelope.topic]
            stream.log_ns = max(stream.log_ns, remembered.log_before(publish_ns + 1))
            return None
        if self._previous.is_within(envelope.topic, publish_ns):
            self._refilled.setdefault(envelope.topic, {})[publish_ns] = envelope.sequence
        stream.log_ns = log_ns
        return log_ns

    def _begin(self, envelope: Envelope, dropped: Counter[str]) -> _Stream:
        """A publisher's first message on a topic: was there something before it?"""
        topic, publish_ns = envelope.topic, envelope.publish_ns
        remembered = self._previous.topics.get(topic)
        after_ns = max(
            remembered.after_ns if remembered is not None else self._since_ns,
            self._after_ns.get(topic, 0),
        )
        self._accounted[topic] = dropped[topic]  # those of others: nobody can place them
        log_ns = remembered.log_before(publish_ns) if remembered is not None else 0
        before_ns = min(after_ns, publish_ns - 1)
        stream = _Stream(topic, envelope.session, envelope.sequence - 1, before_ns, log_ns)
        if envelope.sequence > 1 and publish_ns > after_ns:
            end = publish_ns, envelope.sequence, max(envelope.arrival_ns, log_ns)
            self._add(stream, Hole(after_ns, None, 0, *end, 0, after_ns, first=True))
        return stream

    def _open_hole(
        self, stream: _Stream, envelope: Envelope, missing: int, dropped: Counter[str]
    ) -> None:
        topic = envelope.topic
        queued = min(missing, dropped[topic] - self._accounted[topic])
        self._accounted[topic] += queued
        hole = Hole(
            stream.publish_ns,
            stream.sequence,
            stream.log_ns,
            envelope.publish_ns,
            envelope.sequence,
            max(envelope.arrival_ns, stream.log_ns),
            queued,
            stream.publish_ns,
        )
        self._add(stream, hole)

    def _add(self, stream: _Stream, hole: Hole) -> None:
        stream.holes.append(hole)
        self._open[stream.topic, stream.session] = stream

    def _fill(self, stream: _Stream, publish_ns: int, sequence: int) -> int | None:
        """One that comes later than its successors."""
        index = bisect_right(stream.holes, publish_ns, key=lambda hole: hole.after_ns) - 1
        hole = stream.holes[index] if index >= 0 else None
        if (
            hole is None
            or not hole.after_ns < publish_ns < hole.before_ns
            or publish_ns in hole.filled
            or self._previous.has(stream.topic, publish_ns)
        ):
            self.duplicates += 1
            return None
        hole.filled[publish_ns] = sequence
        log_ns = hole.after_log_ns
        if hole.first:
            self._refilled.setdefault(stream.topic, {})[publish_ns] = sequence
            remembered = self._previous.topics.get(stream.topic)
            log_ns = remembered.log_before(publish_ns) if remembered is not None else 0
        if hole.after_sequence is not None:
            missing = hole.before_sequence - hole.after_sequence - 1
            if len(hole.filled) == missing and not hole.first:
                self._remove(stream, hole)
        return min(max(publish_ns, log_ns), hole.before_log_ns)

    def _remove(self, stream: _Stream, hole: Hole) -> None:
        stream.holes.remove(hole)
        if not stream.holes:
            self._open.pop((stream.topic, stream.session), None)

    # What is asked -------------------------------------------------------------------------------
    @property
    def holes(self) -> int:
        """How many wait for an answer."""
        return sum(len(stream.holes) for stream in self._open.values())

    def holes_of(self, session: int) -> int:
        """How many holes of one publisher wait for an answer."""
        return sum(len(stream.holes) for stream in self._open.values() if stream.session == session)

    def requests(self, now_ns: int, at_once: bool = False) -> list[tuple[int, ResendRequest]]:
        """What is to be asked of which publisher now; `at_once` leaves out the pauses."""
        requests: dict[int, ResendRequest] = {}
        for stream in self._open.values():
            for hole in stream.holes:
                request = requests.setdefault(stream.session, ResendRequest())
                waits = now_ns < hole.due_ns or hole.asked > len(AGAIN_NS)
                if (waits and not at_once) or len(request.stretches) >= STRETCHES:
                    continue
                stretch = ResendStretch(
                    topic=stream.topic,
                    session=stream.session,
                    after_publish_ns=hole.done_ns,
                    before_publish_ns=hole.before_ns,
                )
                request.stretches.append(stretch)
                if not hole.asked or self._heard > hole.heard:
                    hole.asked += 1
                hole.heard = self._heard
                hole.due_ns = now_ns + AGAIN_NS[min(hole.asked, len(AGAIN_NS)) - 1]
        return [(session, request) for session, request in requests.items() if request.stretches]

    def sweep(self, expression: str, now_ns: int, all_of_it: bool = False) -> ResendRequest:
        """What everybody is asked now and then: is there anything that no later message shows?

        Or `all_of_it`, also what may still be on its way: at the start and at the end.
        """
        self._forget_stale(now_ns)
        before_ns = max(now_ns if all_of_it else now_ns - SWEEP_BEHIND_NS, 0)
        request = ResendRequest(
            expression=expression, after_publish_ns=self._since_ns, before_publish_ns=before_ns
        )
        for stream in self._streams.values():
            # Where a hole is open, its own questions are on their way, and the end can wait.
            behind_ns = 0 if stream.holes and not all_of_it else before_ns
            request.stretches.add(
                topic=stream.topic,
                session=stream.session,
                after_publish_ns=stream.publish_ns,
                before_publish_ns=max(behind_ns, stream.publish_ns + 1),
            )
        for topic, remembered in self._previous.topics.items():
            request.stretches.add(
                topic=topic, after_publish_ns=remembered.after_ns, before_publish_ns=before_ns
            )
        return request

    def _forget_stale(self, now_ns: int) -> None:
        """Publishers that were followed by others: else each restart would be remembered."""
        newest: dict[str, int] = {}
        for stream in self._streams.values():
            newest[stream.topic] = max(newest.get(stream.topic, 0), stream.publish_ns)
        for name, stream in list(self._streams.items()):
            old = stream.publish_ns < min(newest[stream.topic], now_ns - STALE_NS)
            if old and not stream.holes:
                del self._streams[name]
                known_ns = self._after_ns.get(stream.topic, 0)
                self._after_ns[stream.topic] = max(known_ns, stream.publish_ns)

    # What is lost --------------------------------------------------------------------------------
    def settle(self, session: int, answer: ResentStretch) -> list[Loss]:
        """Close what a publisher has answered, after its messages were offered: the rest is lost.

        Holes that reach beyond what it knew when it answered stay.
        """
        stream = self._streams.get((answer.topic, session))
        if stream is None or (answer.more and not answer.messages):
            return []
        known_ns = answer.newest_publish_ns
        if answer.more:
            known_ns = answer.messages[-1].publish_ns
        elif answer.before_publish_ns:
            known_ns = min(known_ns, answer.before_publish_ns)
        losses: list[Loss] = []
        for hole in list(stream.holes):
            if answer.after_publish_ns > hole.done_ns or known_ns <= hole.after_ns:
                continue
            if (
                hole.after_sequence is None
                and answer.HasField("after_sequence")
                and answer.after_publish_ns == hole.after_ns
            ):
                hole.after_sequence = answer.after_sequence
            if known_ns >= hole.before_ns:
                losses += self._close(stream, hole)
            elif known_ns > hole.done_ns:
                hole.done_ns, hole.asked, hole.due_ns = known_ns, 0, 0
        return losses

    def give_up(self, now_ns: int, at_once: bool = False) -> list[Loss]:
        """Close what nobody has answered for too long: what is missing is lost."""
        losses: list[Loss] = []
        for stream in list(self._open.values()):
            too_many = len(stream.holes) - MOST_HOLES
            for index, hole in enumerate(list(stream.holes)):
                given_up = hole.asked > len(AGAIN_NS) and now_ns >= hole.due_ns
                if at_once or given_up or index < too_many:
                    losses += self._close(stream, hole)
        if self._orphans and (at_once or now_ns - self._begun_ns > ORPHANED_NS):
            waiting = {stream.topic for stream in self._open.values()}
            for topic in sorted(self._orphans - waiting):
                losses += self._name_orphans(topic)
        return losses

    def _name_orphans(self, topic: str) -> list[Loss]:
        """Name what a predecessor had asked for in vain of a publisher that is gone as well."""
        self._orphans.discard(topic)
        remembered = self._previous.topics[topic]
        here = {**remembered.known, **self._refilled.get(topic, {})}
        told = self._told.get(topic, [])
        losses: list[Loss] = []
        left_ns, left = remembered.after_ns, remembered.after_sequence
        for publish_ns, sequence in sorted(here.items()):
            named = any(after <= left_ns and publish_ns <= before for after, before in told)
            if left is not None and sequence > left + 1 and not named:
                count = sequence - left - 1
                self.lost[topic] += count
                losses.append(self._loss(topic, count, left_ns, publish_ns, Loss.Cause.ABSENT))
            left_ns, left = publish_ns, sequence
        return losses

    def _close(self, stream: _Stream, hole: Hole) -> list[Loss]:
        self._remove(stream, hole)
        remembered = self._previous.topics.get(stream.topic) if hole.first else None
        if remembered and hole.before_sequence > max(remembered.known.values(), default=0):
            self._orphans.discard(stream.topic)  # its numbers go on: what is missing shows here
        cause = Loss.Cause.BUS if remembered is None else Loss.Cause.ABSENT
        queued = hole.queued
        losses = []
        for after_ns, before_ns, count in _missing(hole, remembered):
            self.lost[stream.topic] += count
            if remembered:
                self._told.setdefault(stream.topic, []).append((after_ns, before_ns))
            parts = ((min(queued, count), Loss.Cause.QUEUE), (max(count - queued, 0), cause))
            queued -= min(queued, count)
            losses += [
                self._loss(stream.topic, part, after_ns, before_ns, why)
                for part, why in parts
                if part
            ]
        return losses

    def _loss(
        self, topic: str, count: int, after_ns: int, before_ns: int, cause: Loss.Cause
    ) -> Loss:
        return Loss(
            consumer=self.consumer,
            key=topic,
            count=count,
            after_publish_ns=after_ns,
            before_publish_ns=before_ns,
            cause=cause,
        )


def _missing(hole: Hole, remembered: Remembered | None) -> Iterator[tuple[int, int, int]]:
    """Runs of missing messages: publications around them, and how many."""
    here = dict(hole.filled)
    left_ns, left = hole.after_ns, hole.after_sequence
    if remembered is not None:
        here |= remembered.known
        numbered = remembered.after_sequence
        if numbered is not None and hole.before_sequence > numbered:
            # A session that begins above goes on counting for one that is gone.
            left = numbered if left is None else min(left, numbered)
    for publish_ns, sequence in sorted([*here.items(), (hole.before_ns, hole.before_sequence)]):
        if not hole.after_ns < publish_ns <= hole.before_ns or sequence > hole.before_sequence:
            continue
        if left is not None and sequence <= left:
            continue  # of another publisher
        if left is not None and sequence > left + 1:
            yield left_ns, publish_ns, sequence - left - 1
        left_ns, left = publish_ns, sequence
