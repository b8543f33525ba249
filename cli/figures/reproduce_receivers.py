"""`tramstream reproduce receivers`: positions of captured receivers beside gpsd's."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tramstream.analysis.studies import receivers
from tramstream.cli.figures.options import Options

NAME = "receivers"
CAPTURES = Path("../shared/data/ubx")


def reproduce(options: Options) -> None:
    """Print what became of gpsd's positions, a capture a line."""
    found = [receivers.compare(path) for path in receivers.captures(options.data or CAPTURES)]
    positions = sum(each.positions for each in found)
    missing = sum(len(each.missing) for each in found)
    if options.json:
        figures = {"work": NAME, "positions": positions, "missing": missing}
        print(json.dumps({**figures, "captures": [asdict(each) for each in found]}))
        return
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    for column in ("capture", "frames", "gpsd's", "equal, by source", "last digit", "missing"):
        table.add_column(column, justify="left" if column == "capture" else "right")
    for each in found:
        table.add_row(
            each.capture,
            _counted(each.protocols),
            str(each.positions),
            _counted(each.equal),
            str(each.nearly),
            str(len(each.missing)),
        )
    console = Console()
    console.print(table)
    console.print(
        f"{positions - missing} of {positions} positions that gpsd reports are ours, within "
        f"{receivers.EQUAL_DEG:g}°; last digit: one unit of the last digit off."
    )


def _counted(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in sorted(counts.items())) or "–"
