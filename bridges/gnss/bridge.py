"""GNSS bridge: a receiver's bytes to fixes, times, satellites and raw measurements.

What is published does not depend on how the bytes were cut into reads and messages; stamps depend
on the bytes and on the arrival of the read that completed each frame.

**Stamps.** A message with a GPS time is stamped with its epoch, mapped by `ArrivalClock`; before
any time is known, with its arrival less the receiver's delay. Keys whose instant is the arrival get
just that. NMEA has a clock fit of its own, on UTC, because leap seconds may be unknown.

**One fix an epoch.** Solutions have ranks: NAV-PVT and NAV-PVAT before HNR-PVT before NMEA. As soon
as one has been seen, those of lower rank are no longer published as fixes, for they say the same
thing twice, and HNR-PVT says it ahead of the NAV-PVT of an older epoch, which arrives later. It
then goes out whole on `raw/gnss/frame`, so that nothing is lost. Of NAV-PVT and NAV-PVAT of one
epoch the first counts. When a better solution takes over, its fixes are left out until they are
newer than the last one published. So stamps on `raw/gnss/fix` strictly increase, unless the
receiver's own time or the arrivals go backwards.

**Time for the fit.** NAV and HNR messages; RXM-RAWX (receiver's local time, a few milliseconds off)
only where there are none of these.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Any

from tramstream import keys
from tramstream.bridges.gnss import messages as gnss_messages
from tramstream.bridges.gnss import nmea, ubx
from tramstream.bridges.gnss.clock import (
    MS,
    ArrivalClock,
    ArrivalMemory,
    GpsTimeline,
    in_range,
    leap_seconds_on,
)
from tramstream.bridges.gnss.framer import NMEA, UBX, Frame, Framer, Rejected
from tramstream.bridges.gnss.nmea import EpochAssembler
from tramstream.bridges.gnss.ubx import UbxMessage
from tramstream.clock import GPS_EPOCH_UNIX_S, S
from tramstream.config import Gnss, Vehicle
from tramstream.errors import ConfigError
from tramstream.keys import Key
from tramstream.processor import Ledger, Processor, Sample
from tramstream.proto.gnss_pb2 import GnssCovariance, GnssFix, UbxFrame
from tramstream.proto.raw_pb2 import RawBytes

_RANKS = {"NMEA": 1, "HNR-PVT": 2, "NAV-PVT": 3, "NAV-PVAT": 3}
_NAVIGATION = 3


@dataclass(frozen=True)
class LastFix:
    """What must be known of the fix that was published last."""

    source: str
    itow_ms: int
    utc_ns: int
    device_ns: int | None
    """Its time by the clock that it was stamped with; None if another clock has taken over."""
    stamp_ns: int


@dataclass
class BridgeMemory:
    """What a `GnssBridge` remembers."""

    framer: Framer = field(default_factory=Framer)
    assembler: EpochAssembler = field(default_factory=EpochAssembler)
    timeline: GpsTimeline = field(default_factory=GpsTimeline)
    clock: ArrivalMemory = field(default_factory=ArrivalMemory)
    nmea_clock: ArrivalMemory = field(default_factory=ArrivalMemory)
    reads: deque[tuple[int, int]] = field(default_factory=deque)
    """Of each read that is not settled: its end in the stream, its arrival."""
    decoded: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    rank: int = 0
    navigation_time: bool = False
    """Some NAV or HNR message has told the time."""
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
        keys.GNSS_FRAME,
        *dict.fromkeys(key for key, _ in gnss_messages.BUILDERS.values()),
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
        out: list[Sample] = []
        reads = memory.reads
        for item in memory.framer.feed(raw.data):
            if isinstance(item, Rejected):
                continue  # the framer keeps the count
            while reads[0][0] <= item.end:
                reads.popleft()
            arrival_ns = reads[0][1]
            if item.protocol == UBX:
                out += self._take_ubx(item, arrival_ns)
            elif item.protocol == NMEA:
                out += self._take_nmea(item, arrival_ns)
            else:
                memory.decoded += 1  # corrections on their way back: in the raw bytes, nowhere else
        while reads and reads[0][0] <= memory.framer.position:
            reads.popleft()
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
        gps_ns = self.timeline.of(message)
        if gps_ns is not None and self._tells_time(name):
            self.clock.add(gps_ns, arrival_ns, len(frame.raw))
        if name in _RANKS:
            return self._take_solution(message, frame, gps_ns, arrival_ns)
        if name == "NAV-POSLLH" and memory.rank == _NAVIGATION:
            memory.decoded += 1
            return []  # the same position as in the fix
        made = gnss_messages.BUILDERS.get(name)
        if made is None:
            if name == "NAV-EOE":
                memory.decoded += 1
                return []
            return self._whole(frame, arrival_ns)
        memory.decoded += 1
        key, build = made
        out = self.emit(key, build(message, gps_ns), self._stamp(key, gps_ns, arrival_ns))
        if name == "NAV-COV":
            memory.covariance = out.message
        return [out]

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
        rank = _RANKS[message.name]
        if rank < memory.rank:
            return self._whole(frame, arrival_ns)
        memory.decoded += 1
        fix = gnss_messages.fix(message, gps_ns, self.config.max_accuracy_m)
        last = memory.last_fix
        told = (
            last is not None
            and last.itow_ms == fix.itow_ms
            and last.source != fix.source
            and _RANKS[last.source] == rank
        )
        out = [] if told else self._publish(fix, self.clock, gps_ns, arrival_ns)
        if message.name == "NAV-PVAT":
            attitude = gnss_messages.attitude_of_pvat(message, gps_ns)
            stamp_ns = self._stamp(keys.GNSS_ATTITUDE, gps_ns, arrival_ns)
            out.append(self.emit(keys.GNSS_ATTITUDE, attitude, stamp_ns))
        return out

    def _take_nmea(self, frame: Frame, arrival_ns: int) -> list[Sample]:
        memory = self.memory
        kind = nmea.sentence_type(frame)
        if memory.rank > _RANKS["NMEA"] or kind not in nmea.TIMED + nmea.UNTIMED:
            memory.decoded += 1
            return []
        sentence = nmea.parse(frame)
        if isinstance(sentence, Rejected):
            memory.refused[sentence.reason] += 1
            return []
        memory.decoded += 1
        out: list[Sample] = []
        for epoch in memory.assembler.feed(sentence, arrival_ns, len(frame.raw)):
            utc_ns = epoch.utc_ns
            fix = nmea.fix_of(epoch, self.config.max_accuracy_m)
            if epoch.date:
                fix.utc_ns = utc_ns
                if self.timeline.leap_seconds is not None:
                    leap_s = self.timeline.leap_seconds
                    fix.gps_time_ns = utc_ns + (leap_s - GPS_EPOCH_UNIX_S) * S
            self.nmea_clock.add(utc_ns, epoch.first_arrival_ns, epoch.first_size)
            out += self._publish(fix, self.nmea_clock, utc_ns, epoch.first_arrival_ns)
        return out

    def _publish(
        self, fix: GnssFix, clock: ArrivalClock, device_ns: int | None, arrival_ns: int
    ) -> list[Sample]:
        """Publish a fix, and where it is valid its location."""
        memory = self.memory
        rank = memory.rank = _RANKS[fix.source]
        stamp_ns = clock.stamp(device_ns, arrival_ns)
        last = memory.last_fix
        if last is not None and rank > _RANKS[last.source]:
            behind_ns = last.utc_ns - fix.utc_ns
            if fix.utc_ns and -MS <= behind_ns < ArrivalClock.REORDERED_NS:
                return []  # the solution it takes over from has told of a newer epoch
            last = replace(last, device_ns=None)  # its time may have been UTC
        if last is not None and stamp_ns <= last.stamp_ns <= arrival_ns:
            before_ns = last.device_ns
            if device_ns is None or before_ns is None or device_ns >= before_ns:
                stamp_ns = last.stamp_ns + 1
        memory.last_fix = LastFix(fix.source, fix.itow_ms, fix.utc_ns, device_ns, stamp_ns)
        out = [self.emit(keys.GNSS_FIX, fix, stamp_ns)]
        if fix.valid:
            known_covariance = memory.covariance
            if known_covariance is not None and (
                rank != _NAVIGATION or known_covariance.itow_ms != fix.itow_ms
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


def unix_like_ns(gps_time_ns: int) -> int:
    """GPS time as the vehicle clock of an imported capture: since 1970, leap seconds included."""
    return gps_time_ns + GPS_EPOCH_UNIX_S * S


def epoch_times(data: bytes) -> list[tuple[int, int]]:
    """GPS times in a capture that has no arrival times, for assigning arrivals to its pieces.

    Week and leap seconds may come late in a capture: they are looked for first. Where no message
    tells the leap seconds, the date does. A time older than its predecessor (NAV-PVT behind the
    HNR-PVT of a later epoch) is left out, unless it is so by more than `JUMP_BACK_S`.

    Returns
    -------
    list of tuple
        Place in `data` just behind a frame, and GPS time of its epoch, ns since 1980-01-06.
    """
    framer = Framer()
    frames = [item for item in framer.feed(data) + framer.flush() if isinstance(item, Frame)]
    messages = [(frame.end + 1, ubx.decode(frame)) for frame in frames if frame.protocol == UBX]
    timeline = GpsTimeline()
    for _, message in messages:
        if not isinstance(message, Rejected):
            timeline.of(message)
        if timeline.reference_ns is not None and timeline.leap_seconds is not None:
            break
    leap_seconds = timeline.leap_seconds
    times = [
        (end, gps_ns)
        for end, message in messages
        if not isinstance(message, Rejected) and (gps_ns := timeline.of(message)) is not None
    ]
    times += _nmea_times(frames, leap_seconds)
    times.sort(key=lambda time: time[0])
    return _never_back(times)


JUMP_BACK_S = 2
"""A receiver's time that falls back this far has jumped."""


