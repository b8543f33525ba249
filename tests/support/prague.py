"""The track network of Prague as `tramstream map build` makes it, with heights, stops and lines."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

from typer.testing import CliRunner

from tramstream.cli.main import make_app
from tramstream.tracks import network as networks
from tramstream.tracks.network import Network


class Prague(NamedTuple):
    """The network, and what the verb told of it."""

    network: Network
    path: Path
    told: dict[str, Any]
    """The object of `--json`."""

    def of_kind(self, kind: str) -> list[dict[str, Any]]:
        """Findings of a kind."""
        return [each for each in self.told["findings"] if each["kind"] == kind]


def built(maps: Path, out: Path) -> Prague:
    """Build it of the files in a folder."""
    sources = [*maps.glob("*overpass.json")]
    lines, tile = maps / "lines_7_20.geojson", maps / "N50E014.hgt"
    options = ["-o", out, "--elevation", tile, "--lines", lines, "--json"]
    command = ["map", "build", *map(str, sorted(sources)), *map(str, options)]
    result = CliRunner().invoke(make_app("map"), command, catch_exceptions=False)
    return Prague(networks.load(out), out, json.loads(result.stdout))
