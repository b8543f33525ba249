"""Tables of a grade map: its profiles, and the rides that it was made from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from tramstream.analysis.grade_map.assemble import GradeMap, RideEntry
from tramstream.analysis.grade_map.summary import Profile, percent, profiles, std_percent
from tramstream.shown import date

Head = tuple[tuple[str, str], ...]
PROFILE_HEAD: Head = (
    ("profile", "profile"),
    ("km", "known_km"),
    ("least, %", "grade_least_percent"),
    ("most, %", "grade_most_percent"),
    ("at, m", "steepest_at_m"),
    ("σ median, %", "grade_std_median_percent"),
    ("rides", "rides_median"),
    ("climb, m", "climb_m"),
)
RIDE_HEAD: Head = (
    ("ride", "ride"),
    ("day", "day"),
    ("km", "way_km"),
    ("on cells, km", "counted_km"),
    ("bias, %", "bias_percent"),
    ("scatter", "scatter"),
    ("nod, deg per m/s²", "nod_deg_per_mps2"),
    ("verdict", "verdict"),
)


def profile_rows(made: GradeMap) -> list[dict[str, Any]]:
    """Figures of each profile; slopes are uphill positive along it."""
    return [_profile_row(made, each) for each in profiles(made)]


def _profile_row(made: GradeMap, profile: Profile) -> dict[str, Any]:
    columns, rows = made.columns, profile.rows
    grade = percent(profile.sign * columns["grade_rad"][rows])
    known = np.isfinite(grade)
    width = (columns["to_m"] - columns["from_m"])[rows][known]
    row: dict[str, Any] = {"profile": profile.name, "known_km": float(width.sum()) / 1000}
    if not known.any():
        return row | {name: None for _, name in PROFILE_HEAD[2:]}
    std = std_percent(columns["grade_rad"][rows], columns["grade_std_rad"][rows])[known]
    steepest = int(np.argmax(np.abs(grade[known])))
    return row | {
        "grade_least_percent": float(grade[known].min()),
        "grade_most_percent": float(grade[known].max()),
        "steepest_at_m": float(profile.at_m[known][steepest]),
        "grade_std_median_percent": float(np.median(std)),
        "rides_median": float(np.median(columns["rides"][rows][known])),
        "climb_m": float(np.sum(np.maximum(grade[known], 0.0) / 100 * width)),
    }


def ride_rows(made: GradeMap) -> list[dict[str, Any]]:
    """What is known of each ride."""
    counts = np.bincount(made.passes["ride"], minlength=len(made.rides))
    return [
        _ride_row(ride, float(count) * made.cell_m / 1000)
        for ride, count in zip(made.rides, counts.tolist(), strict=True)
    ]


def _ride_row(ride: RideEntry, counted_km: float) -> dict[str, Any]:
    return {
        "ride": ride.name,
        "digest": ride.digest,
        "vehicle": ride.vehicle,
        "day": date(ride.start_utc_ns) if ride.start_utc_ns else None,
        "way_km": ride.way_m / 1000,
        "counted_km": counted_km,
        "off_map_km": ride.off_map_m / 1000,
        "doubtful_km": ride.doubtful_m / 1000,
        "contradicting_km": ride.contradicting_m / 1000,
        "bias_percent": 100 * ride.bias_rad,
        "scatter": ride.scatter,
        "nod_deg_per_mps2": float(np.degrees(ride.nod_rad_per_mps2)),
        "nod_std_deg_per_mps2": float(np.degrees(ride.nod_std_rad_per_mps2)),
        "smoothed_anew": ride.smoothed_anew,
        "verdict": f"rejected: {ride.out}" if ride.out else "in use",
    }


_DIGITS = {
    "known_km": 2,
    "way_km": 2,
    "counted_km": 2,
    "steepest_at_m": 0,
    "rides_median": 0,
    "climb_m": 1,
    "scatter": 2,
    "bias_percent": 3,
    "grade_std_median_percent": 3,
    "nod_deg_per_mps2": 3,
}


def cells_of_table(head: Head, rows: Iterable[dict[str, Any]]) -> Iterator[list[str]]:
    """Texts of a table's cells, row by row."""
    for row in rows:
        yield [_cell(name, row[name]) for _, name in head]


def _cell(name: str, value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.{_DIGITS.get(name, 2)}f}" if isinstance(value, float) else str(value)
