"""`tramstream simulate -o OUT`: a ride with truth, as the bridges would have recorded it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

PROGRESS_S = 2.0


def simulate(
    out: Annotated[Path, typer.Option("--out", "-o", help="Record to write.")],
    line: Annotated[
        str,
        typer.Option(
            help="FILE.geojson, or FILE.geojson#LINE/DIRECTION to choose one of several; default: "
            "the built-in line.",
            metavar="FILE[#LINE]",
        ),
    ] = "",
    scenario: Annotated[
        str, typer.Option(help="Name of a built-in scenario, or a TOML file.", metavar="NAME|FILE")
    ] = "city",
    seed: Annotated[int, typer.Option(help="Of all chance.", min=0)] = 0,
    duration_s: Annotated[
        float, typer.Option("--duration-s", help="End the ride early; 0 is never.", min=0.0)
    ] = 0.0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace OUT.")] = False,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Simulate a ride along a line and write what the sensors would have said, and the truth.

    Built-in scenarios: city, tram and tram_articulated (a body on bogies and springs, worn rails),
    matching, still (an IMU in a depot, six hours), and one for each published work: kaspar2023,
    melenovsky2023, chladek2023, pusman2017, konecny2004. `tramstream reprocess` makes estimates
    from the record, `tramstream evaluate` holds them to the truth. The same seed gives the same
    record.
    """
    import json
    import time

    from tramstream.analysis.notebook.rides import laid, write_ride
    from tramstream.cli.terminal.session import make_room, say, stop_on_signals
    from tramstream.clock import S
    from tramstream.simulation import scenario as scenarios
    from tramstream.simulation.simulation import EPOCH_NS, Simulation

    source = Path(line.partition("#")[0])
    make_room(
        out, [Path(name) for name in (str(source), scenario) if Path(name).is_file()], overwrite
    )
    chosen = scenarios.load(scenario)
    track = laid(line, chosen.track.geoid_m, say)
    ride = Simulation(track, chosen, seed, duration_s or None)
    stop = stop_on_signals()
    began_s = told_s = time.perf_counter()

    def go_on(time_ns: int) -> bool:
        nonlocal told_s
        if stop.is_set():
            say("interrupted: the record holds what was simulated so far")
            return False
        if time.perf_counter() >= told_s + PROGRESS_S:
            told_s = time.perf_counter()
            say(f"{(time_ns - EPOCH_NS) / S:.0f} s of {ride.duration_s:.0f} s")
        return True

    labels = {"scenario": scenario, "seed": str(seed), "line": line or "built-in"}
    end_ns, messages = write_ride(ride, out, labels, go_on)
    result: dict[str, Any] = {"duration_s": (end_ns - EPOCH_NS) / S, "messages": messages}
    result |= {"out": str(out), **labels, "seed": seed, "length_m": track.length_m}
    result |= {"stops": len(track.stops_m), "elapsed_s": time.perf_counter() - began_s}
    if json_:
        print(json.dumps(result))
        return
    for key, count in messages.items():
        say(f"{key:28} {count:8d}")
    print(
        f"{out}: {result['duration_s']:.1f} s of {track.length_m / 1000:.2f} km, "
        f"{sum(messages.values())} messages in {result['elapsed_s']:.1f} s"
    )
