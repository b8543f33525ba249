"""The filter `tram` errs by as much as it says, no more and no less: NEES and NIS of 20 rides.

Means over all rides lie within bounds on both sides, of 95 % for all of them together, which take
the autocorrelation of all rides into account (`analysis/evaluate/consistency.py`). What each is
worth in independent samples stands in docs/accuracy.md. A filter that is told half or twice the
noise lies outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import pytest
from rides import altered
from told_rides import SEEDS, Figure, Judged, figure, judged

from tramstream.config import Vehicle

SOME = SEEDS[:10]
FEW = SEEDS[:4]
"""Two rides of each kind: their tape is read, and they are gone through with a wrong noise too."""
DIMENSIONS = {"place": 2, "place, speed, yaw": 4}
TOGETHER = 14
"""Figures that are demanded to lie inside, or will be."""
LEAST_EFFECTIVE = 15.0
"""Independent samples without which a mean says little: bounds would be 0.3 and 2.2."""
DOUBT = "2 mm/s are claimed of a vehicle that stands, for nobody has seen its departure yet"
QUANTISED = "a reading of a wheel is claimed to be four times as rough as rounding makes it"
SWAY = "the body is taken to sway; that of the simulated ride does not"
GREATER = "the greater of the noise that is configured and that is seen is used"


@cache
def rides() -> list[Judged]:
    return [judged(seed, taped=seed in FEW) for seed in SEEDS]


def known(name: str, reason: str) -> object:
    """A quantity that is known to lie outside; it fails as soon as it does not."""
    return pytest.param(name, marks=pytest.mark.xfail(strict=True, reason=reason))


def of_errors(judged_rides: list[Judged], quantity: str, figures: int = TOGETHER) -> Figure:
    series = [each.nees[quantity] for each in judged_rides]
    return figure(series, DIMENSIONS.get(quantity, 1), figures)


def of_innovations(judged_rides: list[Judged], measurement: str, figures: int = TOGETHER) -> Figure:
    series = [each.nis[measurement] for each in judged_rides if measurement in each.nis]
    return figure(series, figures=figures)


@pytest.mark.parametrize(
    "quantity",
    [
        "place",
        "along",
        "across",
        "up",
        "speed, moving",
        known("speed, standing", DOUBT),
        "roll",
        "pitch",
        "yaw",
        "place, speed, yaw",
    ],
)
def test_errors_are_as_large_as_the_filter_says(quantity: str) -> None:
    found = of_errors(rides(), quantity)
    assert found.effective > LEAST_EFFECTIVE
    assert found.mean in found.bounds, found


@pytest.mark.parametrize(
    "measurement",
    [
        "gnss_east",
        "gnss_north",
        "gnss_up",
        "gnss_velocity_east",
        "gnss_velocity_north",
        known("wheel_a", QUANTISED),
        known("wheel_b", QUANTISED),
        known("lateral force", SWAY),
        known("standstill speed", DOUBT),
        known("standstill rates", GREATER),
    ],
)
def test_innovations_are_as_large_as_the_filter_says(measurement: str) -> None:
    found = of_innovations(rides(), measurement)
    assert found.effective > LEAST_EFFECTIVE
    assert found.mean in found.bounds, found


def test_nothing_errs_by_more_than_the_filter_says() -> None:
    """What lies outside does so because the filter claims too little.

    Gravity at a stop is among it: its scatter holds the braking yet in the first seconds.
    """
    measurements = sorted({name for each in rides() for name in each.nis})
    found = {name: of_errors(rides(), name) for name in rides()[0].nees}
    found |= {name: of_innovations(rides(), name) for name in measurements}
    assert {name for name, each in found.items() if each.mean > each.bounds.high} == set()


def test_hardly_any_innovation_of_an_honest_sensor_is_refused() -> None:
    for each in rides():
        assert min(each.accepted.values()) > 0.99


# Told a wrong noise -------------------------------------------------------------------------------
@pytest.mark.parametrize(("factor", "side"), [(0.5, "high"), (2.0, "low")])
def test_wrong_noise_of_the_fixes_is_found(factor: float, side: str) -> None:
    wrong = [judged(seed, stated=factor) for seed in FEW]
    for axis in ("east", "north", "up"):
        assert outside(of_innovations(wrong, f"gnss_{axis}", 3)) == side


def gyroscopes_told(factor: float, seeds: Sequence[int], taped: bool = False) -> list[Judged]:
    def told(vehicle: Vehicle) -> Vehicle:
        assert vehicle.imu is not None
        noise, walk = vehicle.imu.gyro_noise_radps_rthz, vehicle.imu.gyro_walk_radps2_rthz
        imu = {"gyro_noise_radps_rthz": factor * noise, "gyro_walk_radps2_rthz": factor * walk}
        changed: Vehicle = altered(vehicle, imu=imu)
        return changed

    return [judged(seed, told, taped=taped) for seed in seeds]


def test_too_little_noise_of_the_gyroscopes_is_found_in_the_speed() -> None:
    """It is process noise: pitch, and with it gravity, drives the speed."""
    wrong = gyroscopes_told(0.5, SOME)
    assert outside(of_errors(wrong, "speed, moving", 1)) == "high"


def test_too_much_noise_of_the_gyroscopes_is_found_at_a_stop() -> None:
    """No error of the motion is much smaller for it; what the gyroscopes read at a stop is."""
    wrong = gyroscopes_told(2.0, FEW, taped=True)
    found = of_innovations(wrong, "standstill rates", 1)
    assert found.mean < 0.5 * found.bounds.low


def outside(found: Figure) -> str:
    """On which side of its bounds a figure lies; empty within."""
    if found.mean in found.bounds:
        return ""
    return "high" if found.mean > found.bounds.high else "low"
