"""`tramstream grade-map`: rides of records become a map, which is added to, shown and handed on."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from graded import Going, hills, passing, states_of, write_smoothed
from looking import tramstream
from networks import town

from tramstream.analysis.grade_map import export, file
from tramstream.analysis.grade_map.assemble import GradeMap, assemble
from tramstream.analysis.grade_map.cells import cells_of
from tramstream.analysis.grade_map.heights import Priors
from tramstream.mapping.line_requests import LineRequest
from tramstream.mapping.lines import lay_lines
from tramstream.tracks.grades import GRADES_ENTRY, NO_GRADES, digest_in
from tramstream.tracks.network import Network, load

ALONG = Going((0, 2), length_m=900.0)
BACK = Going((3, 1), length_m=900.0)
"""Over the same tracks, against the map's rules."""


@pytest.fixture(scope="module")
def network() -> Network:
    return lay_lines(town(), [LineRequest("9", "out", ("West", "Far", "West"))])[0]


@pytest.fixture(scope="module")
def folder(network: Network, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network; three rides, one of them with a pitch that is 1 deg off; and records that are
    none, or say nothing new."""
    made = tmp_path_factory.mktemp("rides")
    network.save(made / "town.net")
    off = BACK._replace(pitch_off_rad=0.0175)
    for k, going in enumerate([ALONG, BACK, ALONG, off]):
        write_smoothed(made / f"ride{k}.mcap", states_of(network, going), seed=k * 10**9)
    (made / "copy.mcap").write_bytes((made / "ride0.mcap").read_bytes())
    held = {GRADES_ENTRY: "1f2e3d"}
    write_smoothed(made / "held.mcap", states_of(network, ALONG), held, seed=9)
    data = bytearray((made / "ride2.mcap").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (made / "damaged.mcap").write_bytes(data)
    (made / "none.mcap").write_bytes(b"no record")
    return made


def build(
    folder: Path,
    out: Path,
    *names: str,
    status: int = 0,
    options: tuple = (),
    workers: int = 1,
) -> dict:
    records = [folder / f"{name}.mcap" for name in names]
    done = tramstream(
        *("grade-map", "build", *records, "--net", folder / "town.net", "-o", out, "--json"),
        *("--workers", workers, *options),
    )
    assert done.returncode == status, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def built(folder: Path) -> tuple[Path, dict]:
    out = folder / "all.parquet"
    return out, build(folder, out, "ride0", "ride1", "ride2", "ride3")


def assert_same(one: GradeMap, other: GradeMap) -> None:
    for name, column in one.columns.items():
        np.testing.assert_allclose(column, other.columns[name], rtol=0, atol=1e-9, err_msg=name)
    assert one.rides == other.rides


# Building -----------------------------------------------------------------------------------------
def test_map_of_rides_is_true_and_names_the_one_that_is_not(network, built) -> None:
    out, figures = built
    made = file.read(out)
    (rejected,) = figures["rides_out"]
    assert rejected["ride"] == "ride3.mcap"
    assert (figures["rides"], figures["rides_added"], figures["left_out"]) == (4, 4, [])
    cells = cells_of(network)
    number = cells.starts[made.columns["track_number"]] + made.columns["cell"]
    error = made.columns["grade_rad"] - hills(network)[0][number]
    inner = made.columns["passes"] == 3
    assert np.count_nonzero(inner) > 160
    assert float(np.sqrt(np.mean(error[inner] ** 2))) < 1e-3
    nees = np.mean((error[inner] / made.columns["grade_std_rad"][inner]) ** 2)
    assert nees < 2.0  # the rides have no noise
    assert {(ride.out != "", ride.start_utc_ns > 0) for ride in made.rides} == {
        (False, True),
        (True, True),
    }


def test_map_is_the_same_in_any_order_with_any_number_of_workers(folder, built) -> None:
    out = folder / "other.parquet"
    build(folder, out, "ride3", "ride2", "ride0", "ride1", workers=2)
    assert_same(file.read(built[0]), file.read(out))


def test_rides_are_added_to_a_map_that_exists_and_none_twice(folder, built) -> None:
    out = folder / "grown.parquet"
    build(folder, out, "ride1", "ride3")
    figures = build(folder, out, "ride0", "ride1", "copy", "ride2")
    assert (figures["rides"], figures["rides_added"]) == (4, 2)
    assert [each["why"] for each in figures["left_out"]] == [
        "counted as ride0.mcap",
        "counted as ride1.mcap in the map already",
    ]
    assert_same(file.read(built[0]), file.read(out))
    anew = build(folder, out, "ride0", options=("--overwrite",))
    assert anew["rides"] == 1


def test_into_leaves_the_old_map_where_another_is_named(folder: Path) -> None:
    old, new = folder / "old.parquet", folder / "new.parquet"
    build(folder, old, "ride0")
    before = old.read_bytes()
    figures = build(folder, new, "ride1", options=("--into", str(old)))
    assert figures["rides"] == 2
    assert old.read_bytes() == before


def test_damaged_and_held_records_are_named_and_skipped(folder: Path) -> None:
    out = folder / "some.parquet"
    figures = build(folder, out, "ride0", "damaged", "held", "none", status=3)
    assert figures["rides"] == 1
    why = {Path(each["name"]).name: each["why"] for each in figures["left_out"]}
    assert set(why) == {"damaged.mcap", "held.mcap", "none.mcap"}
    assert "are damaged" in why["damaged.mcap"]
    assert "held to the grades 1f2e3d of its map" in why["held.mcap"]
    assert "would count what the map said already" in why["held.mcap"]


def test_map_of_nothing_is_not_written(folder: Path) -> None:
    out = folder / "nothing.parquet"
    net = folder / "town.net"
    done = tramstream("grade-map", "build", folder / "held.mcap", "--net", net, "-o", out)
    assert done.returncode == 2
    assert "none of the records can be used" in done.stderr
    assert not out.exists()


def test_map_is_never_written_over_a_record(folder: Path) -> None:
    record, net = folder / "ride0.mcap", folder / "town.net"
    done = tramstream("grade-map", "build", record, "--net", net, "-o", record)
    assert done.returncode == 2
    assert "is what would be read" in done.stderr


# Showing, handing on ------------------------------------------------------------------------------
def test_show_tells_profiles_and_rides_and_draws_a_page(folder, built) -> None:
    page = folder / "page.html"
    done = tramstream("grade-map", "show", built[0], "-o", page)
    assert done.returncode == 0, done.stderr
    assert "line 9 to West" in done.stdout
    assert "rejected: " in done.stdout
    text = page.read_text()
    assert "default-src 'none'" in text
    assert "line 9 to West" in text
    figures = json.loads(tramstream("grade-map", "show", built[0], "--json").stdout)
    (line,) = (each for each in figures["profiles"] if each["profile"].startswith("line"))
    assert line["known_km"] == pytest.approx(0.9, abs=0.03)
    assert line["grade_most_percent"] == pytest.approx(4.0, abs=0.15)
    assert len(figures["by_ride"]) == 4
    again = tramstream("grade-map", "show", built[0], "-o", page)
    assert again.returncode == 2


def test_exports_agree_with_the_map(folder, built) -> None:
    made = file.read(built[0])
    outs = {kind: folder / f"out.{kind}" for kind in ("geojson", "osm", "railml")}
    options = [word for kind, path in outs.items() for word in (f"--{kind}", path)]
    assert tramstream("grade-map", "export", built[0], *options).returncode == 0
    features = json.loads(outs["geojson"].read_text())["features"]
    told = [each["properties"]["grade_percent"] for each in features]
    known = np.isfinite(made.columns["grade_rad"])
    np.testing.assert_allclose(told, 100 * np.tan(made.columns["grade_rad"][known]), atol=1e-3)
    ways = ElementTree.parse(outs["osm"]).getroot().findall("way")
    inclines = [way.find("tag[@k='incline']").get("v") for way in ways]
    assert all(value.endswith("%") for value in inclines)
    assert max(float(value[:-1]) for value in inclines) == pytest.approx(4.0, abs=0.5)
    rails = ElementTree.parse(outs["railml"]).getroot()
    slopes = [float(each.get("slope")) for each in rails.iter(f"{{{export.RAILML}}}gradientChange")]
    assert max(slopes) == pytest.approx(40.0, abs=5.0)
    assert tramstream("grade-map", "export", built[0]).returncode == 2


def test_stretches_cover_every_cell_once_within_their_tolerance(built) -> None:
    made = file.read(built[0])
    found = export.stretches(made)
    rows = [row for part in found for row in range(part.first, part.last + 1)]
    assert rows == np.flatnonzero(np.isfinite(made.columns["grade_rad"])).tolist()
    assert len(found) < len(rows) / 2
    exact = replace(
        made,
        columns=made.columns | {"grade_std_rad": made.columns["grade_std_rad"] * 0 + 1e-9},
    )
    for part in export.stretches(exact):
        own = 100 * np.tan(made.columns["grade_rad"][part.first : part.last + 1])
        assert np.abs(own - part.grade_percent).max() < 2 * export.TOLERANCE + 1e-9


# Back into the network ----------------------------------------------------------------------------
def overpass(folder: Path) -> Path:
    """A street of 800 m with a siding, both ways."""
    elements: list[dict] = [
        {"type": "node", "id": k + 1, "lat": 50.0, "lon": round(14.4 + 2.8e-4 * k, 7)}
        for k in range(41)
    ]
    elements.append({"type": "node", "id": 50, "lat": 50.0002, "lon": 14.4072})
    for osm_id, nodes in ((1, range(1, 42)), (2, (21, 50))):
        elements.append(
            {"type": "way", "id": osm_id, "nodes": list(nodes), "tags": {"railway": "tram"}}
        )
    path = folder / "map.json"
    path.write_text(json.dumps({"elements": elements}))
    return path


def test_network_is_built_with_the_grades_that_rides_measured(tmp_path: Path) -> None:
    """The same map of rails, another build of it: the cells find their tracks by name."""
    source, first = overpass(tmp_path), tmp_path / "first.net"
    assert tramstream("map", "build", source, "-o", first).returncode == 0
    network = load(first)
    rides = [passing(network, k, 1 - 2 * (k % 2), noise_rad=1e-4) for k in range(4)]
    file.write(assemble(network, rides, Priors((), 0.0)), tmp_path / "grades.parquet")
    second = tmp_path / "second.net"
    words = ("map", "build", source, "-o", second, "--grades", tmp_path / "grades.parquet")
    done = tramstream(*words, "--json")
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert (figures["grade_share"], figures["grades_nowhere"]) == (1.0, [])
    built = load(second)
    assert np.isfinite(built.grade_rad).all()
    assert "grades of 4 rides (grades.parquet)" in built.source
    cells = cells_of(network)
    track = int(np.argmax(network.length_m))
    own = built.grade_rad[built.samples_of(track)]
    at = np.arange(len(own)) * float(built.spacing_m[track])
    middle = (np.arange(np.diff(cells.starts)[track]) + 0.5) * cells.width_m[track]
    true = hills(network)[0][cells.starts[track] : cells.starts[track + 1]]
    np.testing.assert_allclose(own, np.interp(at, middle, true), atol=2e-3)
    assert "with a measured grade" in tramstream(*words).stdout
    assert digest_in(second) not in (NO_GRADES, digest_in(first))


def test_grades_that_are_none_end_the_build_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "grades.parquet").write_bytes(b"none")
    words = ("map", "build", overpass(tmp_path), "-o", tmp_path / "a.net")
    done = tramstream(*words, "--grades", tmp_path / "grades.parquet")
    assert done.returncode == 2
    assert "is no grade map" in done.stderr
    assert not (tmp_path / "a.net").exists()
