"""`tramstream map build OSM... -o NET`: a track network from a map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tramstream.mapping.build import Options
    from tramstream.mapping.osm import Extract
    from tramstream.mapping.survey import Report
    from tramstream.tracks.network import Network

SHOWN = 5
"""Findings of each kind that people see; --json has all."""
_KINDS = {
    "gap": "Gaps",
    "dead_end": "Dead ends",
    "one_way": "One-way contradictions",
    "kink": "Sharp kinks",
    "tag": "Tags not understood",
    "line": "Lines",
}


def build(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="OSM...",
            help="Overpass JSON, .osm.pbf, .osm or GeoJSON; several make one network.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Network to write.", metavar="NET")],
    elevation: Annotated[
        list[Path] | None,
        typer.Option(
            help="SRTM tile, like N50E014.hgt, or GeoTIFF in any coordinate system; may be "
            "repeated.",
            metavar="TILE.hgt",
        ),
    ] = None,
    grades: Annotated[
        Path | None,
        typer.Option(
            help="Grades that rides measured: of `grade-map build`; they take the place of "
            "terrain's.",
            metavar="MAP.parquet",
        ),
    ] = None,
    geoid_m: Annotated[
        float | None,
        typer.Option(
            "--geoid-m",
            help="Height of the geoid above the ellipsoid, added to tiles' heights. Default: that "
            "of Prague.",
        ),
    ] = None,
    node_std_m: Annotated[
        float | None,
        typer.Option(
            "--node-std-m",
            help="Deviation of the map's nodes from the rail, per axis. Default: estimated from "
            "the map.",
            min=0.001,
        ),
    ] = None,
    yards: Annotated[bool, typer.Option("--yards", help="Take in service=yard.")] = False,
    lines: Annotated[
        list[Path] | None,
        typer.Option(
            help="Lines as lists of stops, GeoJSON or TOML; may be repeated. Default: the routes "
            "in the map.",
            metavar="FILE",
        ),
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Build a track network: directed edges, smooth curves with their deviation, stops, lines.

    What is odd about the map is told and stops nothing; docs/map.md says what each finding means.
    """
    import json
    import time

    from tramstream.errors import ConfigError
    from tramstream.geodesy import PRAGUE_GEOID_M
    from tramstream.mapping.build import Options

    began_s = time.perf_counter()
    given = [*sources, *(elevation or ()), *(lines or ()), *([grades] if grades else ())]
    if out.resolve() in [path.resolve() for path in given]:
        raise ConfigError(f"{out}: is what would be read; choose another --out")
    height_m = PRAGUE_GEOID_M if geoid_m is None else geoid_m
    options = Options(yards, node_std_m, tuple(elevation or ()), height_m)
    result = _write(sources, options, (lines or [], grades), out)
    result["elapsed_s"] = time.perf_counter() - began_s
    if json_:
        print(json.dumps(result))
    else:
        _show(result)


def _write(
    sources: list[Path], options: Options, besides: tuple[list[Path], Path | None], out: Path
) -> dict[str, Any]:
    """Read, build, save; the figures. `besides`: files of lines, and a grade map."""
    from dataclasses import replace
    from datetime import UTC, datetime

    from tramstream.errors import ConfigError
    from tramstream.mapping import build as network_build
    from tramstream.mapping import extract as extracts
    from tramstream.mapping import lines as network_lines

    extract = extracts.read(sources)
    network, report = network_build.build(extract, options)
    network = network_lines.place_stops(network, extract)
    lines, grades = besides
    network, told = _with_lines(network, extract, lines)
    more: dict[str, Any] = {}
    if grades is not None:
        network, more = _with_grades(network, grades)
    built = f"{network.source}; built {datetime.now(UTC):%Y-%m-%d}"
    try:
        replace(network, source=built).save(out)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written ({error.strerror})") from error
    return _result(network, report, told) | more | {"out": str(out), "bytes": out.stat().st_size}


def _with_lines(
    network: Network, extract: Extract, files: list[Path]
) -> tuple[Network, tuple[str, ...]]:
    """Lay lines from files, or those of the extract; and what is odd about them."""
    from tramstream.mapping import line_requests
    from tramstream.mapping import lines as network_lines

    told: tuple[str, ...] = ()
    if files:
        requests = [request for path in files for request in line_requests.read(path)]
    else:
        requests, told = line_requests.of_extract(extract)
    network, more = network_lines.lay_lines(network, requests)
    return network, told + more


def _with_grades(network: Network, path: Path) -> tuple[Network, dict[str, Any]]:
    """Lay the grades of a map into a network; what came of it."""
    from tramstream.analysis.grade_map import file
    from tramstream.analysis.grade_map.summary import source_of, track_grades
    from tramstream.mapping import grades

    made = file.read(path)
    laid = grades.lay(network, track_grades(made), source_of(made, path.name))
    share = laid.samples / len(network.east)
    return laid.network, {"grade_share": share, "grades_nowhere": list(laid.unknown)}


def _result(network: Network, report: Report, told: tuple[str, ...]) -> dict[str, Any]:
    counts = report.counts | {"stops": len(network.stops), "lines": len(network.lines)}
    findings = [each._asdict() for each in report.findings]
    findings += [{"kind": "line", "text": text, "nodes": (), "ways": ()} for text in told]
    return {"counts": counts, **report.lengths, **report.fit, "findings": findings}


def _show(result: dict[str, Any]) -> None:
    """Print the figures, the first findings of each kind, and the file."""
    from math import degrees

    from rich.console import Console
    from rich.table import Table

    from tramstream.shown import shown

    counts = result["counts"]
    table = Table(title=None, box=None, show_header=False)
    table.add_column()
    table.add_column(justify="right")
    for name in ("nodes", "switches", "tracks", "edges", "segments", "stops", "lines"):
        table.add_row({"segments": "directed segments"}.get(name, name), f"{counts[name]:,}")
    if "grade_share" in result:
        table.add_row("with a measured grade", f"{result['grade_share']:.1%}")
        if nowhere := len(result["grades_nowhere"]):
            table.add_row("tracks of the grade map that are not here", f"{nowhere}")
    for name, text in (
        ("length of tracks", f"{result['track_km']:.1f} km"),
        ("length of edges", f"{result['edge_km']:.1f} km"),
        ("with an opposite edge within 8 m", f"{result['opposite_share']:.1%}"),
        ("nodes off the rail, per axis", f"{result['node_std_m']:.2f} m"),
        ("curves off the rail, median", f"{result['across_std_median_m']:.2f} m"),
        ("  heading, median", f"{degrees(result['yaw_std_median_rad']):.2f} deg"),
    ):
        table.add_row(name, text)
    console = Console(soft_wrap=True, highlight=False)
    console.print(table)
    for kind, title in _KINDS.items():
        texts = [each["text"] for each in result["findings"] if each["kind"] == kind]
        if texts:
            console.print(f"\n{title}: {len(texts)}")
            for text in texts[:SHOWN]:
                console.print(f"  {shown(text)}", markup=False)
            if len(texts) > SHOWN:
                console.print(f"  and {len(texts) - SHOWN} more (--json has all)")
    console.print(
        f"\n{result['out']}: {result['bytes'] / 1e6:.1f} MB in {result['elapsed_s']:.1f} s",
        markup=False,
    )
