"""`tramstream info FILE`: what a record holds, and what is missing in it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from tramstream.recorder.describe import Description


def info(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="A record, its parts, or a folder.")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Describe a record: keys, rates, gaps, losses, damage. Every checksum is looked at."""
    import json

    from tramstream.errors import DamagedRecordError
    from tramstream.recorder.describe import describe
    from tramstream.recorder.reader import open_record

    with open_record(files, any_schema=True) as record:
        description = describe(record)
    if as_json:
        print(json.dumps(description.to_json()))
    else:
        _print(description)
    if description.damaged:
        raise DamagedRecordError(f"{description.damaged}; `tramstream recover` saves the rest")


def _print(description: Description) -> None:
    import sys
    from datetime import UTC, datetime

    from rich.console import Console

    from tramstream.shown import shown

    console = Console(width=None if sys.stdout.isatty() else 160)
    start_ns = description.start_ns + description.utc_offset_ns
    clock = "UTC, as known later" if description.utc_offset_ns else "vehicle clock"
    start = datetime.fromtimestamp(start_ns // 1_000_000_000, UTC)
    schema = description.schema_version
    facts = [
        ("files", "\n".join(description.files)),
        ("vehicle", description.vehicle or "unknown: not written by tramstream"),
        ("written by", description.software),
        ("schema", f"version {schema}" if schema is not None else ""),
        ("start", f"{start:%Y-%m-%d %H:%M:%S} ({clock})" if description.start_ns else ""),
        ("duration", f"{description.duration_s:.1f} s"),
        ("size", f"{description.size_bytes / 1e6:.2f} MB"),
        ("messages", f"{description.message_count}"),
        ("unfinished", "\n".join(description.unfinished)),
        ("recovered", description.recovered),
        ("left out", description.left_out),
        ("missing", ", ".join(f"part {number}" for number in description.missing_parts)),
    ]
    for name, value in facts:
        for line in value.splitlines():
            console.print(f"{name:<11}{shown(line)}", markup=False, highlight=False, soft_wrap=True)
            name = ""
    console.print(_table(description))


def _table(description: Description) -> Table:
    from rich.table import Table
    from rich.text import Text

    from tramstream.shown import shown

    table = Table(box=None, pad_edge=False, header_style="bold")
    channels = description.channels
    table.add_column("key", no_wrap=True)
    table.add_column("type", overflow="fold")
    for name in ("count", "rate Hz"):
        table.add_column(name, justify="right")
    rows = [
        [
            channel.path,
            channel.type.removeprefix("tramstream."),
            str(channel.count),
            f"{channel.rate_hz:.1f}" if channel.count > 1 else "",
        ]
        for channel in channels
    ]
    for name in ("gaps", "missing", "restarts"):
        if any(getattr(channel, name) for channel in channels):
            table.add_column(name, justify="right")
            for row, channel in zip(rows, channels, strict=True):
                row.append(str(getattr(channel, name) or ""))
    if any(channel.reported_lost for channel in channels):
        table.add_column("reported lost")
        for row, channel in zip(rows, channels, strict=True):
            lost = channel.reported_lost.items()
            row.append(", ".join(f"{count} {cause.lower()}" for cause, count in lost))
    for row in rows:
        table.add_row(*(Text(shown(cell)) for cell in row))
    return table
