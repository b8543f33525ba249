"""What a publisher keeps of what it published lately, for a reader that missed some of it.

A time of publication names a message on its topic. A reader that saw a gap asks the publisher for
what lies between two of them; a recorder that was started again asks for everything after the last
that its file holds. Kept is a bounded past, the oldest goes first. zenoh's own cache (advanced
publisher and subscriber) counts messages, not bytes, and knows nothing of a reader that comes back
with a file: it would send everything once more.
"""

from __future__ import annotations

import threading
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Iterator
from operator import itemgetter

from google.protobuf.message import DecodeError

from tramstream import keys
from tramstream.clock import S
from tramstream.proto.resend_pb2 import (
    ResendAnswer,
    ResendRequest,
    ResendStretch,
    ResentMessage,
    ResentStretch,
)

SPAN_S = 30.0
"""Longer than it takes to notice a frozen recorder and to start another (about ten seconds)."""
LIMIT_BYTES = 8_000_000
"""Of one process, with what Python needs for it (tests/transport/test_resend.py)."""
ENTRY_BYTES = 220
"""What one message takes beside its payload: a tuple, two numbers, the head of the bytes."""
KEPT_FEW = 16
"""So many of a topic are kept whatever their age: on a rare key the next message, which shows that
one is missing, may be minutes away."""
FORGET_NS = S // 10
"""How often is looked for old ones: forgetting many at once takes a third of the time."""
ANSWER_BYTES = 256_000
"""Of one answer: a quarter of what a link's queue holds, beside the live stream."""

_Kept = tuple[int, int, bytes, str]
"""Time of publication, sequence number, payload, encoding."""
_TIME = itemgetter(0)


class _Topic:
    """What is kept of one topic, oldest first."""

    __slots__ = (
        "first_publish_ns",
        "first_sequence",
        "forgotten_ns",
        "forgotten_sequence",
        "kept",
        "oldest_ns",
    )

    def __init__(self, publish_ns: int, sequence: int) -> None:
        self.kept: deque[_Kept] = deque()
        self.oldest_ns = publish_ns
        """Of what is kept; of the last forgotten if nothing is."""
        self.first_publish_ns = publish_ns
        self.first_sequence = sequence
        self.forgotten_ns = self.forgotten_sequence = 0
        """Of the last that was forgotten; 0 if none was."""


