"""Losses seen by sequence numbers: what a reader of a key never got."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

from tramstream.proto.health_pb2 import Loss
from tramstream.transport.bus import Envelope


class _Last(NamedTuple):
    session: int
    sequence: int
    publish_ns: int


class LossCounter:
    """Watches the sequence numbers of every topic that one node reads.

    A publisher that started anew (another session) begins anew: what the old one published last
    and nobody got cannot be known. A message without a header (`sequence` 0) is not counted.
    """

    def __init__(self, consumer: str) -> None:
        self.consumer = consumer
        self.lost: Counter[str] = Counter()
        self.disordered: Counter[str] = Counter()
        self._last: dict[str, _Last] = {}
        self._accounted: Counter[str] = Counter()  # drops of the queue that have been told

    @property
    def total(self) -> int:
        return sum(self.lost.values())

    def see(self, envelope: Envelope, dropped: Counter[str]) -> list[Loss]:
        """Take note of a message; return what is missing before it.

        `dropped` counts what the node's own queue has dropped since the beginning, by topic.
        """
        if envelope.sequence == 0:
            return []
        topic = envelope.topic
        last = self._last.get(topic)
        if last is not None and last.session == envelope.session:
            if envelope.sequence <= last.sequence:
                self.disordered[topic] += 1
                return []
            missing = envelope.sequence - last.sequence - 1
        else:
            missing = 0
            self._accounted[topic] = dropped[topic]  # of an old session: nobody can place them
        self._last[topic] = _Last(envelope.session, envelope.sequence, envelope.publish_ns)
        if missing == 0 or last is None:
            return []
        self.lost[topic] += missing
        # Not more than are missing here: the others were dropped after this message.
        queued = min(missing, dropped[topic] - self._accounted[topic])
        self._accounted[topic] += queued
        causes = ((queued, Loss.Cause.QUEUE), (missing - queued, Loss.Cause.BUS))
        return [
            Loss(
                consumer=self.consumer,
                key=topic,
                count=count,
                after_publish_ns=last.publish_ns,
                before_publish_ns=envelope.publish_ns,
                cause=cause,
            )
            for count, cause in causes
            if count
        ]
