"""The figures of docs/calibration.md of whole rides: constants found, IMUs moved. Minutes each."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tramstream.analysis.notebook.rides import simulate
from tramstream.analysis.odometry.calibration import calibrate
from tramstream.analysis.odometry.material import Ride, read_ride
from tramstream.analysis.odometry.moves import changes_in, moved_at
from tramstream.attitude import C_bv_of
from tramstream.processors.consistency.moved import Change
from tramstream.simulation import scenario

pytestmark = pytest.mark.study

WITHIN_S = 10.0
ANGLES_DEG = (0.5, 1.0, 2.0, 5.0, 30.0)
DRAWN = 20
LIMIT = {"kaspar2023": 0.0003, "matching": 0.0003}
"""Of a wheel's constant, as a part. The goal for the first is 0.0001: what it falls short by, and
why, stands in the document."""


def ridden(name: str, seed: int, folder: Path) -> Ride:
    path = folder / f"{name}-{seed}.mcap"
    simulate(name, seed=seed, out=path).close()
    return read_ride(path)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", ["kaspar2023", "matching"])
def test_constants_of_whole_rides(name: str, seed: int, tmp_path: Path) -> None:
    found = calibrate(ridden(name, seed, tmp_path))
    chosen = scenario.load(name)
    assert chosen.wheels is not None
    axle = chosen.wheels.axle
    for side, error_m in zip(("left", "right"), axle.radius_error_m, strict=True):
        figure = found.figure(f"scale {side}")
        assert figure is not None
        off = figure.value - error_m / axle.radius_m
        print(f"{name} {seed} {side}: {100 * off:+.4f} % ± {100 * figure.std:.4f} %")
        assert abs(off) < LIMIT[name]
        assert abs(off) < 4.0 * figure.std
    for each in found.figures[2:]:
        print(f"{name} {seed} {each.name}: {each.value:+.4f} ± {each.std:.4f} {each.unit}")


@pytest.mark.parametrize("name", ["kaspar2023", "matching", "city", "tram"])
def test_imus_that_are_moved_and_those_that_are_not(name: str, tmp_path: Path) -> None:
    ride = ridden(name, 1, tmp_path)
    false = changes_in(ride)
    hours = ride.duration_s / 3600
    print(f"{name}: {len(false)} false alarms in {hours:.2f} h", false)
    rng = np.random.default_rng(1)
    for angle_deg in ANGLES_DEG:
        for kind, axes in (("tilted", (1.0, 1.0, 0.0)), ("turned", (0.0, 0.0, 1.0))):
            hits = [_hit(ride, angle_deg, np.array(axes), rng) for _ in range(DRAWN)]
            late = [abs(found.time_s - at_s) for at_s, found in hits if found is not None]
            worst = max(late, default=math.nan)
            print(f"  {angle_deg:4} ° {kind}: {len(late)} of {DRAWN}, dated to {worst:.1f} s")
    assert len(false) <= 1


def _hit(
    ride: Ride, angle_deg: float, axes: np.ndarray, rng: np.random.Generator
) -> tuple[float, Change | None]:
    """Move the IMU somewhere in the ride; what is found within ten seconds of it."""
    at_s = float(rng.uniform(60.0, ride.duration_s - 40.0))
    axis = rng.normal(size=3) * axes
    axis = C_bv_of(ride.vehicle.imu) @ (axis / np.linalg.norm(axis))
    moved = moved_at(ride, at_s, math.radians(angle_deg) * axis)
    found = changes_in(moved, at_s - 40.0, at_s + 30.0)
    return at_s, next((each for each in found if abs(each.time_s - at_s) < WITHIN_S), None)
