"""What of a network is drawn: polylines, arrows and names, for a part of the plan.

Tracks are thinned to a polyline that stays within `THIN_M` of their samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely

from tramstream.mapping.lines import path_of
from tramstream.tracks.linear_reference import References, references
from tramstream.tracks.network import BACKWARDS, FORWARDS, Array, Network, Way

THIN_M = 0.15
"""Less than a pixel until a screen shows 200 m."""
ARROWS_M = 60.0
"""Between arrows along a track; a track that is shorter has one, in its middle."""
ARROW_LEAST_M = 12.0
SAME_STOP_M = 250.0
"""Stops of one name within this share one label."""


class View(NamedTuple):
    """A part of the plan: its corners in the south-west and north-east, m."""

    low: Array
    high: Array

    def holds(self, plan: Array) -> Any:
        """Whether places, shape (n, 2), are in view, or half a view off at most."""
        margin = 0.5 * float((self.high - self.low).max())
        return np.all((plan > self.low - margin) & (plan < self.high + margin), axis=-1)


def track_rows(network: Network, view: View) -> list[dict[str, Any]]:
    """Give a row for each part of a track of which the map says the same."""
    rows, known = [], references(network)
    for track, from_m, to_m, osm_id, tags in _parts(network):
        backwards = int(network.rules[track]) == BACKWARDS
        run, length_m = 2 * track + backwards, float(network.length_m[track])
        begin_m, end_m = (length_m - to_m, length_m - from_m) if backwards else (from_m, to_m)
        path = path_of(network, [run], begin_m, end_m - begin_m)
        if len(path) < 2 or not view.holds(path[:, 1:]).any():
            continue
        path = thinned(path)
        rows.append(
            {
                "rule": int(network.rules[track]),
                "east": rounded(path[:, 1]),
                "north": rounded(path[:, 2]),
                "chainage": rounded(path[:, 0] + begin_m),
                "run": network.name_of(run),
                "of": f"{length_m:.0f}",
                "told": _told(osm_id, tags),
                "lines": _lines_on(network, known, run),
            }
        )
    return rows


def _told(osm_id: int, tags: dict[str, str]) -> str:
    """What the map says of a part of a track."""
    speed = tags.get("maxspeed", "")
    told = [f"way {osm_id}"] if osm_id else []
    told += [f"{speed} km/h" if speed.isdigit() else speed] if speed else []
    told += [f"{key}={tags[key]}" for key in ("service", "layer") if key in tags]
    return ", ".join(told)


def _lines_on(network: Network, known: References, run: int) -> list[list[Any]]:
    """Lines on the track of a run in either direction, for network_hover.js: name, chainage along
    `run` where the line's own is 0, whether both grow, first and last chainage along `run`."""
    found: list[list[Any]] = []
    length_m = float(network.length_m[run >> 1])
    for each, sign in ((run, 1), (run ^ 1, -1)):
        for row in range(int(known.starts[each]), int(known.starts[each + 1])):
            line = network.lines[known.line[row]]
            begin_m, end_m, offset_m = (
                float(column[row]) for column in (known.from_m, known.to_m, known.offset_m)
            )
            zero_m = -offset_m if sign > 0 else length_m + offset_m
            if sign < 0:
                begin_m, end_m = length_m - end_m, length_m - begin_m
            name = f"line {line.line} to {line.destination}"
            found.append([name, round(zero_m, 1), sign, round(begin_m, 1), round(end_m, 1)])
    return found


def arrow_rows(network: Network, view: View) -> Array:
    """Give east, north, m, and turn of a marker that points north, rad, of arrows along the tracks
    that are gone one way."""
    rows = [np.empty((0, 3))]
    for track in np.flatnonzero(np.isin(network.rules, (FORWARDS, BACKWARDS))):
        length_m, part = float(network.length_m[track]), network.samples_of(int(track))
        if length_m < ARROW_LEAST_M:
            continue
        count = max(int(length_m // ARROWS_M), 1)
        at = (np.arange(count) + 0.5) / count * (part.stop - part.start - 1)
        samples = part.start + at.astype(int)
        turn = -np.pi / 2 if network.rules[track] == FORWARDS else np.pi / 2
        columns = network.east[samples], network.north[samples], network.yaw_rad[samples] + turn
        rows.append(np.column_stack(columns))
    table = np.concatenate(rows)
    inside: Array = table[view.holds(table[:, :2])]
    return inside


def labels(names: Sequence[str], plan: Array) -> tuple[list[str], Array]:
    """Give one label for the stops of one name that lie together, and its place."""
    groups: dict[str, list[list[Array]]] = {}
    for name, place in zip(names, plan, strict=True):
        for group in groups.setdefault(name, []):
            if np.hypot(*(place - group[0])) < SAME_STOP_M:
                group.append(place)
                break
        else:
            groups[name].append([place])
    told = [name for name, found in groups.items() for _ in found]
    places = [np.mean(group, axis=0) for found in groups.values() for group in found]
    return told, np.array(places).reshape(-1, 2)


def thinned(path: Array) -> Array:
    """Rows (distance, east, north) that a polyline within `THIN_M` needs."""
    if len(path) < 3:
        return path
    line = shapely.LineString(np.roll(path, -1, axis=1))
    thin: Array = shapely.get_coordinates(line.simplify(THIN_M), include_z=True)
    return np.roll(thin, 1, axis=1)


def rounded(values: Array) -> list[float]:
    """To a centimetre, which keeps the page small."""
    found: list[float] = np.round(values, 2).tolist()
    return found


def plan_at(network: Network, track: int, chainage_m: float) -> tuple[float, float]:
    """East, north, m, of a place on a track."""
    part = network.samples_of(track)
    at = chainage_m / float(network.spacing_m[track])
    samples = np.arange(part.stop - part.start)
    return (
        float(np.interp(at, samples, network.east[part])),
        float(np.interp(at, samples, network.north[part])),
    )


def plan_of_nodes(network: Network) -> Array:
    """East, north, m, of each node, shape (nodes, 2)."""
    plan = np.full((len(network.node_id), 2), np.nan)
    for node, sample in (
        (network.from_node, network.starts[:-1]),
        (network.to_node, network.starts[1:] - 1),
    ):
        plan[node] = np.column_stack([network.east[sample], network.north[sample]])
    return plan


def _parts(network: Network) -> list[Way]:
    """What the map says of each part of each track; all of a track where it says nothing."""
    told = {way.track for way in network.ways}
    silent = [
        Way(track, 0.0, float(network.length_m[track]), 0, {})
        for track in range(network.track_count)
        if track not in told
    ]
    return [*network.ways, *silent]
