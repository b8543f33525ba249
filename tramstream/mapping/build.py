"""A track network from an extract of a map: joined, smoothed, sampled and looked over.

The steps are modules: `network_topology` (which rails join which), `track_fit` (smooth curves with
their deviation), `network_partners`, `elevation`, `network_report` (what is odd about the map).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.errors import ConfigError
from tramstream.geodesy import PRAGUE_GEOID_M, LocalLevel
from tramstream.mapping import elevation, survey
from tramstream.mapping.chains import Laid, lay
from tramstream.mapping.osm import Extract, OsmWay
from tramstream.mapping.partners import Partners, beside
from tramstream.mapping.survey import Report
from tramstream.mapping.topology import Chain, Topology, contract, join
from tramstream.tracks.network import Network, Way

Array = NDArray[np.float64]

TAGS = (
    "railway",
    "oneway",
    "railway:preferred_direction",
    "service",
    "usage",
    "railway:track_ref",
    "railway:interlaced",
    "tunnel",
    "covered",
    "bridge",
    "embankment",
    "cutting",
    "layer",
    "maxspeed",
    "maxspeed:forward",
    "maxspeed:backward",
    "incline",
    "gauge",
    "electrified",
    "highway",
    "embedded_rails",
    "name",
)
"""Of ways; others are not kept."""


@dataclass(frozen=True)
class Options:
    """What to build."""

    yards: bool = False
    """Whether tracks with service=yard are taken in."""
    node_std_m: float | None = None
    """Deviation of the map's nodes from the rail per axis; None: estimated from the map."""
    tiles: Sequence[Path] = field(default_factory=tuple)
    """Elevation, SRTM .hgt."""
    geoid_m: float = PRAGUE_GEOID_M
    """Height of the geoid above the ellipsoid, added to the tiles' heights above it."""


class _Mapped(NamedTuple):
    """Tracks in the plan."""

    level: LocalLevel
    topology: Topology
    plan: dict[int, tuple[float, float]]


def build(extract: Extract, options: Options | None = None) -> tuple[Network, Report]:
    """Build the network of an extract, without stops and lines (`network_lines`).

    Raises
    ------
    ConfigError
        Where nothing is left to build from, or a tile cannot be read.
    """
    options = options or Options()
    mapped = _mapped(extract, options)
    topology = mapped.topology
    laid = lay(topology, mapped.plan, options.node_std_m)
    fitted = laid.fit
    rules = np.array([chain.rules for chain in topology.chains], dtype=np.int8)
    partners = beside(fitted.starts, rules, fitted.position, fitted.yaw_rad)
    network = _network(extract, mapped, laid, partners)
    if options.tiles:
        tiles = [elevation.read(path) for path in options.tiles]
        network = elevation.lift(network, tiles, options.geoid_m)
    return _rounded(network), survey.report(network, extract, topology, laid, partners)


def _mapped(extract: Extract, options: Options) -> _Mapped:
    ways = [way for way in extract.ways.values() if options.yards or not is_yard(way)]
    if not ways:
        raise ConfigError("every way of the extract is a yard's; take them in with --yards")
    chains = contract(ways)
    nodes = list(dict.fromkeys(node for chain in chains for node in chain.nodes))
    geodetic = np.array([extract.places[node] for node in nodes])
    latitude, longitude = np.round(geodetic.min(axis=0) / 2 + geodetic.max(axis=0) / 2, 6)
    level = LocalLevel(float(latitude), float(longitude), options.geoid_m)
    height = np.full((len(nodes), 1), options.geoid_m)
    points = level.from_geodetic(np.concatenate([geodetic, height], axis=1))[:, :2]
    plan = dict(zip(nodes, map(tuple, points.tolist()), strict=True))
    return _Mapped(level, join(chains, plan), plan)


def is_yard(way: OsmWay) -> bool:
    """Whether a way is a depot's."""
    return way.tags.get("service") == "yard"


def _network(extract: Extract, mapped: _Mapped, laid: Laid, partners: Partners) -> Network:
    chains, following = mapped.topology.chains, mapped.topology.following
    nodes = list(mapped.topology.nodes)
    number = {node: index for index, node in enumerate(nodes)}
    choice = {mapped.topology.run_ends(run)[1] for run, ahead in enumerate(following) if ahead[1:]}
    fitted = laid.fit
    unknown = np.full(len(fitted.yaw_rad), np.nan, dtype=np.float32)
    arrays: dict[str, Any] = {
        "starts": fitted.starts.astype(np.int32),
        "length_m": fitted.length_m,
        "rules": np.array([chain.rules for chain in chains], dtype=np.int8),
        "from_node": np.array([number[chain.nodes[0]] for chain in chains], dtype=np.int32),
        "to_node": np.array([number[chain.nodes[-1]] for chain in chains], dtype=np.int32),
        "node_id": np.array(nodes, dtype=np.int64),
        "node_switch": np.array([node in choice for node in nodes], dtype=np.int8),
        "following_starts": np.cumsum([0, *map(len, following)], dtype=np.int32),
        "following": np.array([run for ahead in following for run in ahead], dtype=np.int32),
        "east": fitted.position[:, 0].copy(),
        "north": fitted.position[:, 1].copy(),
        "yaw_rad": fitted.yaw_rad,
        "curvature_per_m": fitted.curvature_per_m,
        "across_std_m": fitted.across_std_m.astype(np.float32),
        "yaw_std_rad": fitted.yaw_std_rad.astype(np.float32),
        "height": unknown.copy(),
        "grade_rad": unknown.copy(),
        "grade_std_rad": unknown.copy(),
        "partner": partners.sides,
    }
    for array in arrays.values():
        array.flags.writeable = False
    return Network(
        latitude_rad=mapped.level.latitude_rad,
        longitude_rad=mapped.level.longitude_rad,
        height_m=mapped.level.height_m,
        **arrays,
        ways=_ways(extract, chains, laid),
        source="; ".join(extract.sources),
        node_std_m=fitted.node_std_m,
    )


def _ways(extract: Extract, chains: Sequence[Chain], laid: Laid) -> tuple[Way, ...]:
    """What the map says of each part of each track, from where its way begins to where it ends."""
    found = []
    for track, chain in enumerate(chains):
        arc = laid.node_arc_m(track)
        begin = 0
        for segment in range(1, len(chain.ways) + 1):
            if segment < len(chain.ways) and chain.ways[segment] == chain.ways[begin]:
                continue
            osm_id = chain.ways[begin]
            tags = extract.ways[osm_id].tags
            kept = {tag: tags[tag] for tag in TAGS if tag in tags}
            found.append(Way(track, float(arc[begin]), float(arc[segment]), max(osm_id, 0), kept))
            begin = segment
    return tuple(found)


_ROUNDED = {
    "across_std_m": 2.0**-10,
    "yaw_std_rad": 2.0**-14,
    "height": 2.0**-6,
    "grade_rad": 2.0**-14,
    "grade_std_rad": 2.0**-12,
}
"""Powers of two below what the figures are worth: their single floats end in noughts, and pack."""


def _rounded(network: Network) -> Network:
    """Keep of the samples' figures what means something."""
    arrays: dict[str, Any] = {}
    for name, step in _ROUNDED.items():
        value = np.asarray(getattr(network, name))
        arrays[name] = (np.rint(value / step) * step).astype(np.float32)
        arrays[name].flags.writeable = False
    return replace(network, **arrays)
