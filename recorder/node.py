"""The recorder as a node: everything of one vehicle, as it comes off the bus, into the record.

What did not come it asks the publishers for (`tramstream.recorder.gaps`): after a jam on the bus, a
stop of its own, a restart of the router, and, when it was started again, from where the record of
its predecessor ends.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from foxglove_schemas_protobuf.Log_pb2 import Log

from tramstream import config_file, keys
from tramstream.boundary import Undecodable, decode
from tramstream.clock import GPS_EPOCH_UNIX_S, S, boot_id
from tramstream.config import Recorder, Vehicle
from tramstream.keys import Key
from tramstream.live.node import Node
from tramstream.processor import Ledger
from tramstream.proto.gnss_pb2 import GnssTime
from tramstream.proto.health_pb2 import Loss
from tramstream.proto.resend_pb2 import ResendAnswer
from tramstream.recorder.asker import Asker
from tramstream.recorder.gaps import GapBook
from tramstream.recorder.previous import remember
from tramstream.recorder.recording import Recording
from tramstream.transport.bus import Bus, Envelope
from tramstream.transport.header import is_possible
from tramstream.transport.sources import MOST_TOPICS, OTHERS

NAME = "recorder"
SENTENCES = 20
"""About keys of strangers; what follows is counted, and the count told."""
UNSAID_S = 10.0
ASK_S = 0.05
SWEEP_S = 5.0
"""How often everybody is asked for what no later message shows to be missing."""
AGAIN_S = 0.2
"""The same after an answer that was full."""
SILENT_S = 5.0
"""Who ends, and does not answer for so long, is gone already."""
LAST_ROUNDS = 20
"""Questions at the end, each with the answers to the one before."""


@dataclass(slots=True)
class Leaving:
    """A publisher that waits to end: its session, and the call that lets it go."""

    session: int
    answer: Callable[[], None]
    swept: bool = False
    """Whether it has said that it holds nothing that is missing here."""
    silent_ns: int = 0
    """Since when it has answered nothing; 0 if it answered the last question. A full link drops
    questions and answers at once, so how often says nothing."""
    due: bool = False
    """Whether it is to be asked again."""


@dataclass(slots=True)
class Seen:
    """How many answers a publisher that is leaving gave when it was asked for everything."""

    leaving: Leaving
    answers: int


class RecorderNode(Node):
    """Appends every message to the record; flushes, splits and cleans up by timer.

    A key that tramstream does not know is not recorded (nobody could decode it) but named once in
    `health/recorder/log` and counted as dropped.

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
        self._keys: dict[str, Key | None] = {}
        self._mentioned = self._unsaid = self._unsaid_told = 0
        self._ledger = Ledger(NAME, "messages")

    def expressions(self) -> list[str]:
        return [self._expression]

    def begin(self) -> None:
        for sentence in self.recording.start():
            self.log(sentence, Log.INFO)
        if self._goes_on:
            folder = Path(self._settings.directory)
            self._gaps.remember(remember(folder, self.vehicle, boot_id(), NAME))
        self.every(self._settings.flush_s, self.flush)
        self.every(ASK_S, self.ask)
        self.every(UNSAID_S, self._tell_unsaid)
        self.bus.attend(keys.farewell(self.vehicle), self._farewell)
        if self._goes_on:
            self.sweep(all_of_it=True)  # before the first message: where the predecessor ended
        self._sweep_ns = self.clock.now_ns() + int(SWEEP_S * S)

    def handle(self, envelope: Envelope) -> None:
        topic = envelope.topic
        try:
            key = self._keys[topic]
        except KeyError:
            if len(self._keys) >= MOST_TOPICS and self._is_made_up(envelope):
                self._leave_out(f"{topic}: not recorded; {MOST_TOPICS} keys are, and this is more")
                return
            key = self._keys[topic] = self._find(topic)
        log_ns = self._log_time(envelope)
        if log_ns is None:
            return
        self._ledger.received += 1
        if key is None:
            self._ledger.dropped += 1
            return
        self._ledger.delivered += 1
        if key is keys.GNSS_TIME and not keys.is_apart(topic):
            self._learn_time(envelope.payload)
        self.recording.append(
            topic, key, envelope.payload, log_ns, envelope.publish_ns, envelope.sequence
        )

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

    def _leave_out(self, sentence: str) -> None:
        """Count a message that is not recorded, and say so while there is room for sentences."""
        self._ledger.received += 1
        self._ledger.dropped += 1
        self._mention(sentence)

    def _mention(self, sentence: str) -> None:
        """Say something that a stranger may cause any number of times."""
        if self._mentioned < SENTENCES:
            self._mentioned += 1
            self.log(sentence)
        else:
            self._unsaid += 1

    def _tell_unsaid(self) -> None:
        """Count what was not said."""
        if self._unsaid > self._unsaid_told:
            self._unsaid_told = self._unsaid
            self.log(f"{self._unsaid} more sentences about keys of strangers were not said")

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
            text = f"{self._resent - self._told} messages that did not come were had again"
            self.log(text, Log.INFO)
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

    def handle_item(self, item: bytes | Leaving | Seen) -> None:
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
            case _:
                self._take_answer(item)

    def _take_answer(self, item: bytes) -> None:
        """Record what a publisher sent once more, and name what it no longer has."""
        answer = decode(ResendAnswer, item, "an answer")
        if isinstance(answer, Undecodable):
            self.log(f"{answer}; left out")
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

    def _find(self, topic: str) -> Key | None:
        vehicle, path = keys.split(keys.published(topic))
        if any(keys.matches(expression, path) for expression in self._settings.exclude):
            return None
        key = keys.find(path) if vehicle == self.vehicle else None
        if key is None:
            text = "not recorded, for this version of tramstream has no such key"
            self._mention(f"{topic}: {text}")
        elif keys.is_apart(topic):
            who = self.sources.name(int(topic.rpartition(keys.APART)[2], 16))
            self._mention(f"{path} comes from a second publisher, {who}; it is recorded as {topic}")
        return key

    def flush(self) -> None:
        self.recording.flush()
        self._tell()

    def _tell(self) -> None:
        for sentence in self.recording.take_sentences():
            self.log(sentence)
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
        self.trouble = self.recording.text

    def finish(self) -> None:
        self.heartbeat()
        self.drain()
        self.settle_sources(at_end=True)
        self._tell_unsaid()
        try:
            self._ask_for_the_last()
            self.settle_sources(at_end=True)
        except Exception as error:  # noqa: BLE001  told; the last part is finished whatever it was
            self.fault(error)
        if not self.recording.close():
            self.trouble = f"{self.recording.text}; what is written is repaired at the next start"
        self._tell()

    def take_leave(self) -> None:
        """Nobody waits for the recorder, and those who wait for it need not any more."""
        for leaving in self._leaving:
            leaving.answer()

    def ledgers(self) -> list[Ledger]:
        return [self._ledger]


def build(vehicle: Vehicle, bus: Bus, stop: threading.Event) -> RecorderNode:
    """Make the node of a vehicle; the entry point of `tramstream.nodes`."""
    metadata = {config_file.RECORD_ENTRY: config_file.to_json(vehicle)}
    return RecorderNode(vehicle.vehicle, bus, stop, vehicle.recorder, metadata, goes_on=True)
