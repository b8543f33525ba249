"""What the page's strips are drawn from: one row of numbers an instant, kept for the last hour.

The last minute is kept ten times a second, the last hour once a second, in rings of fixed size: a
page that is opened late sees what was before, and a server that runs for weeks does not grow.
"""

from __future__ import annotations

import math
from array import array
from typing import Any

COLUMNS = (
    "t_s",
    "latitude_deg",
    "longitude_deg",
    "speed_mps",
    "gnss_speed_mps",
    "wheel_speed_mps",
    "grade_percent",
    "grade_std_percent",
    "heading_deg",
    "along_std_m",
    "across_std_m",
    "protection_along_m",
    "protection_across_m",
    "gnss_innovation",
    "wheels_innovation",
    "map_innovation",
    "refused",
)
"""Time in seconds of Unix time on the vehicle clock; innovations in their own standard deviations,
that of the largest size since the row before; `refused` counts measurements since then."""
SUMMED, LARGEST = ("refused",), ("gnss_innovation", "wheels_innovation", "map_innovation")
"""How several rows become one: these are added, of these the largest stays, of others the last."""
BEGUN_AGAIN_S = 1.0
FAST_ROWS, SLOW_ROWS = 600, 3600


class Rows:
    """A ring of rows of numbers, the oldest overwritten."""

    def __init__(self, capacity: int, width: int = len(COLUMNS)) -> None:
        self._values = array("d", [math.nan]) * (capacity * width)
        self._capacity, self._width = capacity, width
        self._count = 0

    def __len__(self) -> int:
        return min(self._count, self._capacity)

    def add(self, row: list[float]) -> None:
        """Append a row."""
        at = self._count % self._capacity * self._width
        self._values[at : at + self._width] = array("d", row)
        self._count += 1

    def columns(self) -> list[list[float | None]]:
        """One list a column, oldest first; what is not known is None."""
        first = self._count - len(self)
        order = [k % self._capacity for k in range(first, self._count)]
        return [
            [rounded(self._values[row * self._width + column]) for row in order]
            for column in range(self._width)
        ]


class History:
    """The last minute and the last hour."""

    def __init__(self) -> None:
        self._begin()

    def _begin(self) -> None:
        self._fast, self._slow = Rows(FAST_ROWS), Rows(SLOW_ROWS)
        self._pending: list[list[float]] = []

    def add(self, row: list[float]) -> None:
        """Append the row of an instant; one that is no later than the last is left out.

        Unless it is more than a second earlier: then a record begins again, and so does this.
        """
        if self._pending and row[0] <= self._pending[-1][0]:
            if row[0] > self._pending[-1][0] - BEGUN_AGAIN_S:
                return
            self._begin()
        self._fast.add(row)
        if self._pending and math.floor(row[0]) != math.floor(self._pending[0][0]):
            self._slow.add(condensed(self._pending))
            self._pending.clear()
        self._pending.append(row)

    def as_dict(self) -> dict[str, Any]:
        """Both, for the page."""
        return {
            "columns": COLUMNS,
            "minute": self._fast.columns(),
            "hour": self._slow.columns(),
        }


def condensed(rows: list[list[float]]) -> list[float]:
    """One row for several that follow each other."""
    found = list(rows[-1])
    for column, name in enumerate(COLUMNS):
        values = [row[column] for row in rows if not math.isnan(row[column])]
        if not values:
            continue
        if name in SUMMED:
            found[column] = sum(values)
        elif name in LARGEST:
            found[column] = max(values, key=abs)
        else:
            found[column] = values[-1]
    return found


def rounded(value: float) -> float | None:
    """A number as short as the page needs it; times and places keep their digits."""
    if not math.isfinite(value):
        return None
    return round(value, 3) if abs(value) > 1000 else round(value, 7) + 0.0
