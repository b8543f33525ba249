"""`tramstream doctor [CONFIG]`: is this machine, and this vehicle, ready to run?"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tramstream.cli.terminal.options import JsonOption
from tramstream.shown import shown

if TYPE_CHECKING:
    from tramstream.cli.checks.machine import Finding


def doctor(
    config: Annotated[
        Path | None, typer.Argument(help="Vehicle configuration; without one only the machine.")
    ] = None,
    json_: JsonOption = False,
) -> None:
    """Check ports, rights, disk, clock and bus; each failure names its cure.

    Devices are opened, listened to for up to three seconds and closed, unless a running node has
    them. Nothing is changed. The exit status is 1 if anything fails.
    """
    import shutil
    import sys
    from dataclasses import asdict

    from tramstream.cli.checks.machine import State
    from tramstream.cli.monitor.source import line

    found: list[Finding] = []
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else 0
    for finding in _findings(config):
        found.append(finding)
        if not json_:
            print(_text(finding, width), flush=True)
    failures = sum(finding.state == State.FAIL for finding in found)
    warnings = sum(finding.state == State.WARNING for finding in found)
    if json_:
        sums = {"ok": not failures, "failures": failures, "warnings": warnings}
        print(line({**sums, "checks": [asdict(finding) for finding in found]}))
    else:
        print(_verdict(failures, warnings, config))
    if failures:
        raise typer.Exit(1)


def _findings(config: Path | None) -> Iterator[Finding]:
    """All checks, one after the other, so that each line shows as soon as it is known."""
    from tramstream.cli.checks import devices, machine
    from tramstream.config import Recorder, Vehicle
    from tramstream.config_file import load
    from tramstream.errors import ConfigError
    from tramstream.private import default_runtime_dir

    yield from machine.check_python()
    yield from machine.check_processor()
    yield from machine.check_rights()
    vehicle: Vehicle | None = None
    if config is not None:
        try:
            vehicle = load(config)
            yield machine.ok("configuration", f"{config}: vehicle {vehicle.vehicle}")
        except ConfigError as error:
            yield machine.from_error("configuration", error)
    folder = vehicle.runtime_dir if vehicle is not None else default_runtime_dir()
    yield from machine.check_runtime_dir(folder)
    found, alive = machine.check_bus(folder)
    yield from found
    yield from machine.check_clock(folder)
    recorder = vehicle.recorder if vehicle is not None else Recorder()
    yield from machine.check_disk(recorder)
    yield from devices.check_serial()
    yield from devices.check_can_interfaces()
    if vehicle is not None and vehicle.map is not None:
        yield machine.check_map(vehicle.map, vehicle.processors)
    if vehicle is not None:
        yield from devices.check_vehicle(vehicle, alive)


def _text(finding: Finding, width: int) -> str:
    """A finding as a line; the cure stands below it."""
    colours = {"ok": "green", "warning": "yellow", "FAIL": "red"}
    colour = colours[finding.state] if width else None
    state = typer.style(f"{finding.state:<8}", fg=colour) if colour else f"{finding.state:<8}"
    text = f"{state} {finding.name:<15} {shown(finding.text)}"
    return f"{text}\n{'':<25}→ {shown(finding.cure)}" if finding.cure else text


def _verdict(failures: int, warnings: int, config: Path | None) -> str:
    def counted(number: int, what: str) -> str:
        return f"{number} {what}{'' if number == 1 else 's'}"

    if failures:
        return f"\n{counted(failures, 'failure')}, {counted(warnings, 'warning')}"
    ready = "ready" if config is not None else "this machine is fit"
    return f"\n{ready}" + (f"; {counted(warnings, 'warning')}" if warnings else "")