class History:
    """The latest messages of one bus session, by topic; called from any thread.

    Parameters
    ----------
    session : int
        The publisher's number, as in the header of its messages.
    span_s : float
        Older ones are forgotten, but for the last few of each topic.
    limit_bytes : int
        More is never kept.
    """

    def __init__(
        self, session: int, span_s: float = SPAN_S, limit_bytes: int = LIMIT_BYTES
    ) -> None:
        self.session = session
        self.size_bytes = 0
        self.refused = 0
        """Requests that could not be read."""
        self._span_ns = int(span_s * S)
        self._limit_bytes = limit_bytes
        self._topics: dict[str, _Topic] = {}
        self._order: deque[_Topic] = deque()  # of what is kept, but for the last few of a topic
        self._due_ns = 0
        self._lock = threading.Lock()

    def keep(
        self, topic: str, payload: bytes, encoding: str, sequence: int, publish_ns: int
    ) -> None:
        """Add what is being published."""
        with self._lock:
            known = self._topics.get(topic)
            if known is None:
                known = self._topics[topic] = _Topic(publish_ns, sequence)
            kept = known.kept
            kept.append((publish_ns, sequence, payload, encoding))
            self.size_bytes += len(payload) + ENTRY_BYTES
            self._order.append(known)
            if publish_ns >= self._due_ns or self.size_bytes > self._limit_bytes:
                self._forget_old(publish_ns)

    def _forget_old(self, now_ns: int) -> None:
        """Forget what is older, and the oldest until there is room again: many at a time."""
        order, horizon_ns = self._order, now_ns - self._span_ns
        full = self.size_bytes > self._limit_bytes
        room_bytes = self._limit_bytes - self._limit_bytes // 64 if full else self._limit_bytes
        while order and (self.size_bytes > room_bytes or order[0].oldest_ns < horizon_ns):
            oldest = order.popleft()
            if len(oldest.kept) > KEPT_FEW:
                self._forget(oldest)
        while self.size_bytes > self._limit_bytes:  # the last few of each topic: the oldest of all
            topics = [topic for topic in self._topics.values() if topic.kept]
            self._forget(min(topics, key=lambda topic: topic.oldest_ns))
        self._due_ns = now_ns + FORGET_NS

    def _forget(self, topic: _Topic) -> None:
        kept = topic.kept
        topic.forgotten_ns, topic.forgotten_sequence, payload, _ = kept.popleft()
        topic.oldest_ns = kept[0][0] if kept else topic.forgotten_ns
        self.size_bytes -= len(payload) + ENTRY_BYTES

    def answer(self, data: bytes) -> bytes | None:
        """Answer an encoded `ResendRequest`; None if it cannot be read or there is nothing to say.

        Oldest first within a stretch, and about `ANSWER_BYTES`: the rest is asked for again.
        """
        try:
            request = ResendRequest.FromString(data)
        except DecodeError:
            self.refused += 1
            return None
        answer = ResendAnswer(session=self.session)
        room = ANSWER_BYTES
        for stretch in self._wanted(request):
            if room <= 0:
                answer.more = True
                break
            made = self._stretch(stretch, room)
            if made is None:
                continue
            resent, size = made
            # Asked for everything, who has nothing new stays silent.
            if resent.messages or not request.expression:
                answer.stretches.append(resent)
                room -= size
        return answer.SerializeToString() if answer.stretches or request.always else None

    def _wanted(self, request: ResendRequest) -> Iterator[ResendStretch]:
        """Stretches of the request that are about this session."""
        ours: dict[str, list[ResendStretch]] = {}
        anybody: dict[str, list[ResendStretch]] = {}
        for stretch in request.stretches:
            if stretch.session == self.session:
                ours.setdefault(stretch.topic, []).append(stretch)
            elif stretch.session == 0:
                anybody.setdefault(stretch.topic, []).append(stretch)
        for topic in list(self._topics):
            known = ours.get(topic) or anybody.get(topic)
            if known is not None:
                yield from known
            elif request.expression and keys.matches(request.expression, topic):
                yield ResendStretch(
                    topic=topic,
                    after_publish_ns=request.after_publish_ns,
                    before_publish_ns=request.before_publish_ns,
                )

    def _stretch(self, wanted: ResendStretch, room: int) -> tuple[ResentStretch, int] | None:
        """What is kept of a stretch, and its size; None if nothing was ever published there."""
        known = self._topics.get(wanted.topic)
        if known is None:
            return None
        with self._lock:
            kept = list(known.kept)
            forgotten_ns, forgotten = known.forgotten_ns, known.forgotten_sequence
        after_ns = wanted.after_publish_ns
        begin = bisect_right(kept, after_ns, key=_TIME)
        end = len(kept)
        if wanted.before_publish_ns:
            end = bisect_left(kept, wanted.before_publish_ns, key=_TIME)
        resent = ResentStretch(
            topic=wanted.topic,
            after_publish_ns=after_ns,
            before_publish_ns=wanted.before_publish_ns,
            newest_publish_ns=kept[-1][0] if kept else forgotten_ns,
        )
        if begin > 0:
            resent.after_sequence = kept[begin - 1][1]
        elif known.first_publish_ns > after_ns:
            resent.after_sequence = known.first_sequence - 1
        elif 0 < forgotten_ns <= after_ns:
            resent.after_sequence = forgotten
        size = 0
        for publish_ns, sequence, payload, encoding in kept[begin:end]:
            if size >= room:
                resent.more = True
                break
            size += len(payload) + ENTRY_BYTES
            resent.messages.append(
                ResentMessage(
                    publish_ns=publish_ns, sequence=sequence, encoding=encoding, payload=payload
                )
            )
        return resent, size
