"""GNSS bridge: a receiver's bytes to fixes, times, satellites, raw measurements and its state.

What is published does not depend on how the bytes were cut into reads and messages; stamps depend
on the bytes and on the arrival of the read that completed each frame.

**Stamps.** A message with a GPS time is stamped with its epoch, mapped by `ArrivalClock`; before
any time is known, with its arrival less the receiver's delay. Keys whose instant is the arrival get
just that. NMEA has a clock fit of its own, on UTC, because leap seconds may be unknown.

**One fix an epoch.** Solutions have ranks: NAV-PVT and NAV-PVAT before HNR-PVT before what older
receivers say in several messages (`combined.py`) before NMEA before a place without a word on its
quality (NAV-POSLLH alone). As soon as one has been seen, those of lower rank are no longer
published as fixes, for they say the same thing twice; HNR-PVT, which says it ahead of the NAV-PVT
of an older epoch, then goes out on `raw/gnss/high_rate`. Of NAV-PVT and NAV-PVAT of one epoch, or
one that comes twice, the first counts. When a better solution takes over, its fixes are left out
until they are newer than the last one published. So stamps on `raw/gnss/fix` strictly increase,
unless the receiver's own time or the arrivals go backwards.

**Time for the fit.** NAV and HNR messages; RXM-RAWX (receiver's local time, a few milliseconds off)
only where there are none of these.

**The receiver's own words** on jamming and spoofing (SEC-SIG, MON-RF, MON-HW, NAV-STATUS) go out on
`raw/gnss/interference`, and the worst of the last ten seconds stands in each fix, for whoever uses
fixes.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any

from tramstream import keys
from tramstream.bridges.gnss import combined, fix_stream, line, nmea, ubx
from tramstream.bridges.gnss import messages as gnss_messages
from tramstream.bridges.gnss.builders import BUILDERS
from tramstream.bridges.gnss.clock import (
    ArrivalClock,
    ArrivalMemory,
    GpsTimeline,
    behind_ns,
    in_range,
)
from tramstream.bridges.gnss.combined import CombinationAssembler
from tramstream.bridges.gnss.fix_stream import (
    COMBINED,
    HIGH_RATE,
    NAVIGATION,
    NMEA_RANK,
    PLACE,
    LastFix,
)
from tramstream.bridges.gnss.framer import NMEA, UBX, Frame, Framer, Rejected
from tramstream.bridges.gnss.interference import Interference
from tramstream.bridges.gnss.nmea import EpochAssembler
from tramstream.bridges.gnss.nmea_sentences import TIMED, UNTIMED, parse, sentence_type
from tramstream.bridges.gnss.ubx import UbxMessage
from tramstream.clock import GPS_EPOCH_UNIX_S, S
from tramstream.config import Gnss, Vehicle
from tramstream.errors import ConfigError
from tramstream.events.kinds import Event
from tramstream.keys import Key
from tramstream.processor import Ledger, Processor, Sample
from tramstream.proto.gnss_pb2 import GnssCovariance, GnssFix, GnssInterference, UbxFrame
from tramstream.proto.raw_pb2 import RawBytes

_RANKS = {"HNR-PVT": HIGH_RATE, "NAV-PVT": NAVIGATION, "NAV-PVAT": NAVIGATION}
_IN_THE_FIX = ("NAV-SOL", "NAV-VELNED", "NAV-POSECEF", "NAV-VELECEF", "NAV-EOE")
"""Parts of a fix that say nothing else, and the end of an epoch."""


@dataclass
class BridgeMemory:
    """What a `GnssBridge` remembers."""

    framer: Framer = field(default_factory=Framer)
    assembler: EpochAssembler = field(default_factory=EpochAssembler)
    combinations: CombinationAssembler = field(default_factory=CombinationAssembler)
    timeline: GpsTimeline = field(default_factory=GpsTimeline)
    clock: ArrivalMemory = field(default_factory=ArrivalMemory)
    nmea_clock: ArrivalMemory = field(default_factory=ArrivalMemory)
    interference: Interference = field(default_factory=Interference)
    line: line.LineMemory = field(default_factory=line.LineMemory)
    reads: deque[tuple[int, int]] = field(default_factory=deque)
    """Of each read that is not settled: its end in the stream, its arrival."""
    decoded: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    rank: int = 0
    navigation_time: bool = False
    """Some NAV or HNR message has told the time."""
    arrival_ns: int = 0
    """Of the last read."""
    last_fix: LastFix | None = None
    covariance: GnssCovariance | None = None


class GnssBridge(Processor):
    """Receiver's bytes to messages; see the head of the module."""

    name = "gnss"
    Settings = Gnss
    Memory = BridgeMemory
    memory: BridgeMemory
    inputs = (keys.GNSS_BYTES,)
    outputs = (
        keys.GNSS_FIX,
        keys.GNSS_LOCATION,
        keys.GNSS_HIGH_RATE,
        keys.GNSS_FRAME,
        *dict.fromkeys(key for key, _ in BUILDERS.values()),
    )

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        if vehicle.gnss is None:
            raise ConfigError("$.gnss is missing: the GNSS bridge needs a receiver")
        self.config = vehicle.gnss
        delay_s, baud_rate = vehicle.gnss.receiver_delay_s, vehicle.gnss.baud_rate
        memory = self.memory
        self.clock = ArrivalClock(delay_s, baud_rate, memory.clock)
        self.nmea_clock = ArrivalClock(delay_s, baud_rate, memory.nmea_clock)
        self.timeline = memory.timeline

    def step(self, sample: Sample) -> list[Sample]:
        memory = self.memory
        raw: RawBytes = sample.message
        self._note_reads(raw, sample.stamp_ns)
        frames = memory.framer.frames
        out = self._take(memory.framer.feed(raw.data))
        memory.line.note(raw.data, understood=memory.framer.frames > frames)
        return out

    def finish(self) -> list[Sample]:
        """End of the bytes: what the framer still holds, and the epochs under way."""
        memory = self.memory
        out = self._take(memory.framer.flush())
        for each in memory.combinations.flush():
            out += self._publish_combination(each, memory.arrival_ns)
        for epoch in memory.assembler.flush():
            out += self._publish_epoch(epoch)
        return out

    def _take(self, items: list[Frame | Rejected]) -> list[Sample]:
        memory = self.memory
        out: list[Sample] = []
        reads = memory.reads
        for item in items:
            if isinstance(item, Rejected):
                continue  # the framer keeps the count
            while reads and reads[0][0] <= item.end:
                reads.popleft()
            arrival_ns = reads[0][1] if reads else memory.arrival_ns
            if item.protocol == UBX:
                out += self._take_ubx(item, arrival_ns)
            elif item.protocol == NMEA:
                out += self._take_nmea(item, arrival_ns)
            else:
                memory.decoded += 1  # corrections on their way back: in the raw bytes, nowhere else
        while reads and reads[0][0] <= memory.framer.position:
            memory.arrival_ns = reads.popleft()[1]
        return out

    def _note_reads(self, raw: RawBytes, stamp_ns: int) -> None:
        """Remember when each read of `raw` arrived; what no read claims came with the last."""
        memory = self.memory
        start = memory.framer.bytes_in
        size = len(raw.data)
        arrival_ns = stamp_ns
        if len(raw.read_length) == len(raw.read_offset_ns):
            ends = accumulate(raw.read_length)
            for end, offset_ns in zip(ends, raw.read_offset_ns, strict=True):
                arrival_ns = in_range(stamp_ns + offset_ns)
                if end >= size:
                    break
                memory.reads.append((start + end, arrival_ns))
        if size:
            memory.reads.append((start + size, arrival_ns))

    def _take_ubx(self, frame: Frame, arrival_ns: int) -> list[Sample]:
        memory = self.memory
        if not ubx.knows(frame.kind) or len(frame.raw) == ubx.REQUEST_LENGTH:
            return self._whole(frame, arrival_ns)
        message = ubx.decode(frame)
        if isinstance(message, Rejected):
            memory.refused[message.reason] += 1
            return []
        name = message.name
        gps_ns = self.timeline.of(message, arrival_ns)
        if gps_ns is not None and self._tells_time(name):
            self.clock.add(gps_ns, arrival_ns, len(frame.raw))
        if name in _RANKS:
            return self._take_solution(message, frame, gps_ns, arrival_ns)
        made = BUILDERS.get(name)
        if made is None and name not in _IN_THE_FIX:
            return self._whole(frame, arrival_ns)
        memory.decoded += 1
        out = self._take_part(message, gps_ns, arrival_ns)
        if made is None or (name == "NAV-POSLLH" and memory.rank == NAVIGATION):
            return out  # the same position as in the fix
        key, build = made
        built = build(message, gps_ns)
        if isinstance(built, GnssInterference) and not memory.interference.take(built, arrival_ns):
            return out
        sample = self.emit(key, built, self._stamp(key, gps_ns, arrival_ns))
        if name == "NAV-COV":
            memory.covariance = sample.message
        return [*out, sample]

    def _tells_time(self, name: str) -> bool:
        """Whether the arrival of message `name` may enter the clock fit."""
        memory = self.memory
        if name.startswith(("NAV-", "HNR-")):
            memory.navigation_time = True
            return True
        return name == "RXM-RAWX" and not memory.navigation_time

    def _stamp(self, key: Key, gps_ns: int | None, arrival_ns: int) -> int:
        return arrival_ns if key.instant == "arrival" else self.clock.stamp(gps_ns, arrival_ns)

    def _whole(self, frame: Frame, arrival_ns: int) -> list[Sample]:
        self.memory.decoded += 1
        message = UbxFrame(
            message_class=frame.kind >> 8,
            message_id=frame.kind & 0xFF,
            name=frame.name,
            payload=frame.payload,
        )
        return [self.emit(keys.GNSS_FRAME, message, arrival_ns)]

    def _take_solution(
        self, message: UbxMessage, frame: Frame, gps_ns: int | None, arrival_ns: int
    ) -> list[Sample]:
        """NAV-PVT, NAV-PVAT and HNR-PVT."""
        memory = self.memory
        memory.decoded += 1
        rank = _RANKS[message.name]
        fix = gnss_messages.fix(message, gps_ns, self.config.max_accuracy_m)
        if rank < memory.rank:
            memory.interference.mark(fix, arrival_ns)
            return [self.emit(keys.GNSS_HIGH_RATE, fix, self.clock.stamp(gps_ns, arrival_ns))]
        out: list[Sample] = []
        if not fix_stream.is_told(memory.last_fix, fix, rank, frame.payload):
            instant = self.clock, gps_ns, arrival_ns
            out = self._publish(fix, rank, instant, frame.payload)
        if message.name == "NAV-PVAT":
            attitude = gnss_messages.attitude_of_pvat(message, gps_ns)
            stamp_ns = self._stamp(keys.GNSS_ATTITUDE, gps_ns, arrival_ns)
            out.append(self.emit(keys.GNSS_ATTITUDE, attitude, stamp_ns))
        return out

    def _take_part(self, message: UbxMessage, gps_ns: int | None, arrival_ns: int) -> list[Sample]:
        """What is only a part of a fix, and the fixes that it completes."""
        assembler = self.memory.combinations
        epochs: list[combined.Combination] = []
        if message.name == "NAV-EOE":
            epochs = assembler.flush()
        elif message.name in combined.PARTS and self.memory.rank < HIGH_RATE:
            epochs = assembler.feed(message, gps_ns, arrival_ns)
        return [each for e in epochs for each in self._publish_combination(e, arrival_ns)]

    def _publish_combination(self, epoch: combined.Combination, arrival_ns: int) -> list[Sample]:
        """The fix of receivers before NAV-PVT; none where there is a better solution."""
        rank = COMBINED if epoch.is_judged else PLACE
        if rank < self.memory.rank:
            return []
        fix = combined.fix_of(epoch, self.config.max_accuracy_m)
        leap_seconds = self.timeline.leap_seconds
        if epoch.gps_ns is not None and leap_seconds is not None and not fix.utc_ns:
            fix.utc_ns = epoch.gps_ns + (GPS_EPOCH_UNIX_S - leap_seconds) * S
        arrival_ns = min(epoch.first_arrival_ns, arrival_ns)
        return self._publish(fix, rank, (self.clock, epoch.gps_ns, arrival_ns))

    def _take_nmea(self, frame: Frame, arrival_ns: int) -> list[Sample]:
        memory = self.memory
        kind = sentence_type(frame)
        if memory.rank > NMEA_RANK or kind not in TIMED + UNTIMED:
            memory.decoded += 1
            return []
        sentence = parse(frame)
        if isinstance(sentence, Rejected):
            memory.refused[sentence.reason] += 1
            return []
        memory.decoded += 1
        out: list[Sample] = []
        for epoch in memory.assembler.feed(sentence, arrival_ns, len(frame.raw)):
            out += self._publish_epoch(epoch)
        return out

    def _publish_epoch(self, epoch: nmea.Epoch) -> list[Sample]:
        """The fix of a complete epoch of NMEA; none where there is a better solution."""
        if self.memory.rank > NMEA_RANK:
            return []
        utc_ns = epoch.utc_ns
        fix = nmea.fix_of(epoch, self.config.max_accuracy_m)
        if epoch.date:
            utc_ns += behind_ns(utc_ns, epoch.first_arrival_ns)
            utc_ns += self.timeline.in_its_age(gps_ns := utc_ns - GPS_EPOCH_UNIX_S * S) - gps_ns
            fix.utc_ns = utc_ns
            if self.timeline.leap_seconds is not None:
                leap_s = self.timeline.leap_seconds
                fix.gps_time_ns = utc_ns + (leap_s - GPS_EPOCH_UNIX_S) * S
        self.nmea_clock.add(utc_ns, epoch.first_arrival_ns, epoch.first_size)
        return self._publish(fix, NMEA_RANK, (self.nmea_clock, utc_ns, epoch.first_arrival_ns))

    def _publish(
        self,
        fix: GnssFix,
        rank: int,
        instant: tuple[ArrivalClock, int | None, int],
        payload: bytes = b"",
    ) -> list[Sample]:
        """Publish a fix, and where it is valid its location.

        `instant` is the clock that stamps it, its time by that clock, its arrival.
        """
        memory = self.memory
        clock, device_ns, arrival_ns = instant
        memory.rank = max(rank, memory.rank)
        last = memory.last_fix
        if fix_stream.takes_over_early(last, fix, rank):
            return []  # the solution it takes over from has told of a newer epoch
        stamp_ns = clock.stamp(device_ns, arrival_ns)
        stamp_ns = fix_stream.stamp_after(last, rank, stamp_ns, device_ns, arrival_ns)
        memory.last_fix = LastFix(
            fix.source, rank, fix.itow_ms, fix.utc_ns, device_ns, stamp_ns, payload
        )
        memory.interference.mark(fix, arrival_ns)
        out = [self.emit(keys.GNSS_FIX, fix, stamp_ns)]
        if fix.valid:
            known_covariance = memory.covariance
            if known_covariance is not None and (
                rank not in (COMBINED, NAVIGATION) or known_covariance.itow_ms != fix.itow_ms
            ):
                known_covariance = None
            location = gnss_messages.location(fix, known_covariance)
            out.append(self.emit(keys.GNSS_LOCATION, location, stamp_ns))
        return out

    def ledgers(self) -> list[Ledger]:
        """Bytes, and the frames cut from them: delivered were understood, dropped were refused."""
        memory = self.memory
        framer = memory.framer
        return [
            Ledger(
                self.name, "bytes", framer.bytes_in, framer.bytes_in_frames,
                framer.bytes_rejected, framer.bytes_pending,
            ),
            Ledger(self.name, "frames", framer.frames, memory.decoded, memory.refused.total(), 0),
        ]  # fmt: skip

    def device_counters(self) -> dict[str, Any]:
        """Figures of `DeviceHealth`, under its field names.

        The clock's offset is against GPS time (NMEA: UTC) counted from the Unix epoch.
        """
        memory = self.memory
        reasons = memory.framer.false_starts + memory.refused
        counters: dict[str, Any] = {
            "messages_decoded": memory.decoded,
            "frames_rejected": reasons.total(),
            "bytes_rejected": memory.framer.bytes_rejected,
            "rejected_by_reason": dict(reasons),
        }
        gps, nmea_only = self.clock.fit, self.nmea_clock.fit
        fit = gps if gps.ready else nmea_only
        if fit.ready:
            epoch_s = GPS_EPOCH_UNIX_S if fit is gps else 0
            counters["clock_offset_s"] = fit.offset_ns / S - epoch_s
            counters["clock_skew_ppm"] = fit.skew * 1e6
            counters["clock_residual_s"] = fit.residual_ns / S
        return counters

    def device_troubles(self) -> list[Event]:
        """What is wrong now with the line, and what the receiver says of its signals."""
        memory = self.memory
        wrong = line.judge(memory.line, self.config.baud_rate)
        found = [] if wrong is None else [wrong]
        return found + memory.interference.troubles(memory.arrival_ns)
