"""Devices that do not exist, on pseudo terminals: they speak real devices' bytes at their time.

`run_simulators` is one loop over all simulated devices of a vehicle. It keeps the next chunk of
each device's stream in a heap, waits for the earliest on the vehicle clock, and meanwhile answers
what hosts send. What becomes of a chunk is counted in exactly one of a device's tallies:

    sent        handed to the terminal whole
    overrun     the reader was too slow for it: cut short, as on a line without flow control
    unplugged   the device was pulled out
    unheard     the CAN adapter's channel was closed
"""

from __future__ import annotations

import heapq
import select
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tramstream import config
from tramstream.bridges.odometer.slcan import SlcanAdapter
from tramstream.bridges.simulators.captures import GnssLog, can_file_stream
from tramstream.bridges.simulators.pseudo_terminal import PseudoTerminal
from tramstream.bridges.simulators.receiver import GnssDevice, gnss_stream
from tramstream.bridges.simulators.streams import (
    SILENCE_AFTER_S,
    Cable,
    CanDevice,
    Chunk,
    Faults,
    ImuDevice,
    can_stream,
    imu_stream,
    riding,
    still,
)
from tramstream.clock import S, VehicleClock
from tramstream.errors import ConfigError
from tramstream.lines.line import built_in_line
from tramstream.proto.raw_pb2 import TruthState
from tramstream.simulation.ride import Ride

LEAD_NS = S // 5
"""Rides and files begin so long after the links are there."""
NEVER_NS = 2**63
HOST_S = 0.2
"""Hosts are looked for so often."""
MAX_WAIT_S = 0.05
"""Stop is looked at this often at least."""
DRAIN_S = 0.5
"""At the end readers may have so long to fetch what waits for them."""
DRAIN_STEP_S = 0.01
TRUTH_PERIOD_NS = S // 10
PROGRESS_NS = S

Report = Callable[[dict[str, Any]], None]
TakeTruth = Callable[[TruthState], None]
Stream = Callable[[int], Iterator[Chunk]]
"""Chunks of a device whose time begins at the given instant of the vehicle clock."""


@dataclass
class Device:
    """A simulated device: its terminal, and what became of all it had to say."""

    name: str
    terminal: PseudoTerminal
    stream: Stream
    sent: Counter[str] = field(default_factory=Counter)
    overrun: Counter[str] = field(default_factory=Counter)
    unplugged: Counter[str] = field(default_factory=Counter)
    unheard: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)
    bytes_received: int = 0
    late_max_ns: int = 0

    def take(self, chunk: Chunk, now_ns: int) -> bool:
        """Let a chunk out; tell whether it reached the line whole."""
        self.late_max_ns = max(self.late_max_ns, now_ns - chunk.due_ns)
        if chunk.cable is Cable.PULLED:
            self.terminal.close()
        elif chunk.cable is Cable.PLUGGED:
            self.terminal.open()
        tally = self._transmit(chunk.data) if chunk.data else self.sent
        tally.update(chunk.counts)
        if tally is self.sent:
            self.faults.update(chunk.faults)
        return tally is self.sent

    def serve(self) -> None:
        """Take what the host has sent."""
        self.bytes_received += len(self.terminal.read())

    def summary(self) -> dict[str, Any]:
        return {
            "link": str(self.terminal.link),
            "sent": dict(self.sent),
            "overrun": dict(self.overrun),
            "unplugged": dict(self.unplugged),
            "unheard": dict(self.unheard),
            "faults": dict(self.faults),
            "bytes_sent": self.terminal.bytes_sent,
            "bytes_overrun": self.terminal.bytes_overrun,
            "bytes_received": self.bytes_received,
            "late_max_s": self.late_max_ns / S,
        }

    def _transmit(self, data: bytes) -> Counter[str]:
        if not self.terminal.is_open:
            return self.unplugged
        return self.sent if self.terminal.write(data) == len(data) else self.overrun


@dataclass
class CanAdapter(Device):
    """A simulated device behind an slcan adapter: silent while the channel is closed."""

    adapter: SlcanAdapter = field(default_factory=SlcanAdapter)

    def serve(self) -> None:
        data = self.terminal.read()
        self.bytes_received += len(data)
        answers = self.adapter.feed(data)
        if answers:
            self.terminal.write(answers)

    def _transmit(self, data: bytes) -> Counter[str]:
        return super()._transmit(data) if self.adapter.channel_open else self.unheard