def _nmea_times(frames: list[Frame], leap_seconds: int | None) -> list[tuple[int, int]]:
    """GPS times of NMEA epochs with a date, at their first sentence."""
    assembler = EpochAssembler()
    epochs: list[tuple[int, nmea.Epoch]] = []
    for frame in frames:
        if frame.protocol != NMEA or nmea.sentence_type(frame) not in ("GGA", "GNS", "RMC", "ZDA"):
            continue
        sentence = nmea.parse(frame)
        if not isinstance(sentence, Rejected):
            place = frame.end + 1  # taken for the arrival
            epochs += [(e.first_arrival_ns, e) for e in assembler.feed(sentence, place, 0)]
    epochs += [(epoch.first_arrival_ns, epoch) for epoch in assembler.flush()]
    times: list[tuple[int, int]] = []
    for end, epoch in epochs:
        if epoch.date:
            leap_s = leap_seconds_on(epoch.utc_ns) if leap_seconds is None else leap_seconds
            times.append((end, epoch.utc_ns + (leap_s - GPS_EPOCH_UNIX_S) * S))
    return times


def _never_back(times: list[tuple[int, int]]) -> list[tuple[int, int]]:
    kept: list[tuple[int, int]] = []
    for end, gps_ns in times:
        late_ns = kept[-1][1] - gps_ns if kept else 0
        if late_ns <= 0 or late_ns > JUMP_BACK_S * S:
            kept.append((end, gps_ns))
    return kept
