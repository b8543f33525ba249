"""`tramstream hz KEY`: how often messages come, how evenly, and how many are missing."""

from __future__ import annotations

from typing import Annotated

import typer

from tramstream.cli.terminal.options import (
    FileOption,
    Format,
    FormatOption,
    JsonOption,
    KeyArgument,
    VehicleOption,
    WindowOption,
)


def hz(
    key: KeyArgument,
    file: FileOption = None,
    count: Annotated[
        int,
        typer.Option("--count", help="Reports; of a file messages to read; 0: all.", min=0),
    ] = 0,
    format_: FormatOption = Format.text,
    json_: JsonOption = False,
    vehicle: VehicleOption = "",
    window_s: WindowOption = 10.0,
) -> None:
    """Rate and period of keys, and losses: one line a second, one in all for a file.

    Periods are between arrivals. Losses are gaps in the sequence numbers since this verb began.
    """
    from typing import Any

    from tramstream.cli.monitor.source import look
    from tramstream.cli.monitor.survey import Sheet, survey
    from tramstream.cli.terminal.session import stop_on_signals
    from tramstream.events.wording import number
    from tramstream.monitor.stats import Figures, KeyStats

    def cells(stats: KeyStats, of: Figures) -> list[str]:
        periods = (of.period_min_s, of.period_max_s, of.period_std_s)
        nominal_hz = stats.key.rate_hz if stats.key is not None else 0.0
        return [
            number(of.rate_hz),
            f"{nominal_hz:g}" if nominal_hz else "",
            *(number(None if period is None else 1e3 * period) for period in periods),
            str(stats.count),
            str(stats.lost),
        ]

    def data(stats: KeyStats, of: Figures) -> dict[str, Any]:
        return {
            "rate_hz": of.rate_hz,
            "nominal_hz": stats.key.rate_hz if stats.key is not None else None,
            "period_min_s": of.period_min_s,
            "period_max_s": of.period_max_s,
            "period_std_s": of.period_std_s,
            "count": stats.count,
            "lost": stats.lost,
            "disordered": stats.disordered,
        }

    head = ("rate Hz", "nominal", "min ms", "max ms", "std ms", "count", "lost")
    stop = stop_on_signals()
    with look(key, file, vehicle) as source:
        as_json = json_ or format_ is Format.json
        survey(source, stop, Sheet(head, cells, data), as_json, count, window_s)
