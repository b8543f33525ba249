"""A grade map in figures and sentences, and as profiles along lines or tracks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from tramstream.analysis.grade_map.assemble import GradeMap, LinePart
from tramstream.mapping.grades import TrackGrades
from tramstream.shown import date
from tramstream.tracks.network import Array


class Profile(NamedTuple):
    """Cells in the order in which somebody goes over them."""

    name: str
    rows: Any
    """Of the map; where a cell has none, the profile has a gap."""
    at_m: Array
    """Middle of each cell, along the profile."""
    sign: Array
    """+1 where the way goes along the track as drawn."""


def percent(grade_rad: Any) -> Any:
    """A slope as people read it."""
    return 100 * np.tan(grade_rad)


def std_percent(grade_rad: Any, std_rad: Any) -> Any:
    """Deviation of `percent`."""
    return 100 * std_rad / np.cos(grade_rad) ** 2


def summary(made: GradeMap) -> dict[str, Any]:
    """Figures by name; of what is not known None."""
    columns = made.columns
    known = np.isfinite(columns["grade_rad"])
    grade = percent(columns["grade_rad"][known])
    std = std_percent(columns["grade_rad"][known], columns["grade_std_rad"][known])
    several = known & (columns["passes"] > 1)
    freedom = float(np.sum(columns["passes"][several] - 1))
    chi2 = float(np.sum(columns["chi2"][several]))
    out = [ride for ride in made.rides if ride.out]
    return {
        "rides": len(made.rides),
        "rides_out": [{"ride": ride.name, "why": ride.out} for ride in out],
        "cells": int(np.count_nonzero(known)),
        "track_km": float(np.sum((columns["to_m"] - columns["from_m"])[known])) / 1000,
        "grade_least_percent": float(grade.min()) if len(grade) else None,
        "grade_most_percent": float(grade.max()) if len(grade) else None,
        "grade_std_median_percent": float(np.median(std)) if len(std) else None,
        "both_ways_share": float(
            np.mean((columns["forwards"][known] > 0) & (columns["backwards"][known] > 0))
        )
        if len(grade)
        else None,
        "chi2_per_freedom": chi2 / freedom if freedom else None,
        "passes_left_out": int(np.sum(columns["left_out"])),
        "first_utc_ns": int(min(_stamps(columns["first_utc_ns"]), default=0)),
        "last_utc_ns": int(max(_stamps(columns["last_utc_ns"]), default=0)),
        "source": made.source,
    }


def _stamps(values: Any) -> list[int]:
    return [int(each) for each in values if each > 0]


def sentences(figures: dict[str, Any]) -> Iterator[str]:
    """The same for people."""
    yield (
        f"{figures['rides']} rides, {figures['cells']} cells, {figures['track_km']:.2f} km of track"
    )
    if figures["cells"]:
        yield (
            f"grades from {figures['grade_least_percent']:+.2f} to "
            f"{figures['grade_most_percent']:+.2f} %, known to "
            f"{figures['grade_std_median_percent']:.3f} % (median σ); "
            f"{figures['both_ways_share']:.0%} gone over both ways"
        )
    if figures["chi2_per_freedom"] is not None:
        yield f"χ² per degree of freedom {figures['chi2_per_freedom']:.2f}"
    if figures["last_utc_ns"]:
        first, last = (date(figures[name]) for name in ("first_utc_ns", "last_utc_ns"))
        yield f"rides of {first}" + (f" to {last}" if first != last else "")
    for each in figures["rides_out"]:
        yield f"rejected: {each['ride']}: {each['why']}"


# Profiles -----------------------------------------------------------------------------------------
def profiles(made: GradeMap) -> list[Profile]:
    """Along each line that the map knows; tracks that are on none by themselves."""
    by_track = _rows_by_track(made)
    found = [_along_line(made, line, by_track) for line in made.lines]
    found = [each for each in found if len(each.rows)]
    on_lines = {run >> 1 for line in made.lines for run, _ in line.runs}
    for track, rows in by_track.items():
        if track in on_lines:
            continue
        columns = made.columns
        middle = (columns["from_m"][rows] + columns["to_m"][rows]) / 2
        found.append(Profile(f"track {made.track[rows[0]]}", rows, middle, np.ones(len(rows))))
    return found


def _rows_by_track(made: GradeMap) -> dict[int, Any]:
    track = made.columns["track_number"]
    numbers, first = np.unique(track, return_index=True)
    bounds = [*first.tolist(), len(track)]
    return {int(number): np.arange(bounds[k], bounds[k + 1]) for k, number in enumerate(numbers)}


def _along_line(made: GradeMap, line: LinePart, by_track: dict[int, Any]) -> Profile:
    rows, at, sign = [np.empty(0, dtype=np.int64)], [np.empty(0)], [np.empty(0)]
    gone = -line.begin_m
    for run, length_m in line.runs:
        own = by_track.get(run >> 1)
        if own is not None:
            middle = (made.columns["from_m"][own] + made.columns["to_m"][own]) / 2
            along = gone + (middle if run % 2 == 0 else length_m - middle)
            order = np.argsort(along, kind="stable")
            inside = order[(along[order] >= 0) & (along[order] <= line.length_m)]
            rows.append(own[inside])
            at.append(along[inside])
            sign.append(np.full(len(inside), 1.0 if run % 2 == 0 else -1.0))
        gone += length_m
    name = f"line {line.line} to {line.destination}"
    return Profile(name, np.concatenate(rows), np.concatenate(at), np.concatenate(sign))


# Back into a network ------------------------------------------------------------------------------
def track_grades(made: GradeMap) -> list[TrackGrades]:
    """Give the map as `mapping.grades` lays it into a network."""
    columns = made.columns
    found = []
    for rows in _rows_by_track(made).values():
        width = float(columns["to_m"][rows[0]] - columns["from_m"][rows[0]])
        found.append(
            TrackGrades(
                made.track[rows[0]],
                float(columns["track_m"][rows[0]]),
                (columns["from_m"][rows] + columns["to_m"][rows]) / 2,
                width,
                columns["grade_rad"][rows],
                columns["grade_std_rad"][rows],
                columns["height_ellipsoid_m"][rows],
            )
        )
    return found


def source_of(made: GradeMap, name: str) -> str:
    """Say what a network that has these grades owes to them."""
    used = sum(not ride.out for ride in made.rides)
    return f"grades of {used} rides ({name})"