def run_simulators(
    vehicle: config.Vehicle,
    clock: VehicleClock,
    stop: threading.Event,
    truth: TakeTruth | None = None,
    report: Report | None = None,
) -> dict[str, dict[str, Any]]:
    """Run all simulators of a vehicle until `stop`, or until rides and files have ended.

    Parameters
    ----------
    truth
        Called ten times a second with the truth of the first ride, stamped on the vehicle clock.
    report
        Called with `{"event": "ready", "links": {device: path}}` once the devices are there, with
        `{"event": "fault", "device", "stamp_ns", "faults"}` for each injected fault, and with
        `{"event": "progress", "stamp_ns", "devices"}` every second and at the end; `devices` is
        what this function returns.

    Returns
    -------
    devices : dict
        For each device, by name (`<simulator>`, of a ride `<simulator>.gnss`, `.imu`, `.can`):
        the tallies of this module's head (of fixes, samples, frames, pulses), the injected faults,
        bytes and greatest lateness.

    Raises
    ------
    ConfigError
        If a link cannot be made, a file cannot be read, or two simulators share a link.
    DeviceError
        If the kernel has no pseudo terminal left.
    """
    rides: list[Ride] = []
    devices = [
        device
        for name, simulator in vehicle.simulators.items()
        for device in _devices(name, simulator, vehicle, rides)
    ]
    links = [device.terminal.link for device in devices]
    if len(set(links)) < len(links):
        raise ConfigError("$.simulators: two simulated devices have the same link")
    tell = report or (lambda _event: None)
    with ExitStack() as terminals:
        for device in devices:
            terminals.callback(device.terminal.close)
            device.terminal.open()
        tell({"event": "ready", "links": {d.name: str(d.terminal.link) for d in devices}})
        patience_s = max((each.patience_s for each in vehicle.simulators.values()), default=0.0)
        _await_hosts(devices, patience_s, stop)
        loop = _Loop(devices, clock, stop, tell)
        lasts_s = max((each.lasts_s for each in vehicle.simulators.values()), default=0.0)
        if lasts_s:
            loop.end_ns = loop.start_ns + round(lasts_s * S)
        if rides and truth is not None:
            loop.follow(rides[0], truth)
        loop.run()
        loop.drain()
    return loop.summary()


def _await_hosts(devices: list[Device], patience_s: float, stop: threading.Event) -> None:
    """Let nothing out until all lines have somebody at their other end, or for so long."""
    end_s = time.monotonic() + patience_s
    waiting = devices
    while waiting and time.monotonic() < end_s and not stop.wait(HOST_S):
        waiting = [device for device in waiting if not device.terminal.has_host()]
    if patience_s:
        stop.wait(HOST_S)  # who has opened a line throws away what was on it


Action = Callable[[int], None]
"""What to do when it is due; takes the present."""


class _Loop:
    """What is due next, of all devices."""

    def __init__(
        self, devices: list[Device], clock: VehicleClock, stop: threading.Event, tell: Report
    ) -> None:
        self.devices = devices
        self.clock = clock
        self.stop = stop
        self.tell = tell
        self.start_ns = clock.now_ns() + LEAD_NS
        self.end_ns = NEVER_NS
        self._agendas = [self._agenda(device) for device in devices]
        self._due: list[tuple[int, int, Action]] = []
        self._progress_ns = self.start_ns
        for index in range(len(self._agendas)):
            self._advance(index)

    def follow(self, ride: Ride, truth: TakeTruth) -> None:
        """Call `truth` with the state of `ride` until its devices fall silent."""
        self._agendas.append(_truth_agenda(ride, truth, self.start_ns))
        self._advance(len(self._agendas) - 1)

    def run(self) -> None:
        while self._due and not self.stop.is_set():
            due_ns, index, action = self._due[0]
            if due_ns >= self.end_ns:
                break
            wait_s = (due_ns - self.clock.now_ns()) / S / self.clock.rate
            self._serve(min(max(wait_s, 0.0), MAX_WAIT_S))
            now_ns = self.clock.now_ns()
            if now_ns >= due_ns:
                heapq.heappop(self._due)
                action(now_ns)
                self._advance(index)
            if now_ns >= self._progress_ns:
                self._progress_ns += PROGRESS_NS
                self._tell_progress(now_ns)
        self._tell_progress(self.clock.now_ns())

    def drain(self) -> None:
        """Leave the terminals open until readers have fetched what waits for them, or nobody has.

        The kernel moves bytes to the reader's side in steps: empty twice is empty.
        """
        empty = 0
        for _ in range(int(DRAIN_S / DRAIN_STEP_S)):
            empty = 0 if any(device.terminal.waiting for device in self.devices) else empty + 1
            if empty == 2:
                return
            self._serve(0.0)
            time.sleep(DRAIN_STEP_S)

    def summary(self) -> dict[str, dict[str, Any]]:
        return {device.name: device.summary() for device in self.devices}

    def _tell_progress(self, now_ns: int) -> None:
        self.tell({"event": "progress", "stamp_ns": now_ns, "devices": self.summary()})

    def _advance(self, index: int) -> None:
        due = next(self._agendas[index], None)
        if due is not None:
            heapq.heappush(self._due, (due[0], index, due[1]))

    def _serve(self, timeout_s: float) -> None:
        plugged = [device for device in self.devices if device.terminal.is_open]
        readable, _, _ = select.select([d.terminal for d in plugged], [], [], timeout_s)
        for device in plugged:
            if device.terminal in readable:
                device.serve()

    def _agenda(self, device: Device) -> Iterator[tuple[int, Action]]:
        for chunk in device.stream(self.start_ns):
            yield chunk.due_ns, partial(self._let_out, device, chunk)

    def _let_out(self, device: Device, chunk: Chunk, now_ns: int) -> None:
        sent = device.take(chunk, now_ns)
        if sent and chunk.faults:
            event = {"event": "fault", "device": device.name, "stamp_ns": chunk.due_ns}
            self.tell({**event, "faults": dict(chunk.faults)})


