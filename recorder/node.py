"""The recorder as a node: everything of one vehicle, as it comes off the bus, into the record."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path

from foxglove_schemas_protobuf.Log_pb2 import Log

from tramstream import config, keys
from tramstream.boundary import Undecodable, decode
from tramstream.bus import Bus, Envelope
from tramstream.clock import GPS_EPOCH_UNIX_S, S
from tramstream.config import Recorder, Vehicle
from tramstream.keys import Key
from tramstream.node import Node
from tramstream.processor import Ledger
from tramstream.proto.gnss_pb2 import GnssTime
from tramstream.proto.health_pb2 import Loss
from tramstream.recorder.disk import Recording

NAME = "recorder"


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
    ) -> None:
        super().__init__(NAME, vehicle, bus, stop)
        self.recording = Recording(Path(settings.directory), vehicle, settings, bus.clock, metadata)
        self._settings = settings
        self._expression = expression
        self._keys: dict[str, Key | None] = {}
        self._ledger = Ledger(NAME, "messages")

    def expressions(self) -> list[str]:
        return [self._expression]

    def begin(self) -> None:
        for sentence in self.recording.start():
            self.log(sentence, Log.INFO)
        self.every(self._settings.flush_s, self.flush)

    def handle(self, envelope: Envelope) -> None:
        topic = envelope.topic
        try:
            key = self._keys[topic]
        except KeyError:
            key = self._keys[topic] = self._find(topic)
        self._ledger.received += 1
        if key is None:
            self._ledger.dropped += 1
            return
        self._ledger.delivered += 1
        if key is keys.GNSS_TIME and not keys.is_apart(topic):
            self._learn_time(envelope.payload)
        self.recording.append(
            topic,
            key,
            envelope.payload,
            envelope.arrival_ns,
            envelope.publish_ns,
            envelope.sequence,
        )

    def _learn_time(self, payload: bytes) -> None:
        """Take from a receiver what time it is: for the names of records only."""
        known = decode(GnssTime, payload, keys.GNSS_TIME.path)
        if isinstance(known, Undecodable):
            return  # recorded as it is; whoever uses it says so
        if known.HasField("gps_time_ns") and known.HasField("leap_seconds"):
            utc_ns = known.gps_time_ns + (GPS_EPOCH_UNIX_S - known.leap_seconds) * S
            self.recording.utc.learn(utc_ns, known.stamp_ns)

    def _find(self, topic: str) -> Key | None:
        path = keys.split(topic)[1]
        if keys.is_apart(path):
            path = path.partition(keys.APART)[0]
            who = self.sources.name(int(topic.rpartition(keys.APART)[2], 16))
            self.log(f"{path} comes from a second publisher, {who}; it is recorded as {topic}")
        if any(keys.matches(expression, path) for expression in self._settings.exclude):
            return None
        key = keys.find(path)
        if key is None:
            self.log(f"{topic}: not recorded, for this version of tramstream has no such key")
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
        while len(self.ring):
            self._turn(0.0)
        self.settle_sources(at_end=True)
        if not self.recording.close():
            self.trouble = f"{self.recording.text}; what is written is repaired at the next start"
        self._tell()

    def ledgers(self) -> list[Ledger]:
        return [self._ledger]


def build(vehicle: Vehicle, bus: Bus, stop: threading.Event) -> RecorderNode:
    """Make the node of a vehicle; the entry point of `tramstream.nodes`."""
    metadata = {config.RECORD_ENTRY: config.to_json(vehicle)}
    return RecorderNode(vehicle.vehicle, bus, stop, vehicle.recorder, metadata)
