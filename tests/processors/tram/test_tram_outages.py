"""The filter `tram` while sensors fall silent, and when time does not run as it should.

Whatever is missing: a sentence says so, the covariance stays one, and when the sensor is back, so
is the vehicle. Sensors and driver are those of `test_tram_faults`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pytest
from rides import EVERY, Array, Errors, Ride, judged, laid, ridden, time_s
from seeds import seeds
from test_tram_faults import city
from test_tram_start import PLACE_M, YAW_RAD, copies, plain

from tramstream.clock import S
from tramstream.estimation.localiser import DEAD_RECKONING, HEADING_UNKNOWN, TRACKING
from tramstream.events import Kind
from tramstream.processors.tram.localiser import BACK_S, BLIND_S, TramLocaliser
from tramstream.processors.tram_filter.events import (
    HEADING_LOST,
    NO_FIX,
    NO_IMU,
    NO_WHEELS,
    SET_BACK,
    TIME_BACKWARDS,
)
from tramstream.proto.sync_pb2 import SyncFrame
from tramstream.simulation.scenario import Tunnel

SEEDS = seeds(1, of=4)
FEW = seeds(1, of=2)
"""Where a ride is long, or where the seed hardly matters."""
CURVE_S = 24.0
STRAIGHT_S = 41.0
"""Instants of `plain`: within the first curve, on the straight after it."""
ROUNDING = 1e-9
"""Of a correlation: some ten thousand updates in double precision."""


@dataclass(frozen=True)
class Watched:
    """What a filter estimated, and what it said when, s of the ride."""

    errors: Errors
    said: list[tuple[float, Kind]]

    def after(self, start_s: float) -> set[Kind]:
        return {kind for time, kind in self.said if time > start_s}

    def times(self, kind: Kind) -> list[float]:
        return [time for time, each in self.said if each is kind]


def assert_covariance(P: Array) -> None:
    """It is symmetric and positive, but for what rounding takes."""
    assert np.isfinite(P).all()
    variances = np.diag(P)
    assert variances.min() >= 0.0
    unit = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    correlation = P / unit[:, None] / unit
    assert np.abs(correlation - correlation.T).max() < ROUNDING
    assert np.linalg.eigvalsh(correlation).min() > -ROUNDING


def watch(ride: Ride, frames: Iterable[SyncFrame]) -> Watched:
    """Run the filter, and look at its covariance twice a second."""
    localiser = TramLocaliser(ride.simulation.vehicle)
    kept, said = [], []
    for number, frame in enumerate(frames):
        estimate = localiser.take(frame)
        said += [(time_s(frame.stamp_ns), each.kind) for each in localiser.complaints()]
        if estimate is not None and number % EVERY == 0:
            kept.append(estimate)
        if estimate is not None and number % 50 == 0:
            assert_covariance(estimate.covariance)
            assert localiser._navigation is not None
            assert_covariance(localiser._navigation.ekf.P)
    return Watched(judged(ride.simulation, localiser, kept), said)


def without(ride: Ride, start_s: float, end_s: float, *fields: str) -> list[SyncFrame]:
    """Frames from which something is missing for a while."""
    changed = copies(ride.frames)
    for frame in changed:
        if start_s < time_s(frame.stamp_ns) <= end_s:
            for field in fields:
                frame.ClearField(field)
    return changed


def pausing(ride: Ride, start_s: float, end_s: float) -> list[SyncFrame]:
    """A while without any frame: the IMU's silence is the horizon's."""
    return [*ride.between(-1.0, start_s), *ride.between(end_s, math.inf)]


def assert_back(errors: Errors, from_s: float) -> None:
    later = errors.within(from_s, math.inf)
    assert (later.mode == TRACKING).all()
    assert later.horizontal_m.max() < PLACE_M
    assert np.abs(later.yaw_rad).max() < YAW_RAD


# One sensor ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("start_s", [CURVE_S, STRAIGHT_S, 65.0, 75.5])
def test_wheels_carry_it_through_3_s_without_imu(start_s: float) -> None:
    ride = plain(1)  # in a curve, on a straight, at a stop, at a departure
    watched = watch(ride, without(ride, start_s, start_s + 3.0, "imu"))
    assert watched.times(NO_IMU)
    assert_back(watched.errors, CURVE_S)


@pytest.mark.parametrize("start_s", [CURVE_S, 34.0])
@pytest.mark.parametrize("seed", SEEDS)
def test_3_s_without_anything_are_bridged(seed: int, start_s: float) -> None:
    ride = plain(seed)
    watched = watch(ride, pausing(ride, start_s, start_s + 3.0))
    assert_back(watched.errors, start_s + 5.0)
    claimed = watched.errors.within(start_s + 3.0, start_s + 5.0)
    normal = claimed.horizontal_m**2 / np.trace(claimed.covariance[:, :2, :2], axis1=1, axis2=2)
    assert normal.max() < 3.5**2


@pytest.mark.parametrize(("start_s", "end_s"), [(30.0, 50.0), (50.0, 70.0), (70.0, 85.0)])
@pytest.mark.parametrize("seed", FEW)
def test_imu_carries_it_while_the_wheels_are_silent(
    seed: int, start_s: float, end_s: float
) -> None:
    ride = plain(seed)  # on the way, over an arrival, over a departure
    watched = watch(ride, without(ride, start_s, end_s, "odometry"))
    first = watched.times(NO_WHEELS)[0]
    assert start_s + 5.0 < first < start_s + 6.5
    assert NO_WHEELS not in watched.after(end_s + 0.1)
    assert_back(watched.errors, 25.0)
    silent = watched.errors.within(start_s, end_s)
    assert np.abs(silent.speed_mps).max() < 0.5


@pytest.mark.parametrize("seed", FEW)
def test_5_min_without_fixes_are_dead_reckoning_and_recovered(seed: int) -> None:
    start_s, end_s = 100.0, 400.0
    tunnel = Tunnel(start_s=start_s, duration_s=end_s - start_s)
    line = laid("| 100 L60/70 150 | 200 R80/60 300 | 400 L90/60 300 R70/80 200 | 300 L60/90 900 |")
    ride = ridden(line, city(events=(tunnel,)), seed, 430.0)
    watched = watch(ride, ride.frames)
    errors = watched.errors
    assert (errors.within(start_s + 7.0, end_s).mode == DEAD_RECKONING).all()
    said = watched.times(NO_FIX)
    assert start_s + 59.0 < said[0] < start_s + 62.0
    assert 9.0 < np.diff(said).min() < 12.0  # again and again, not all the time
    blind = errors.within(start_s, end_s)
    claimed = np.sqrt(np.trace(blind.covariance[:, :2, :2], axis1=1, axis2=2))
    assert (blind.horizontal_m < 3.5 * claimed).all()
    assert claimed[-1] > 3.0 * claimed[0]
    assert_back(errors, end_s + 10.0)
    assert NO_FIX not in watched.after(end_s + 10.0)


# Everything ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("frames_go_on", [False, True])
@pytest.mark.parametrize("start_s", [CURVE_S, 34.0])
@pytest.mark.parametrize("seed", FEW)
def test_long_silence_while_moving_lets_the_heading_be_sought_anew(
    seed: int, start_s: float, frames_go_on: bool
) -> None:
    ride, end_s = plain(seed), start_s + 2.0 * BLIND_S
    silent = without(ride, start_s, end_s, "imu", "odometry")
    watched = watch(ride, silent if frames_go_on else pausing(ride, start_s, end_s))
    assert len(watched.times(HEADING_LOST)) == 1
    assert_back(watched.errors, end_s + 5.0)
    waking = watched.errors.within(end_s + 0.1, end_s + 1.5)
    assert (waking.mode == HEADING_UNKNOWN).all()


@pytest.mark.parametrize(("start_s", "end_s"), [(55.0, 70.0), (70.0, 85.0)])
def test_long_silence_over_an_arrival_or_a_departure(start_s: float, end_s: float) -> None:
    ride = plain(1)
    watched = watch(ride, pausing(ride, start_s, end_s))
    errors = watched.errors
    assert watched.times(HEADING_LOST)
    # Whoever woke at the stop stands until the departure, and needs some metres then.
    assert_back(errors, max(end_s, ride.departure_s(2)) + 8.0)
    claimed = np.sqrt(np.trace(errors.covariance[:, :2, :2], axis1=1, axis2=2))
    assert (errors.horizontal_m < 3.5 * claimed).all()


def test_nothing_but_fixes_from_the_beginning() -> None:
    ride = plain(1)
    watched = watch(ride, without(ride, -1.0, 40.0, "imu", "odometry"))
    assert {NO_IMU, NO_WHEELS} <= {each for _, each in watched.said}
    assert_back(watched.errors, 50.0)


# Time ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("back_s", [0.0, 0.02, 1.0, 3600.0])
def test_one_frame_whose_time_ran_backwards_is_left_out(back_s: float) -> None:
    ride = plain(1)
    frames = ride.between(-1.0, 60.0)
    wrong = SyncFrame.FromString(frames[4000].SerializeToString())
    wrong.stamp_ns -= round(back_s * S)
    watched = watch(ride, [*frames[:4001], wrong, *frames[4001:]])
    assert [kind for _, kind in watched.said] == [TIME_BACKWARDS]
    assert_back(watched.errors, 35.0)


def test_left_out_frame_changes_nothing() -> None:
    ride = plain(1)
    frames = ride.between(-1.0, 60.0)
    one, other = (TramLocaliser(ride.simulation.vehicle) for _ in range(2))
    for number, frame in enumerate(frames):
        a = one.take(frame)
        if number == 4000:
            assert one.take(frames[3900]) is None
        b = other.take(frame)
    assert a is not None
    assert b is not None
    assert a.motion.tobytes() == b.motion.tobytes()
    assert a.covariance.tobytes() == b.covariance.tobytes()


@pytest.mark.parametrize("to_s", [0.0, 20.0])
def test_clock_that_was_set_back_begins_a_new_ride(to_s: float) -> None:
    ride = plain(1)
    localiser = TramLocaliser(ride.simulation.vehicle)
    for frame in ride.between(-1.0, 50.0):
        localiser.take(frame)
    kept, said = [], []
    for frame in ride.between(to_s, 60.0):
        estimate = localiser.take(frame)
        said += [each.kind for each in localiser.complaints()]
        if estimate is not None:
            kept.append(estimate)
    assert said.count(SET_BACK) == 1
    assert said.count(TIME_BACKWARDS) <= round(BACK_S * 100.0) + 1
    errors = judged(ride.simulation, localiser, kept)
    assert to_s + BACK_S - 0.1 < errors.time_s[0] < to_s + BACK_S + 2.0
    assert_back(errors, 30.0 + 0.2 * to_s)


# Whatever is missing ------------------------------------------------------------------------------
@pytest.mark.parametrize("field", ["imu", "odometry", "gnss"])
def test_sensor_that_comes_and_goes_leaves_the_covariance_whole(field: str) -> None:
    ride = plain(2)
    frames = copies(ride.frames)
    rng = np.random.default_rng(5)
    missing = False
    for frame in frames:
        if rng.uniform() < 0.01:
            missing = not missing
        if missing:
            frame.ClearField(field)
    watched = watch(ride, frames)
    assert watched.errors.within(50.0, math.inf).horizontal_m.max() < PLACE_M
