"""`tramstream map match FILE --net NET`: the path of a ride over the track network."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tramstream.analysis.studies.match_source import Source
    from tramstream.processors.matching.offline import Leg
    from tramstream.tracks.linear_reference import References
    from tramstream.tracks.network import Network


def match(
    file: Annotated[Path, typer.Argument(help="Record, or a trace: .mcap, .gpx, .geojson.")],
    net: Annotated[Path, typer.Option("--net", help="Network of `map build`.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Page to write, PAGE.html.")
    ] = None,
    csv: Annotated[
        Path | None, typer.Option("--csv", help="Table to write: the place on the track, by time.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the outputs.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Find the path over the tracks that a ride took, the whole ride known.

    What the vehicle itself said as it went is in its record, on map/matcher.
    """
    import json

    from rich.console import Console

    from tramstream.analysis.studies.match_source import match as match_file
    from tramstream.cli.terminal.page_file import make_place
    from tramstream.cli.terminal.session import say
    from tramstream.shown import shown, shown_json
    from tramstream.tracks.linear_reference import references
    from tramstream.tracks.network import load

    for target, option in ((out, "--out"), (csv, "--csv")):
        if target is not None:
            make_place(target, [file, net], overwrite, option)
    network = load(net)
    known = references(network)
    with Console(stderr=True).status(shown(str(file))):
        source = match_file(file, network, net, say)
        figures = {"file": str(file), "net": str(net), **describe(network, known, source)}
        if out is not None:
            from tramstream.analysis.report.map_match_page import compose
            from tramstream.cli.terminal.page_file import write

            write(out, compose(network, source, figures))
            figures["out"] = str(out)
        if csv is not None:
            _write_csv(csv, network, known, source)
            figures["csv"] = str(csv)
    if as_json:
        print(shown_json(json.dumps(figures, ensure_ascii=False)))
    else:
        _print(figures)


# Figures ------------------------------------------------------------------------------------------
def describe(network: Network, known: References, source: Source) -> dict[str, Any]:
    """Give the path and what is to be said of it, by name."""
    import numpy as np

    places = [place for place in source.path.places if place.run >= 0]
    across = np.array([place.across_m for place in places])
    ends = _ends(network, source.path.legs)
    legs = [
        _leg(network, known, source, leg, begin_m, end_m)
        for leg, (begin_m, end_m) in zip(source.path.legs, ends, strict=True)
    ]
    covered = _covered(legs)
    for leg in legs:
        leg["lines"].sort(key=lambda each: -covered[each["line"], each["direction"]])
    count = max(len(source.path.places), 1)
    return {
        "matched": source.kind,
        "notes": [*source.notes, *([] if places else [_nowhere(network, source)])],
        "duration_s": float(source.stamp_ns[-1] - source.stamp_ns[0]) / 1e9,
        "length_m": sum(leg["to_m"] - leg["from_m"] for leg in legs),
        "on_track_share": len(places) / count,
        "across_rms_m": float(np.sqrt(np.mean(across**2))) if len(across) else None,
        "across_p95_m": float(np.quantile(np.abs(across), 0.95)) if len(across) else None,
        "path": legs,
    }


