"""What a node read and did not use: counted, told now and then, named for reprocessing.

A refused message is dirty input, not a fault. It is counted in the node's ledger, told in
`health/<node>/log` (the first of a kind at once, then with its count every ten seconds) and in the
heartbeat while it lasts, and named by a `Loss` of its key, which reprocessing leaves out likewise.
"""

from __future__ import annotations

from dataclasses import dataclass

from tramstream.boundary import name_of
from tramstream.clock import S
from tramstream.processor import Ledger
from tramstream.proto.health_pb2 import Loss
from tramstream.transport.bus import Envelope

TOLD_AGAIN_S = 10.0
"""What repeats is told so often."""
LASTS_S = 10.0
"""So long after the last refusal the heartbeat says so: one round of what is told."""
MOST_KINDS = 100
"""Kinds told one by one (a stranger may invent topics); the others are counted together."""


@dataclass(slots=True)
class _Run:
    """Messages of one topic that were refused one after another, for one cause."""

    cause: Loss.Cause
    count: int
    first_publish_ns: int
    last_publish_ns: int


@dataclass(slots=True)
class _Kind:
    """Everything that was refused of one topic for one cause."""

    count: int = 0
    told: int = 0
    told_ns: int = 0
    why: str = ""


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
        self._kinds: dict[tuple[str, int], _Kind] = {}
        self._closed: list[tuple[str, _Run]] = []
        self._last_ns = 0
        self._last_text = ""

    def refuse(self, envelope: Envelope, cause: Loss.Cause, why: str, now_ns: int) -> None:
        """Take note of a message that is not used; `why` is the sentence's predicate."""
        topic = envelope.topic
        self.count += 1
        place = (topic, int(cause))
        if place not in self._kinds and len(self._kinds) >= MOST_KINDS:
            place = ("other keys", int(cause))
        kind = self._kinds.setdefault(place, _Kind())
        kind.count += 1
        kind.why = why
        self._last_ns, self._last_text = now_ns, f"{place[0]} {why}"
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

    def take_sentences(self, now_ns: int) -> list[str]:
        """What is to be told now."""
        sentences = []
        for (topic, cause), kind in self._kinds.items():
            due = kind.told == 0 or now_ns - kind.told_ns >= TOLD_AGAIN_S * S
            if kind.count > kind.told and due:
                kind.told, kind.told_ns = kind.count, now_ns
                name = name_of(Loss.Cause, cause)
                sentences.append(f"{topic} {kind.why}; {kind.count} not used so far ({name})")
        return sentences

    def text(self, now_ns: int) -> str:
        """One sentence while it lasts, else nothing."""
        if not self.count or now_ns - self._last_ns > LASTS_S * S:
            return ""
        return f"{self._last_text}; {self.count} messages not used in all"

    def ledger(self, received: int, pending: int) -> Ledger:
        """Books of a node that has judged all but `pending` of `received` messages."""
        return Ledger(
            "inputs", "messages", received, received - self.count - pending, self.count, pending
        )
