"""`tramstream simulate -o OUT`: a ride with truth, as the bridges would have recorded it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tramstream.lines.line import Line
    from tramstream.simulation.simulation import Simulation

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

    Built-in scenarios: city, and one for each published work: kaspar2023, melenovsky2023,
    chladek2023, pusman2017, konecny2004. `tramstream reprocess` makes estimates from the record,
    `tramstream evaluate` holds them to the truth. The same seed gives the same record.
    """
    import json
    import time

    from tramstream.cli.terminal.session import make_room, say, stop_on_signals
    from tramstream.simulation import scenario as scenarios
    from tramstream.simulation.simulation import Simulation

    source = Path(line.partition("#")[0])
    make_room(
        out, [Path(name) for name in (str(source), scenario) if Path(name).is_file()], overwrite
    )
    chosen = scenarios.load(scenario)
    track = _line(line, chosen.track.geoid_m, say)
    ride = Simulation(track, chosen, seed, duration_s or None)
    stop = stop_on_signals()
    began_s = time.perf_counter()
    labels = {"scenario": scenario, "seed": str(seed), "line": line or "built-in"}
    result = _write(ride, out, labels, stop, say)
    result |= {"out": str(out), **labels, "seed": seed, "length_m": track.length_m}
    result |= {"stops": len(track.stops_m), "elapsed_s": time.perf_counter() - began_s}
    if json_:
        print(json.dumps(result))
        return
    for key, count in result["messages"].items():
        say(f"{key:28} {count:8d}")
    print(
        f"{out}: {result['duration_s']:.1f} s of {track.length_m / 1000:.2f} km, "
        f"{sum(result['messages'].values())} messages in {result['elapsed_s']:.1f} s"
    )


def _line(source: str, geoid_m: float, say: Any) -> Line:
    """The built-in line, or one from a map."""
    from tramstream.lines.line import built_in_line

    if not source:
        return built_in_line()
    from tramstream.lines import geojson

    mapped = geojson.read(source, geoid_m)
    line = geojson.lay(mapped)
    say(
        f"{source}: {line.length_m:.0f} m, {len(line.stops_m)} stops; the smooth line is at most "
        f"{geojson.deviation_m(mapped, line):.2f} m beside the map's"
    )
    return line


def _write(
    ride: Simulation, out: Path, labels: dict[str, str], stop: Any, say: Any
) -> dict[str, Any]:
    """Write the record until the end or a signal; a record that was cut short is whole."""
    import time

    from tramstream import config_file
    from tramstream.clock import S
    from tramstream.recorder.file.writer import RecordFile
    from tramstream.simulation.simulation import EPOCH_NS

    vehicle = ride.vehicle.vehicle
    metadata = {config_file.RECORD_ENTRY: config_file.to_json(ride.vehicle)}
    metadata |= {f"simulation.{name}": value for name, value in labels.items()}
    messages: dict[str, int] = {}
    topics: dict[str, str] = {}
    told_s = time.monotonic()
    time_ns = EPOCH_NS
    with RecordFile(out, vehicle, metadata) as target:
        for number, sample in enumerate(_with_locations(ride)):
            path, time_ns = sample.key.path, sample.publish_ns
            topic = topics.get(path) or topics.setdefault(path, sample.key.on(vehicle))
            payload = sample.message.SerializeToString()
            target.append(topic, sample.key, payload, time_ns, time_ns, sample.sequence)
            messages[path] = messages.get(path, 0) + 1
            if number % 1024 == 0:
                if stop.is_set():
                    say("interrupted: the record holds what was simulated so far")
                    break
                if time.monotonic() >= told_s + PROGRESS_S:
                    told_s = time.monotonic()
                    say(f"{(time_ns - EPOCH_NS) / S:.0f} s of {ride.duration_s:.0f} s")
    return {"duration_s": (time_ns - EPOCH_NS) / S, "messages": dict(sorted(messages.items()))}


def _with_locations(ride: Simulation) -> Iterator[Any]:
    """Samples of the ride, and with each valid fix its location, as the bridge does."""
    from tramstream import keys
    from tramstream.bridges.gnss.messages import location
    from tramstream.processor import Sample, stamp

    sequence = 0
    for sample in ride.samples():
        yield sample
        if sample.key is keys.GNSS_FIX and sample.message.valid:
            sequence += 1
            message = location(sample.message)
            stamp(message, sample.stamp_ns, sequence)
            yield Sample(keys.GNSS_LOCATION, message, sample.stamp_ns, sequence, sample.publish_ns)
