"""What verbs on the bus share: the configuration, the clock, signals, a way to find the vehicle."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from tramstream import keys
from tramstream.clock import VehicleClock
from tramstream.errors import BusError, ConfigError
from tramstream.private import default_runtime_dir
from tramstream.recorder.file.sink import ACTIVE
from tramstream.recorder.file.storage import is_written
from tramstream.shown import shown
from tramstream.transport import buses
from tramstream.transport.bus import Bus, ZenohBus


def say(text: str) -> None:
    """Say something to people, on standard error; what strangers wrote in it does no harm."""
    print(shown(text, lines=True), file=sys.stderr, flush=True)


def make_room(out: Path, sources: Sequence[Path], overwrite: bool) -> None:
    """Delete `out` if it shall be replaced, unless it is, or lies in, one of the `sources`.

    So is what a run that was killed has left of it (`OUT.active`).

    Raises
    ------
    ConfigError
        If `out` would destroy what it is made from, or somebody writes it.
    """
    target = out.resolve()
    for source in sources:
        place = source.resolve()
        if target == place or (place.is_dir() and place in target.parents):
            raise ConfigError(
                f"{out}: is what would be read, or lies in its folder; choose another --out"
            )
    unfinished = out.with_name(out.name + ACTIVE)
    if unfinished.exists():
        if is_written(unfinished):
            raise ConfigError(f"{unfinished}: is being written; end that program first")
        if not overwrite:
            raise ConfigError(
                f"{unfinished}: was left by a program that was killed",
                cure="--overwrite replaces it, `tramstream recover` makes a record of it",
            )
    if overwrite:
        unfinished.unlink(missing_ok=True)
        out.unlink(missing_ok=True)


def stop_on_signals() -> threading.Event:
    """An event that Ctrl-C, SIGTERM and a closed terminal set; a second Ctrl-C interrupts for good.

    Not a closed terminal if that was to be ignored (`nohup`).
    """
    stop = threading.Event()

    def handle(number: int, frame: FrameType | None) -> None:
        if stop.is_set() and number == signal.SIGINT:
            raise KeyboardInterrupt
        stop.set()

    signal.signal(signal.SIGINT, handle)
    signal.signal(signal.SIGTERM, handle)
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        signal.signal(signal.SIGHUP, handle)
    return stop


@contextmanager
def client(vehicle: str = "", folder: Path | None = None) -> Iterator[Bus]:
    """A session on a bus of this user, closed at the end: the only one, or that with `vehicle`.

    Where a `folder` is named, on the bus there.

    Raises
    ------
    BusError
        If there is no bus, or several and none is chosen.
    """
    bus = _the_one(vehicle) if folder is None else _joined(folder)
    try:
        yield bus
    finally:
        bus.close()


def _the_one(vehicle: str) -> Bus:
    folders = buses.listening()
    if len(folders) < 2:
        folder = folders[0] if folders else default_runtime_dir()
        return _joined(folder)
    several: dict[str, list[str]] = {}
    chosen: Bus | None = None
    for folder in folders:
        bus = _joined(folder)
        several[str(folder)] = vehicles = _vehicles(bus)
        if chosen is None and vehicle in vehicles:
            chosen = bus
        else:
            bus.close()
    if chosen is not None:
        return chosen
    told = "; ".join(
        f"{folder}: {', '.join(names) or 'empty'}" for folder, names in several.items()
    )
    raise BusError(
        f"vehicle {vehicle} is on none of the buses of this user ({told})"
        if vehicle not in ("", keys.ANY_SOURCE)
        else f"this user has several buses ({told}); choose with --vehicle",
    )


def _joined(folder: Path) -> Bus:
    return ZenohBus.connect(folder, VehicleClock.shared(folder))


def _vehicles(bus: Bus) -> list[str]:
    """Vehicles that have nodes on the bus, by name."""
    return sorted({keys.split(token)[0] for token in bus.alive(keys.alive("*", "*"))})


def vehicle_on(bus: Bus, wanted: str = "") -> str:
    """The vehicle to look at: `wanted`, or the only one that has nodes on the bus.

    Raises
    ------
    BusError
        If there is none, or several and none is wanted.
    """
    if wanted:
        return wanted
    vehicles = _vehicles(bus)
    if len(vehicles) == 1:
        return vehicles[0]
    if not vehicles:
        raise BusError("the bus has no nodes; start `tramstream run`, `demo` or `replay`")
    raise BusError(
        f"several vehicles are on the bus ({', '.join(vehicles)}); choose with --vehicle"
    )
