"""Checks of the machine: software, runtime folder, clock, disk, processor, rights.

Each check returns findings; none changes anything but a temporary file, and none raises for what it
finds wrong.
"""

from __future__ import annotations

import ctypes
import os
import pwd
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib import metadata
from pathlib import Path

from tramstream import keys, private
from tramstream.clock import S, VehicleClock
from tramstream.config import MATCHER, Map, Recorder
from tramstream.errors import TramstreamError
from tramstream.machine import machine_code
from tramstream.tracks import network as networks
from tramstream.transport import bus, router_socket

RECORD_BYTES_PER_H = 400e6
"""Measured on a simulated ride with all three devices (`tramstream demo`, 2.5 minutes)."""
SHORT_DISK_H = 24.0
SYNCS = 12
SYNC_BYTES = 32_768
"""A flush of a quarter of a second."""
CPU_SAMPLE_S = 0.3
NEEDED_CORES = 0.5
"""All nodes take about a third of a core; the rest is for what comes at once."""
_ADJTIMEX_UNSYNCHRONISED = 5
"""TIME_ERROR (adjtimex(2)): the kernel's clock is not disciplined by anybody."""
_TIMEX_BYTES = 512
"""More than `struct timex` has; all zero means: only read."""


class State(StrEnum):
    """How a check ended."""

    OK = "ok"
    WARNING = "warning"
    FAIL = "FAIL"


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor's: what was looked at, how it is, what to do."""

    name: str
    state: State
    text: str
    cure: str = ""


def ok(name: str, text: str) -> Finding:
    return Finding(name, State.OK, text)


def warning(name: str, text: str, cure: str) -> Finding:
    return Finding(name, State.WARNING, text, cure)


def fail(name: str, text: str, cure: str) -> Finding:
    return Finding(name, State.FAIL, text, cure)


def from_error(name: str, error: TramstreamError) -> Finding:
    """A failure out of an error, which knows its cure."""
    return fail(name, error.reason, error.cure)


# Software -----------------------------------------------------------------------------------------
def check_python() -> list[Finding]:
    """The interpreter and the packages that tramstream asks for."""
    version = ".".join(map(str, sys.version_info[:3]))
    found = [ok("python", f"{version}, {sys.executable}")]
    return [*found, *check_packages(metadata.requires("tramstream") or [])]


def check_packages(requirements: list[str]) -> list[Finding]:
    """Whether what is installed satisfies `requirements`."""
    from packaging.requirements import Requirement

    wrong: list[Finding] = []
    names: list[str] = []
    for text in requirements:
        requirement = Requirement(text)
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": ""}):
            continue
        cure = f"pip install '{requirement.name}{requirement.specifier}'"
        try:
            version = metadata.version(requirement.name)
        except metadata.PackageNotFoundError:
            wrong.append(fail("packages", f"{requirement.name} is not installed", cure))
            continue
        if not requirement.specifier.contains(version, prereleases=True):
            wanted = f"tramstream wants {requirement.specifier}"
            wrong.append(fail("packages", f"{requirement.name} is {version}, {wanted}", cure))
        names.append(f"{requirement.name} {version}")
    return wrong or [ok("packages", f"{len(names)} as wanted, among them {', '.join(names[:3])}")]


# Rights -------------------------------------------------------------------------------------------
def check_rights() -> list[Finding]:
    """Who runs this, and whether others could write where machine code is taken from."""
    if os.geteuid() == 0:
        text = "runs as root: whoever finds a fault in a decoder has the whole machine"
        cure = (
            "useradd --system --groups dialout tram; run it as that user (systemd: User=tram, "
            "RuntimeDirectory=tramstream, Environment=TRAMSTREAM_RUNTIME_DIR=/run/tramstream)"
        )
        found = [warning("user", text, cure)]
    else:
        found = [ok("user", pwd.getpwuid(os.geteuid()).pw_name)]
    machine_code.folder()
    for text in machine_code.refused():
        cure = "see who did that; XDG_CACHE_HOME names another place"
        found.append(warning("machine code", text, cure))
    return found


# Bus ----------------------------------------------------------------------------------------------
def check_runtime_dir(folder: Path) -> list[Finding]:
    """Whether socket, clock file and snapshot can live in `folder`."""
    name = "runtime folder"
    cure = "set $.bus.runtime_dir or TRAMSTREAM_RUNTIME_DIR to a folder of your own"
    try:
        router_socket.socket_path(folder)
    except TramstreamError as error:
        return [from_error(name, error)]
    there = _nearest(folder)
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        return [fail(name, f"{there}: cannot be written", cure)]
    doubt = private.doubt_of(folder) if there == folder else ""
    if doubt:
        return [fail(name, f"{folder}: {doubt}", cure)]
    made = "" if there == folder else ", will be made"
    return [ok(name, f"{folder}{made}")]


def check_bus(folder: Path) -> tuple[list[Finding], list[str]]:
    """Whether a router runs in `folder`; also the liveliness tokens of its nodes."""
    from tramstream.cli.terminal.session import client

    try:
        if not bus.router_listens(folder):
            return [ok("bus", "no router yet; `tramstream run` will be it")], []
        with client(folder=folder) as session:
            tokens = session.alive(keys.alive("*", "*"))
    except TramstreamError as error:
        return [from_error("bus", error)], []
    nodes: dict[str, list[str]] = {}
    for token in tokens:
        vehicle, path = keys.split(token)
        nodes.setdefault(vehicle, []).append(path.split("/")[1])
    running = "; ".join(f"{vehicle}: {', '.join(names)}" for vehicle, names in nodes.items())
    return [ok("bus", f"a router is running with {running or 'no nodes'}")], tokens


