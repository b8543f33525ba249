"""The track network of Prague as `tramstream map build` makes it, with heights, stops and lines."""

from __future__ import annotations

import fcntl
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


def shared(maps: Path, folder: Path) -> Prague:
    """Build it of the files in `maps`, or take what another worker of this run has built."""
    folder.mkdir(exist_ok=True)
    out, told = folder / "prague.net", folder / "told.json"
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not told.exists():
            told.write_text(_build(maps, out))
    return Prague(networks.load(out), out, json.loads(told.read_text()))


def _build(maps: Path, out: Path) -> str:
    sources = [*maps.glob("*overpass.json")]
    lines, tile = maps / "lines_7_20.geojson", maps / "N50E014.hgt"
    options = ["-o", out, "--elevation", tile, "--lines", lines, "--json"]
    command = ["map", "build", *map(str, sorted(sources)), *map(str, options)]
    return CliRunner().invoke(make_app("map"), command, catch_exceptions=False).stdout
