"""Captures as the raw messages that a live bridge would have had, and their way into a record."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import msgspec

from tramstream import config_file, keys
from tramstream.analysis.tables import can_log, clocks, wheel_units
from tramstream.analysis.tables.can_log import CanLog
from tramstream.analysis.tables.mapping import GnssTable
from tramstream.analysis.tables.tables import Tables
from tramstream.bridges.gnss.bridge import GnssBridge
from tramstream.bridges.gnss.capture import read_times
from tramstream.bridges.imu import framer as adis
from tramstream.bridges.imu.bridge import HOLD_NS, U32, ImuBridge, interval_between
from tramstream.bridges.odometer import frames as canframe
from tramstream.bridges.odometer.bridge import OdometerBridge
from tramstream.bridges.odometer.dbc import Database
from tramstream.clock import S
from tramstream.config import Gnss, Imu, Odometer, Vehicle, Wheel
from tramstream.errors import ConfigError, RecordError
from tramstream.keys import Key
from tramstream.processor import Processor, Sample, stamp
from tramstream.proto.health_pb2 import DeviceHealth
from tramstream.proto.raw_pb2 import RawBytes
from tramstream.recorder.file.writer import RecordFile
from tramstream.strict_toml import convert

NO_LINE_BAUD = 1_000_000_000
"""A capture has no line: its bytes take no time."""
READ_BYTES = 4096
CAN_GROUP_NS = S // 50
"""Frames of so long go into one message, as the live port gathers them."""
ADIS_READ = 10 * adis.FRAME_LENGTH
"""Ten samples a read: 5 ms at 2 kHz."""


@dataclass(frozen=True)
class Item:
    """A raw message, its stamp, when it came, and the bridge that takes it; rows have none."""

    key: Key
    message: Any
    stamp_ns: int
    arrival_ns: int
    bridge: Processor | None = None


class Imports:
    """Collects sources, then writes them as one record in the order of their times."""

    def __init__(
        self,
        config: Path | None,
        vehicle: str,
        model: str,
        offsets: Mapping[str, int] | None = None,
    ) -> None:
        self._offsets = offsets or {}
        self._configured = config is not None
        self._vehicle_id = vehicle
        self._use(config_file.load(config) if config is not None else Vehicle(vehicle="import"))
        self.malformed_lines = 0
        """Lines of CAN logs that are no frames, and of tables that are no rows: left out, and
        told."""
        self.tables_read: list[dict[str, Any]] = []
        self._model = model
        self._items: list[Item] = []
        self._bridges: dict[str, Processor] = {}
        self.can_told: dict[str, Any] = {}
        """What became of the CAN log."""

    def _use(self, vehicle: Vehicle) -> None:
        name = self._vehicle_id or vehicle.vehicle
        self.vehicle = msgspec.structs.replace(vehicle, vehicle=name)

    def tables(self, tables: Tables) -> None:
        """Rows of tables; before all other sources, for a mapping may hold the configuration."""
        if tables.mapping.vehicle is not None and not self._configured:
            self._use(tables.mapping.vehicle)
        receiver = next((t.file for t in tables.mapping.tables if isinstance(t, GnssTable)), "")
        if receiver and self.vehicle.gnss is None:
            self.vehicle = msgspec.structs.replace(self.vehicle, gnss=Gnss(device=receiver))
        made = tables.read(self.vehicle)
        self._items += [Item(*row) for row in made.rows]
        self.tables_read += made.tables
        self.malformed_lines += made.malformed_lines

    def gnss(self, path: Path) -> None:
        """A receiver's bytes; each read gets the epoch that its frames tell."""
        data = _read(path)
        self.vehicle = msgspec.structs.replace(
            self.vehicle, gnss=self.vehicle.gnss or Gnss(device=path.name)
        )
        assert self.vehicle.gnss is not None
        immediate = msgspec.structs.replace(
            self.vehicle.gnss, receiver_delay_s=0.0, baud_rate=NO_LINE_BAUD
        )
        bridge = GnssBridge(msgspec.structs.replace(self.vehicle, gnss=immediate))
        for arrival_ns, piece in _timed_pieces(data, read_times(data)):
            message = RawBytes(stamp_ns=arrival_ns, device=path.name, data=piece)
            self._items.append(Item(keys.GNSS_BYTES, message, arrival_ns, arrival_ns, bridge))
        self._bridges[bridge.name] = bridge

    def imu(self, path: Path) -> None:
        """An IMU's frames; a read arrives when its last frame was latched."""
        data = _read(path)
        section = self.vehicle.imu or convert(
            {"device": path.name, "model": self._model}, Imu, "--model"
        )
        section = msgspec.structs.replace(section, baud_rate=NO_LINE_BAUD)
        self.vehicle = msgspec.structs.replace(self.vehicle, imu=section)
        bridge = ImuBridge(self.vehicle)
        items = []
        for piece, arrival_ns in _adis_reads(data, section.rate_hz):
            message = RawBytes(stamp_ns=arrival_ns, device=path.name, data=piece)
            items.append(Item(keys.IMU_BYTES, message, arrival_ns, arrival_ns, bridge))
        last = items[-1].message  # nothing came for a while after it: the batch is whole
        last.read_length.extend((len(last.data), 0))
        last.read_offset_ns.extend((0, HOLD_NS + 1))
        self._items += items
        self._bridges[bridge.name] = bridge

    def can(self, path: Path, dbc: Path | None, wheels: list[str], bus: str = "") -> str:
        """A CAN log on its own clock; returns the wheels it decodes, for people.

        `bus` is the interface to decode, where identifiers come on several; by default that of the
        configuration, if there is one and the log has it.
        """
        section = self.vehicle.odometer
        if dbc is not None:
            chosen = _wheels(dbc, wheels)
            section = Odometer(
                interface="virtual", channel=path.name, dbc=str(dbc.absolute()), wheels=chosen
            )
        if section is None:
            raise ConfigError("--can: the configuration has no section [odometer]; give --dbc")
        self.vehicle = msgspec.structs.replace(self.vehicle, odometer=section)
        bridge = OdometerBridge(self.vehicle)
        log = can_log.read(path, _read(path).decode("ascii", "replace"))
        self.malformed_lines += log.malformed
        if dbc is None and section.channel in log.interfaces:
            bus = bus or section.channel
        decoded, heard = can_log.buses(path, log, bridge.wants, bus)
        log.unheard = sorted({wheel.message for wheel in section.wheels.values()} - heard)
        items = []
        self.can_told = _told(log)
        for interface in log.interfaces:
            frames = [frame for frame in log.frames if frame.interface == interface]
            of = bridge if interface in decoded else None
            for group in can_log.gathers(frames, CAN_GROUP_NS):
                message = canframe.pack(group, interface)
                stamp_ns = message.stamp_ns
                items.append(Item(keys.ODO_FRAMES, message, stamp_ns, stamp_ns, of))
        log.frames.clear()
        items.sort(key=lambda item: item.arrival_ns)
        _check_decodes(path, OdometerBridge(self.vehicle), items)
        self._items += items
        self._bridges[bridge.name] = bridge
        return ", ".join(f"{n} = {w.message}.{w.signal}" for n, w in section.wheels.items())

    def _shifted(self, item: Item) -> Item:
        """A message on the record's clock; rows of tables are on it."""
        offset_ns = self._offsets.get(clocks.name_of(item), 0)
        if not offset_ns:
            return item
        at_ns = item.stamp_ns + offset_ns, item.arrival_ns + offset_ns
        return replace(item, stamp_ns=at_ns[0], arrival_ns=at_ns[1])

    def write(self, out: Path) -> dict[str, Any]:
        """Step everything through the bridges and write it; return what came out."""
        self._items = [self._shifted(item) for item in self._items]
        clocks.check(self._items, self._offsets)
        self._items.sort(key=lambda item: item.arrival_ns)
        messages: dict[str, int] = {}
        published: dict[str, int] = {}
        metadata = {config_file.RECORD_ENTRY: config_file.to_json(self.vehicle)}
        with RecordFile(out, self.vehicle.vehicle, metadata) as target:

            def write(sample: Sample, log_ns: int) -> None:
                path = sample.key.path
                publish_ns = published[path] = max(log_ns, published.get(path, 0) + 1)
                target.append(
                    sample.key.on(self.vehicle.vehicle),
                    sample.key,
                    sample.message.SerializeToString(),
                    log_ns,
                    publish_ns,
                    sample.sequence,
                )
                messages[path] = messages.get(path, 0) + 1

            log_ns = 0
            last = {id(item.bridge): at for at, item in enumerate(self._items)}
            for at, item in enumerate(self._items):
                log_ns = item.arrival_ns
                sequence = 1 + messages.get(item.key.path, 0)
                stamp(item.message, item.stamp_ns, sequence)
                raw = Sample(item.key, item.message, item.stamp_ns, sequence)
                write(raw, log_ns)
                for sample in item.bridge.step(raw) if item.bridge is not None else ():
                    write(sample, log_ns)
                if at == last.get(id(item.bridge)) and isinstance(item.bridge, GnssBridge):
                    for sample in item.bridge.finish():
                        write(sample, log_ns)
            devices = {}
            for name, bridge in self._bridges.items():
                counters = bridge.device_counters()
                devices[name] = counters
                health = DeviceHealth(
                    device=name, port="import", stamp_ns=log_ns, sequence=1, **counters
                )
                write(Sample(keys.DEVICE.at(name), health, log_ns, 1), log_ns)
        return {
            "out": str(out),
            "messages": dict(sorted(messages.items())),
            "devices": devices,
            "malformed_lines": self.malformed_lines,
            "tables": self.tables_read,
            "can": self.can_told,
        }


