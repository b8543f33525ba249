"""The network that a mapper would make of a line: nodes where it bends, each with an error.

For studies of filters with a map whose truth is known.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator

from tramstream.estimation.kalman import Array
from tramstream.lines.line import Line
from tramstream.mapping.build import Options, build
from tramstream.mapping.osm import Extract, OsmWay
from tramstream.tracks.network import Network

SAGITTA_M = 0.1
"""A mapper sets a node before the chord leaves the rail by so much,"""
NODES_M = (3.0, 25.0)
"""but not nearer, and not farther, than this."""
LEAST_STD_M = 0.02
"""Of nodes that are exact: a fit wants some room."""
_LOOK_M = 2.5


def nodes_m(line: Line) -> Array:
    """Arc lengths at which a mapper sets nodes, from the line's begin to its end."""
    least, most = NODES_M
    ahead = np.arange(0.0, most, _LOOK_M)
    found = [0.0]
    while found[-1] < line.length_m:
        bent = float(np.max(np.abs(line.curvature_per_m(found[-1] + ahead))))
        chord_m = math.sqrt(8.0 * SAGITTA_M / max(bent, 1e-9))
        found.append(min(found[-1] + min(max(chord_m, least), most), line.length_m))
    return np.array(found)


def network_of(line: Line, node_std_m: float, rng: Generator) -> Network:
    """Map a line and build the network of the map.

    Parameters
    ----------
    node_std_m : float
        Deviation of each node, east and north.
    """
    at = nodes_m(line)
    places_l = line.position_l(at)
    places_l[:, :2] += node_std_m * rng.standard_normal((len(at), 2))
    geodetic = line.level.to_geodetic(places_l)[:, :2].tolist()
    nodes = range(1, len(at) + 1)
    extract = Extract()
    extract.places.update(zip(nodes, map(tuple, geodetic), strict=True))
    tags = {"railway": "tram", "oneway": "yes"}
    extract.ways[1] = OsmWay(1, tuple(nodes), tags)
    network, _ = build(extract, Options(node_std_m=max(node_std_m, LEAST_STD_M)))
    return network
