"""`tramstream map build`: the file, what is printed, and what is refused."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import pytest
from live import finished
from prague import Prague
from typer.testing import CliRunner, Result

from tramstream.cli.main import make_app
from tramstream.errors import ConfigError
from tramstream.tracks import network


def build(*arguments: object) -> Result:
    """Run the verb in this process; what it refuses is raised."""
    result = CliRunner().invoke(make_app("map"), ["map", "build", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def overpass(folder: Path, name: str = "map.json") -> Path:
    """A straight track with two stops and a siding, a yard beyond its end, and an odd tag."""
    elements: list[dict[str, Any]] = []
    metre = 1 / (math.radians(1) * 6.39e6 * math.cos(math.radians(50.0)))
    for node in range(41):
        place = {"lat": 50.0, "lon": round(14.4 + 20 * node * metre, 9)}
        tags = {5: "A", 35: "B"}.get(node)
        named = {"railway": "tram_stop", "name": tags} if tags else {}
        elements.append({"type": "node", "id": node + 1, **place, "tags": named})
    elements.append({"type": "node", "id": 50, "lat": 50.0002, "lon": 14.4 + 520 * metre})
    for osm_id, nodes, tags in (
        (1, range(1, 31), {"oneway": "yes", "maxspeed": "quick"}),
        (2, range(30, 39), {"oneway": "yes"}),
        (3, (21, 50), {"oneway": "yes"}),
        (4, range(38, 42), {"service": "yard"}),
    ):
        rails = {"railway": "tram", **tags}
        elements.append({"type": "way", "id": osm_id, "nodes": list(nodes), "tags": rails})
    path = folder / name
    path.write_text(json.dumps({"elements": elements}))
    return path


def test_network_and_figures(tmp_path: Path) -> None:
    source, out = overpass(tmp_path), tmp_path / "a.net"
    told = json.loads(build(source, "-o", out, "--json").stdout)
    built = network.load(out)
    assert told["counts"]["edges"] == len(built.edges) == 3
    assert told["counts"]["stops"] == len(built.stops) == 2
    assert {stop.name for stop in built.stops} == {"A", "B"}
    assert told["bytes"] == out.stat().st_size
    assert told["track_km"] == pytest.approx(built.length_m.sum() / 1000)
    kinds = {finding["kind"] for finding in told["findings"]}
    assert kinds == {"dead_end", "tag"}
    assert "map.json" in built.source
    assert "built 2" in built.source


def test_table_for_people(tmp_path: Path) -> None:
    result = build(overpass(tmp_path), "-o", tmp_path / "a.net")
    assert result.exit_code == 0
    assert "directed segments" in result.stdout
    assert "Dead ends: 2" in result.stdout
    assert "maxspeed=quick is not understood" in result.stdout
    assert result.stdout.splitlines()[-1].startswith(f"{tmp_path / 'a.net'}: ")


def test_options_reach_the_network(tmp_path: Path) -> None:
    source, out = overpass(tmp_path), tmp_path / "a.net"
    tile = tmp_path / "N50E014.hgt"
    tile.write_bytes(b"\x01\x2c" * 1201**2)  # 300 m everywhere
    arguments = ("--yards", "--node-std-m", 0.5, "--elevation", tile, "--geoid-m", 40, "--json")
    told = json.loads(build(source, "-o", out, *arguments).stdout)
    built = network.load(out)
    assert told["counts"]["ways_left_out"] == 0
    assert built.node_std_m == 0.5
    assert built.height.min() == pytest.approx(340.0, abs=0.1)


def test_lines_come_from_a_file(tmp_path: Path) -> None:
    lines = tmp_path / "lines.toml"
    lines.write_text('[[line]]\nline = "1"\ndirection = "B"\nstops = ["A", "B"]\n')
    out = tmp_path / "a.net"
    told = json.loads(build(overpass(tmp_path), "-o", out, "--lines", lines, "--json").stdout)
    assert told["counts"]["lines"] == 1
    (line,) = network.load(out).lines
    assert line.length_m == pytest.approx(600.0, abs=1.0)


def test_nothing_is_written_where_nothing_can_be_built(tmp_path: Path) -> None:
    source, out = overpass(tmp_path), tmp_path / "a.net"
    with pytest.raises(ConfigError, match=r"none.json: cannot be read"):
        build(tmp_path / "none.json", "-o", out)
    with pytest.raises(ConfigError, match="choose another --out"):
        build(source, "-o", source)
    with pytest.raises(ConfigError, match="cannot be written"):
        build(source, "-o", tmp_path / "no" / "folder" / "a.net")
    assert not out.exists()
    assert build(source, "-o", out, "--node-std-m", 0).exit_code == 2


def test_group_lists_its_verbs() -> None:
    result = CliRunner().invoke(make_app(), ["map", "--help"])
    for verb in ("build", "info", "match"):
        assert verb in result.stdout


def test_help_loads_nothing_heavy() -> None:
    program = (
        "import sys; from tramstream.cli.main import make_app; make_app('map'); "
        "sys.exit(any(m in sys.modules for m in ('numpy', 'numba', 'osmium', 'scipy')))"
    )
    assert finished([sys.executable, "-c", program]).returncode == 0


@pytest.mark.realdata
def test_prague_with_everything(prague: Prague) -> None:
    counts = prague.told["counts"]
    assert (counts["nodes"], counts["edges"], counts["segments"]) == (941, 1630, 21817)
    assert counts["lines"] == 4
    assert counts["stops"] > 600
    assert prague.of_kind("line") == []
    assert prague.told["bytes"] == prague.path.stat().st_size < 5e6