def _read(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror}); check the name") from error
    if not data:
        raise RecordError(f"{path}: is empty")
    return data


def _timed_pieces(data: bytes, times: list[tuple[int, int]]) -> Iterable[tuple[int, bytes]]:
    """Cut where a time ends; bytes after the last time get that one."""
    begin, arrival_ns = 0, S
    for end, time_ns in times:
        arrival_ns = time_ns
        if end > begin:
            yield time_ns, data[begin:end]
            begin = end
    for start in range(begin, len(data), READ_BYTES):
        yield arrival_ns, data[start : start + READ_BYTES]


def _adis_reads(data: bytes, rate_hz: float) -> Iterable[tuple[bytes, int]]:
    """Reads of a capture, each with the device time of its last frame, from one second on.

    Where the device was started again, nothing tells how long it was off: no longer than a read.
    """
    framer = adis.AdisFramer()
    period_us = 1e6 / rate_hz
    last: tuple[int, int] | None = None
    arrival_ns = S
    for begin in range(0, len(data), ADIS_READ):
        piece = data[begin : begin + ADIS_READ]
        frames = framer.feed(piece).frames
        for sequence, stamp_us in _ends(frames):
            interval_us: float | None = 0.0
            if last is not None:
                steps = (sequence - last[0]) & U32, (stamp_us - last[1]) & U32
                interval_us = interval_between(*steps, period_us)
            arrival_ns += round(1000 * (period_us if interval_us is None else interval_us))
            last = sequence, stamp_us
        yield piece, arrival_ns


