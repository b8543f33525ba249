"""What a network holds, how good its curves are, and what is odd about the map it was built from.

Findings are data: each has a kind, one sentence, and the map's numbers of what it is about. None of
them stops a build; a network is as good as its map.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tramstream.mapping.chains import Laid, steps
from tramstream.mapping.osm import Extract
from tramstream.mapping.partners import Partners
from tramstream.mapping.topology import Topology
from tramstream.tracks.network import BACKWARDS, FORWARDS, Network

Array = NDArray[np.float64]

GAP_M = 5.0
"""Ends of track as near to each other, one ahead of the other, look like one that was torn."""
KINK_PER_M = 1 / 13.0
"""Curvature that no tram takes; Prague's tightest curves have 18 m."""
SWITCH_M = 10.0
CORNER_RAD = math.radians(45.0)
"""So much of a curve nobody draws with one node."""
CURVE_PER_M = 1 / 60.0
STRAIGHT_PER_M = 1 / 500.0
_AHEAD_RAD = math.radians(45.0)
_SAME_PLACE_M = 0.5
_KNOWN = {
    "oneway": r"yes|no|-1|reversible|alternating|reverse|true|false|1|0",
    "railway:preferred_direction": r"forward|backward|both",
    "service": r"yard|siding|spur|crossover",
    "maxspeed": r"\d+( mph| km/h)?|none|signals|walk|[A-Z]{2}:[a-z_]+",
    "incline": r"up|down|[+-]?\d+(\.\d+)?( ?%|°)?",
    "layer": r"-?\d",
}
"""Values that are understood, or known to say nothing that matters here."""


class Finding(NamedTuple):
    """Something odd."""

    kind: str
    """"gap", "dead_end", "one_way", "kink" or "tag"."""
    text: str
    """One sentence that names the map's object."""
    nodes: tuple[int, ...] = ()
    ways: tuple[int, ...] = ()


@dataclass(frozen=True)
class Report:
    """Figures by name, with their unit, and findings."""

    counts: dict[str, int]
    lengths: dict[str, float]
    """Of tracks and of edges, km; shares of the edges' length."""
    fit: dict[str, float]
    """Deviations and measured errors of the curves; see `_fit_figures`."""
    findings: tuple[Finding, ...]

    def of_kind(self, kind: str) -> tuple[Finding, ...]:
        return tuple(each for each in self.findings if each.kind == kind)


def report(
    network: Network, extract: Extract, topology: Topology, laid: Laid, partners: Partners
) -> Report:
    """Look a network over."""
    findings = [
        *_gaps(topology, network),
        *_dead_ends(topology, extract),
        *_one_way(topology),
        *_preferences(extract),
        *_kinks(topology, network, laid),
        *_tags(extract),
    ]
    return Report(
        _counts(network, extract, topology),
        _lengths(network, partners),
        _fit_figures(network, topology, laid),
        tuple(findings),
    )


# Figures ------------------------------------------------------------------------------------------
def _counts(network: Network, extract: Extract, topology: Topology) -> dict[str, int]:
    chains = topology.chains
    used = {way for chain in chains for way in chain.ways}
    return {
        "nodes": len(topology.nodes),
        "tracks": network.track_count,
        "edges": len(network.edges),
        "segments": sum(len(chain.ways) * int(chain.rules).bit_count() for chain in chains),
        "switches": int(np.sum(network.node_switch)),
        "followings": len(network.following),
        "samples": len(network.east),
        "ways": len(used),
        "ways_left_out": len(extract.ways) - len(used),
    }


def _lengths(network: Network, partners: Partners) -> dict[str, float]:
    samples = np.diff(network.starts)
    weight = np.repeat(network.length_m / samples, samples)
    rules = np.repeat(network.rules, samples)
    edge, opposite = 0.0, 0.0
    for bit in (FORWARDS, BACKWARDS):
        edge += float(np.sum(weight[rules & bit != 0]))
        opposite += float(np.sum(weight[(rules & bit != 0) & (partners.opposite & bit != 0)]))
    return {
        "track_km": float(np.sum(network.length_m)) / 1000,
        "edge_km": edge / 1000,
        "opposite_share": opposite / edge if edge else 0.0,
        "partner_share": float(np.sum(weight[partners.sides != 0]) / np.sum(weight)),
    }


