"""Rails from OpenStreetMap's own files (`.osm.pbf`, `.osm`, `.osm.gz`), read with osmium.

Two passes: ways and routes first, then the nodes that these run through; so a country's file needs
no more memory than its trams.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import osmium

from tramstream.errors import ConfigError
from tramstream.mapping import osm
from tramstream.mapping.osm import Extract, Member, OsmRoute, OsmWay

_KINDS = {"n": "node", "w": "way", "r": "relation"}


def read(path: Path, extract: Extract) -> None:
    """Read a file into an extract; see `tramstream.mapping.extract.read`."""
    if not path.is_file():
        raise ConfigError(f"{path}: cannot be read (no such file); check the name")
    try:
        header = osmium.io.Reader(str(path), osmium.osm.NOTHING)
        date = header.header().get("osmosis_replication_timestamp")
        header.close()
        needed = _ways_and_routes(path, extract)
        _nodes(path, extract, needed)
    except RuntimeError as error:  # osmium has no other
        raise ConfigError(f"{path}: is no OpenStreetMap file: {error}") from error
    extract.sources.append(f"{path.name} (OpenStreetMap{f' of {date}' if date else ''}, ODbL)")


def _ways_and_routes(path: Path, extract: Extract) -> set[int]:
    """Keep the tracks and routes; the nodes that they need."""
    needed: set[int] = set()
    found: Any = osmium.FileProcessor(str(path), osmium.osm.WAY | osmium.osm.RELATION)
    found = found.with_filter(osmium.filter.KeyFilter("railway", "route"))
    for each in found:
        tags = {tag.k: tag.v for tag in each.tags}
        if each.is_way() and tags.get("railway") in osm.RAILS:
            nodes = tuple(node.ref for node in each.nodes)
            needed.update(nodes)
            osm.keep_way(extract, OsmWay(each.id, nodes, tags), f"{path}: way {each.id}")
        elif each.is_relation() and osm.is_route(tags):
            members = tuple(Member(_KINDS[m.type], m.ref, m.role) for m in each.members)
            extract.routes[each.id] = OsmRoute(each.id, members, tags)
    return needed


def _nodes(path: Path, extract: Extract, needed: set[int]) -> None:
    """Keep the places of needed nodes, and nodes that matter by themselves."""
    found: Any = osmium.FileProcessor(str(path), osmium.osm.NODE)
    found = found.with_filter(osmium.filter.IdFilter(needed))
    for each in found:
        osm.place(extract, each.id, each.lat, each.lon, f"{path}: node {each.id}")
    found = osmium.FileProcessor(str(path), osmium.osm.NODE)
    found = found.with_filter(osmium.filter.KeyFilter("railway", "public_transport"))
    for each in found:
        tags = {tag.k: tag.v for tag in each.tags}
        if tags.get("railway") in osm.NODES or osm.is_stop(tags):
            osm.place(extract, each.id, each.lat, each.lon, f"{path}: node {each.id}")
            osm.keep_node(extract, each.id, tags)
