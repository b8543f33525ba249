"""`tramstream grade-map build RECORDS... --net NET -o MAP.parquet`: slopes from many rides."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tramstream.analysis.grade_map.assemble import GradeMap
    from tramstream.analysis.grade_map.passes import Ride
    from tramstream.analysis.grade_map.record import Refused
    from tramstream.tracks.network import Network


def build(
    records: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDS...", help="Records, or folders with the parts of one: a ride each."
        ),
    ],
    net: Annotated[Path, typer.Option("--net", help="Network of `map build`.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Map to write, MAP.parquet. To one that exists the rides are added.",
        ),
    ] = None,
    into: Annotated[
        Path | None,
        typer.Option(help="Map to add the rides to; it is replaced, or left for --out."),
    ] = None,
    elevation: Annotated[
        list[Path] | None,
        typer.Option(
            help="Raster with heights above the geoid: SRTM tile (.hgt), GeoTIFF in any coordinate "
            "system; may be repeated.",
            metavar="FILE",
        ),
    ] = None,
    geoid_m: Annotated[
        float | None,
        typer.Option(
            "--geoid-m",
            help="Height of the geoid above the ellipsoid, added to rasters' heights. Default: "
            "that of Prague.",
        ),
    ] = None,
    workers: Annotated[
        int, typer.Option(help="Rides that are smoothed at a time; 0: one a core.", min=0)
    ] = 0,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Make MAP anew, without what is in it.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Merge rides into a map of the tracks' slopes, with their deviation.

    A ride without smoothed states, or whose filter was held to a map's grades, is smoothed first
    (0.6 GB of memory for an hour of it). A ride that is in the map already is not counted again.
    """
    import json
    import time

    from tramstream.analysis.grade_map import file
    from tramstream.analysis.grade_map.assemble import assemble, rides_of
    from tramstream.cli.terminal.session import say
    from tramstream.errors import DamagedRecordError, RecordError
    from tramstream.shown import shown, shown_json
    from tramstream.tracks.network import load

    began_s = time.perf_counter()
    target, base = _places(out, into, [*records, net, *(elevation or ())], overwrite)
    network = load(net)
    known = rides_of(file.read(base), network) if base is not None else []
    priors = _priors(elevation or [], geoid_m)
    rides, refused = _read(records, network, known, workers)
    for each in refused:
        say(f"{each.name}: left out: {each.why}")
    if not rides and not known:
        raise RecordError("none of the records can be used; no map is written")
    read_s = time.perf_counter() - began_s
    began_s = time.perf_counter()
    made = assemble(network, [*known, *rides], priors)
    file.write(made, target)
    figures = _figures(made, target, len(rides), refused)
    figures |= {"reading_s": read_s, "merging_s": time.perf_counter() - began_s}
    if as_json:
        print(shown_json(json.dumps(figures, ensure_ascii=False)))
    else:
        print(shown("\n".join(_told(figures)), lines=True))
    damaged = [each for each in refused if each.damaged]
    if damaged:
        raise DamagedRecordError(f"{len(damaged)} records are damaged: {damaged[0].why}")


def _places(
    out: Path | None, into: Path | None, sources: Sequence[Path], overwrite: bool
) -> tuple[Path, Path | None]:
    """Where the map goes, and the one that it begins with.

    Raises
    ------
    ConfigError
        If there is no place for it, or it would destroy what it is made from.
    """
    from tramstream.cli.terminal.page_file import make_place
    from tramstream.errors import ConfigError

    target = out or into
    if target is None:
        raise ConfigError("no map is named", cure="-o MAP.parquet writes one")
    if into is not None and not into.exists():
        raise ConfigError(f"{into}: does not exist", cure="-o makes a new map")
    make_place(target, sources, overwrite=True)
    if into is not None:
        if overwrite and target.resolve() == into.resolve():
            raise ConfigError("--overwrite would throw away what --into adds to; leave one out")
        if out is not None and out.exists() and out.resolve() != into.resolve() and not overwrite:
            raise ConfigError(f"{out}: exists already; choose another -o or give --overwrite")
        return target, into
    return target, target if target.exists() and not overwrite else None


def _priors(elevation: Sequence[Path], geoid_m: float | None) -> Any:
    from tramstream.analysis.grade_map.heights import Priors
    from tramstream.geodesy import PRAGUE_GEOID_M
    from tramstream.mapping import elevation as rasters

    tiles = [rasters.read(path) for path in elevation]
    return Priors(tiles, PRAGUE_GEOID_M if geoid_m is None else geoid_m)


def _read(
    records: Sequence[Path], network: Network, known: Sequence[Ride], workers: int
) -> tuple[list[Ride], list[Refused]]:
    """Read rides on all cores, those that are known left out; what a signal leaves is told."""
    import tempfile

    from tramstream.analysis.grade_map.record import Refused, identity, level_ground
    from tramstream.cli.terminal.session import say
    from tramstream.errors import RecordError

    rides: list[Ride] = []
    refused: list[Refused] = []
    seen = {ride.digest: f"as {ride.name} in the map already" for ride in known}
    wanted: list[Path] = []
    for path in records:
        try:
            digest = identity(path)
        except (RecordError, OSError) as error:
            refused.append(Refused(str(path), "", str(error)))
            continue
        if digest in seen:
            refused.append(Refused(str(path), digest, f"counted {seen[digest]}"))
            continue
        seen[digest] = f"as {path.name}"
        wanted.append(path)
    if not wanted:
        return rides, refused
    with tempfile.TemporaryDirectory(prefix="tramstream-") as folder:
        level_net = Path(folder) / "level.net"
        level_ground(network).save(level_net)
        done = 0
        for result in _results(wanted, level_net, workers):
            done += 1
            if isinstance(result, Refused):
                refused.append(result)
            else:
                rides.append(result)
    if done < len(wanted):
        say(f"stopped; {len(wanted) - done} records are missing")
    refused.sort(key=lambda each: each.name)
    return rides, refused


def _results(wanted: Sequence[Path], level_net: Path, workers: int) -> Iterator[Ride | Refused]:
    """Rides as they are done, with one line of progress; after a signal no more."""
    from tramstream.analysis.grade_map.record import ride_of
    from tramstream.cli.terminal import pool
    from tramstream.cli.terminal.session import say
    from tramstream.errors import MachineCodeError
    from tramstream.machine import compilation

    try:
        compilation.ensure(say)  # a single ride is smoothed, too
    except MachineCodeError as error:
        say(f"{error}; what is needed is compiled on the way")
    jobs = [pool.Job(ride_of, (path, level_net)) for path in wanted]
    for _, result in pool.shown(jobs, workers, "rides"):
        yield result


def _figures(
    made: GradeMap, target: Path, added: int, refused: Sequence[Refused]
) -> dict[str, Any]:
    from tramstream.analysis.grade_map.summary import summary

    return {
        "out": str(target),
        "bytes": target.stat().st_size,
        "rides_added": added,
        **summary(made),
        "left_out": [each._asdict() for each in refused],
    }


def _told(figures: dict[str, Any]) -> Iterator[str]:
    from tramstream.analysis.grade_map.summary import sentences

    yield from sentences(figures)
    yield (
        f"{figures['out']}: {figures['bytes'] / 1e6:.1f} MB; {figures['rides_added']} rides added, "
        f"read in {figures['reading_s']:.1f} s and merged in {figures['merging_s']:.2f} s"
    )