# Clock --------------------------------------------------------------------------------------------
def check_clock(folder: Path) -> list[Finding]:
    """Whether the host's UTC can be trusted, and how far the vehicle clock is from it."""
    cure = (
        "harmless for positions; for right dates in file names set up systemd-timesyncd or chrony"
    )
    found = []
    if time.gmtime().tm_year < 2024:
        year = time.strftime("%Y-%m-%d", time.gmtime())
        found.append(warning("clock", f"the host believes it is {year}", cure))
    elif kernel_clock_is_synchronised():
        found.append(ok("clock", "the host's UTC is synchronised"))
    else:
        found.append(warning("clock", "nobody synchronises the host's UTC", cure))
    if (folder / "clock.json").exists():
        try:
            clock = VehicleClock.shared(folder)
        except TramstreamError as error:
            return [*found, from_error("vehicle clock", error)]
        ahead_s = (clock.now_ns() - time.time_ns()) / S
        text = f"{ahead_s:+.3f} s from the host's UTC since this boot's first run"
        found.append(ok("vehicle clock", text))
    return found


def kernel_clock_is_synchronised() -> bool:
    """What the kernel says (chrony, ntpd, ptp and timesyncd all tell it), else timesyncd's mark."""
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        state = int(libc.adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES)))
    except (OSError, AttributeError):
        state = -1
    if state >= 0:
        return state != _ADJTIMEX_UNSYNCHRONISED
    return Path("/run/systemd/timesync/synchronized").exists()


# Disk ---------------------------------------------------------------------------------------------
def check_disk(settings: Recorder) -> list[Finding]:
    """Whether records can be written, for how long, and how fast they are safe."""
    name, folder = "records", Path(settings.directory)
    there = _nearest(folder)
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        cure = "give this user the right to write there, or change $.recorder.directory"
        return [fail(name, f"{there}: cannot be written", cure)]
    if there == folder and (doubt := private.doubt_of(folder)):
        cure = "let only the user that records write there (chmod 750), or use another folder"
        return [warning(name, f"{folder}: {doubt}", cure), *_check_space(settings, there)]
    return _check_space(settings, there)


def _check_space(settings: Recorder, there: Path) -> list[Finding]:
    name, folder = "records", Path(settings.directory)
    floor_bytes = settings.free_space_floor_bytes
    free_bytes = shutil.disk_usage(there).free
    hours = (free_bytes - floor_bytes) / RECORD_BYTES_PER_H
    text = f"{folder.absolute()}: {free_bytes / 1e9:.1f} GB free"
    cure = "free some space, or choose another disk in $.recorder.directory"
    if hours <= 0:
        found = [fail(name, f"{text}, below the floor of {floor_bytes / 1e9:.1f} GB", cure)]
    elif hours < SHORT_DISK_H:
        text += f", enough for {hours:.1f} h; then the oldest records are deleted"
        found = [warning(name, text, cure)]
    else:
        found = [ok(name, f"{text}, enough for about {hours:.0f} h before the oldest are deleted")]
    return [*found, _check_sync(there, settings.flush_s)]


def _check_sync(folder: Path, flush_s: float) -> Finding:
    """How long the disk takes to keep a flush for good."""
    took_ms: list[float] = []
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            for _ in range(SYNCS):
                begin_s = time.perf_counter()
                file.write(os.urandom(SYNC_BYTES))
                file.flush()
                os.fdatasync(file.fileno())
                took_ms.append(1e3 * (time.perf_counter() - begin_s))
    except OSError as error:
        cure = "look at the disk (dmesg), or choose another in $.recorder.directory"
        return fail("disk sync", f"{folder}: {error.strerror}", cure)
    worst_ms = max(took_ms)
    text = f"median {statistics.median(took_ms):.1f} ms, worst of {SYNCS} {worst_ms:.1f} ms"
    if worst_ms > 1e3 * flush_s:
        cure = "use a faster disk; what a power cut takes is older than $.recorder.flush_s"
        return warning("disk sync", text, cure)
    return ok("disk sync", text)


# Processor ----------------------------------------------------------------------------------------
def check_map(settings: Map, processors: Sequence[str] = (MATCHER,)) -> Finding:
    """The track network can be read, and somebody matches with it."""
    try:
        network = networks.load(Path(settings.network))
    except TramstreamError as error:
        return from_error("map", error)
    if MATCHER not in processors:
        text = f"{settings.network}: nobody matches with it, for $.processors names no {MATCHER}"
        return warning("map", text, f'add "{MATCHER}" to $.processors, or take [map] out')
    km = float(network.length_m.sum()) / 1000.0
    return ok("map", f"{settings.network}: {network.track_count} tracks, {km:.0f} km")


def check_processor() -> list[Finding]:
    """How much of the processor is free right now."""
    cores = os.cpu_count() or 1
    idle_before, total_before = _cpu_ticks()
    time.sleep(CPU_SAMPLE_S)
    idle, total = _cpu_ticks()
    free = cores * (idle - idle_before) / max(1, total - total_before)
    text = f"{free:.1f} of {cores} cores free"
    if free < NEEDED_CORES:
        cure = "see with `top` what else is running; all of tramstream takes about 0.3"
        return [warning("processor", text, cure)]
    return [ok("processor", text)]


def _cpu_ticks() -> tuple[int, int]:
    """Idle and all processor time since boot, over all cores (proc(5))."""
    first = Path("/proc/stat").read_text().split("\n", 1)[0]
    ticks = [int(number) for number in first.split()[1:9]]
    return ticks[3] + ticks[4], sum(ticks)


def _nearest(folder: Path) -> Path:
    """`folder`, or the nearest folder above it that exists."""
    folder = folder.absolute()
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder
