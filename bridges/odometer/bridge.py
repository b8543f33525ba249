"""Odometry bridge: CAN frames to wheel readings.

Only frames that carry a configured signal are decoded. A wheel counts by what it is: `pulses` are
added up, a `counter` is unwrapped (a step of half its range or more is a step backwards: a tram
backs), a `speed` is the last one. As soon as every configured wheel has been seen since the last
reading, one is published with the arrival of the frame that completed it; a wheel that has been
silent for `silence_s` is not waited for and left out. Doors and motor force
ride along as last known.

A frame that cannot be used (too short, remote, an error frame, not a number) is counted by reason.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from tramstream import keys
from tramstream.bridges.odometer.dbc import EXTENDED_ID, Database, Field
from tramstream.bridges.odometer.frames import (
    ERROR,
    EXTENDED,
    HOST_OVERFLOW,
    REMOTE,
    classify_error,
)
from tramstream.clock import S
from tramstream.config import Odometer, Signal, Vehicle
from tramstream.config import Wheel as WheelConfig
from tramstream.errors import ConfigError
from tramstream.processor import Ledger, Processor, Sample
from tramstream.proto.raw_pb2 import CanFrames, Odometry

REJECT_REMOTE = "remote frame"
REJECT_SHORT = "frame too short"
REJECT_NAN = "not a number"


@dataclass
class WheelMemory:
    """What is known of one wheel."""

    total: float = 0
    """Pulses before scaling; for a counter before the DBC's too."""
    counter: int | None = None
    speed_mps: float = 0.0
    values: int = 0
    """Since the last reading."""
    seen_ns: int = 0


class _Wheel:
    """One wheel as configured, and what is known of it."""

    def __init__(self, name: str, config: WheelConfig, signal: Field, memory: WheelMemory) -> None:
        self.name = name
        self.kind = config.kind
        self.signal = signal
        self.scale = config.scale
        self.range = 1 << config.counter_bits
        self.memory = memory

    def take(self, value: float, data: bytes, stamp_ns: int) -> None:
        """Take the physical value of a frame."""
        memory = self.memory
        if self.kind == "speed":
            memory.speed_mps = value * self.scale
        elif self.kind == "pulses":
            memory.total += value
        else:
            raw = self.signal.raw(data)
            assert raw is not None  # the caller has its physical value
            counter = int(raw)
            if memory.counter is not None:
                half = self.range // 2
                memory.total += (counter - memory.counter + half) % self.range - half
            memory.counter = counter
        memory.values += 1
        memory.seen_ns = stamp_ns

    @property
    def pulses(self) -> int:
        scale = self.scale * self.signal.scale if self.kind == "counter" else self.scale
        return round(self.memory.total * scale)


class _Plan:
    """What is wanted of frames with one identifier."""

    def __init__(self) -> None:
        self.wheels: list[_Wheel] = []
        self.signals: list[tuple[str, Field, float]] = []
        self.bytes_needed = 0


@dataclass
class BridgeMemory:
    """What an `OdometerBridge` remembers."""

    wheels: dict[str, WheelMemory] = field(default_factory=dict)
    """By name, those that are configured."""
    known: dict[str, float] = field(default_factory=dict)
    """Doors and motor force."""
    decoded: int = 0
    passed_over: int = 0
    rejected: dict[str, int] = field(default_factory=dict)
    bytes_rejected: int = 0
    frames_lost: int = 0
    values_published: int = 0
    values_replaced: int = 0


