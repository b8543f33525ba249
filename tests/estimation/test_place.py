"""States in `l` as they are published, against the exact conversion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tramstream.estimation.localiser import (
    COVARIANCE,
    HEADING_UNKNOWN,
    TRACKING,
    VALUES,
    Estimate,
    values_of,
)
from tramstream.estimation.published import Places
from tramstream.geodesy import LocalLevel, convergence_rad
from tramstream.memory.stage import copied

LEVEL = LocalLevel.at_deg(50.0, 14.4, 250.0)
TENTH_MM_DEG = math.degrees(1e-4 / 6.4e6)
SINGLE = 6e-8
"""Half a unit in the last of 24 bits."""
STD = np.array([0.3, 0.2, 0.5, 0.1, 0.01, 0.02, 0.03])


def estimate(
    p_l: tuple[float, float, float], yaw_rad: float = 0.4, mode: int = TRACKING
) -> Estimate:
    motion = np.array([*p_l, 12.0, 0.01, -0.02, yaw_rad])
    return Estimate(1, mode, values_of(motion, np.diag(STD**2), 0.7, 0.05), False)


@pytest.mark.parametrize("far_m", [0.0, 19.9, 5000.0])
def test_place_is_that_of_the_exact_conversion(far_m: float) -> None:
    places = Places(LEVEL)
    places.describe(estimate((0.0, 0.0, 0.0)), 1.0)
    p_l = (far_m, -0.5 * far_m, 0.01 * far_m)
    message = places.describe(estimate(p_l), 1.0)
    assert message is not None
    latitude, longitude, height = LEVEL.to_geodetic(p_l).tolist()
    assert message.latitude_deg == pytest.approx(math.degrees(latitude), abs=TENTH_MM_DEG)
    assert message.longitude_deg == pytest.approx(math.degrees(longitude), abs=2 * TENTH_MM_DEG)
    assert message.height_ellipsoid_m == pytest.approx(height, abs=1e-4)
    turned = 0.4 - float(convergence_rad(LEVEL, longitude))
    assert message.yaw_rad == pytest.approx(turned, abs=1e-6)


def test_deviations_are_along_and_across_the_vehicle() -> None:
    message = Places(LEVEL).describe(estimate((0.0, 0.0, 0.0), math.pi / 2), 2.0)
    assert message is not None
    assert (message.along_std_m, message.across_std_m) == pytest.approx((0.2, 0.3))
    assert message.protection_along_m == pytest.approx(2.0 * message.along_std_m, rel=SINGLE)
    assert message.protection_across_m == pytest.approx(2.0 * message.across_std_m, rel=SINGLE)
    others = (message.up_std_m, message.speed_std_mps, message.yaw_std_rad)
    assert others == pytest.approx((0.5, 0.1, 0.03))
    said = (message.speed_mps, message.acceleration_mps2, message.yaw_rate_radps)
    assert said == pytest.approx((12.0, 0.7, 0.05), rel=SINGLE)
    expected = np.diag(STD**2)[np.triu_indices(7)]
    np.testing.assert_allclose(message.covariance, expected, rtol=SINGLE, atol=0.0)


def test_numbers_beside_the_place_have_the_digits_of_a_single() -> None:
    """What is beyond them is noise that takes room in every record."""
    message = Places(LEVEL).describe(estimate((1.0, 2.0, 3.0)), 3.29)
    assert message is not None
    units = ("std_m", "along_m", "across_m", "_mps", "_mps2", "_rad", "_radps")
    numbers = [value for field, value in message.ListFields() if field.name.endswith(units)]
    assert len(numbers) == 13
    for number in [*numbers, *message.covariance]:
        assert float(np.float32(number)) == number


def test_without_a_heading_any_direction_may_be_the_worst() -> None:
    message = Places(LEVEL).describe(estimate((0.0, 0.0, 0.0), mode=HEADING_UNKNOWN), 2.0)
    assert message is not None
    assert message.along_std_m == message.across_std_m == pytest.approx(0.3)


@pytest.mark.parametrize("broken", [0, 6, COVARIANCE, VALUES - 1])
def test_what_is_no_number_is_not_described(broken: int) -> None:
    said = estimate((0.0, 0.0, 0.0))
    said.values[broken] = math.nan
    places = Places(LEVEL)
    assert places.describe(said, 1.0) is None
    assert places.describe(estimate((0.0, 0.0, 0.0)), 1.0) is not None


def test_negative_variance_is_not_described() -> None:
    said = estimate((0.0, 0.0, 0.0))
    said.covariance[3, 3] = -1e-9
    assert Places(LEVEL).describe(said, 1.0) is None


def test_restored_places_go_on_to_the_last_digit() -> None:
    one = Places(LEVEL)
    one.describe(estimate((100.0, 50.0, 1.0)), 1.0)
    other = Places(LEVEL, copied(one.memory))
    next_ = estimate((105.0, 55.0, 1.1))
    first, second = one.describe(next_, 1.0), other.describe(next_, 1.0)
    assert first is not None
    assert first == second