def _truth_agenda(ride: Ride, truth: TakeTruth, start_ns: int) -> Iterator[tuple[int, Action]]:
    end_ns = start_ns + round((ride.duration_s + SILENCE_AFTER_S) * S)
    for stamp_ns in range(start_ns, end_ns, TRUTH_PERIOD_NS):
        state = ride.truth((stamp_ns - start_ns) / S, stamp_ns)
        yield stamp_ns, partial(_tell_truth, truth, state)


def _tell_truth(truth: TakeTruth, state: TruthState, _now_ns: int) -> None:
    truth(state)


def _devices(
    name: str, simulator: config.Simulator, vehicle: config.Vehicle, rides: list[Ride]
) -> list[Device]:
    """Devices of one simulator; a ride is added to `rides`."""
    if not simulator.link:
        raise ConfigError(f"$.simulators.{name}.link: where shall the pseudo terminal appear?")
    link = Path(simulator.link)
    if simulator.kind == "ride":
        ride = Ride(built_in_line())
        rides.append(ride)
        return _ride_devices(name, link, simulator.seed, ride, vehicle)
    terminal = PseudoTerminal(link)
    if simulator.kind == "imu_still":
        rng, imu = np.random.default_rng(simulator.seed), _imu_device(vehicle)
        return [Device(name, terminal, lambda start: imu_stream(still, rng, start, np.inf, imu))]
    path = Path(simulator.file)
    if not path.is_file():
        raise ConfigError(f"$.simulators.{name}.file: there is no file {simulator.file!r}")
    if simulator.kind == "can_file":
        return [
            CanAdapter(name, terminal, lambda start: can_file_stream(path, start, simulator.loop))
        ]
    baud_rate = vehicle.gnss.baud_rate if vehicle.gnss else GnssDevice().baud_rate
    log = GnssLog.load(path)
    return [Device(name, terminal, lambda start: log.stream(start, baud_rate, simulator.loop))]


def _ride_devices(
    name: str, link: Path, seed: int, ride: Ride, vehicle: config.Vehicle
) -> list[Device]:
    faults = Faults()
    gnss_rng, imu_rng, can_rng = np.random.default_rng(seed).spawn(3)
    gnss, imu = _gnss_device(vehicle), _imu_device(vehicle)
    end_s = ride.duration_s + SILENCE_AFTER_S
    mounted = vehicle.imu
    feel = riding(ride, mounted.lever_arm_m, mounted.mounting_deg) if mounted else riding(ride)

    def terminal(suffix: str) -> PseudoTerminal:
        return PseudoTerminal(link.with_name(f"{link.name}.{suffix}"))

    return [
        Device(
            f"{name}.gnss",
            terminal("gnss"),
            lambda start: gnss_stream(ride, gnss_rng, start, gnss, faults),
        ),
        Device(
            f"{name}.imu",
            terminal("imu"),
            lambda start: imu_stream(feel, imu_rng, start, end_s, imu, faults),
        ),
        CanAdapter(
            f"{name}.can",
            terminal("can"),
            lambda start: can_stream(ride, can_rng, start, CanDevice(), faults),
        ),
    ]


def _gnss_device(vehicle: config.Vehicle) -> GnssDevice:
    if vehicle.gnss is None:
        return GnssDevice()
    return GnssDevice(baud_rate=vehicle.gnss.baud_rate, p_va_v=vehicle.gnss.lever_arm_m)


def _imu_device(vehicle: config.Vehicle) -> ImuDevice:
    if vehicle.imu is None:
        return ImuDevice()
    section = vehicle.imu
    return ImuDevice(section.rate_hz, section.model, section.baud_rate)