def _fit_figures(network: Network, topology: Topology, laid: Laid) -> dict[str, float]:
    """Deviation of nodes; what curves state; errors at left-out nodes, and as shares of what is
    stated (1: honest); jumps where edge follows edge."""
    left_out = laid.fit.left_out
    error, bent = np.abs(left_out.error_m), np.abs(left_out.curvature_per_m)
    share = error / left_out.std_m
    figures = {
        "node_std_m": laid.fit.node_std_m,
        "across_std_median_m": float(np.median(network.across_std_m)),
        "across_std_p95_m": float(np.percentile(network.across_std_m, 95)),
        "yaw_std_median_rad": float(np.median(network.yaw_std_rad)),
        "yaw_std_p95_rad": float(np.percentile(network.yaw_std_rad, 95)),
    }
    if len(error):
        figures["left_out_error_median_m"] = float(np.median(error))
        figures["left_out_error_p95_m"] = float(np.percentile(error, 95))
    for name, chosen in (
        ("curves", bent > CURVE_PER_M),
        ("bends", (bent <= CURVE_PER_M) & (bent > STRAIGHT_PER_M)),
        ("straights", bent <= STRAIGHT_PER_M),
    ):
        if np.any(chosen):
            figures[f"left_out_normalised_{name}"] = float(np.sqrt(np.mean(share[chosen] ** 2)))
    jumps = steps(topology.following, laid.fit)
    is_edge = np.array([topology.is_edge(run) for run in range(2 * network.track_count)])
    legal = is_edge[jumps.before] & is_edge[jumps.after]
    across, turn = np.abs(jumps.across_m[legal]), np.abs(jumps.turn_rad[legal])
    if len(across):
        figures["jump_median_m"] = float(np.median(across))
        figures["jump_p95_m"] = float(np.percentile(across, 95))
        figures["turn_median_rad"] = float(np.median(turn))
        figures["turn_p95_rad"] = float(np.percentile(turn, 95))
    return figures


# Findings -----------------------------------------------------------------------------------------
def _way_at(topology: Topology, run: int) -> int:
    """The way on which a run arrives."""
    ways = topology.chains[run >> 1].ways
    return ways[-1] if run % 2 == 0 else ways[0]


def _arriving(topology: Topology) -> dict[int, list[int]]:
    """Runs by the node where they arrive."""
    found: dict[int, list[int]] = {}
    for run in range(2 * len(topology.chains)):
        found.setdefault(topology.run_ends(run)[1], []).append(run)
    return found


def _gaps(topology: Topology, network: Network) -> Iterator[Finding]:
    """Ends of track with another end close ahead."""
    arriving = _arriving(topology)
    nodes = list(arriving)
    ends = {}
    for node, runs in arriving.items():
        first = network.starts[runs[0] >> 1], network.starts[(runs[0] >> 1) + 1] - 1
        sample = int(first[1 - runs[0] % 2])
        yaw = network.yaw_rad[sample] + math.pi * (runs[0] % 2)
        ends[node] = (network.east[sample], network.north[sample], yaw)
    plan = np.array([ends[node][:2] for node in nodes])
    number = {node: index for index, node in enumerate(nodes)}
    tree = cKDTree(plan)
    told = set()
    for node in nodes:
        if len(arriving[node]) > 1:
            continue
        joined = {topology.run_ends(run)[0] for run in arriving[node]}
        for index in tree.query_ball_point(plan[number[node]], GAP_M):
            other = nodes[index]
            if other == node or other in joined or (other, node) in told:
                continue
            away = plan[index] - plan[number[node]]
            distance = float(np.hypot(*away))
            turn = math.remainder(math.atan2(away[1], away[0]) - ends[node][2], 2 * math.pi)
            if distance < _SAME_PLACE_M or abs(turn) < _AHEAD_RAD:
                told.add((node, other))
                ways = _way_at(topology, arriving[node][0]), _way_at(topology, arriving[other][0])
                text = (
                    f"way {ways[0]} ends at node {node}, {distance:.1f} m short of node {other} of "
                    f"way {ways[1]}"
                )
                yield Finding("gap", text, (node, other), ways)


