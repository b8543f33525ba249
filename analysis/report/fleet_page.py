"""The page of a fleet: vehicles as rows, their figures, and what has changed since last time."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bokeh.document import Document

from tramstream.analysis.fleet.changes import APART, State
from tramstream.analysis.fleet.table import Row
from tramstream.analysis.report.page import Page
from tramstream.calibrated import Source

HELP = (
    "A figure is the mean of all rides that agree, from the newest backwards, each by its "
    "variance. Behind ± stands its deviation.",
    f"Changed: a ride before is more than {APART:g} deviations off, so it is of another state of "
    "the vehicle, and it is left out. Newest: how far the newest ride is off those before it that "
    "agree, in deviations.",
    "Slope: how the figure goes in a hundred days, over rides that agree; of a wheel, its wear.",
)
HEAD = ("vehicle", "figure", "value", "±", "unit", "rides", "since", "newest", "changed", "slope")
SLOPE_STDS = 3.0


def lines(states: Sequence[State]) -> list[tuple[str, ...]]:
    """Rows of a table about vehicles; see `HEAD`."""
    return [
        (
            state.vehicle,
            state.field,
            f"{state.value:.8g}",
            f"{state.std:.2g}",
            state.unit,
            str(state.rides),
            day(state.since_ns),
            _stds(state.latest_by, state.latest_std),
            _changed(state),
            _slope(state),
        )
        for state in states
    ]


def day(stamp_ns: int) -> str:
    """Date of an instant of the vehicle clock."""
    return Source.of("", "", stamp_ns, stamp_ns).start[:10]


def _stds(off: float, std: float) -> str:
    return f"{off / std:+.1f} σ" if math.isfinite(off) and std > 0.0 else ""


def _changed(state: State) -> str:
    if not math.isfinite(state.changed_by):
        return ""
    return f"{day(state.since_ns)}: by {state.changed_by:.3g} {state.unit}".rstrip()


def _slope(state: State) -> str:
    slope, std = state.per_100_days, state.per_100_days_std
    if not (math.isfinite(slope) and abs(slope) > SLOPE_STDS * std):
        return ""
    return f"{slope:.2g} ± {std:.1g} in 100 days"


def compose(
    verb: str, rows: Sequence[Row], states: Sequence[State], refused: Sequence[tuple[str, str]]
) -> str:
    """Make the page; `refused` are records that could not be read, and why."""
    vehicles = sorted({row.vehicle for row in rows})
    facts = [f"{len(vehicles)} vehicles, {len({row.digest for row in rows})} rides"]
    page = Page(f"Fleet: {verb}", facts)
    page.fold("How to read this page", HELP)
    page.section("Vehicles")
    found = lines([state for state in states if state.verb == verb])
    if found:
        page.table(HEAD, found)
    else:
        page.absent("No figures.")
    changed = [state for state in states if math.isfinite(state.changed_by)]
    page.section("What has changed")
    if changed:
        page.table(
            ("vehicle", "figure", "by", "±", "since"),
            [
                (each.vehicle, each.field, f"{each.changed_by:.4g}", f"{each.changed_std:.2g}",
                 day(each.since_ns))
                for each in changed
            ],
        )  # fmt: skip
    else:
        page.absent("Nothing beyond what the figures' deviations allow.")
    verdicts = sorted({(row.vehicle, row.record, row.verdict) for row in rows if row.verdict})
    if verdicts or refused:
        page.section("Rides without figures")
        page.table(("vehicle", "record", "why"), [*verdicts, *(("", *each) for each in refused)])
    return page.render(Document())