def _nowhere(network: Network, source: Source) -> str:
    """Tell how far from all tracks a ride was that was on none."""
    from tramstream.tracks.rails import Search

    east, north = source.plan[len(source.plan) // 2]
    away_m = Search(network).away_m(float(east), float(north))
    return (
        f"On no track of this map; the nearest is {away_m / 1000:.1f} km away. Is it this city's?"
    )


def _ends(network: Network, legs: list[Leg]) -> list[tuple[float, float]]:
    """From where to where each leg goes along its run: to its end, where the next run joins it."""
    ends = [
        (min(leg.begin_m, leg.end_m), max(leg.begin_m, leg.end_m)) if leg.run >= 0 else (0.0, 0.0)
        for leg in legs
    ]
    for k, (leg, after) in enumerate(pairwise(legs)):
        if leg.run >= 0 and after.run in network.following_of(leg.run):
            ends[k] = ends[k][0], float(network.length_m[leg.run >> 1])
            ends[k + 1] = 0.0, ends[k + 1][1]
    return ends


def _leg(
    network: Network, known: References, source: Source, leg: Leg, begin_m: float, end_m: float
) -> dict[str, Any]:
    on_track = leg.run >= 0
    middle_m = (begin_m + end_m) / 2
    lines = []
    for line, chainage_m in known.at(leg.run, middle_m) if on_track else []:
        begin = chainage_m - middle_m + begin_m
        lines.append(
            {
                "line": network.lines[line].line,
                "direction": network.lines[line].direction,
                "destination": network.lines[line].destination,
                "from_m": begin,
                "to_m": begin + end_m - begin_m,
            }
        )
    return {
        "edge": network.name_of(leg.run) if on_track else None,
        "run": leg.run,
        "from_m": begin_m,
        "to_m": end_m,
        "entered_ns": leg.begin_ns,
        "left_ns": leg.end_ns,
        "entered": source.time(leg.begin_ns),
        "probability": leg.probability,
        "lines": lines,
    }


def _covered(legs: list[dict[str, Any]]) -> dict[tuple[str, str], float]:
    """How much of the path each line goes along: the line that was driven comes first."""
    covered: dict[tuple[str, str], float] = {}
    for leg in legs:
        for each in leg["lines"]:
            name = each["line"], each["direction"]
            covered[name] = covered.get(name, 0.0) + leg["to_m"] - leg["from_m"]
    return covered


# Tables -------------------------------------------------------------------------------------------
def _print(figures: dict[str, Any]) -> None:
    import sys

    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from tramstream.analysis.report.network_tables import LEG_HEAD, leg_rows, match_facts
    from tramstream.shown import shown

    console = Console(width=None if sys.stdout.isatty() else 160)
    for name, value in match_facts(figures):
        console.print(f"{name:<10}{shown(value)}", markup=False, highlight=False, soft_wrap=True)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in LEG_HEAD:
        table.add_column(name, justify="right" if name in ("from, m", "to, m") else "left")
    for row in leg_rows(figures):
        table.add_row(*(escape(shown(cell)) for cell in row))
    console.print(table)
    for name in ("out", "csv"):
        if name in figures:
            console.print(f"{name:<10}{figures[name]}", markup=False, highlight=False)


def _write_csv(target: Path, network: Network, known: References, source: Source) -> None:
    import csv as tables

    import numpy as np

    from tramstream.analysis.report.network_drawing import plan_at
    from tramstream.shown import cell

    plan = [
        plan_at(network, place.run >> 1, _drawn_m(network, place.run, place.chainage_m))
        for place in source.path.places
        if place.run >= 0
    ]
    geodetic = iter(np.degrees(network.geodetic_of(np.array(plan).reshape(-1, 2))).tolist())
    head = "stamp_ns edge run chainage_m across_m probability latitude_deg longitude_deg"
    with target.open("w", newline="", encoding="utf-8") as file:
        table = tables.writer(file)
        table.writerow([*head.split(), "line", "direction", "line_chainage_m"])
        for place in source.path.places:
            if place.run < 0:
                table.writerow([place.stamp_ns, "", -1])
                continue
            row: list[object] = [place.stamp_ns, network.name_of(place.run), place.run]
            row += [f"{place.chainage_m:.2f}", f"{place.across_m:.2f}", f"{place.probability:.4f}"]
            row += [f"{each:.8f}" for each in next(geodetic)]
            found = known.at(place.run, place.chainage_m)
            if found:
                line = network.lines[found[0].line]
                row += [cell(line.line), cell(line.direction), f"{found[0].chainage_m:.2f}"]
            table.writerow(row)


def _drawn_m(network: Network, run: int, chainage_m: float) -> float:
    """Chainage along the track as drawn."""
    return chainage_m if run % 2 == 0 else float(network.length_m[run >> 1]) - chainage_m
