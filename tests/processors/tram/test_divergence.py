"""Who is wrong, the measurement or the filter: what several sources say alike is believed."""

from __future__ import annotations

import numpy as np
import pytest
from rides import Errors, judged, laid, reference, ridden, time_s
from seeds import seeds
from test_liveness import AT_S, PROTECTION_SIGMA, first_s, gone, undisturbed, worst_sigma
from test_tram_faults import DRIVER, PLAN, altered

from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram_filter import events
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_sources.divergence import Divergence, Offset, _prolonged
from tramstream.proto.sync_pb2 import SyncFrame
from tramstream.simulation.scenario import Slip

SURE = 0.01
"""Deviation that a filter claims that was led astray."""
MISLED_S = 31.0
"""On the straight after the first curve."""


def misled(state: Ix, by: float, velocity: bool) -> tuple[Errors, list[float]]:
    """Errors of a ride in whose middle a state is off and sure of itself; when that was found."""
    ride = undisturbed(velocity)
    localiser = TramLocaliser(ride.simulation.vehicle)
    kept, found, done = [], [], False
    for number, frame in enumerate(ride.frames):
        estimate = localiser.take(frame)
        now_s = time_s(frame.stamp_ns)
        if not done and now_s > MISLED_S:
            navigation = localiser._navigation
            assert navigation is not None
            navigation.ekf.reset(state, navigation.ekf.state[state] + by, SURE)
            done = True
        found += [now_s for each in localiser.complaints() if each.kind is events.FILTER_WRONG]
        if estimate is not None and number % 5 == 0:
            kept.append(estimate)
    return judged(ride.simulation, localiser, kept), found


@pytest.mark.parametrize(("velocity", "within_s"), [(True, 3.0), (False, 8.0)])
@pytest.mark.parametrize("by", [0.7, -2.0])
def test_heading_that_is_wrong_is_found_and_taken_from_the_fixes(
    by: float, velocity: bool, within_s: float
) -> None:
    errors, found = misled(Ix.YAW, by, velocity)
    assert MISLED_S < found[0] < MISLED_S + within_s
    later = errors.within(MISLED_S + within_s + 2.0, 75.0)
    assert np.abs(later.yaw_rad).max() < 0.1
    assert later.horizontal_m.max() < 4.0


@pytest.mark.parametrize("by", [4.0, -4.0])
def test_speed_that_is_wrong_is_found_by_wheels_and_fixes_together(by: float) -> None:
    errors, found = misled(Ix.SPEED, by, velocity=True)
    assert MISLED_S < found[0] < MISLED_S + 2.5
    later = errors.within(MISLED_S + 4.5, 75.0)
    assert np.abs(later.speed_mps).max() < 0.3
    assert later.horizontal_m.max() < 3.0


@pytest.mark.parametrize("velocity", [True, False])
def test_gyroscope_whose_bias_runs_away_does_not_take_the_vehicle_with_it(velocity: bool) -> None:
    def fault(frames: list[SyncFrame]) -> None:
        for number, frame in enumerate(frames):
            frame.imu.gyro_z_radps += 5e-5 * number  # 0.005 rad/s a second

    errors, _ = gone(undisturbed(velocity), fault, AT_S, 40.0)
    assert errors.within(AT_S, 75.0).horizontal_m.max() < 6.0


def test_imu_that_contradicts_all_others_is_left_out() -> None:
    """Its axes are turned by a quarter: no setting of the filter's own takes that up."""

    def fault(frames: list[SyncFrame]) -> None:
        for frame in frames:
            imu = frame.imu
            imu.gyro_x_radps, imu.gyro_z_radps = -imu.gyro_z_radps, imu.gyro_x_radps
            imu.accel_x_mps2, imu.accel_y_mps2 = -imu.accel_y_mps2, imu.accel_x_mps2

    errors, said = gone(undisturbed(), fault, AT_S, 60.0)
    print(f"{errors.within(AT_S, 75.0).horizontal_m.max():.1f} m")
    assert first_s(said, events.FILTER_WRONG) < 60.0
    assert errors.within(AT_S, 75.0).horizontal_m.max() < 10.0


@pytest.mark.parametrize("seed", seeds(1, of=3))
@pytest.mark.parametrize("velocity", [True, False])
def test_filter_that_is_right_is_never_found_wrong(seed: int, velocity: bool) -> None:
    """Not even where both wheels slip for long: fixes and forces speak for it."""
    slip = Slip(start_s=20.0, duration_s=6.0, factor=1.3)
    gnss = {"velocity": velocity}
    chosen = altered(reference(), driver=DRIVER, gnss=gnss, events=(slip,))
    _, said = gone(ridden(laid(PLAN), chosen, seed), lambda _: None)
    assert first_s(said, events.FILTER_WRONG) == np.inf
    assert first_s(said, events.IMU_STUCK) == np.inf
    assert first_s(said, events.WHEEL_DEAD) == np.inf
    assert first_s(said, events.FIXES_FROZEN) == np.inf


# Fixes that jump ----------------------------------------------------------------------------------
@pytest.mark.parametrize("velocity", [True, False])
def test_spoofed_jump_of_200_m_is_not_followed_and_said(velocity: bool) -> None:
    chosen = altered(reference(), driver=DRIVER, gnss={"velocity": velocity})
    ride = ridden(laid(PLAN + " | 300 | 300 | 300 |"), chosen, 2, 200.0)
    start_s, lasts_s = 100.0, 60.0

    def fault(frames: list[SyncFrame]) -> None:
        for frame in frames:
            for fix in frame.gnss:
                fix.latitude_deg += 200.0 / 111_200.0

    errors, said = gone(ride, fault, start_s, lasts_s)
    assert first_s(said, events.FIXES_JUMPED) < start_s + 5.0
    back_s = first_s(said, events.FIXES_BACK)
    assert start_s + lasts_s < back_s < start_s + lasts_s + 3.0
    assert errors.within(start_s, start_s + lasts_s).horizontal_m.max() < 10.0
    assert worst_sigma(errors.within(start_s, 200.0)) < PROTECTION_SIGMA


# The parts ----------------------------------------------------------------------------------------
def test_refusals_with_a_pause_between_them_are_two() -> None:
    S = 1_000_000_000
    assert _prolonged((S, 2 * S), 2 * S + S // 10, 0.3) == (S, 2 * S + S // 10)
    assert _prolonged((S, 2 * S), 3 * S, 0.3) == (3 * S, 3 * S)


def heard(divergence: Divergence, navigation: Navigation, off_m: list[float]) -> Offset | None:
    """What fixes show of a filter that stands at one place, five of them a second."""
    for number, each in enumerate(off_m):
        divergence.before_fix(navigation.ekf, 200_000_000 * (number + 1), each, 0.0)
        divergence.memory.antenna_m = divergence._antenna(navigation.ekf)
    return divergence._way_offset(0.3)


def test_way_between_fixes_shows_a_velocity_and_no_jump() -> None:
    ride = undisturbed()
    localiser = TramLocaliser(ride.simulation.vehicle)
    for frame in ride.frames[:300]:
        localiser.take(frame)
    navigation = localiser._navigation
    assert navigation is not None
    even = heard(Divergence(ride.simulation.vehicle, 20.0), navigation, [2.0 * k for k in range(8)])
    assert even is not None
    assert even.east_mps == pytest.approx(10.0)
    assert even.north_mps == pytest.approx(0.0)
    jump = [0.0] * 4 + [40.0] * 4
    assert heard(Divergence(ride.simulation.vehicle, 20.0), navigation, jump) is None
