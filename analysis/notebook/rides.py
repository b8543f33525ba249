"""Simulated rides as records: what the bridges would have recorded, and the truth."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from tramstream import config, keys
from tramstream.analysis.notebook.record import PathLike, Record
from tramstream.bridges.gnss.messages import location
from tramstream.errors import RecordError
from tramstream.lines import geojson
from tramstream.lines.line import Line, built_in_line
from tramstream.processor import Sample, stamp
from tramstream.recorder import reader
from tramstream.recorder.file.writer import RecordFile
from tramstream.simulation import scenario as scenarios
from tramstream.simulation.scenario import Scenario
from tramstream.simulation.simulation import EPOCH_NS, Simulation

_ASK_EVERY = 1024
"""Messages between two looks at whether to go on."""


def simulate(
    scenario: PathLike | Scenario = "city",
    *,
    line: PathLike | Line | None = None,
    seed: int = 0,
    duration_s: float | None = None,
    out: PathLike | None = None,
) -> Record:
    """Simulate a ride: its measurements and its truth (`raw/truth/state`) as a record.

    Parameters
    ----------
    scenario : str, path or Scenario
        Name of a built-in one (`city`, `kaspar2023` …) or a TOML file: sensors, driver, events.
    line : str, path or Line, optional
        `FILE.geojson` or `FILE.geojson#LINE/DIRECTION`; else the built-in line.
    seed : int
        Of all chance; the same seed gives the same record.
    duration_s : float, optional
        End the ride early, s.
    out : str or path, optional
        Where the record is kept; else in a temporary folder that goes with it.

    Raises
    ------
    ConfigError
        If there is no such scenario or line.
    RecordError
        If `out` exists.
    """
    chosen = scenario if isinstance(scenario, Scenario) else scenarios.load(str(scenario))
    track = line if isinstance(line, Line) else laid(str(line or ""), chosen.track.geoid_m)
    ride = Simulation(track, chosen, seed, duration_s)
    labels = {"scenario": str(scenario), "seed": str(seed), "line": str(line or "built-in")}
    target, folder = place_for(out, "ride.mcap")
    write_ride(ride, target, labels)
    return made(target, folder)


def place_for(
    out: PathLike | None, name: str
) -> tuple[Path, tempfile.TemporaryDirectory[str] | None]:
    """Where a new record goes: to `out`, else to `name` in a temporary folder.

    Raises
    ------
    RecordError
        If `out` exists.
    """
    if out is None:
        folder = tempfile.TemporaryDirectory(prefix="tramstream-", ignore_cleanup_errors=True)
        return Path(folder.name) / name, folder
    target = Path(out).expanduser()
    if target.exists():
        raise RecordError(f"{target}: exists; delete it or name another `out`")
    return target, None


def made(
    place: Path, folder: tempfile.TemporaryDirectory[str] | None, source: Record | None = None
) -> Record:
    """A record that was just written."""
    return Record(reader.open_record(place), place, source, folder)


def laid(source: str, geoid_m: float, say: Callable[[str], None] = lambda _: None) -> Line:
    """The built-in line, or one from a map (`FILE.geojson#LINE/DIRECTION`).

    Raises
    ------
    ConfigError
    """
    if not source:
        return built_in_line()
    mapped = geojson.read(source, geoid_m)
    line = geojson.lay(mapped)
    say(
        f"{source}: {line.length_m:.0f} m, {len(line.stops_m)} stops; the smooth line is at most "
        f"{geojson.deviation_m(mapped, line):.2f} m beside the map's"
    )
    return line


def write_ride(
    ride: Simulation,
    out: Path,
    labels: dict[str, str],
    go_on: Callable[[int], bool] = lambda _: True,
) -> tuple[int, dict[str, int]]:
    """Write a ride as the bridges would have recorded it; its end and its messages by key.

    `go_on` is told the ride's instant (ns) now and then; a record that it cuts short is whole.
    """
    vehicle = ride.vehicle.vehicle
    metadata = {config.RECORD_ENTRY: config.to_json(ride.vehicle)}
    metadata |= {f"simulation.{name}": value for name, value in labels.items()}
    messages: dict[str, int] = {}
    topics: dict[str, str] = {}
    time_ns = EPOCH_NS
    with RecordFile(out, vehicle, metadata) as target:
        for number, sample in enumerate(_with_locations(ride)):
            path, time_ns = sample.key.path, sample.publish_ns
            topic = topics.get(path) or topics.setdefault(path, sample.key.on(vehicle))
            payload = sample.message.SerializeToString()
            target.append(topic, sample.key, payload, time_ns, time_ns, sample.sequence)
            messages[path] = messages.get(path, 0) + 1
            if number % _ASK_EVERY == 0 and not go_on(time_ns):
                break
    return time_ns, dict(sorted(messages.items()))


def _with_locations(ride: Simulation) -> Iterator[Sample]:
    """Samples of the ride, and with each valid fix its location, as the bridge does."""
    sequence = 0
    for sample in ride.samples():
        yield sample
        if sample.key is keys.GNSS_FIX and sample.message.valid:
            sequence += 1
            message = location(sample.message)
            stamp(message, sample.stamp_ns, sequence)
            yield Sample(keys.GNSS_LOCATION, message, sample.stamp_ns, sequence, sample.publish_ns)
