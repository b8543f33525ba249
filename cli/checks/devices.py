"""Checks of what is plugged in: serial lines, CAN, and whether what they say makes sense."""

from __future__ import annotations

import grp
import json
import math
import os
import pwd
import shutil
import stat
import subprocess
import time
from pathlib import Path
from typing import Any

from tramstream import keys, plugins
from tramstream.bridges.odometer import socketcan
from tramstream.cli.checks.machine import Finding, fail, from_error, ok, warning
from tramstream.clock import VehicleClock
from tramstream.config import Odometer, Vehicle
from tramstream.errors import ConfigError, DeviceError, TramstreamError
from tramstream.live import registry
from tramstream.live.ports import size
from tramstream.processor import Sample

LISTEN_S = 3.0
"""Every device of a tram has said something twice by then."""
BY_ID = Path("/dev/serial/by-id")
_RIVALS = {
    "gpsd": "sudo systemctl disable --now gpsd.socket gpsd",
    "ModemManager": "sudo systemctl disable --now ModemManager",
}
"""Programs that open serial devices by themselves."""


# The machine --------------------------------------------------------------------------------------
def check_serial() -> list[Finding]:
    """Serial devices, the right to open them, and who else reaches for them."""
    named = sorted(BY_ID.glob("*"))
    loose = sorted([*Path("/dev").glob("ttyACM*"), *Path("/dev").glob("ttyUSB*")])
    if named:
        found = [ok("serial", f"{path} is {path.resolve()}") for path in named]
    else:
        text = ", ".join(map(str, loose)) or "no USB serial device is plugged in"
        found = [ok("serial", text)]
    for name, cure in _RIVALS.items():
        if any(process == name for _, process in _processes()):
            text = f"{name} is running and opens serial devices by itself"
            found.append(warning("serial", text, cure))
    return [*found, _check_rights(loose)]


def _check_rights(devices: list[Path]) -> Finding:
    user = pwd.getpwuid(os.geteuid()).pw_name
    if os.geteuid() == 0:
        return ok("rights", "root may open every device")
    groups = {grp.getgrgid(device.stat().st_gid).gr_name for device in devices} or {"dialout"}
    mine = {grp.getgrgid(number).gr_name for number in os.getgroups()}
    missing = sorted(groups - mine)
    if missing and not all(os.access(device, os.R_OK | os.W_OK) for device in devices or [BY_ID]):
        cure = f"sudo usermod -aG {','.join(missing)} {user}, and log in again"
        return warning("rights", f"{user} is not in group {', '.join(missing)}", cure)
    return ok("rights", f"{user} may open serial devices")


def check_can_interfaces() -> list[Finding]:
    """CAN interfaces of the kernel."""
    found = []
    for folder in sorted(socketcan.INTERFACES.glob("*")):
        try:
            if (folder / "type").read_text().strip() == socketcan.CAN_TYPE:
                state = "up" if socketcan.is_interface_up(folder) else "down"
                found.append(f"{folder.name} ({state})")
        except OSError:
            continue  # went away meanwhile
    return [ok("CAN", ", ".join(found) or "no network interface of the kernel is one")]


# The vehicle --------------------------------------------------------------------------------------
def check_vehicle(vehicle: Vehicle, alive: list[str]) -> list[Finding]:
    """Every device of the configuration; `alive` are the tokens of nodes that run already."""
    found: list[Finding] = []
    try:
        processors = registry.make_processors(vehicle)
        found.append(ok("processors", ", ".join(processor.name for processor in processors)))
    except TramstreamError as error:
        found.append(from_error("processors", error))
    bridges = registry.configured_bridges(vehicle)
    if not bridges:
        cure = "add a section [gnss], [imu] or [odometer]; `tramstream init` shows them"
        found.append(warning("devices", "the configuration has none", cure))
    for name in bridges:
        found += check_device(name, vehicle, alive)
    return found


def check_device(name: str, vehicle: Vehicle, alive: list[str]) -> list[Finding]:
    """One device: configured well, there, free, and saying what its bridge understands."""
    try:
        bridge = plugins.load("bridges", name)(vehicle)
        port = plugins.load("ports", name)(vehicle, VehicleClock())
    except ConfigError as error:
        return [from_error(name, error)]
    found = []
    if vehicle.odometer is not None and name == "odometer":
        found.append(ok(name, f"{vehicle.odometer.dbc} has all signals"))
        found += check_bit_rate(vehicle.odometer)
        found += check_queue(vehicle.odometer)
    if keys.alive(vehicle.vehicle, name) in alive:
        return [*found, ok(name, f"{port.device} is in use by the running node {name}")]
    path = Path(port.device)
    links = [simulator.link for simulator in vehicle.simulators.values() if simulator.link]
    if not path.exists() and any(port.device.startswith(link) for link in links):
        return [*found, ok(name, f"{port.device} is simulated; it appears with `tramstream run`")]
    if path.is_absolute():
        found += _check_path(name, path)
    if any(finding.state == "FAIL" for finding in found):
        return found
    return [*found, _listen(name, port, bridge)]


