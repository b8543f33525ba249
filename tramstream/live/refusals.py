"""What a node read and did not use: counted, told now and then, named for reprocessing.

A refused message is dirty input, not a fault. It is counted in the node's ledger, told in
`health/<node>/log` (the first of a kind at once, then with its count every ten seconds) and in the
heartbeat while it lasts, and named by a `Loss` of its key, which reprocessing leaves out likewise.
"""

from __future__ import annotations

from dataclasses import dataclass

from tramstream.clock import S
from tramstream.events.kinds import Event
from tramstream.live.events import NOT_USED
from tramstream.processor import Ledger
from tramstream.proto.health_pb2 import Loss
from tramstream.transport.bus import Envelope

LASTS_S = 10.0
"""So long after the last refusal the heartbeat says so: one round of what is told."""


@dataclass(slots=True)
class _Run:
    """Messages of one topic that were refused one after another, for one cause."""

    cause: Loss.Cause
    count: int
    first_publish_ns: int
    last_publish_ns: int


class Refusals:
    """Keeps account for one node.

    Parameters
    ----------
    consumer : str
        Name of the node.
    """

    def __init__(self, consumer: str) -> None:
        self.count = 0
        self.runs: dict[str, _Run] = {}
        """By topic; not yet named. Whoever uses a message of such a topic closes its run."""
        self._consumer = consumer
        self._closed: list[tuple[str, _Run]] = []
        self._last_ns = 0
        self._last: Event | None = None

    def refuse(self, envelope: Envelope, cause: Loss.Cause, why: Event, now_ns: int) -> None:
        """Take note of a message that is not used."""
        topic = envelope.topic
        self.count += 1
        self._last_ns, self._last = now_ns, why
        if cause == Loss.SOURCE:
            return  # the record has it under a topic of its own
        run = self.runs.get(topic)
        if run is None or run.cause != cause:
            self.close(topic)
            self.runs[topic] = _Run(cause, 1, envelope.publish_ns, envelope.publish_ns)
        else:
            run.count += 1
            run.last_publish_ns = envelope.publish_ns

    def close(self, topic: str) -> None:
        """End the run of `topic`: what follows is used, or refused for another cause."""
        run = self.runs.pop(topic, None)
        if run is not None:
            self._closed.append((topic, run))

    def take_losses(self) -> list[Loss]:
        """What has not been named yet."""
        for topic in list(self.runs):
            self.close(topic)
        closed, self._closed = self._closed, []
        return [
            Loss(
                consumer=self._consumer,
                key=topic,
                count=run.count,
                after_publish_ns=max(run.first_publish_ns - 1, 0),
                before_publish_ns=run.last_publish_ns + 1,
                cause=run.cause,
            )
            for topic, run in closed
        ]

    def troubles(self, now_ns: int) -> list[Event]:
        """What to say of it while it lasts, else nothing."""
        if self._last is None or now_ns - self._last_ns > LASTS_S * S:
            return []
        return [self._last, NOT_USED(not_used=self.count)]

    def ledger(self, received: int, pending: int) -> Ledger:
        """Books of a node that has judged all but `pending` of `received` messages."""
        return Ledger(
            "inputs", "messages", received, received - self.count - pending, self.count, pending
        )
