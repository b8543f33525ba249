"""What a vehicle's figures are now, over its rides, and what has changed since last time.

Rides of one vehicle are put together from the newest backwards, as long as they agree: each weighs
by its variance. Where an older one is `APART` deviations off what is known since, something was
changed between the two (a wheel was turned or exchanged, an antenna moved), and what is older is
left out and said.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from tramstream.analysis.fleet.table import Row

APART = 4.5
"""Deviations: of ten thousand figures that agree, less than one is further apart."""
DAY_NS = 86_400 * 1_000_000_000


class State(NamedTuple):
    """One figure of a vehicle."""

    vehicle: str
    verb: str
    field: str
    unit: str
    value: float
    std: float
    rides: int
    since_ns: int
    """Start of the first ride that agrees."""
    last_ns: int
    changed_by: float
    """Against the rides before; NaN where there are none, or all agree."""
    changed_std: float
    latest_by: float
    """The newest ride against all before it that agree; NaN for the first."""
    latest_std: float
    per_100_days: float
    """Slope over the rides that agree; NaN below three of them within a day."""
    per_100_days_std: float


def states(rows: Iterable[Row]) -> list[State]:
    """States of all vehicles, in order of vehicle, verb and field."""
    series: dict[tuple[str, str, str, str], list[Row]] = {}
    for row in rows:
        if row.field and math.isfinite(row.value) and row.std > 0.0 and math.isfinite(row.std):
            series.setdefault((row.vehicle, row.verb, row.field, row.unit), []).append(row)
    return [_state(key, sorted(found, key=_time)) for key, found in sorted(series.items())]


def _time(row: Row) -> tuple[int, str]:
    return row.start_ns, row.digest


def _state(key: tuple[str, str, str, str], rows: Sequence[Row]) -> State:
    first = len(rows) - 1
    value, std = rows[first].value, rows[first].std
    by = by_std = math.nan
    for k in range(len(rows) - 2, -1, -1):
        off, known = value - rows[k].value, math.hypot(std, rows[k].std)
        if abs(off) > APART * known:
            by, by_std = off, known
            break
        first = k
        value, std = together(rows[first:])
    latest_by = latest_std = math.nan
    if first < len(rows) - 1:
        before, before_std = together(rows[first:-1])
        latest_by, latest_std = rows[-1].value - before, math.hypot(before_std, rows[-1].std)
    slope, slope_std = _slope(rows[first:])
    vehicle, verb, field, unit = key
    return State(
        vehicle, verb, field, unit, value, std, len(rows) - first,
        rows[first].start_ns, rows[-1].start_ns, by, by_std, latest_by, latest_std,
        slope, slope_std,
    )  # fmt: skip


def together(rows: Sequence[Row]) -> tuple[float, float]:
    """Weighted mean and its deviation, no better than the scatter allows."""
    weight = [1.0 / row.std**2 for row in rows]
    total = math.fsum(weight)
    value = math.fsum(w * row.value for w, row in zip(weight, rows, strict=True)) / total
    squares = math.fsum(w * (row.value - value) ** 2 for w, row in zip(weight, rows, strict=True))
    scatter = squares / (len(rows) - 1) if len(rows) > 2 else 1.0
    return value, math.sqrt(max(scatter, 1.0) / total)


def _slope(rows: Sequence[Row]) -> tuple[float, float]:
    """Change in a hundred days: wear."""
    days = [(row.start_ns - rows[0].start_ns) / DAY_NS for row in rows]
    if len(rows) < 3 or days[-1] < 1.0:
        return math.nan, math.nan
    weight = [1.0 / row.std**2 for row in rows]
    total = math.fsum(weight)
    middle = math.fsum(w * d for w, d in zip(weight, days, strict=True)) / total
    spread = math.fsum(w * (d - middle) ** 2 for w, d in zip(weight, days, strict=True))
    if not spread > 0.0:
        return math.nan, math.nan
    moment = math.fsum(
        w * (d - middle) * row.value for w, d, row in zip(weight, days, rows, strict=True)
    )
    return 100.0 * moment / spread, 100.0 / math.sqrt(spread)
