"""A record on the bus again, at its own pace or another."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from threading import Event

from tramstream import keys
from tramstream.clock import S
from tramstream.recorder.reader import PAUSE_NS, Entry, Record
from tramstream.transport.bus import Bus
from tramstream.transport.resend import ENTRY_BYTES, LIMIT_BYTES

AHEAD_S = 0.002
"""Messages due within so little time go out at once: sleeping is no finer."""
WAIT_S = 0.1
"""Longest sleep: how fast a pause or the end is noticed."""
LEAVE_S = 30.0
"""At the end a recorder gets so long to ask for what it missed; it is slower than `--rate 0`."""
UNPACED_RATE_HZ = 20_000
"""`--rate 0`: no subscriber takes more."""
PORTION_BYTES = LIMIT_BYTES // 2
"""`--rate 0`: after so much the recorder gets time for it. What it missed can still be sent again:
twice as much is kept (tests/test_pipeline.py)."""
AFTER_NS = 10 * S
"""Of a pause in the record so much is waited for: whoever measures silence notices it."""
PORTION_S = 10.0
"""A recorder that stands still gets so long, once."""


@dataclass
class Replay:
    """One replay of a record.

    Parameters
    ----------
    record, bus : Record, Bus
    vehicle : str
        Identifier that the messages are published under, instead of the recorded one.
    rate : float
        Times real time; 0 is as fast as subscribers take it.
    match : callable
        Takes a full key, says whether it is wanted.
    """

    record: Record
    bus: Bus
    vehicle: str
    rate: float
    match: Callable[[str], bool]
    start_ns: int | None = None
    end_ns: int | None = None
    loop: bool = False
    paused: bool = False
    published: int = 0
    position_ns: int = 0
    """Log time of the last message published."""
    skipped_ns: int = 0
    """Of pauses, together."""

    def run(self, stop: Event, each: Callable[[], None]) -> None:
        """Publish until the end of the record, or of `stop`; `each` is called now and then."""
        while not stop.is_set():
            self._once(stop, each)
            self.bus.until_recorded(self.vehicle, LEAVE_S)
            if not self.loop:
                return
            self.bus.renew_session()  # sequence numbers begin anew: nobody shall count a loss

    def _once(self, stop: Event, each: Callable[[], None]) -> None:
        due = self._paced(self.record.messages(self.match, self.start_ns, self.end_ns), stop, each)
        encodings: dict[str, tuple[str, str]] = {}
        waits, ahead_bytes = self.rate <= 0, 0
        for entry in due:
            if keys.is_apart(entry.topic):
                continue  # a second publisher's: it would be one of ours on the bus
            known = encodings.get(entry.topic)
            if known is None:
                path = keys.split(entry.topic)[1] or entry.topic
                known = encodings[entry.topic] = (
                    keys.full(self.vehicle, path),
                    f"application/protobuf;{self.record.type_of(entry.topic)}",
                )
            self.bus.publish(known[0], entry.payload, known[1], entry.sequence)
            self.published += 1
            self.position_ns = entry.log_ns
            ahead_bytes += len(entry.payload) + ENTRY_BYTES
            if waits and ahead_bytes >= PORTION_BYTES:
                waits, ahead_bytes = self.bus.until_recorded(self.vehicle, PORTION_S), 0

    def _paced(
        self, entries: Iterator[Entry], stop: Event, each: Callable[[], None]
    ) -> Iterator[Entry]:
        """Hold every entry back until it is due."""
        begin_s = time.monotonic()
        first_ns = before_ns = 0
        count = 0
        for entry in entries:
            first_ns = first_ns or entry.log_ns
            if before_ns and entry.log_ns - before_ns > PAUSE_NS:
                skipped_ns = entry.log_ns - before_ns - AFTER_NS
                first_ns += skipped_ns
                self.skipped_ns += skipped_ns
            before_ns = entry.log_ns
            while not stop.is_set():
                now_s = time.monotonic()
                if self.paused:
                    each()
                    stop.wait(WAIT_S)
                    begin_s += time.monotonic() - now_s
                    continue
                due_s = count / UNPACED_RATE_HZ
                if self.rate > 0:
                    due_s = (entry.log_ns - first_ns) / S / self.rate
                wait_s = begin_s + due_s - now_s
                if wait_s <= AHEAD_S:
                    break
                each()
                stop.wait(min(wait_s, WAIT_S))
            if stop.is_set():
                return
            count += 1
            yield entry
