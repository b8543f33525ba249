"""What a record says of the grades that its filter was held to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from networks import single

from tramstream.config import Map, Vehicle
from tramstream.tracks.grades import NO_GRADES, digest_in, held_to


def saved(path: Path, grade: float, std: float = 0.01) -> Path:
    network = single().network
    level = np.zeros(len(network.east), np.float32)
    replace(
        network,
        grade_rad=level + np.float32(grade),
        grade_std_rad=level + np.float32(std),
    ).save(path)
    return path


def test_network_without_grades_has_none(tmp_path: Path) -> None:
    single().network.save(tmp_path / "a.net")
    assert digest_in(tmp_path / "a.net") == NO_GRADES


def test_digest_is_that_of_grades_and_their_deviations(tmp_path: Path) -> None:
    found = [
        digest_in(saved(tmp_path / f"{k}.net", *each))
        for k, each in enumerate([(0.01,), (0.01,), (0.02,), (0.01, 0.02)])
    ]
    assert found[0] == found[1]
    assert len(set(found)) == 3
    assert NO_GRADES not in found


@pytest.mark.parametrize("content", [None, b"", b"no zip", b"PK\x03\x04"])
def test_file_that_is_no_network_has_none(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "a.net"
    if content is not None:
        path.write_bytes(content)
    assert digest_in(path) == NO_GRADES


def test_network_that_is_cut_anywhere_ends_nothing(tmp_path: Path) -> None:
    data = saved(tmp_path / "a.net", 0.01).read_bytes()
    for end in range(0, len(data), 97):
        (tmp_path / "cut.net").write_bytes(data[:end])
        assert digest_in(tmp_path / "cut.net") == NO_GRADES


def test_vehicle_without_a_matcher_or_a_map_is_held_to_none(tmp_path: Path) -> None:
    path = str(saved(tmp_path / "a.net", 0.01))
    mapped = Vehicle(vehicle="1", map=Map(network=path))
    assert held_to(mapped) == digest_in(Path(path))
    assert held_to(Vehicle(vehicle="1")) == NO_GRADES
    assert held_to(Vehicle(vehicle="1", map=Map(network=path), processors=("ekf",))) == NO_GRADES