def _ends(frames: Any) -> list[tuple[int, int]]:
    """Sequence and stamp of a read's frames; of those that follow each other the ends do."""
    numbers: list[int] = frames["sequence"].tolist()
    stamps: list[int] = frames["stamp_us"].tolist()
    if len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return [(numbers[0], stamps[0]), (numbers[-1], stamps[-1])]
    return list(zip(numbers, stamps, strict=True))


def _check_decodes(path: Path, probe: OdometerBridge, items: list[Item]) -> None:
    """Refuse a log of which no wanted frame can be used.

    Raises
    ------
    ConfigError
        Says what became of them.
    """
    for item in items:
        if item.bridge is not None:
            probe.step(Sample(item.key, item.message, item.stamp_ns, 1))
            if probe.memory.decoded:
                return
    reasons = probe.device_counters()["rejected_by_reason"]
    told = ", ".join(f"{count} {reason}" for reason, count in reasons.items())
    raise ConfigError(
        f"{path}: nothing in it decodes: of the frames that the DBC names none can be used "
        f"({told})",
        cure=can_log.OTHER_DBC,
    )


def _told(log: CanLog) -> dict[str, Any]:
    """What became of a CAN log."""
    told = {each.name: getattr(log, each.name) for each in fields(log)}
    return {**told, "frames": len(log.frames), "interfaces": log.interfaces}


def _wheels(dbc: Path, chosen: list[str]) -> dict[str, Wheel]:
    """Wheels from NAME=MESSAGE.SIGNAL[:UNIT]; by default every signal that is a wheel's speed."""
    units = Database(str(dbc), "--dbc").units()
    if not chosen:
        found = {
            signal.lower(): Wheel(message=message, signal=signal, kind="speed", scale=factor)
            for (message, signal), unit in units.items()
            if "WHEEL" in signal.upper() and (factor := wheel_units.factor_to_mps(unit)) is not None
        }
        if not found:
            raise ConfigError(
                f"{dbc}: no signal looks like a wheel's speed; name them with "
                "--wheel NAME=MESSAGE.SIGNAL"
            )
        return found
    wheels = {}
    for text in chosen:
        name, _, place = text.partition("=")
        message, _, rest = place.partition(".")
        signal, _, stated = rest.partition(":")
        if not (name and message and signal):
            raise ConfigError(f"--wheel {text}: must read NAME=MESSAGE.SIGNAL or …SIGNAL:UNIT")
        unit = stated or units.get((message, signal), "")
        kind = wheel_units.kind_of(unit, "" if stated else signal)
        if kind is None and ((message, signal) in units or stated):
            raise ConfigError(
                f"--wheel {text}: nobody knows what a wheel says in the unit '{unit}'",
                cure=f"say it: --wheel {name}={message}.{signal}:km/h, or :m/s, or :pulses",
            )
        what, scale = kind or (wheel_units.PULSES, 1.0)
        wheels[name] = Wheel(message=message, signal=signal, kind=what, scale=scale)  # type: ignore[arg-type]
    return wheels