def _dead_ends(topology: Topology, extract: Extract) -> Iterator[Finding]:
    """Edges that no edge follows."""
    arriving = _arriving(topology)
    used = {way for chain in topology.chains for way in chain.ways}
    left_out = {
        node for way in extract.ways.values() if way.osm_id not in used for node in way.nodes
    }
    for run in range(2 * len(topology.chains)):
        ahead = topology.following[run]
        if not topology.is_edge(run) or any(topology.is_edge(other) for other in ahead):
            continue
        node, way = topology.run_ends(run)[1], _way_at(topology, run)
        if ahead:
            why = f"way {_way_at(topology, ahead[0] ^ 1)} goes on, but against its oneway"
        elif len(arriving[node]) > 1:
            why = "the others there leave at angles that no tram takes"
        elif node in left_out:
            why = "only a way that was left out goes on (service=yard)"
        else:
            why = "the map's rails end"
        yield Finding("dead_end", f"way {way} ends at node {node}: {why}", (node,), (way,))


def _one_way(topology: Topology) -> Iterator[Finding]:
    """Nodes of several tracks where edges only arrive, or only leave."""
    for node, runs in _arriving(topology).items():
        if len(runs) < 2:
            continue
        arrive = [run for run in runs if topology.is_edge(run)]
        leave = [run for run in runs if topology.is_edge(run ^ 1)]
        if arrive and leave:
            continue
        ways = tuple(dict.fromkeys(_way_at(topology, run) for run in runs))
        what = "only lead to it" if arrive else "only lead away from it"
        names = ", ".join(map(str, ways))
        text = f"node {node}: by their oneway, ways {names} {what}"
        yield Finding("one_way", text, (node,), ways)


def _preferences(extract: Extract) -> Iterator[Finding]:
    for way in extract.ways.values():
        oneway = way.tags.get("oneway")
        preferred = way.tags.get("railway:preferred_direction")
        if (oneway, preferred) in (("yes", "backward"), ("-1", "forward")):
            text = f"way {way.osm_id}: railway:preferred_direction={preferred}, oneway={oneway}"
            yield Finding("one_way", text, (), (way.osm_id,))


def _kinks(topology: Topology, network: Network, laid: Laid) -> Iterator[Finding]:
    """Places where the smoothed curve bends as no track does, and corners of the map.

    Not beside nodes: every other switch is drawn with a kink, which the deviations there tell.
    """
    for track, chain in enumerate(topology.chains):
        samples, arc = network.samples_of(track), laid.node_arc_m(track)
        bent = np.abs(network.curvature_per_m[samples])
        away = np.linspace(0.0, network.length_m[track], len(bent))
        away = np.minimum(away, away[::-1])
        sharp = np.flatnonzero((bent > KINK_PER_M) & (away > SWITCH_M))
        told: set[int] = set()
        for part in np.split(sharp, np.flatnonzero(np.diff(sharp) > 1) + 1) if len(sharp) else ():
            worst = int(part[np.argmax(bent[part])])
            at = worst * float(network.spacing_m[track])
            nearest = int(np.argmin(np.abs(arc - at)))
            if nearest in told:  # the curve swings round a corner
                continue
            told.add(nearest)
            node, way = chain.nodes[nearest], chain.ways[min(nearest, len(chain.ways) - 1)]
            text = f"way {way} bends with a radius of {1 / bent[worst]:.0f} m near node {node}"
            yield Finding("kink", text, (node,), (way,))
        for corner, turn in _corners(laid.node_plan(track)):
            if corner not in told:
                node, way = chain.nodes[corner], chain.ways[corner]
                text = f"way {way} turns by {math.degrees(turn):.0f} deg at node {node}"
                yield Finding("kink", text, (node,), (way,))


def _corners(plan: Array) -> Iterator[tuple[int, float]]:
    """Nodes of a chain where it turns by more than `CORNER_RAD`, and by how much."""
    step = np.diff(plan, axis=0)
    yaw = np.arctan2(step[:, 1], step[:, 0])
    turn = np.abs(np.angle(np.exp(1j * np.diff(yaw))))
    for index in np.flatnonzero(turn > CORNER_RAD):
        yield int(index) + 1, float(turn[index])


def _tags(extract: Extract) -> Iterator[Finding]:
    for way in extract.ways.values():
        for tag, pattern in _KNOWN.items():
            value = way.tags.get(tag)
            if value is not None and not re.fullmatch(pattern, value):
                text = f"way {way.osm_id}: {tag}={value} is not understood"
                yield Finding("tag", text, (), (way.osm_id,))