def _check_path(name: str, path: Path) -> list[Finding]:
    """A serial device by its path: there, free, and named so that it stays the same."""
    if not path.exists():
        others = ", ".join(map(str, sorted(BY_ID.glob("*")))) or "no USB serial device is here"
        return [fail(name, f"{path}: there is no such device", f"plug it in or name it; {others}")]
    if not stat.S_ISCHR(path.stat().st_mode):
        return [fail(name, f"{path}: is no serial device", "name one under /dev/serial/by-id")]
    users = users_of(path)
    if users:
        names = ", ".join(f"{process} (process {number})" for number, process in users)
        cure = next((_RIVALS[p] for _, p in users if p in _RIVALS), "stop that program")
        return [fail(name, f"{path}: is in use by {names}", cure)]
    if not path.is_symlink():
        for link in sorted(BY_ID.glob("*")):
            if link.resolve() == path:
                text = f"{path}: is another device when plugged in otherwise"
                return [warning(name, text, f"name it {link}")]
    return []


def users_of(path: Path) -> list[tuple[int, str]]:
    """Other processes that have `path` open, as far as this user may see."""
    target = str(path.resolve())
    return [
        (number, process)
        for number, process in _processes()
        if number != os.getpid() and _has_open(number, target)
    ]


def _processes() -> list[tuple[int, str]]:
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            found.append((int(folder.name), (folder / "comm").read_text().strip()))
        except OSError:
            continue  # ended meanwhile
    return found


def _has_open(number: int, target: str) -> bool:
    try:
        descriptors = os.listdir(f"/proc/{number}/fd")
    except OSError:
        return False  # somebody else's, or ended
    for descriptor in descriptors:
        try:
            if os.readlink(f"/proc/{number}/fd/{descriptor}") == target:
                return True
        except OSError:
            continue
    return False


def _listen(name: str, port: Any, bridge: Any) -> Finding:
    """Open the device and let its bridge work on what it says, until something is understood."""
    frames = received = 0
    said = {keys.EVENT.at(name).path, keys.LOG.at(name).path}
    end_s = time.monotonic() + LISTEN_S
    try:
        port.open()
        while time.monotonic() < end_s:
            message = port.read()
            if message is None:
                continue
            frames += 1
            received += size(message)
            results = bridge.step(Sample(port.key, message, message.stamp_ns, 0))
            paths = {result.key.path for result in results} - said  # what is said of it is no data
            if paths:
                what = ", ".join(sorted(paths))
                return ok(name, f"{port.device} speaks: {what}")
    except DeviceError as error:
        return from_error(name, error)
    finally:
        port.close()
    if not frames:
        text = f"{port.device}: silent for {LISTEN_S:g} s"
        return warning(name, text, "check its power and cable, and what it is set to send")
    if troubles := bridge.device_troubles():
        return warning(name, f"{port.device}: {troubles[0].plain}", troubles[0].kind.cure)
    rate = "bit rate" if name == "odometer" else f"$.{name}.baud_rate"
    what = f"{received} bytes" if received else "empty frames"
    text = f"{port.device}: {what} in {LISTEN_S:g} s, but nothing that {name} understands"
    return warning(name, text, f"check {rate} and that it is the right device")


def check_bit_rate(odometer: Odometer) -> list[Finding]:
    """Whether a socketcan interface runs at the configured bit rate and stays on the bus."""
    if odometer.interface != "socketcan" or shutil.which("ip") is None:
        return []
    command = ["ip", "-json", "-details", "link", "show", odometer.channel]
    try:
        shown = subprocess.run(command, capture_output=True, text=True, check=False, timeout=5)
        info = json.loads(shown.stdout or "[]")[0]["linkinfo"]["info_data"]
    except (ValueError, LookupError, OSError, subprocess.TimeoutExpired):
        return []  # no such interface, or one without a bit rate: opening it will tell
    return judge_link(odometer, info)


def check_queue(odometer: Odometer) -> list[Finding]:
    """Whether the kernel may hold as many frames as the bridge asks it to."""
    if odometer.interface != "socketcan":
        return []
    granted, wanted = socketcan.granted_bytes(), socketcan.BUFFER_BYTES
    if granted >= wanted:
        return []
    frames = math.ceil(2 * granted / socketcan.FRAME_COST_BYTES)
    text = f"the kernel holds {frames} frames for us; what comes beyond while we wait is lost"
    cure = f"sudo sysctl -w net.core.rmem_max={wanted}, and in /etc/sysctl.d to make it last"
    return [warning("odometer", f"{odometer.channel}: {text}", cure)]


def judge_link(odometer: Odometer, info: dict[str, Any]) -> list[Finding]:
    """Findings out of what `ip -details link show` says of a CAN interface."""
    channel = odometer.channel
    up = f"sudo ip link set {channel} down; sudo ip link set {channel} up type can "
    cure = f"{up}bitrate {odometer.bitrate} restart-ms 100"
    bit_rate = info.get("bittiming", {}).get("bitrate")
    if bit_rate is not None and bit_rate != odometer.bitrate:
        text = f"{channel}: runs at {bit_rate} bit/s, $.odometer.bitrate says {odometer.bitrate}"
        return [fail("odometer", text, cure)]
    state = info.get("state", "")
    if state in ("BUS-OFF", "ERROR-PASSIVE"):
        cure = "check termination, wiring and bit rate of the bus"
        return [warning("odometer", f"{channel}: is {state}", cure)]
    if bit_rate is not None and not info.get("restart_ms"):
        return [warning("odometer", f"{channel}: stays off the bus after an error", cure)]
    return []
