"""`tramstream bw KEY`: how many bytes keys carry."""

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


def bw(
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
    """Bytes a second and message sizes of keys: one line a second, one in all for a file.

    Sizes are of encoded messages, without the bus' own headers and before a record's compression.
    """
    from typing import Any

    from tramstream.cli.monitor.source import look
    from tramstream.cli.monitor.survey import Sheet, survey
    from tramstream.cli.terminal.session import stop_on_signals
    from tramstream.events.wording import number, scaled
    from tramstream.monitor.stats import Figures, KeyStats

    def cells(stats: KeyStats, of: Figures) -> list[str]:
        return [
            scaled(of.bytes_per_s, "B/s"),
            str(of.size_min_bytes) if of.size_min_bytes is not None else "–",
            number(of.size_mean_bytes, 1),
            str(of.size_max_bytes) if of.size_max_bytes is not None else "–",
            str(stats.count),
            scaled(stats.bytes, "B"),
        ]

    def data(stats: KeyStats, of: Figures) -> dict[str, Any]:
        return {
            "bytes_per_s": of.bytes_per_s,
            "size_min_bytes": of.size_min_bytes,
            "size_mean_bytes": of.size_mean_bytes,
            "size_max_bytes": of.size_max_bytes,
            "count": stats.count,
            "total_bytes": stats.bytes,
        }

    head = ("bandwidth", "min B", "mean B", "max B", "count", "in all")
    stop = stop_on_signals()
    with look(key, file, vehicle) as source:
        as_json = json_ or format_ is Format.json
        survey(source, stop, Sheet(head, cells, data), as_json, count, window_s)
