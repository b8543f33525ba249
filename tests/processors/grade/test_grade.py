"""The slope on rides whose truth is known: springs, mass, and one input after the other missing."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from slopes import FRAME_S, Found, Slopes

from tramstream.errors import ConfigError
from tramstream.processors.grade.processor import GradeEstimator

HALF_DEG = math.degrees(0.0025)
"""The rides' springs told half as soft as they are."""
TOLD = {"pitch_deg_per_mps2": HALF_DEG, "pitch_std_deg_per_mps2": HALF_DEG}


@cache
def plain() -> Found:
    """All that there is, and springs told half as soft as they are."""
    return Found(Slopes(settings=TOLD))


def test_slope_is_found_with_the_springs_unknown_by_half() -> None:
    found = plain()
    assert found.rms_percent(since_s=60.0) < 0.05
    assert found.learned("pitch_per_mps2")[0] == pytest.approx(0.005, rel=0.05)
    assert found.learned("pitch_per_mps2")[1] < 0.0003
    assert found.nees() < 2.0


def test_springs_that_are_none_are_found_to_be_none() -> None:
    found = Found(Slopes(nod=0.0))
    value, std = found.learned("pitch_per_mps2")
    assert abs(value) < 2e-4
    assert std < 3e-4
    assert not [kind for kind in found.events() if "suspension" in kind]


def test_body_pitch_is_that_of_the_springs_nose_down_when_braking() -> None:
    found = plain()
    speed, change, place = found.ride.motion()
    rows = np.rint(found.time_s / FRAME_S).astype(int) - 1
    force = found.ride.followed(change + 9.81 * found.ride.slope_rad(place))[rows]
    said = np.array([each.body_pitch_rad for each in found.states])
    settled = found.time_s > 60.0
    assert np.abs(said + 0.005 * force)[settled].max() < 3e-4
    braking = settled & (change[rows] < -0.5)
    assert said[braking].min() > 0.0
    assert speed[rows][braking].min() > 0.0
    assert place[-1] > 500.0


def test_vehicle_that_stands_keeps_its_slope_and_its_certainty() -> None:
    found = Found(Slopes(settings=TOLD, dwell_s=60.0, duration_s=160.0))
    stand = (found.time_s > 101.0) & (found.speed == 0.0)
    said = np.array([each.grade_rad for each in found.states])[stand]
    assert len(said) > 50.0 / FRAME_S
    assert np.ptp(said) < 3e-4
    std = found.std[stand]
    assert std.max() < 1.2 * std[0]
    assert np.isfinite(found.std).all()


def test_slope_keeps_its_sign_along_x_when_the_vehicle_runs_backwards() -> None:
    found = Found(Slopes(direction=-1.0, settings=TOLD))
    assert found.place[-1] < -500.0
    assert found.rms_percent() < 0.06
    assert found.last.mass_kg == pytest.approx(40_000.0, rel=0.02)


@pytest.mark.parametrize("told", [0.7, 1.3])
def test_mass_told_wrong_by_a_third_is_found_within_2_percent(told: float) -> None:
    """By two departures and two brakings."""
    settings = {**TOLD, "mass_kg": told * 40_000.0, "mass_std_kg": 0.3 * 40_000.0}
    found = Found(Slopes(settings=settings))
    assert found.last.mass_kg == pytest.approx(40_000.0, rel=0.02)
    assert found.last.mass_std_kg < 0.03 * 40_000.0
    assert abs(found.last.mass_kg - 40_000.0) < 3.0 * found.last.mass_std_kg


def test_mass_is_told_by_the_first_departure_and_not_by_standing_or_coasting() -> None:
    found = plain()
    std = np.array([each.mass_std_kg for each in found.states])
    standing = std[found.time_s < 14.0]
    assert not standing.any(), "nothing is said of a mass before the motor has pushed"
    assert std[np.searchsorted(found.time_s, 28.0)] < 0.04 * 40_000.0


def test_without_the_force_nothing_is_said_of_the_mass_and_the_slope_is_found() -> None:
    found = Found(Slopes(forced=False, settings=TOLD))
    assert not any(each.HasField("mass_kg") for each in found.states)
    assert found.rms_percent() < 0.06
    assert "motor_force" not in found.last.inputs


def test_without_heights_the_localisers_pitch_and_its_deviation_are_what_there_is() -> None:
    found = Found(Slopes(heights=False, settings=TOLD))
    assert found.rms_percent() < 0.06
    assert {name for each in found.states for name in each.inputs} == {
        "accelerometer",
        "odometry",
        "motor_force",
    }


def test_pitch_that_is_off_by_2_percent_is_found_by_the_heights_and_said() -> None:
    """As by a mounting that is off by a degree, of which the localiser is too sure."""
    found = Found(Slopes(pitch_error_rad=0.02, settings=TOLD, duration_s=400.0))
    assert found.rms_percent(since_s=200.0) < 0.3
    assert found.nees(since_s=200.0) < 3.0
    assert "grade.pitch_contradicts" in found.events()


