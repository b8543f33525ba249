"""The recorder as a node: everything of one vehicle, as it comes off the bus, into the record.

What did not come it asks the publishers for (`tramstream.recorder.gaps`): after a jam on the bus, a
stop of its own, a restart of the router, and, when it was started again, from where the record of
its predecessor ends.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path

from tramstream import config_file, keys
from tramstream.boundary import Undecodable, decode
from tramstream.clock import GPS_EPOCH_UNIX_S, S, boot_id
from tramstream.config import Recorder, Vehicle
from tramstream.events.kinds import Event
from tramstream.live.node import Node
from tramstream.processor import Ledger
from tramstream.proto.gnss_pb2 import GnssTime
from tramstream.proto.health_pb2 import Loss
from tramstream.proto.resend_pb2 import ResendAnswer
from tramstream.recorder.asker import Asker
from tramstream.recorder.events import (
    HAD_AGAIN,
    KEY_OF_OTHERS,
    NOT_DESCRIBED,
    NOT_FINISHED,
    SECOND_PUBLISHER,
    STRANGE_ANSWER,
    TOO_MANY_KEYS,
)
from tramstream.recorder.foreign import (
    PENDING,
    UNDESCRIBED,
    ForeignTypes,
    Held,
    Kind,
)
from tramstream.recorder.gaps import GapBook
from tramstream.recorder.leaving import Leaving, Seen
from tramstream.recorder.previous import remember
from tramstream.recorder.recording import Recording
from tramstream.tracks import grades
from tramstream.transport.bus import Bus, Envelope
from tramstream.transport.descriptions import Described
from tramstream.transport.header import is_possible
from tramstream.transport.sources import MOST_TOPICS, OTHERS

NAME = "recorder"
ASK_S = 0.05
SWEEP_S = 5.0
"""How often everybody is asked for what no later message shows to be missing."""
AGAIN_S = 0.2
"""The same after an answer that was full."""
SILENT_S = 5.0
"""Who ends, and does not answer for so long, is gone already."""
LAST_ROUNDS = 20
"""Questions at the end, each with the answers to the one before."""


class RecorderNode(Node):
    """Appends every message to the record; flushes, splits and cleans up by timer.

    Keys of other packages are recorded like ours, with the description of their messages that their
    publisher gives; what nobody describes is recorded as the bytes that it is.

    Parameters
    ----------
    settings : Recorder
    metadata : mapping
        Goes into every part of the record, e.g. the configuration.
    expression : str
        What to record, below `tram/<vehicle>/`.
    goes_on : bool
        Have what was published since the folder's newest record ends, if that is of this boot: what
        a recorder that died has missed. Somebody who stopped one on purpose does not want that.
    """

    gather_s = 0.02

    def __init__(
        self,
        vehicle: str,
        bus: Bus,
        stop: threading.Event,
        settings: Recorder,
        metadata: Mapping[str, str],
        expression: str = "**",
        goes_on: bool = False,
    ) -> None:
        super().__init__(NAME, vehicle, bus, stop)
        self._gaps = GapBook(NAME, bus.session, bus.clock.now_ns())
        self.losses = self._gaps
        self._asker = Asker(bus, self._answered)
        self._goes_on = goes_on
        self._deaf = False  # at the end: nothing comes off the bus, not even what we say ourselves
        self._leaving: list[Leaving] = []
        self._answers = self._resent = self._told = self._sweep_ns = 0
        self.recording = Recording(Path(settings.directory), vehicle, settings, bus.clock, metadata)
        self._settings = settings
        self._expression = expression
        self._time_topic = keys.GNSS_TIME.on(vehicle)
        self._kinds: dict[str, Kind | None] = {}
        self._types = ForeignTypes(bus, lambda answer: self.ring.put(NAME, answer))
        self._ledger = Ledger(NAME, "messages")

    def expressions(self) -> list[str]:
        return [self._expression]

    def begin(self) -> None:
        for event in self.recording.start():
            self.tell(event)
        if self._goes_on:
            folder = Path(self._settings.directory)
            self._gaps.remember(remember(folder, self.vehicle, boot_id(), NAME))
        self.every(self._settings.flush_s, self.flush)
        self.every(ASK_S, self.ask)
        self.bus.attend(keys.farewell(self.vehicle), self._farewell)
        if self._goes_on:
            self.sweep(all_of_it=True)  # before the first message: where the predecessor ended
        self._sweep_ns = self.clock.now_ns() + int(SWEEP_S * S)

    def handle(self, envelope: Envelope) -> None:
        topic = envelope.topic
        try:
            kind = self._kinds[topic]
        except KeyError:
            if len(self._kinds) >= MOST_TOPICS and self._is_made_up(envelope):
                self._leave_out(TOO_MANY_KEYS(key=topic, limit=MOST_TOPICS))
                return
            kind = self._find(envelope)
        log_ns = self._log_time(envelope)
        if log_ns is None:
            return
        self._ledger.received += 1
        if kind is None:
            self._ledger.dropped += 1
            return
        self._ledger.delivered += 1
        if kind is GnssTime and topic == self._time_topic:
            self._learn_time(envelope.payload)
        payload, publish_ns, sequence = envelope.payload, envelope.publish_ns, envelope.sequence
        if kind is PENDING:
            held = Held(topic, payload, log_ns, publish_ns, sequence)
            self._types.hold(envelope.encoding, held)
            return
        self.recording.append(topic, kind, payload, log_ns, publish_ns, sequence)

    def _log_time(self, envelope: Envelope) -> int | None:
        """When a message came; None if the record has it."""
        topic = envelope.topic
        if not keys.is_apart(topic):
            return self._gaps.offer(envelope, self.ring.dropped)
        if topic == keys.apart(keys.published(topic), OTHERS):
            return envelope.arrival_ns  # of ever new sessions: nothing can be counted
        # Its publisher knows it by the topic that it was published on.
        published = envelope._replace(topic=keys.published(topic))
        return self._gaps.offer(published, self.ring.dropped)

    def _is_made_up(self, envelope: Envelope) -> bool:
        """Whether no node that is announced publishes it."""
        session = envelope.session
        return not session or not self.sources.is_announced(session, self.clock.now_ns())

    def _leave_out(self, why: Event) -> None:
        """Count a message that is not recorded, and say so."""
        self._ledger.received += 1
        self._ledger.dropped += 1
        self.tell(why)

    def _learn_time(self, payload: bytes) -> None:
        """Take from a receiver what time it is: for the names of records only."""
        known = decode(GnssTime, payload, keys.GNSS_TIME.path)
        if isinstance(known, Undecodable):
            return  # recorded as it is; whoever uses it says so
        if known.HasField("gps_time_ns") and known.HasField("leap_seconds"):
            utc_ns = known.gps_time_ns + (GPS_EPOCH_UNIX_S - known.leap_seconds) * S
            self.recording.utc.learn(utc_ns, known.stamp_ns)

    # What did not come ---------------------------------------------------------------------------
    def ask(self) -> None:
        """Put the questions that are due, unless others are on their way."""
        now_ns = self.clock.now_ns()
        self._name_lost(self._gaps.give_up(now_ns))
        if now_ns >= self._sweep_ns:
            self._sweep_ns = now_ns + int(SWEEP_S * S)
            self.sweep()
        self._let_go()
        if not self._asker.busy:
            for session, request in self._gaps.requests(now_ns):
                self._asker.ask(session, request.SerializeToString())

    def sweep(self, all_of_it: bool = False) -> None:
        """Ask everybody; say what the questions before have brought."""
        if self._resent > self._told and not self._gaps.holes:
            self.tell(HAD_AGAIN(messages=self._resent - self._told))
            self._told = self._resent
        expression = keys.full(self.vehicle, self._expression)
        request = self._gaps.sweep(expression, self.clock.now_ns(), all_of_it)
        self._asker.ask(None, request.SerializeToString())

    def _answered(self, data: bytes) -> None:
        self.ring.put(NAME, data)

    # Who ends ------------------------------------------------------------------------------------
    def _farewell(self, payload: bytes, answer: Callable[[], None]) -> None:
        if len(payload) == 4:
            self.ring.put(NAME, Leaving(int.from_bytes(payload, "little"), answer))
        else:
            answer()  # of no version of ours

    def _see_off(self, leaving: Leaving) -> None:
        """Ask a publisher that is about to end for all that has not come."""
        expression = keys.full(self.vehicle, self._expression)
        request = self._gaps.sweep(expression, self.clock.now_ns(), all_of_it=True)
        request.always = True
        self._asker.ask(
            leaving.session,
            request.SerializeToString(),
            lambda answers: self.ring.put(NAME, Seen(leaving, answers)),
        )

    def _let_go(self) -> None:
        """Answer publishers that have nothing left that is missing here."""
        for leaving in list(self._leaving):
            if leaving.due:
                leaving.due = False
                self._see_off(leaving)
            elif leaving.swept and not self._gaps.holes_of(leaving.session):
                self._leaving.remove(leaving)
                leaving.answer()

    def handle_item(self, item: bytes | Leaving | Seen | Described) -> None:
        """Work on what publishers say beside their messages."""
        match item:
            case Leaving():
                self._leaving.append(item)
                self._see_off(item)
            case Seen(leaving, answers):
                now_ns = self.clock.now_ns()
                leaving.silent_ns = 0 if answers else leaving.silent_ns or now_ns
                gone = leaving.silent_ns and now_ns - leaving.silent_ns > SILENT_S * S
                leaving.swept = leaving.swept or bool(gone)
                leaving.due = not leaving.swept
            case Described():
                self._learn_type(item)
            case _:
                self._take_answer(item)

    def _take_answer(self, item: bytes) -> None:
        """Record what a publisher sent once more, and name what it no longer has."""
        answer = decode(ResendAnswer, item, "an answer")
        if isinstance(answer, Undecodable):
            self.tell(STRANGE_ANSWER(size_bytes=answer.size, reason=answer.reason))
            return
        self._answers += 1
        if not answer.stretches:  # the answer to a publisher's farewell
            for leaving in self._leaving:
                leaving.swept = leaving.swept or leaving.session == answer.session
            return
        if answer.more:
            self._sweep_ns = min(self._sweep_ns, self.clock.now_ns() + int(AGAIN_S * S))
        before, now_ns = self._ledger.received, self.clock.now_ns()
        for stretch in answer.stretches:
            for message in stretch.messages:
                if not is_possible(message.publish_ns, message.sequence, now_ns):
                    continue  # a stranger's answer
                again = Envelope(
                    stretch.topic,
                    message.payload,
                    message.encoding,
                    message.publish_ns,
                    message.sequence,
                    answer.session,
                    message.publish_ns,
                )
                self.handle(self.sources.place(again))
            self._name_lost(self._gaps.settle(answer.session, stretch))
        self._resent += self._ledger.received - before
        if not self._deaf:
            self.ask()

    def _name_lost(self, losses: list[Loss]) -> None:
        key = keys.LOSS.at(NAME)
        for loss in losses:
            at_ns = self.publish(key, loss)
            if self._deaf:
                topic, data = key.on(self.vehicle), loss.SerializeToString()
                self.recording.append(topic, key, data, at_ns, at_ns, loss.sequence)

    def _ask_for_the_last(self) -> None:
        """Ask for what is still missing; what nobody sends now is lost."""
        self._deaf = True
        self.sweep(all_of_it=True)
        self._asker.close()
        self.drain()
        for _ in range(LAST_ROUNDS):
            asker, answers = Asker(self.bus, self._answered), self._answers
            for session, request in self._gaps.requests(self.clock.now_ns(), at_once=True):
                asker.ask(session, request.SerializeToString())
            asker.close()
            self.drain()
            if self._answers == answers:
                break
        self._name_lost(self._gaps.give_up(self.clock.now_ns(), at_once=True))
        self._deaf = False

    def _find(self, envelope: Envelope) -> Kind | None:
        """What a topic holds; None if it is not recorded."""
        topic = envelope.topic
        vehicle, path = keys.split(keys.published(topic))
        kind: Kind | None = None
        if vehicle != self.vehicle:
            self.tell(KEY_OF_OTHERS(key=topic))
        elif not any(keys.matches(expression, path) for expression in self._settings.exclude):
            key = keys.find(path)
            kind = self._types.kind(envelope.encoding) if key is None else key.type
            if keys.is_apart(topic):
                who = self.sources.name(int(topic.rpartition(keys.APART)[2], 16))
                self.tell(SECOND_PUBLISHER(key=path, who=who, kept=topic))
        if kind is not PENDING:
            self._kinds[topic] = kind
        return kind

    def _learn_type(self, answer: Described) -> None:
        """Record what has waited for the description of its type."""
        if answer.type is None:
            self.tell(NOT_DESCRIBED(type=answer.name, reason=answer.reason))
        self._record_held(self._types.settle(answer), answer.type or UNDESCRIBED)

    def _record_held(self, held: list[Held], kind: Kind) -> None:
        for each in held:
            self.recording.append(each.topic, kind, *each[1:])

    def flush(self) -> None:
        self.recording.flush()
        self._tell()

    def _tell(self) -> None:
        for event in self.recording.take_events():
            self.tell(event)
        for loss in self.recording.take_losses():
            self._ledger.delivered -= loss.count
            self._ledger.dropped += loss.count
            self.publish(
                keys.LOSS.at(NAME),
                Loss(
                    consumer=NAME,
                    key=loss.topic,
                    count=loss.count,
                    after_publish_ns=loss.after_publish_ns,
                    before_publish_ns=loss.before_publish_ns,
                    cause=Loss.Cause.DISK,
                ),
            )
        trouble = self.recording.trouble
        self.troubles = [] if trouble is None else [trouble]

    def finish(self) -> None:
        self.heartbeat()
        self.drain()
        self.settle_sources(at_end=True)
        try:
            self._ask_for_the_last()
            self.settle_sources(at_end=True)
        except Exception as error:  # noqa: BLE001  told; the last part is finished whatever it was
            self.fault(error)
        self._record_held(self._types.give_up(), UNDESCRIBED)
        whole = self.recording.close()
        self._tell()
        if not whole:
            self.troubles.append(NOT_FINISHED())

    def take_leave(self) -> None:
        """Nobody waits for the recorder, and those who wait for it need not any more."""
        for leaving in self._leaving:
            leaving.answer()

    def ledgers(self) -> list[Ledger]:
        return [self._ledger]


def build(vehicle: Vehicle, bus: Bus, stop: threading.Event) -> RecorderNode:
    """Make the node of a vehicle; the entry point of `tramstream.nodes`."""
    metadata = {
        config_file.RECORD_ENTRY: config_file.to_json(vehicle),
        grades.GRADES_ENTRY: grades.held_to(vehicle),
    }
    return RecorderNode(vehicle.vehicle, bus, stop, vehicle.recorder, metadata, goes_on=True)
