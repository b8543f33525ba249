"""`tramstream calibrate RECORD…`: wheels, antenna and delays out of ordinary rides."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tramstream.analysis.fleet.changes import State
    from tramstream.analysis.fleet.outcome import Outcome
    from tramstream.analysis.odometry.calibration import Calibration


def calibrate(
    records: Annotated[
        list[str],
        typer.Argument(
            metavar="RECORD...",
            help="Records, globs, or folders, of one vehicle or many: a ride each.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Calibration to write: OUT.toml of one vehicle, or a folder, with one of each.",
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(help="Configuration; by default that of each record."),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option(help="Table of all rides, TABLE.parquet; one that exists is added to."),
    ] = None,
    page: Annotated[Path | None, typer.Option(help="Page to write, PAGE.html.")] = None,
    workers: Annotated[
        int, typer.Option(help="Rides that are worked on at a time; 0: one a core.", min=0)
    ] = 0,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace OUT and PAGE; make TABLE anew.")
    ] = False,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Find each wheel's constant, the antenna's place, delays, slips, and a clock that is off.

    Rides of a vehicle are put together; what has changed between them, and how wheels wear, is
    said. A ride without motion, fixes or living sensors has a verdict and no figures; status 1 if
    no ride has any.
    """
    import json
    import time

    from tramstream.analysis.fleet.changes import states
    from tramstream.analysis.fleet.places import places
    from tramstream.analysis.odometry.finding import VERB, find
    from tramstream.cli.terminal.fleet import kept, over
    from tramstream.cli.terminal.page_file import make_place, write
    from tramstream.config_file import load
    from tramstream.errors import CheckFailedError, DamagedRecordError
    from tramstream.shown import shown, shown_json

    began_s = time.perf_counter()
    rides = places(records)
    sources = [path for ride in rides for path in ride.paths]
    for each in (out, page):
        if each is not None and not each.is_dir():
            make_place(each, sources, overwrite)
    if table is not None:
        make_place(table, sources, overwrite=True)
    vehicle = load(config) if config is not None else None
    outcomes = over(rides, find, (vehicle,), workers)
    rows = kept(VERB, outcomes, table, overwrite)
    digests = {one.finding.digest for one in outcomes if one.finding is not None}
    vehicles = {row.vehicle for row in rows if row.digest in digests}
    found = states(row for row in rows if row.verb == VERB and row.vehicle in vehicles)
    if page is not None:
        from tramstream.analysis.report.fleet_page import compose

        refused = [(one.place.name, one.refused) for one in outcomes if one.refused]
        write(page, compose(VERB, rows, states(rows), refused))
    if out is not None:
        _write_calibrations(out, outcomes, found, overwrite)
    if json_:
        figures = _plain(outcomes, found) | {"elapsed_s": time.perf_counter() - began_s}
        print(shown_json(json.dumps(figures, ensure_ascii=False)))
    else:
        print(shown("\n".join(_told(outcomes, found)), lines=True))
    damaged = [one for one in outcomes if one.damaged]
    usable = [one for one in outcomes if one.finding is not None and not one.finding.verdict]
    if not usable:
        first = outcomes[0] if outcomes else None
        why = "nothing was done" if first is None else first.refused or _verdict(first)
        if damaged:
            raise DamagedRecordError(why)
        raise CheckFailedError(f"{first.place.name if first else 'calibrate'}: {why}")
    if damaged:
        raise DamagedRecordError(f"{len(damaged)} of {len(outcomes)} records are damaged")


def _verdict(outcome: Outcome) -> str:
    return outcome.finding.verdict if outcome.finding is not None else ""


def _write_calibrations(
    out: Path, outcomes: Sequence[Outcome], found: Sequence[State], overwrite: bool
) -> None:
    """Write one calibration, or one of each vehicle into a folder."""
    from tramstream.analysis.odometry.finding import fragment
    from tramstream.cli.terminal.page_file import make_place, write
    from tramstream.errors import ConfigError

    details: dict[str, list[Any]] = {}
    for one in outcomes:
        if one.finding is not None and not one.finding.verdict:
            details.setdefault(one.finding.vehicle, []).append(one.finding.detail)
    if not out.is_dir() and len(details) > 1:
        names = ", ".join(sorted(details))
        raise ConfigError(f"{out}: {names} are several vehicles", cure="-o FOLDER takes one each")
    for name, used in sorted(details.items()):
        text = fragment([state for state in found if state.vehicle == name], used)
        if not text:
            continue
        place = out / f"{name}.calibration.toml" if out.is_dir() else out
        make_place(place, [], overwrite)
        write(place, text)


# What is printed ----------------------------------------------------------------------------------
def _told(outcomes: Sequence[Outcome], found: Sequence[State]) -> Iterator[str]:
    from tramstream.analysis.odometry.wording import of_ride
    from tramstream.analysis.report.fleet_page import HEAD, lines

    for one in outcomes:
        if one.finding is None:
            continue
        yield f"{one.place.name}: {one.finding.vehicle}, {one.finding.duration_s:.0f} s"
        yield from (f"  {line}" for line in of_ride(one.finding.detail.calibration))
    if len(outcomes) > 1 and found:
        cells = [HEAD, *lines(found)]
        widths = [max(len(row[k]) for row in cells) for k in range(len(HEAD))]
        for row in cells:
            yield "  ".join(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=True)).rstrip()


def _plain(outcomes: Sequence[Outcome], found: Sequence[State]) -> dict[str, Any]:
    """All figures, without NaN, which JSON does not have."""
    from tramstream.analysis.odometry.wording import number

    return {
        "rides": [
            {
                "record": one.place.name,
                "vehicle": one.finding.vehicle if one.finding is not None else "",
                "refused": one.refused,
                "damaged": one.damaged,
                **(_of(one.finding.detail.calibration) if one.finding is not None else {}),
            }
            for one in outcomes
        ],
        "vehicles": [
            {name: number(value) for name, value in state._asdict().items()} for state in found
        ],
    }


def _of(found: Calibration) -> dict[str, Any]:
    from tramstream.analysis.odometry.wording import number

    clock = found.clock
    return {
        "verdict": found.verdict,
        "figures": {
            each.name: {"value": each.value, "std": each.std, "unit": each.unit}
            for each in found.figures
            if each.told
        },
        "unknown": {each.name: each.std for each in found.figures if not each.told},
        "correlation": {
            "of": [each.name for each in found.figures],
            "matrix": found.correlation.tolist(),
        },
        "clock_off": clock.sensor,
        "clock_offset_s": number(clock.offset_s) if clock.sensor else None,
        "clock_std_s": number(clock.std_s) if clock.sensor else None,
        "slips": [each._asdict() for each in found.slips],
        "fix_error_over_stated": number(found.fix_error),
        "misfit": number(found.misfit),
        "way_m": found.way_m,
        "moving_s": found.moving_s,
        "notes": list(found.notes),
    }
