"""Odometry bridge: CAN frames to wheel readings.

Only frames that carry a configured signal are decoded. A wheel counts by what it is: `pulses` are
added up, a `counter` is unwrapped (`wheels.py`: a step of half its range or more is a step
backwards, a tram backs), a `speed` is the last one. As soon as every configured wheel has been seen
since the last reading, one is published with the stamp of the frame that completed it; a wheel that
has been silent for `silence_s` is not waited for and left out. Doors and motor force ride along as
last known.

A frame that cannot be used (too short, remote, an error frame, not a number, a value that stands
for none) is counted by reason. Frames that only their reader stamped are stamped by the cycle of
their message (`cycle.py`). Of J1939 the parameter group and the sender count (`j1939.py`): where
the DBC names any, the first that is heard is the one, until it falls silent.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from tramstream import keys
from tramstream.bridges.odometer import events as own_events
from tramstream.bridges.odometer import j1939
from tramstream.bridges.odometer.cycle import LATE_NS, Cycle, CycleMemory
from tramstream.bridges.odometer.dbc import EXTENDED_ID, NO_NUMBER, SHORT, Database, Field
from tramstream.bridges.odometer.frames import (
    ERROR,
    EXTENDED,
    HOST_OVERFLOW,
    REMOTE,
    classify_error,
)
from tramstream.bridges.odometer.wheels import UnknownWay, Wheel, WheelMemory
from tramstream.clock import S
from tramstream.config import Odometer, Signal, Vehicle
from tramstream.errors import ConfigError
from tramstream.events.kinds import Event, declared
from tramstream.processor import Ledger, Processor, Sample
from tramstream.proto.raw_pb2 import CanFrames, Odometry

REJECT_REMOTE = "remote frame"
REJECT_SHORT = SHORT
REJECT_NAN = NO_NUMBER
NOTE_LATE = "read late"
NOTE_LOST = "lost from a cycle"
NOTE_SENDER = "of another sender (J1939)"
NOTE_UNKNOWN = "way not known"
LATE_SAID_NS = S // 20
"""Lateness that is said; a third of it is the width of what the filter expects of a bus."""


class _Plan:
    """What is wanted of one message."""

    def __init__(self, message: str, address: j1939.Address | None) -> None:
        self.message = message
        self.address = address
        self.wheels: list[Wheel] = []
        self.signals: list[tuple[str, Field, float]] = []
        self.cycle: Cycle | None = None


@dataclass
class SenderMemory:
    """Whom a message of J1939 is taken from, where the DBC names any sender."""

    source: int = -1
    heard_ns: int = 0


@dataclass
class BridgeMemory:
    """What an `OdometerBridge` remembers."""

    wheels: dict[str, WheelMemory] = field(default_factory=dict)
    """By name, those that are configured."""
    cycles: dict[str, CycleMemory] = field(default_factory=dict)
    """By message, of those that carry wheels."""
    senders: dict[str, SenderMemory] = field(default_factory=dict)
    """By message, of those of J1939 that anybody may send."""
    known: dict[str, float] = field(default_factory=dict)
    """Doors and motor force."""
    decoded: int = 0
    passed_over: int = 0
    rejected: dict[str, int] = field(default_factory=dict)
    bytes_rejected: int = 0
    frames_lost: int = 0
    values_published: int = 0
    values_replaced: int = 0
    notes: dict[str, int] = field(default_factory=dict)
    """What was noticed of frames that were used."""
    published_ns: int = 0
    """Stamp of the last reading."""
    first_ns: int = 0
    """Stamp of the first frame."""
    heard: bool = False
    """Whether a configured message has come."""


class OdometerBridge(Processor):
    """`CanFrames` to `Odometry`."""

    name = "odometer"
    Settings = Odometer
    Memory = BridgeMemory
    memory: BridgeMemory
    inputs = (keys.ODO_FRAMES,)
    outputs = (keys.ODO_WHEELS,)
    events = declared(own_events)

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        if vehicle.odometer is None:
            raise ConfigError(
                "$.odometer: missing", cure="the odometer bridge needs its DBC and wheels"
            )
        self._wheels: list[Wheel] = []
        self._plans: dict[str, _Plan] = {}
        self._by_id: dict[int, _Plan] = {}
        self._by_sender: dict[j1939.Address, _Plan] = {}
        self._of_anybody: dict[int, _Plan] = {}
        self._not_theirs: dict[int, set[int]] = {}
        self._m_per_pulse = vehicle.wheels.m_per_pulse
        self._silence_ns = int(vehicle.odometer.silence_s * S)
        self._compile(vehicle.odometer)

    def _compile(self, config: Odometer) -> None:
        """Look up the configured signals in the DBC."""
        if not config.wheels:
            raise ConfigError(
                "$.odometer.wheels: empty", cure="name at least one wheel and its signal"
            )
        database = Database(config.dbc, "$.odometer.dbc")
        for name, wheel in config.wheels.items():
            where = f"$.odometer.wheels.{name}"
            key, found = database.find(wheel.message, wheel.signal, where)
            if wheel.kind == "counter" and wheel.counter_bits > found.length:
                raise ConfigError(
                    f"{where}.counter_bits: {wheel.counter_bits}, but signal '{wheel.signal}' has "
                    f"{found.length} bits in {config.dbc}"
                )
            memory = self.memory.wheels[name] = WheelMemory()
            self._wheels.append(Wheel(name, wheel, found, self._m_per_pulse, memory))
            plan = self._plan(wheel.message, key, database)
            plan.wheels.append(self._wheels[-1])
            if plan.cycle is None:
                plan.cycle = Cycle(self.memory.cycles.setdefault(wheel.message, CycleMemory()))
        for what in ("doors_open", "motor_force_n"):
            signal: Signal | None = getattr(config, what)
            if signal is not None:
                key, found = database.find(signal.message, signal.signal, f"$.odometer.{what}")
                plan = self._plan(signal.message, key, database)
                plan.signals.append((what, found, signal.scale))

    def _plan(self, message: str, key: int, database: Database) -> _Plan:
        if message in self._plans:
            return self._plans[message]
        address = database.address(message)
        plan = self._plans[message] = _Plan(message, address)
        if address is None:
            self._by_id[key] = plan
        elif address.source == j1939.ANY_SOURCE:
            self._of_anybody[address.group] = plan
            self._not_theirs[address.group] = database.senders(address.group)
            self.memory.senders[message] = SenderMemory()
        else:
            self._by_sender[address] = plan
        return plan

    def restored(self) -> None:
        for plan in self._plans.values():
            if plan.cycle is not None:
                plan.cycle.restored()

    def step(self, sample: Sample) -> list[Sample]:
        message: CanFrames = sample.message
        out: list[Sample] = []
        columns = zip(message.offset_ns, message.id, message.flags, message.data, strict=False)
        for offset_ns, id_, flags, data in columns:
            stamp_ns = message.stamp_ns + offset_ns
            if flags & ERROR:
                self._take_error(id_, data)
                continue
            plan = self._planned(id_, flags, stamp_ns, out)
            if plan is None:
                self._pass_over(stamp_ns, out)
            elif flags & REMOTE:
                self._reject(REJECT_REMOTE, data)
            else:
                if message.read_stamps and plan.cycle is not None:
                    stamp_ns = self._by_cycle(plan, plan.cycle, stamp_ns, out)
                if self._decode(plan, data, stamp_ns, out) and self._complete(stamp_ns):
                    out.append(self._publish(stamp_ns))
        return out

    def wants(self, id_: int, flags: int) -> str | None:
        """Message that a frame is taken for, whoever sends it; None where it is passed over."""
        plan = None
        if not flags & (ERROR | EXTENDED):
            plan = self._by_id.get(id_)
        elif flags & EXTENDED:
            address = j1939.address_of(id_)
            plan = self._by_id.get(id_ | EXTENDED_ID) or self._by_sender.get(address)
            if address.source not in self._not_theirs.get(address.group, ()):
                plan = plan or self._of_anybody.get(address.group)
        return None if plan is None else plan.message

    def _planned(self, id_: int, flags: int, stamp_ns: int, out: list[Sample]) -> _Plan | None:
        """What is wanted of a frame, if anything is."""
        if not flags & EXTENDED:
            return self._by_id.get(id_)
        plan = self._by_id.get(id_ | EXTENDED_ID)
        if plan is not None or not (self._by_sender or self._of_anybody):
            return plan
        address = j1939.address_of(id_)
        plan = self._by_sender.get(address)
        if plan is not None:
            return plan
        plan = self._of_anybody.get(address.group)
        if plan is not None:
            if address.source in self._not_theirs[address.group]:
                return None  # another message of the DBC
            sender = self.memory.senders[plan.message]
            if sender.source != address.source:
                if sender.source >= 0 and stamp_ns - sender.heard_ns <= self._silence_ns:
                    self._note_sender(plan, address, f"{sender.source:02X}", stamp_ns, out)
                    return None
                for wheel in plan.wheels:
                    wheel.forget_counter()
                sender.source = address.source
            sender.heard_ns = stamp_ns
            return plan
        for wanted, plan in self._by_sender.items():
            if wanted.group == address.group:
                self._note_sender(plan, address, f"{wanted.source:02X}", stamp_ns, out)
        return None

    def _note_sender(
        self, plan: _Plan, address: j1939.Address, wanted: str, stamp_ns: int, out: list[Sample]
    ) -> None:
        self._note(NOTE_SENDER)
        heard = f"{address.source:02X}"
        said = own_events.OTHER_SENDER(message=plan.message, heard=heard, wanted=wanted)
        out += self.raise_event(said, stamp_ns)

    def _pass_over(self, stamp_ns: int, out: list[Sample]) -> None:
        """Count a frame that carries nothing configured; say so where none ever does."""
        memory = self.memory
        memory.passed_over += 1
        if memory.heard:
            return
        memory.first_ns = memory.first_ns or stamp_ns
        heard_ns = stamp_ns - memory.first_ns
        if heard_ns > self._silence_ns:
            unheard = own_events.UNHEARD(
                frames=memory.passed_over, heard_s=heard_ns / S, messages=", ".join(self._plans)
            )
            out += self.raise_event(unheard, stamp_ns)

    def _by_cycle(self, plan: _Plan, cycle: Cycle, arrival_ns: int, out: list[Sample]) -> int:
        """When a frame was sent that a reader stamped; no earlier than the last reading."""
        skipped = cycle.memory.skipped
        stamp_ns = cycle.stamp(arrival_ns)
        if stamp_ns <= self.memory.published_ns <= arrival_ns:
            stamp_ns = self.memory.published_ns + 1
        self._note(NOTE_LOST, cycle.memory.skipped - skipped)
        if cycle.late_ns > LATE_NS:
            self._note(NOTE_LATE)
        if cycle.late_ns > LATE_SAID_NS:
            late = own_events.READ_LATE(
                message=plan.message,
                late_s=cycle.late_ns / S,
                cycle_s=cycle.period_ns / S,
                late=cycle.memory.late,
            )
            out += self.raise_event(late, arrival_ns)
        return stamp_ns

    def _complete(self, stamp_ns: int) -> bool:
        """Whether every wheel that is not silent has been seen since the last reading."""
        wheels = self.memory.wheels.values()
        for wheel in wheels:
            wheel.seen_ns = wheel.seen_ns or stamp_ns  # silence begins with the first frame
        silent_ns = stamp_ns - self._silence_ns
        return all(wheel.values or wheel.seen_ns < silent_ns for wheel in wheels)

    def _decode(self, plan: _Plan, data: bytes, stamp_ns: int, out: list[Sample]) -> bool:
        """Take a frame's values; whether a wheel was among them."""
        memory = self.memory
        memory.heard = True
        found = [(wheel, wheel.read(data)) for wheel in plan.wheels]
        known = [(what, signal.read(data, scale), scale) for what, signal, scale in plan.signals]
        values = [value for _, value in found] + [value for _, value, _ in known]
        reasons = [value for value in values if isinstance(value, str)]
        unusable = next((each for each in reasons if each in (SHORT, NO_NUMBER)), "")
        if unusable or (reasons and len(reasons) == len(values) - values.count(None)):
            self._reject(unusable or reasons[0], data)
            self._forget(known)
            return False
        for reason in reasons:
            self._note(reason)
        memory.decoded += 1
        self._forget(known)
        for what, value, scale in known:
            if isinstance(value, float | int):
                memory.known[what] = value * scale
        seen = False
        for wheel, value in found:
            if isinstance(value, float | int):
                unknown = wheel.take(value, stamp_ns)
                seen = True
                if unknown is not None:
                    self._note(NOTE_UNKNOWN)
                    out += self.raise_event(_unknown_way(unknown), stamp_ns)
        return seen

    def _forget(self, known: list[tuple[str, float | str | None, float]]) -> None:
        """Of what stands for no value nothing is known any more: better than an old one."""
        for what, value, _ in known:
            if isinstance(value, str) and value not in (SHORT, NO_NUMBER):
                self.memory.known.pop(what, None)

    def _publish(self, stamp_ns: int) -> Sample:
        memory = self.memory
        message = Odometry()
        for wheel in self._wheels:
            values = wheel.memory.values
            if not values:
                continue  # silent: better no reading than an old one
            if wheel.kind == "speed":
                message.wheels.add(wheel=wheel.name, speed_mps=wheel.memory.speed_mps or 0.0)
                memory.values_replaced += values - 1
                memory.values_published += 1
            else:
                message.wheels.add(wheel=wheel.name, pulses=wheel.pulses)
                memory.values_published += values
            wheel.memory.values = 0
        if "doors_open" in memory.known:
            message.doors_open = memory.known["doors_open"] >= 0.5
        if "motor_force_n" in memory.known:
            message.motor_force_n = memory.known["motor_force_n"]
        memory.published_ns = stamp_ns
        return self.emit(keys.ODO_WHEELS, message, stamp_ns)

    def _take_error(self, id_: int, data: bytes) -> None:
        if id_ & HOST_OVERFLOW:
            self.memory.frames_lost += int.from_bytes(data, "big")
        self._reject(classify_error(id_, data), data)

    def _reject(self, reason: str, data: bytes) -> None:
        memory = self.memory
        memory.rejected[reason] = memory.rejected.get(reason, 0) + 1
        memory.bytes_rejected += len(data)

    def _note(self, what: str, count: int = 1) -> None:
        if count:
            self.memory.notes[what] = self.memory.notes.get(what, 0) + count

    def ledgers(self) -> list[Ledger]:
        """Frames: delivered counts those that carry nothing configured too, they are passed over.

        Readings: values of wheels; pulses that wait are added up, a speed that waits is dropped
        when a newer one comes.
        """
        memory = self.memory
        rejected = sum(memory.rejected.values())
        delivered = memory.decoded + memory.passed_over
        pending = sum(wheel.values for wheel in memory.wheels.values())
        published, replaced = memory.values_published, memory.values_replaced
        received = published + replaced + pending
        return [
            Ledger(self.name, "frames", delivered + rejected, delivered, rejected),
            Ledger(self.name, "readings", received, published, replaced, pending),
        ]

    def device_counters(self) -> dict[str, Any]:
        """Figures of `DeviceHealth`, under its field names; error frames count as rejected.

        `rejected_by_reason` also holds what was noticed of frames that were used, or passed over
        (late, of another sender), so it may add up to more than `frames_rejected`.
        """
        memory = self.memory
        return {
            "messages_decoded": memory.decoded,
            "frames_rejected": sum(memory.rejected.values()),
            "bytes_rejected": memory.bytes_rejected,
            "samples_lost": memory.frames_lost,
            "rejected_by_reason": {**memory.rejected, **_added(memory.rejected, memory.notes)},
        }


def _added(rejected: dict[str, int], notes: dict[str, int]) -> dict[str, int]:
    """Notes, and with them the frames that were rejected for the same reason."""
    return {reason: count + rejected.get(reason, 0) for reason, count in notes.items()}


def _unknown_way(unknown: UnknownWay) -> Event:
    return own_events.WAY_UNKNOWN(wheel=unknown.wheel, gap_s=unknown.gap_s, reason=unknown.reason)