class OdometerBridge(Processor):
    """`CanFrames` to `Odometry`."""

    name = "odometer"
    Settings = Odometer
    Memory = BridgeMemory
    memory: BridgeMemory
    inputs = (keys.ODO_FRAMES,)
    outputs = (keys.ODO_WHEELS,)

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        if vehicle.odometer is None:
            raise ConfigError(
                "$.odometer: missing", cure="the odometer bridge needs its DBC and wheels"
            )
        self._wheels: list[_Wheel] = []
        self._plans: dict[int, _Plan] = {}
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
            self._wheels.append(_Wheel(name, wheel, found, memory))
            self._plan(key, found).wheels.append(self._wheels[-1])
        for what in ("doors_open", "motor_force_n"):
            signal: Signal | None = getattr(config, what)
            if signal is not None:
                key, found = database.find(signal.message, signal.signal, f"$.odometer.{what}")
                self._plan(key, found).signals.append((what, found, signal.scale))

    def _plan(self, key: int, signal: Field) -> _Plan:
        plan = self._plans.setdefault(key, _Plan())
        plan.bytes_needed = max(plan.bytes_needed, signal.bytes_needed)
        return plan

    def step(self, sample: Sample) -> list[Sample]:
        message: CanFrames = sample.message
        out: list[Sample] = []
        columns = zip(message.offset_ns, message.id, message.flags, message.data, strict=False)
        for offset_ns, id_, flags, data in columns:
            if flags & ERROR:
                self._take_error(id_, data)
                continue
            plan = self._plans.get(id_ | EXTENDED_ID if flags & EXTENDED else id_)
            if plan is None:
                self.memory.passed_over += 1
            elif flags & REMOTE:
                self._reject(REJECT_REMOTE, data)
            elif len(data) < plan.bytes_needed:
                self._reject(REJECT_SHORT, data)
            else:
                stamp_ns = message.stamp_ns + offset_ns
                if self._decode(plan, data, stamp_ns) and self._complete(stamp_ns):
                    out.append(self._publish(stamp_ns))
        return out

    def _complete(self, stamp_ns: int) -> bool:
        """Whether every wheel that is not silent has been seen since the last reading."""
        wheels = self.memory.wheels.values()
        for wheel in wheels:
            wheel.seen_ns = wheel.seen_ns or stamp_ns  # silence begins with the first frame
        silent_ns = stamp_ns - self._silence_ns
        return all(wheel.values or wheel.seen_ns < silent_ns for wheel in wheels)

    def _decode(self, plan: _Plan, data: bytes, stamp_ns: int) -> bool:
        """Take a frame's values; whether a wheel was among them."""
        memory = self.memory
        found = [(wheel, wheel.signal.physical(data)) for wheel in plan.wheels]
        known = [(what, signal.physical(data), scale) for what, signal, scale in plan.signals]
        values = [value for _, value in found] + [value for _, value, _ in known]
        if not all(value is None or math.isfinite(value) for value in values):
            self._reject(REJECT_NAN, data)
            return False
        memory.decoded += 1
        for what, value, scale in known:
            if value is not None:
                memory.known[what] = value * scale
        seen = False
        for wheel, value in found:
            if value is not None:
                wheel.take(value, data, stamp_ns)
                seen = True
        return seen

    def _publish(self, stamp_ns: int) -> Sample:
        memory = self.memory
        message = Odometry()
        for wheel in self._wheels:
            values = wheel.memory.values
            if not values:
                continue  # silent: better no reading than an old one
            if wheel.kind == "speed":
                message.wheels.add(wheel=wheel.name, speed_mps=wheel.memory.speed_mps)
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
        return self.emit(keys.ODO_WHEELS, message, stamp_ns)

    def _take_error(self, id_: int, data: bytes) -> None:
        if id_ & HOST_OVERFLOW:
            self.memory.frames_lost += int.from_bytes(data, "big")
        self._reject(classify_error(id_, data), data)

    def _reject(self, reason: str, data: bytes) -> None:
        memory = self.memory
        memory.rejected[reason] = memory.rejected.get(reason, 0) + 1
        memory.bytes_rejected += len(data)

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
        """Figures of `DeviceHealth`, under its field names; error frames count as rejected."""
        memory = self.memory
        return {
            "messages_decoded": memory.decoded,
            "frames_rejected": sum(memory.rejected.values()),
            "bytes_rejected": memory.bytes_rejected,
            "samples_lost": memory.frames_lost,
            "rejected_by_reason": dict(memory.rejected),
        }
