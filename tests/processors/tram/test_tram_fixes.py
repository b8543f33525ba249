"""What a fix is worth to the filter `tram`: the deviation of each axis as the receiver states it.

u-blox and GST state other things: hAcc is the deviation of the horizontal distance (√2 of an axis'
if both are alike), GST one of latitude and one of longitude.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from rides import EVERY, Ride, altered, judged, laid, localised, ridden, run
from scipy.stats import chi2
from test_tram_faults import PLAN, city

from tramstream.bridges.gnss.nmea import Epoch, fix_of
from tramstream.clock import S
from tramstream.estimation.fixes import deviations, velocity_l
from tramstream.geodesy import C_nl, LocalLevel, convergence_rad
from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.processors.tram_filter.events import RECEIVER_BOASTS
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.sync_pb2 import SyncFrame

FLOOR_M = 0.005
THREE_SIGMA = chi2.ppf(math.erf(3.0 / math.sqrt(2.0)), 2)
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
    fix = GnssFix(height_ellipsoid_m=240.0, horizontal_std_m=distance_m, vertical_std_m=up_m)
    assert deviations(fix, FLOOR_M) == pytest.approx((axis_m, up_m), rel=0.01)


def test_deviations_of_latitude_and_longitude_come_back_as_those_of_the_axes() -> None:
    epoch = Epoch(0, 0, 0, 0, quality=1, latitude_deg=50.0, longitude_deg=14.0)
    epoch.altitude_m, epoch.separation_m = 200.0, 45.0
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


# Velocities have the axes of their place ----------------------------------------------------------
FAR_M = 50_000.0
"""East of the frame's origin, where the meridians have turned by 0.0094 rad."""


def test_velocity_is_turned_into_the_level_frame() -> None:
    """Truth: a velocity in `l`, turned into the axes of a place by geodesy."""
    level = LocalLevel.at_deg(50.08, 14.42, 250.0)
    geodetic = level.to_geodetic([FAR_M, -3000.0, 40.0])
    in_l = np.array([11.0, 5.0, 0.0])
    east, north, up = C_nl(level, geodetic) @ in_l
    latitude_deg, longitude_deg = np.degrees(geodetic[:2])
    fix = GnssFix(
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        vel_e_mps=east,
        vel_n_mps=north,
        vel_d_mps=-up,
    )
    found = velocity_l(fix, level)
    assert found == pytest.approx(in_l[:2], abs=1e-3)
    assert abs(east - in_l[0]) > 0.01  # what is at stake


def test_speed_and_course_are_a_velocity_where_both_are_told() -> None:
    """A receiver that speaks NMEA gives no components."""
    level = LocalLevel.at_deg(50.08, 14.42, 250.0)
    place = {"latitude_deg": 50.08, "longitude_deg": 14.42}
    told = GnssFix(**place, speed_mps=10.0, course_deg=120.0)
    east, north = 10.0 * math.sin(math.radians(120.0)), 10.0 * math.cos(math.radians(120.0))
    assert velocity_l(told, level) == pytest.approx((east, north))
    assert velocity_l(GnssFix(**place, speed_mps=0.0, course_deg=0.0), level) is None
    nowhere = GnssFix(**place, speed_mps=0.3, course_deg=0.0, course_std_deg=180.0)
    assert velocity_l(nowhere, level) is None
    half = GnssFix(**place, vel_e_mps=3.0, speed_mps=10.0, course_deg=120.0)
    assert velocity_l(half, level) is None


def test_heading_does_not_depend_on_where_the_frame_was_laid() -> None:
    """Truth: the same ride in a frame laid in its middle; the other frame lies far to the west."""
    ride = ridden(laid(PLAN), city(gnss={"velocity": True}), 3, 150.0)
    first = next(frame for frame in ride.frames if frame.gnss)
    away = ride.simulation.line.level.to_geodetic([-FAR_M, 0.0, 0.0])
    elsewhere = SyncFrame()
    elsewhere.CopyFrom(first)
    for fix in elsewhere.gnss:
        fix.latitude_deg, fix.longitude_deg = np.degrees(away[:2])
        fix.height_ellipsoid_m = away[2]
    far = [elsewhere if frame is first else frame for frame in ride.frames]
    vehicle = ride.simulation.vehicle
    yaws = [yaw_of_place(TramLocaliser(vehicle), frames) for frames in (ride.frames, far)]
    assert abs(np.mean(yaws[1] - yaws[0])) < 0.003  # the meridians have turned by 0.0094


def yaw_of_place(localiser: TramLocaliser, frames: list[SyncFrame]) -> NDArray[np.float64]:
    """Yaw against east of the place in the last 10 s."""
    late = [each for each in run(localiser, frames) if each.stamp_ns > frames[-1].stamp_ns - 10 * S]
    level = localiser.level
    assert level is not None
    longitude = level.to_geodetic(np.array([each.p_l for each in late]))[:, 1]
    yaw: NDArray[np.float64] = np.array([each.motion[6] for each in late])
    return yaw - convergence_rad(level, longitude)


# Fixes by time, not by number ---------------------------------------------------------------------
def claimed_m(ride: Ride, start_s: float, end_s: float) -> float:
    """Mean deviation of the place that the filter claims, along and across together."""
    covariance = localised(ride).within(start_s, end_s).covariance
    return float(np.mean(np.sqrt(np.trace(covariance[:, :2, :2], axis1=1, axis2=2))))


def test_more_fixes_of_the_same_error_make_the_filter_no_surer() -> None:
    """Five times as many, whose errors last as long."""
    base = city(gnss={"rate_hz": 5.0, "velocity": True})
    few = ridden(laid(PLAN), base, 1, 60.0)
    many = ridden(laid(PLAN), altered(base, gnss={"rate_hz": 25.0}), 1, 60.0)
    assert claimed_m(many, 40.0, 60.0) > 0.95 * claimed_m(few, 40.0, 60.0)


def test_standing_for_long_averages_nothing() -> None:
    """The surroundings stand still too: what is wrong after ten seconds is after five minutes."""
    ride = ridden(laid(PLAN), altered(city(), driver={"first_dwell_s": 320.0}), 1, 315.0)
    assert claimed_m(ride, 300.0, 310.0) > 0.95 * claimed_m(ride, 5.0, 10.0)


def test_height_of_a_first_fix_that_was_far_away_does_not_stay() -> None:
    """50 km to the west the ground lies 196 m below the tangent plane: the height was wrong too."""
    ride = ridden(laid(PLAN), city(), 2, 60.0)
    first = next(frame for frame in ride.frames if frame.gnss)
    wrong = SyncFrame()
    wrong.CopyFrom(first)
    away = ride.simulation.line.level.to_geodetic([-FAR_M, 0.0, 0.0])
    for fix in wrong.gnss:
        fix.latitude_deg, fix.longitude_deg = np.degrees(away[:2])
        fix.height_ellipsoid_m = away[2]
    frames = [wrong if frame is first else frame for frame in ride.frames]
    errors = localised(ride, frames).within(40.0, 60.0)
    assert errors.horizontal_m.max() < 5.0
    assert np.abs(errors.p_l[:, 2]).max() < 8.0


def test_fixes_without_a_height_say_nothing_of_it_and_place_the_vehicle_as_well() -> None:
    """A receiver that tells only the height above the sea, 45 m off; every fix is such."""
    ride = ridden(laid(PLAN), city(), 2, 60.0)
    frames = []
    for each in ride.frames:
        frame = SyncFrame()
        frame.CopyFrom(each)
        for fix in frame.gnss:
            fix.height_msl_m = fix.height_ellipsoid_m - 45.0
            fix.ClearField("height_ellipsoid_m")
        frames.append(frame)
    told, untold = (localised(ride, each).within(40.0, 60.0) for each in (ride.frames, frames))
    assert untold.horizontal_m.max() < told.horizontal_m.max() + 0.5
    assert np.sqrt(untold.covariance[:, 2, 2]).min() > 100.0


def test_receiver_that_boasts_tenfold_is_said_and_weighed() -> None:
    """Errors of 0.5 m on an axis, stated as 0.05 m: within 3 σ for 97 % of the time."""
    gnss = {"stated_horizontal_std_m": 0.05, "stated_vertical_std_m": 0.1, "rate_hz": 5.0}
    ride = ridden(laid(PLAN), city(gnss=gnss), 4, 110.0)
    localiser, kept, said = TramLocaliser(ride.simulation.vehicle), [], []
    for frame in ride.frames:
        estimate = localiser.take(frame)
        found = [each.kind for each in localiser.complaints()]
        said += [frame.stamp_ns] * found.count(RECEIVER_BOASTS)
        if estimate is not None:
            kept.append(estimate)
    assert len(said) == 1
    assert (said[0] - ride.frames[0].stamp_ns) / S < 60.0
    errors = judged(ride.simulation, localiser, kept[::EVERY]).within(60.0, 110.0)
    claimed = errors.covariance[:, :2, :2]
    distance = np.linalg.solve(claimed, errors.p_l[:, :2, None])[:, :, 0]
    normal = np.sum(distance * errors.p_l[:, :2], axis=1)
    assert np.mean(normal < THREE_SIGMA) >= 0.97