def test_without_a_localiser_fixes_wheels_and_force_tell_the_slope_and_how_well() -> None:
    found = Found(Slopes(localised=False))
    assert found.rms_percent() < 1.5
    assert 0.05 < found.nees() < 2.0
    assert "accelerometer" not in found.last.inputs
    assert {"odometry", "gnss_velocity", "gnss_height"} <= set(found.last.inputs)


def test_without_a_localiser_and_without_fixes_the_force_alone_is_no_slope() -> None:
    """The mass is not known, so the force says nothing for certain: the deviation says that."""
    found = Found(Slopes(localised=False, fixes=False))
    assert found.nees() < 3.0
    assert found.std[-1] > 0.003


def test_nothing_is_said_while_nobody_says_a_speed() -> None:
    found = Found(Slopes(localised=False, fixes=False, wheels=False, duration_s=20.0))
    assert not found.states


def test_localiser_that_is_lost_and_comes_back_is_said_both_times() -> None:
    ride = Slopes(localised_until_s=70.0, localised_from_s=100.0, settings=TOLD)
    found = Found(ride)
    away = (found.time_s > 75.0) & (found.time_s < 99.0)
    assert found.std[away].max() > 3.0 * found.std[found.time_s < 69.0][-1]
    assert found.rms_percent(since_s=110.0) < 0.1
    assert found.nees(since_s=60.0) < 2.0
    assert found.events().count("grade.input_lost") == 1
    assert found.events().count("grade.input_back") == 1
    rows = {each.stamp_ns: list(each.inputs) for each in found.states}
    inputs = list(rows.values())
    assert "accelerometer" not in inputs[int(85.0 / FRAME_S)]


def test_height_that_jumps_by_40_m_is_refused_and_then_another_datum() -> None:
    found = Found(Slopes(height_jump_m=40.0, settings=TOLD))
    assert found.rms_percent(since_s=60.0) < 0.08
    verdicts = [v for each in found.states for v in each.innovations]
    heights = [v.accepted for v in verdicts if v.measurement == "gnss_height"]
    assert 10 < heights.count(False) < 30
    assert all(heights[-100:])


def test_spike_of_one_fix_changes_nothing() -> None:
    ride = Slopes(settings=TOLD)
    processor = GradeEstimator(ride.vehicle)
    said = []
    for sample in ride.samples():
        if sample.sequence == 5001 and hasattr(sample.message, "gnss"):
            sample.message.gnss[0].height_ellipsoid_m += 500.0
        said += processor.step(sample)
    last = [each.message for each in said if each.key.path == "est/grade/state"][-1]
    assert last.grade_rad == pytest.approx(plain().last.grade_rad, abs=1e-4)


def test_pivot_behind_the_origin_is_no_lag_of_the_slope() -> None:
    """The body's axis is the slope midway between its bogies; what is said is under the origin."""
    found = Found(Slopes(pivot_m=3.2, settings=TOLD))
    assert found.rms_percent() < 0.07
    moving = (np.abs(found.speed) > 5.0) & (found.time_s > 60.0)
    slope = found.ride.slope_rad(found.place - 3.2)
    lagging = np.sqrt(np.mean((slope - found.slope)[moving] ** 2))
    assert 100.0 * lagging > 0.08, "what it would be without"


def test_springs_that_are_far_from_what_is_told_are_said() -> None:
    settings = {"pitch_deg_per_mps2": 0.05, "pitch_std_deg_per_mps2": 0.02}
    assert "grade.suspension_contradicts" in Found(Slopes(settings=settings)).events()


def test_match_of_the_instant_is_named_with_its_chainage() -> None:
    ride = Slopes(matched=True, duration_s=40.0)
    found = Found(ride)
    chainage = np.array([each.chainage_m for each in found.states])
    assert np.abs(chainage - np.abs(found.place)).max() < 1e-6
    assert {each.edge for each in found.states} == {"a-b"}
    assert {each.run for each in plain().states} == {-1}


def test_distance_to_stop_is_that_from_the_current_speed() -> None:
    found = plain()
    moving = [each for each in found.stops if each.speed_mps > 11.9]
    assert len(moving) > 20
    for each in moving:
        service, full = each.stops
        assert (service.deceleration_mps2, full.deceleration_mps2) == (1.0, 1.55)
        assert service.level_m == pytest.approx(each.speed_mps**2 / 2.0)
        assert full.distance_m < service.distance_m < 130.0
        assert service.distance_std_m > full.distance_std_m > 0.0
        if abs(each.grade_ahead_rad) > 0.003:
            assert (service.distance_m < service.level_m) == (each.grade_ahead_rad > 0.0)
    standing = [each for each in found.stops if each.speed_mps == 0.0]
    assert {stop.distance_m for each in standing for stop in each.stops} == {0.0}


def test_source_that_carries_no_state_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match=r"\$\.grade\.source.*est/ekf/state"):
        GradeEstimator(Slopes(settings={"source": "raw/gnss/fix"}).vehicle)
