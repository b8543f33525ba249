"""`tramstream demo`: a ride on simulated devices through everything that runs on a tram."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def demo(
    duration_s: Annotated[
        float, typer.Option("--duration-s", help="Length of the ride; 0 is until Ctrl-C.", min=0.0)
    ] = 60.0,
    rate: Annotated[
        float, typer.Option(help="Times real time: the whole ride runs on a faster clock.", min=0.1)
    ] = 1.0,
    seed: Annotated[int, typer.Option(help="Of the simulated sensors.")] = 7,
    out: Annotated[
        Path | None, typer.Option(help="Record to write; default demo-<time>.mcap.")
    ] = None,
    add: Annotated[
        list[str] | None,
        typer.Option("--add", metavar="NAME", help="Run this processor of another package too."),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Serve the live page beside, and print its address.")
    ] = False,
    listen: Annotated[
        str, typer.Option("--listen", help="With --live: HOST:PORT of the page.")
    ] = "127.0.0.1:8470",
    headless: Annotated[bool, typer.Option("--headless", help="No live screen.")] = False,
    json_: Annotated[
        bool, typer.Option("--json", help="Print one JSON object at the end.")
    ] = False,
) -> None:
    """Simulate a ride through real bridges, bus, processors and recorder; end with the errors.

    The devices are simulated, the rest is what runs on the vehicle: GNSS and IMU bytes on pseudo
    terminals, CAN through an slcan adapter, processes that meet on zenoh. On the way the receiver
    is unplugged, frames are corrupted and samples are lost.
    """
    import json
    import shutil
    import tempfile
    import time
    from dataclasses import asdict

    from tramstream.cli.terminal.demo_vehicle import configuration
    from tramstream.cli.terminal.page_beside import check_installed
    from tramstream.cli.terminal.session import say, stop_on_signals
    from tramstream.config_file import load
    from tramstream.errors import ConfigError, DamagedRecordError
    from tramstream.supervision import vehicle as fleet
    from tramstream.supervision.supervisor import Plan

    if live:
        check_installed()
    target = out or Path(time.strftime("demo-%Y%m%dT%H%M%S.mcap"))
    if target.exists():
        raise ConfigError(f"{target}: exists already; choose another --out or delete it")
    target.parent.mkdir(parents=True, exist_ok=True)
    stop = stop_on_signals()
    folder = Path(tempfile.mkdtemp(prefix="tramstream-demo-", dir="/tmp"))
    config = folder / "demo.toml"
    config.write_text(configuration(folder, seed, add or ()))
    vehicle = load(config)
    records = folder / "records"
    try:
        with fleet.running(Plan(vehicle, config, rate=rate), say, stop) as run:
            _watch(run, stop, duration_s, headless or json_, listen if live else "")
    finally:
        parts = sorted(records.glob("*.mcap*"))
        if not parts and stop.is_set():  # ended before there was anything to keep
            shutil.rmtree(folder, ignore_errors=True)
    if not parts and stop.is_set():
        raise KeyboardInterrupt
    if len(parts) != 1 or parts[0].suffix != ".mcap":
        raise DamagedRecordError(
            f"the recorder left {len(parts)} files in {records} and they were kept; "
            "`tramstream recover` saves what is in them"
        )
    shutil.move(parts[0], target)
    shutil.rmtree(folder, ignore_errors=True)  # not before the record is in its place
    from tramstream.analysis.evaluate.demo import summarise  # numpy, only now that the ride is over

    report = summarise(target)
    if json_:
        print(json.dumps({"record": str(target), **asdict(report)}))
    else:
        _print(report, target)
    if report.lost or report.unbalanced:
        raise DamagedRecordError(
            f"{report.lost} messages were lost; stages that do not add up: "
            f"{', '.join(report.unbalanced) or 'none'}"
        )


def _watch(run: Any, stop: Any, duration_s: float, headless: bool, listen: str) -> None:
    """Let the ride run, with the live screen or a line every ten seconds, and perhaps the page."""
    import sys
    import time
    from contextlib import ExitStack

    from tramstream.cli.terminal.page_beside import page_beside
    from tramstream.cli.terminal.session import say

    begin_s = time.monotonic()
    said = 0

    def each() -> None:
        nonlocal said
        elapsed_s = (time.monotonic() - begin_s) * run.bus.clock.rate
        if elapsed_s >= said + 10:
            said += 10
            say(f"{said} s of {duration_s:g} s")

    with ExitStack() as stack:
        page = ""
        if listen:
            vehicle = run.vehicle
            page = stack.enter_context(page_beside(vehicle.vehicle, vehicle.runtime_dir, listen))
            say(f"live page: {page}")
        if headless or not sys.stdout.isatty():
            run.until(stop, duration_s, each)
            return
        from tramstream.cli.top import live_screen

        title = f"tramstream demo: a simulated ride, {duration_s:g} s. Ctrl-C ends it early."
        title += f" Page: {page}" if page else ""
        with live_screen(run.bus, run.vehicle.vehicle, title) as refresh:
            run.until(stop, duration_s, refresh)


def _place_rows(report: Any) -> list[tuple[str, str, str]]:
    """Lines about the localisation filter, if the ride was long enough for a heading."""
    if report.position_rms_m is None:
        return []
    rows = [("position error", f"{report.position_rms_m:.3f} m", "RMS of the localisation filter")]
    if report.gnss_position_rms_m is not None:
        rows.append(("", f"{report.gnss_position_rms_m:.3f} m", "RMS of GNSS alone"))
    if report.yaw_rms_deg is not None:
        rows.append(("heading error", f"{report.yaw_rms_deg:.3f} °", "RMS"))
    return rows


def _print(report: Any, target: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    from tramstream import keys

    console = Console()
    title = f"{target}: {report.duration_s:.1f} s, {report.messages} messages"
    table = Table(title=title, box=None)
    table.add_column("figure")
    table.add_column("value", justify="right")
    table.add_column("", style="dim")
    rates = report.rates_hz
    rows = [
        ("lost", f"{report.lost}", "messages any node missed, by sequence numbers"),
        ("travelled", f"{report.distance_m:.2f} m", "truth"),
        ("distance error", f"{report.distance_rms_m:.3f} m", "RMS against the truth"),
        ("", f"{report.distance_end_m:+.3f} m", "at the end"),
        ("speed error", f"{report.speed_rms_mps:.4f} m/s", "RMS of the estimate"),
        ("", f"{report.gnss_speed_rms_mps:.4f} m/s", "RMS of GNSS alone"),
        *_place_rows(report),
        ("IMU", f"{rates.get(keys.IMU_BATCH.path, 0) * 20:.0f} Hz", "samples"),
        ("odometry", f"{rates.get(keys.ODO_WHEELS.path, 0):.1f} Hz", ""),
        ("GNSS", f"{rates.get(keys.GNSS_FIX.path, 0):.2f} Hz", ""),
        ("sync", f"{rates.get(keys.SYNC_FRAME.path, 0):.1f} Hz", "frames at the fusion horizon"),
    ]
    for row in rows:
        table.add_row(*row)
    console.print(table)
    injected = ", ".join(f"{name} {count}" for name, count in report.injected.items() if count)
    found = ", ".join(f"{name} {count}" for name, count in report.found.items() if count)
    console.print(f"faults injected: {injected or 'none'}", soft_wrap=True, highlight=False)
    console.print(f"faults found:    {found or 'none'}", soft_wrap=True, highlight=False)
    overrun = ", ".join(f"{name} {count}" for name, count in report.overrun.items() if count)
    if overrun:
        console.print(f"this machine read too late for: {overrun}", soft_wrap=True, highlight=False)
    console.print(
        f"next: tramstream info {target}; tramstream reprocess {target} -o again.mcap --check; "
        f"tramstream replay {target}",
        soft_wrap=True,
        highlight=False,
    )
