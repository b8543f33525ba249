"""Plain aligned columns: as readable in a terminal as in a log or behind a pipe."""

from __future__ import annotations

from collections.abc import Sequence

from tramstream.events.wording import clipped
from tramstream.shown import shown

GAP = "  "


def aligned(rows: Sequence[Sequence[str]], left: frozenset[int], width: int = 0) -> list[str]:
    """Rows as lines; columns in `left` are flush left, the others flush right.

    With a `width` longer lines are cut.
    """
    if not rows:
        return []
    rows = [[shown(cell) for cell in row] for row in rows]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [
            cell.ljust(size) if column in left else cell.rjust(size)
            for column, (cell, size) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append(
            clipped(GAP.join(cells).rstrip(), width) if width else GAP.join(cells).rstrip()
        )
    return lines
