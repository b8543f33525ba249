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
from tramstream.processor import Ledger, Processor, Sample, State
from tramstream.proto.raw_pb2 import CanFrames, Odometry

REJECT_REMOTE = "remote frame"
REJECT_SHORT = "frame too short"
REJECT_NAN = "not a number"


class _Wheel:
    """What is known of one wheel."""

    def __init__(self, name: str, config: WheelConfig, field: Field) -> None:
        self.name = name
        self.kind = config.kind
        self.field = field
        self.scale = config.scale
        self.range = 1 << config.counter_bits
        self.total: float = 0  # pulses before scaling; for a counter before the DBC's too
        self.counter: int | None = None
        self.speed_mps = 0.0
        self.values = 0  # since the last reading
        self.seen_ns = 0

    def take(self, value: float, data: bytes) -> None:
        """Take the physical value of a frame."""
        if self.kind == "speed":
            self.speed_mps = value * self.scale
        elif self.kind == "pulses":
            self.total += value
        else:
            raw = self.field.raw(data)
            assert raw is not None  # the caller has its physical value
            counter = int(raw)
            if self.counter is not None:
                half = self.range // 2
                self.total += (counter - self.counter + half) % self.range - half
            self.counter = counter
        self.values += 1

    @property
    def pulses(self) -> int:
        scale = self.scale * self.field.scale if self.kind == "counter" else self.scale
        return round(self.total * scale)


class _Plan:
    """What is wanted of frames with one identifier."""

    def __init__(self) -> None:
        self.wheels: list[_Wheel] = []
        self.signals: list[tuple[str, Field, float]] = []
        self.bytes_needed = 0


