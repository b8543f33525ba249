"""An extract of a map from files, whichever of the forms they have."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tramstream.errors import ConfigError
from tramstream.mapping import osm, osm_file


def read(paths: Sequence[Path]) -> osm.Extract:
    """Read an extract from files.

    Raises
    ------
    ConfigError
        One sentence with the file, the way and what is wrong with it.
    """
    extract = osm.Extract()
    for path in paths:
        if path.name.endswith((".pbf", ".osm", ".osm.gz", ".osm.bz2", ".o5m")):
            osm_file.read(path, extract)
        else:
            osm.read_json(path, extract)
    names = ", ".join(str(path) for path in paths) or "no file"
    if not extract.ways:
        raise ConfigError(f"{names}: has no way with railway=tram or railway=light_rail")
    for way in extract.ways.values():
        for node in way.nodes:
            if node not in extract.places:
                raise ConfigError(
                    f"{names}: way {way.osm_id} has node {node}, which has no coordinates; "
                    "extract complete ways (`out geom` of Overpass, `osmium extract`)"
                )
    return extract
