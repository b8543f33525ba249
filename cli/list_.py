"""`tramstream list`: which keys there are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from tramstream.cli.terminal.options import (
    FileOption,
    Format,
    FormatOption,
    JsonOption,
    VehicleOption,
)

if TYPE_CHECKING:
    from tramstream.cli.monitor.source import FileSource, LiveSource

LISTEN_S = 1.5
"""Sees everything that comes once a second."""


def list_(
    key: Annotated[
        str, typer.Argument(metavar="[KEY]", help="Only keys in this expression.")
    ] = "**",
    file: FileOption = None,
    count: Annotated[int, typer.Option("--count", help="List at most so many; 0: all.", min=0)] = 0,
    format_: FormatOption = Format.text,
    json_: JsonOption = False,
    vehicle: VehicleOption = "",
    listen_s: Annotated[
        float, typer.Option("--listen-s", help="How long to listen to the bus.", min=0.1)
    ] = LISTEN_S,
) -> None:
    """List keys with type, rate against the nominal one, losses and meaning.

    On the bus only what comes while listening is seen: give slow keys time with --listen-s. Of a
    file the rates are means over the whole record; `tramstream info` tells of its losses.
    """
    import shutil
    import sys

    from tramstream.cli.monitor.source import FileSource, LiveSource, line, look
    from tramstream.cli.terminal.columns import aligned
    from tramstream.cli.terminal.session import stop_on_signals
    from tramstream.events.wording import number

    stop = stop_on_signals()
    with look(key, file, vehicle) as source:
        if isinstance(source, FileSource):
            rows = _in_file(source)
        else:
            assert isinstance(source, LiveSource)
            rows = _on_bus(source, stop, listen_s)
    rows = rows[: count or None]
    if json_ or format_ is Format.json:
        print(line({"vehicle": source.wanted.vehicle, "keys": rows}))
        return
    if not rows:
        print(f"nothing came within {listen_s:g} s; --listen-s listens longer", file=sys.stderr)
        return
    third = "lost" if source.live else "count"
    table = [["key", "type", "rate Hz", "nominal", third, ""]]
    for row in rows:
        nominal_hz = row["nominal_hz"]
        rate = number(row["rate_hz"])
        nominal = f"{nominal_hz:g}" if nominal_hz else ""
        table.append([row["key"], row["type"], rate, nominal, str(row[third]), row["doc"]])
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else 0
    print("\n".join(aligned(table, frozenset([0, 1, 5]), width)))


def _on_bus(source: LiveSource, stop: Any, listen_s: float) -> list[dict[str, Any]]:
    """What came within `listen_s` or until `stop`."""
    import time

    from tramstream.monitor.stats import Stats

    stats = Stats(listen_s)
    end_s = time.monotonic() + listen_s
    for envelope in source.messages(stop):
        if envelope is not None:
            stats.add(envelope)
        if time.monotonic() >= end_s:
            break
    now_ns = source.now_ns()
    return [
        {
            "key": source.shown(found.topic),
            "type": found.type_name,
            "rate_hz": found.rate_hz(now_ns),
            "nominal_hz": found.key.rate_hz if found.key is not None else None,
            "count": found.count,
            "lost": found.lost,
            "doc": found.key.doc if found.key is not None else "",
        }
        for found in stats.in_order()
    ]


def _in_file(source: FileSource) -> list[dict[str, Any]]:
    """What the record's channels say."""
    from tramstream.clock import S
    from tramstream.monitor.stats import KeyStats, order

    duration_s = (source.record.end_ns - source.record.start_ns) / S
    counts = {info.topic: info for info in source.channels}
    rows = []
    for stats in sorted((KeyStats(topic) for topic in counts), key=order):
        info = counts[stats.topic]
        rate_hz = info.count / duration_s if duration_s > 0 and info.count > 1 else None
        rows.append(
            {
                "key": source.shown(stats.topic),
                "type": info.schema,
                "rate_hz": rate_hz,
                "nominal_hz": stats.key.rate_hz if stats.key is not None else None,
                "count": info.count,
                "doc": stats.key.doc if stats.key is not None else "",
            }
        )
    return rows