class OdometerBridge(Processor):
    """`CanFrames` to `Odometry`."""

    name = "odometer"
    Settings = Odometer
    inputs = (keys.ODO_FRAMES,)
    outputs = (keys.ODO_WHEELS,)

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        if vehicle.odometer is None:
            raise ConfigError("$.odometer: missing; the odometer bridge needs its DBC and wheels")
        self._wheels: list[_Wheel] = []
        self._plans: dict[int, _Plan] = {}
        self._silence_ns = int(vehicle.odometer.silence_s * S)
        self._compile(vehicle.odometer)
        self._known: dict[str, float] = {}  # doors_open, motor_force_n
        self._decoded = 0
        self._passed_over = 0
        self._rejected: dict[str, int] = {}
        self._bytes_rejected = 0
        self._frames_lost = 0
        self._values_published = 0
        self._values_replaced = 0

    def _compile(self, config: Odometer) -> None:
        """Look up the configured signals in the DBC."""
        if not config.wheels:
            raise ConfigError("$.odometer.wheels: empty; name at least one wheel and its signal")
        database = Database(config.dbc, "$.odometer.dbc")
        for name, wheel in config.wheels.items():
            where = f"$.odometer.wheels.{name}"
            key, field = database.find(wheel.message, wheel.signal, where)
            if wheel.kind == "counter" and wheel.counter_bits > field.length:
                raise ConfigError(
                    f"{where}.counter_bits: {wheel.counter_bits}, but signal '{wheel.signal}' has "
                    f"{field.length} bits in {config.dbc}"
                )
            self._wheels.append(_Wheel(name, wheel, field))
            self._plan(key, field).wheels.append(self._wheels[-1])
        for what in ("doors_open", "motor_force_n"):
            signal: Signal | None = getattr(config, what)
            if signal is not None:
                key, field = database.find(signal.message, signal.signal, f"$.odometer.{what}")
                self._plan(key, field).signals.append((what, field, signal.scale))

    def _plan(self, key: int, field: Field) -> _Plan:
        plan = self._plans.setdefault(key, _Plan())
        plan.bytes_needed = max(plan.bytes_needed, field.bytes_needed)
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
                self._passed_over += 1
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
        for wheel in self._wheels:
            wheel.seen_ns = wheel.seen_ns or stamp_ns  # silence begins with the first frame
        silent_ns = stamp_ns - self._silence_ns
        return all(wheel.values or wheel.seen_ns < silent_ns for wheel in self._wheels)

    def _decode(self, plan: _Plan, data: bytes, stamp_ns: int) -> bool:
        """Take a frame's values; whether a wheel was among them."""
        found = [(wheel, wheel.field.physical(data)) for wheel in plan.wheels]
        known = [(what, field.physical(data), scale) for what, field, scale in plan.signals]
        values = [value for _, value in found] + [value for _, value, _ in known]
        if not all(value is None or math.isfinite(value) for value in values):
            self._reject(REJECT_NAN, data)
            return False
        self._decoded += 1
        for what, value, scale in known:
            if value is not None:
                self._known[what] = value * scale
        seen = False
        for wheel, value in found:
            if value is not None:
                wheel.take(value, data)
                wheel.seen_ns = stamp_ns
                seen = True
        return seen

    def _publish(self, stamp_ns: int) -> Sample:
        message = Odometry()
        for wheel in self._wheels:
            if not wheel.values:
                continue  # silent: better no reading than an old one
            if wheel.kind == "speed":
                message.wheels.add(wheel=wheel.name, speed_mps=wheel.speed_mps)
                self._values_replaced += wheel.values - 1
                self._values_published += 1
            else:
                message.wheels.add(wheel=wheel.name, pulses=wheel.pulses)
                self._values_published += wheel.values
            wheel.values = 0
        if "doors_open" in self._known:
            message.doors_open = self._known["doors_open"] >= 0.5
        if "motor_force_n" in self._known:
            message.motor_force_n = self._known["motor_force_n"]
        return self.emit(keys.ODO_WHEELS, message, stamp_ns)

    def _take_error(self, id_: int, data: bytes) -> None:
        if id_ & HOST_OVERFLOW:
            self._frames_lost += int.from_bytes(data, "big")
        self._reject(classify_error(id_, data), data)

    def _reject(self, reason: str, data: bytes) -> None:
        self._rejected[reason] = self._rejected.get(reason, 0) + 1
        self._bytes_rejected += len(data)

    def ledgers(self) -> list[Ledger]:
        """Frames: delivered counts those that carry nothing configured too, they are passed over.

        Readings: values of wheels; pulses that wait are added up, a speed that waits is dropped
        when a newer one comes.
        """
        rejected = sum(self._rejected.values())
        delivered = self._decoded + self._passed_over
        pending = sum(wheel.values for wheel in self._wheels)
        published, replaced = self._values_published, self._values_replaced
        received = published + replaced + pending
        return [
            Ledger(self.name, "frames", delivered + rejected, delivered, rejected),
            Ledger(self.name, "readings", received, published, replaced, pending),
        ]

    def device_counters(self) -> dict[str, Any]:
        """Figures of `DeviceHealth`, under its field names; error frames count as rejected."""
        return {
            "messages_decoded": self._decoded,
            "frames_rejected": sum(self._rejected.values()),
            "bytes_rejected": self._bytes_rejected,
            "samples_lost": self._frames_lost,
            "rejected_by_reason": dict(self._rejected),
        }

    def snapshot(self) -> State:
        return {
            "sequences": self.sequences(),
            "wheels": {
                wheel.name: {
                    "total": wheel.total,
                    "counter": wheel.counter,
                    "speed_mps": wheel.speed_mps,
                    "values": wheel.values,
                    "seen_ns": wheel.seen_ns,
                }
                for wheel in self._wheels
            },
            "known": dict(self._known),
            "decoded": self._decoded,
            "passed_over": self._passed_over,
            "rejected": dict(self._rejected),
            "bytes_rejected": self._bytes_rejected,
            "frames_lost": self._frames_lost,
            "values_published": self._values_published,
            "values_replaced": self._values_replaced,
        }

    def restore(self, state: State) -> None:
        self.restore_sequences(state["sequences"])
        for wheel in self._wheels:
            for name, value in state["wheels"].get(wheel.name, {}).items():
                setattr(wheel, name, value)
        self._known = dict(state["known"])
        self._decoded = state["decoded"]
        self._passed_over = state["passed_over"]
        self._rejected = dict(state["rejected"])
        self._bytes_rejected = state["bytes_rejected"]
        self._frames_lost = state["frames_lost"]
        self._values_published = state["values_published"]
        self._values_replaced = state["values_replaced"]
