"""`tramstream allan RECORD…`: the noise of the inertial sensors out of hours of standstill."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tramstream.analysis.calibration.standing_noise import AxisNoise, Found, Settings
    from tramstream.calibrated import Source


def allan(
    records: Annotated[
        list[Path],
        typer.Argument(help="Records of one sensor, or folders with the parts of one."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="Calibration to write: OUT.toml, for `calibration` of a vehicle."
        ),
    ] = None,
    page: Annotated[Path | None, typer.Option(help="Page to write, PAGE.html.")] = None,
    least_s: Annotated[
        float,
        typer.Option("--least-s", help="Standstill without which there are no figures.", min=1.0),
    ] = 300.0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace OUT and PAGE.")] = False,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Estimate white noise N, bias instability B and T_b, and random walk K of each inertial axis.

    The vehicle stands, for hours if B and K are wanted; stretches that move are found and left out.
    All coefficients come out of one fit, each with its deviation; what the record cannot show is
    said. Beside stand the tangents of the published work. Ends with status 1 and without figures
    where there is not enough standstill.
    """
    import json
    import time

    from rich.console import Console

    from tramstream.analysis.calibration.standing_noise import analyse, settings_of
    from tramstream.calibrated import Source
    from tramstream.cli.terminal.page_file import make_place, write
    from tramstream.cli.terminal.session import say
    from tramstream.errors import CheckFailedError, DamagedRecordError
    from tramstream.recorder.reader import open_record

    for each in (out, page):
        if each is not None:
            make_place(each, records, overwrite)
    began_s = time.perf_counter()
    opened = [open_record(path) for path in records]
    try:
        with Console(stderr=True).status("reading") as status:
            found = analyse(opened, least_s, status.update)
        damaged = next((each.damaged for each in opened if each.damaged), "")
        left_out = next((each.left_out for each in opened if each.left_out), "")
        sources = tuple(
            Source.of(str(path), each.vehicle, each.start_ns, each.end_ns)
            for path, each in zip(records, opened, strict=True)
        )
    finally:
        for record in opened:
            record.close()
    settings = settings_of(found)
    if page is not None:
        from tramstream.analysis.report.allan_page import compose

        triples = [(name, value, settings.std[name]) for name, value in settings.values.items()]
        write(page, compose(found, triples))
    if out is not None and not found.verdict:
        write(out, fragment(settings, sources))
    if json_:
        print(json.dumps(plain(found, settings) | {"elapsed_s": time.perf_counter() - began_s}))
    else:
        _print(found, settings)
    for text in (damaged, left_out):
        if text:
            say(text)
    if found.verdict:
        raise CheckFailedError(f"{', '.join(map(str, records))}: {found.verdict}")
    if damaged or left_out:
        raise DamagedRecordError(damaged or left_out)


def fragment(settings: Settings, sources: tuple[Source, ...]) -> str:
    """The text of the calibration."""
    from tramstream.calibrated import Provenance
    from tramstream.calibration_file import document

    std = {f"imu.{name}": value for name, value in settings.std.items()}
    provenance = Provenance.now("allan", sources, std, tuple(settings.notes))
    return document({"imu": settings.values}, provenance)


def plain(found: Found, settings: Settings) -> dict[str, Any]:
    """All figures, without NaN, which JSON does not have."""
    low, high = found.temperature_degc
    return {
        "records": found.records,
        "key": found.key,
        "rate_hz": _number(found.rate_hz),
        "recorded_s": found.recorded_s,
        "standing_s": found.rest.standing_s,
        "moving_s": found.rest.moving_s,
        "stretches_s": [list(each) for each in found.stretches_s],
        "bridged_samples": found.bridged,
        "temperature_degc": [_number(low), _number(high)],
        "verdict": found.verdict,
        "axes": [_axis(each) for each in found.axes],
        "settings": {"imu": settings.values},
        "settings_std": {"imu": settings.std},
        "notes": settings.notes,
    }


def _axis(axis: AxisNoise) -> dict[str, Any]:
    from tramstream.analysis.calibration.fit import value_of
    from tramstream.analysis.calibration.noise import NAMES

    found: dict[str, Any] = {
        "axis": axis.name,
        "unit": axis.unit,
        "mean": _number(axis.mean),
        "trouble": axis.trouble,
        "remark": axis.remark,
        "tau_s": axis.curve.tau_s.tolist(),
        "allan_deviation": axis.curve.deviation.tolist(),
        "terms": axis.curve.terms.tolist(),
        "tangents": {
            name: _number(value) for name, value in zip(NAMES, axis.tangents, strict=True)
        },
    }
    fit = axis.fit
    if fit is not None:
        found["fit"] = {
            name: {
                "value": value_of(fit.noise, name),
                "std": value_of(fit.noise, name) * fit.std[name],
                "interval_95": list(fit.interval(name)),
            }
            for name in fit.std
        }
        found["at_most_95"] = {name: _number(value) for name, value in fit.limit.items()}
        found["white_from_s"] = fit.white_from_s
        found["per_degc"] = _number(fit.per_degc)
        found["per_degc_std"] = _number(fit.per_degc_std)
    return found


def _number(value: float) -> float | None:
    from math import isfinite

    return value if isfinite(value) else None


def _print(found: Found, settings: Settings) -> None:
    import sys

    from rich.console import Console
    from rich.table import Table

    from tramstream.analysis.report.allan_page import HEAD, facts, rows, short
    from tramstream.shown import shown

    console = Console(width=None if sys.stdout.isatty() else 160)
    for name, value in facts(found):
        console.print(f"{name:<16}{shown(value)}", markup=False, highlight=False, soft_wrap=True)
    if found.verdict:
        return
    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    for name in HEAD:
        table.add_column(name, no_wrap=True)
    for axis in found.axes:
        for row in rows(axis):
            table.add_row(*row)
    console.print(table)
    for name, setting in settings.values.items():
        text = f"[imu] {name} = {short(setting)} ± {short(settings.std[name])}"
        console.print(text, markup=False, highlight=False, soft_wrap=True)
    for note in settings.notes:
        console.print(note, markup=False, highlight=False, soft_wrap=True)
