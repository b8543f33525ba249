"""Where the driver keeps a speed, on track whose curvature changes everywhere."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tramstream.geodesy import LocalLevel
from tramstream.lines.line import Line, Segment
from tramstream.simulation.ride import Limits, Ride
from tramstream.simulation.speed_plan import WORTH_M, regions

LEVEL = LocalLevel.at_deg(50.0, 14.0, 250.0)
LIMITS = Limits(lateral_mps2=0.5)


def wavy(curvatures: list[float]) -> Line:
    """Track of 5 m pieces between these curvatures, with a stop in its middle."""
    segments = [Segment(5.0, a, b) for a, b in pairwise(curvatures)]
    length_m = 5.0 * len(segments)
    return Line(segments, [0.0, 5.0 * (len(segments) // 2), length_m], LEVEL)


curvatures = st.lists(st.floats(-0.05, 0.05), min_size=12, max_size=80)


@given(curvatures)
@settings(max_examples=50)
def test_regions_cover_the_line_and_allow_no_more_than_the_track(values: list[float]) -> None:
    line = wavy(values)
    found = regions(line, LIMITS)
    assert found[0].start_m == 0.0
    assert found[-1].end_m == line.stops_m[-1]
    assert [region.end_m for region in found if region.stop] == line.stops_m[1:].tolist()
    for region, after in zip(found, [*found[1:], None], strict=True):
        assert after is None or after.start_m == region.end_m
        inside = np.linspace(region.start_m + 1e-9, region.end_m - 1e-9, 50)
        sharpest = float(np.max(np.abs(line.curvature_per_m(inside))))
        assert region.limit_mps <= math.sqrt(0.5 / max(sharpest, 0.5 / 15.0**2)) * (1 + 1e-9)


@given(curvatures)
@settings(max_examples=50)
def test_no_region_is_faster_than_a_neighbour_for_less_than_it_is_worth(
    values: list[float],
) -> None:
    found = regions(wavy(values), LIMITS)
    for index, region in enumerate(found):
        if region.end_m - region.start_m >= WORTH_M - 1e-9:
            continue
        if index > 0 and not found[index - 1].stop:
            assert region.limit_mps <= found[index - 1].limit_mps
        if not region.stop:
            assert region.limit_mps <= found[index + 1].limit_mps


@given(curvatures)
@settings(max_examples=25)
def test_ride_on_wavy_track_keeps_its_limits(values: list[float]) -> None:
    ride = Ride(wavy(values), LIMITS)
    motion = ride.motion(np.linspace(0.0, ride.duration_s, 3001))
    assert np.max(np.abs(motion.speed_mps * motion.yaw_rate_radps)) <= 0.5 + 1e-6
    assert np.max(np.abs(motion.acceleration_mps2)) <= 0.5 + 1e-6
    assert motion.arc_length_m[-1] == ride.line.stops_m[-1]
