"""What a fix is worth: heights that are not told, and receivers that disown their fixes."""

from __future__ import annotations

import math

import pytest

from tramstream.estimation.events import FIX_JAMMED, FIX_SPOOFED
from tramstream.estimation.fixes import (
    WORST_STD_M,
    antenna_l,
    deviations,
    measures_height,
    place_deg,
    unusable,
)
from tramstream.geodesy import LocalLevel
from tramstream.proto.gnss_pb2 import (
    JAMMING_CRITICAL,
    JAMMING_OK,
    JAMMING_UNKNOWN,
    JAMMING_WARNING,
    SPOOFING_AFFIRMED,
    SPOOFING_INDICATED,
    SPOOFING_NONE,
    SPOOFING_UNKNOWN,
    GnssFix,
)

LEVEL = LocalLevel.at_deg(50.08, 14.42, 250.0)
SEPARATION_M = 45.0
MILLIMETRE = 0.001


def fix(**values: object) -> GnssFix:
    base = {"latitude_deg": 50.08, "longitude_deg": 14.43, "horizontal_std_m": 2.0, "valid": True,
            "vertical_std_m": 3.0, "fix_type": GnssFix.FIX_3D, "satellites_used": 9}  # fmt: skip
    return GnssFix(**base | values)  # type: ignore[arg-type]


def test_height_that_is_told_is_used() -> None:
    told = fix(height_ellipsoid_m=250.0)
    assert measures_height(told)
    assert deviations(told, 0.005) == (pytest.approx(math.sqrt(2.0)), 3.0)
    assert place_deg(told) == (50.08, 14.43, 250.0)


@pytest.mark.parametrize(
    "untold",
    [fix(), fix(height_msl_m=205.0), fix(height_ellipsoid_m=250.0, fix_type=GnssFix.FIX_2D)],
    ids=["none", "above the sea", "two dimensions"],
)
def test_of_a_height_that_is_not_told_nothing_is_known(untold: GnssFix) -> None:
    assert not measures_height(untold)
    assert deviations(untold, 0.005) == (pytest.approx(math.sqrt(2.0)), WORST_STD_M)
    assert unusable(untold, LEVEL) is None


def test_place_without_a_height_is_where_it_is_in_the_plane() -> None:
    """Within what the missing height moves it: 45 m of 6,378 km, 0.7 km away."""
    east, north, _ = antenna_l(fix(height_ellipsoid_m=250.0), LEVEL)
    for other in (fix(), fix(height_msl_m=250.0 - SEPARATION_M)):
        near_east, near_north, _ = antenna_l(other, LEVEL)
        assert math.hypot(near_east - east, near_north - north) < 10 * MILLIMETRE
    assert antenna_l(fix(), LEVEL)[2] == pytest.approx(0.0, abs=0.1)  # at the frame's own height


@pytest.mark.parametrize("state", [SPOOFING_INDICATED, SPOOFING_AFFIRMED])
def test_fix_of_a_receiver_that_says_it_is_spoofed_is_not_used(state: int) -> None:
    why = unusable(fix(height_ellipsoid_m=250.0, spoofing=state), LEVEL)
    assert why is not None
    assert why.kind is FIX_SPOOFED
    assert (why.facts["accuracy_m"], why.facts["satellites"]) == (2.0, 9)


def test_fix_of_a_receiver_that_says_it_is_jammed_is_not_used() -> None:
    why = unusable(fix(jamming=JAMMING_CRITICAL), None)
    assert why is not None
    assert why.kind is FIX_JAMMED


@pytest.mark.parametrize("jamming", [JAMMING_UNKNOWN, JAMMING_OK, JAMMING_WARNING])
@pytest.mark.parametrize("spoofing", [SPOOFING_UNKNOWN, SPOOFING_NONE])
def test_receiver_that_copes_is_believed(jamming: int, spoofing: int) -> None:
    assert unusable(fix(jamming=jamming, spoofing=spoofing), LEVEL) is None
