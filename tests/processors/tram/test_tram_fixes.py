"""What a fix is worth to the filter `tram`: the deviation of each axis as the receiver states it.

u-blox and GST state other things: hAcc is the deviation of the horizontal distance (√2 of an axis'
if both are alike), GST one of latitude and one of longitude.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from rides import judged, laid, ridden, run
from scipy.stats import chi2
from test_tram_faults import PLAN, city

from tramstream.bridges.gnss.nmea import Epoch, fix_of
from tramstream.estimation.fixes import deviations
from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.proto.gnss_pb2 import GnssFix

FLOOR_M = 0.005
RUNS = 40
AXES_M = [(0.4, 6.0), (3.0, 0.5)]
"""Deviation of a horizontal axis and of the height: neither may pass for the other."""


@pytest.mark.parametrize(("axis_m", "up_m"), AXES_M)
def test_deviation_of_an_axis_is_that_of_the_distance_over_root_two(
    axis_m: float, up_m: float
) -> None:
    """Truth: errors drawn on two axes; the root mean square of the distance is what is stated."""
    drawn = np.random.default_rng(1).normal(0.0, axis_m, (100_000, 2))
    distance_m = math.sqrt(np.mean(np.sum(drawn**2, axis=1)))
    fix = GnssFix(horizontal_std_m=distance_m, vertical_std_m=up_m)
    assert deviations(fix, FLOOR_M) == pytest.approx((axis_m, up_m), rel=0.01)


def test_deviations_of_latitude_and_longitude_come_back_as_those_of_the_axes() -> None:
    epoch = Epoch(0, 0, 0, 0, quality=1, latitude_deg=50.0, longitude_deg=14.0, altitude_m=200.0)
    epoch.std_m = [3.0, 3.0, 5.0]
    assert deviations(fix_of(epoch, 100.0), FLOOR_M) == pytest.approx((3.0, 5.0))


@pytest.mark.parametrize(("axis_m", "up_m"), AXES_M)
def test_first_position_is_as_uncertain_on_each_axis_as_the_fix_is_wrong(
    axis_m: float, up_m: float
) -> None:
    """NEES of first estimates over many receivers in both bounds, plane and height apart."""
    errors = {"horizontal_std_m": axis_m, "vertical_std_m": up_m}
    plane = height = 0.0
    for seed in range(RUNS):
        ride = ridden(laid(PLAN), city(gnss={"errors": errors}), seed, 2.5)
        localiser = TramLocaliser(ride.simulation.vehicle)
        (first,) = run(localiser, ride.frames, every=1)[:1]
        error = judged(ride.simulation, localiser, [first]).p_l[0]
        P = first.covariance
        plane += float(error[:2] @ np.linalg.solve(P[:2, :2], error[:2]))
        height += float(error[2] ** 2 / P[2, 2])
    for found, degrees in ((plane, 2 * RUNS), (height, RUNS)):
        low, high = chi2.ppf([0.005, 0.995], degrees)
        assert low < found < high
