"""Keys of a record as columns: every number at its place, whatever order it came in."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from record_samples import START_NS, VEHICLE

from tramstream import keys
from tramstream.clock import S
from tramstream.estimation.series import GradeSeries, Slot
from tramstream.geodesy import LocalLevel
from tramstream.proto.estimate_pb2 import GradeState, Innovation, MotionState
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import TruthState
from tramstream.recorder.columns import RideSeries, read_ride
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import open_record

LEVEL = LocalLevel.at_deg(50.0, 14.0, 250.0)
MM = 1e-3


def state(stamp_ns: int, **fields) -> MotionState:
    place = {"latitude_deg": 50.0, "longitude_deg": 14.0, "height_ellipsoid_m": 250.0}
    return MotionState(stamp_ns=stamp_ns, **{**place, **fields})


def read(path: Path, messages: list, **wanted) -> RideSeries:
    with RecordFile(path, VEHICLE) as record:
        for number, (key, message) in enumerate(messages):
            log_ns = START_NS + number
            payload = message.SerializeToString()
            record.append(key.on(VEHICLE), key, payload, log_ns, log_ns, number)
    with open_record(path) as record:
        return read_ride(record, **wanted)


def read_states(path: Path, *messages: MotionState):
    ride = read(path, [(keys.EST_STATE, each) for each in messages], states=[keys.EST_STATE.path])
    return ride.states[keys.EST_STATE.path]


def test_every_field_of_a_state_is_in_its_column(tmp_path):
    message = state(
        START_NS,
        mode=MotionState.DEAD_RECKONING,
        latitude_deg=50.001,
        speed_mps=-3.0,
        acceleration_mps2=0.4,
        roll_rad=0.01,
        pitch_rad=-0.02,
        yaw_rad=3.0 + 2 * np.pi,
        yaw_rate_radps=0.05,
        standing=True,
        protection_along_m=4.0,
        covariance=range(1, 29),
        innovations=[Innovation(measurement="gnss", value=0.5, variance=2.0, accepted=True)],
    )
    series = read_states(tmp_path / "a.mcap", state(START_NS - 1), message).take(np.array([1]))
    assert series.stamp_ns[0] == START_NS
    np.testing.assert_allclose(series.geodetic[0], [np.radians(50.001), np.radians(14.0), 250.0])
    np.testing.assert_allclose(series.p_l[0], LEVEL.from_geodetic(series.geodetic[0]), atol=1e-9)
    np.testing.assert_allclose(series.attitude_rad[0], [0.01, -0.02, 3.0])
    assert series.speed_mps[0] == -3.0
    assert series.acceleration_mps2[0] == 0.4
    assert series.yaw_rate_radps[0] == 0.05
    assert series.mode[0] == MotionState.DEAD_RECKONING
    assert series.standing[0]
    np.testing.assert_array_equal(series.protection_m[0], [4.0, np.nan])
    covariance = series.covariance[0]
    np.testing.assert_array_equal(covariance, covariance.T)
    np.testing.assert_array_equal(covariance[Slot.EAST], range(1, 8))
    np.testing.assert_array_equal(covariance[Slot.NORTH, 1:], range(8, 14))
    assert covariance[Slot.YAW, Slot.YAW] == 28
    found = series.innovations
    assert found.names == ("gnss",)
    assert (found.stamp_ns[0], found.value[0], found.variance[0]) == (START_NS, 0.5, 2.0)
    assert found.accepted[0]


def test_rows_are_in_order_of_stamps_and_of_equal_ones_the_last_stays(tmp_path):
    stamps = [3, 1, 2, 1]
    messages = [state(START_NS + n, speed_mps=k) for k, n in enumerate(stamps)]
    series = read_states(tmp_path / "a.mcap", *messages)
    np.testing.assert_array_equal(series.stamp_ns - START_NS, [1, 2, 3])
    np.testing.assert_array_equal(series.speed_mps, [3.0, 2.0, 0.0])


def test_covariance_that_is_absent_is_nan(tmp_path):
    series = read_states(
        tmp_path / "a.mcap", state(START_NS), state(START_NS + 1, covariance=[1.0] * 28)
    )
    assert np.isnan(series.covariance[0]).all()
    np.testing.assert_array_equal(series.covariance[1], np.ones((7, 7)))


def test_innovations_know_their_state_and_name(tmp_path):
    messages = [state(START_NS + n) for n in range(3)]
    for name, n in (("wheel", 2), ("gnss", 0), ("wheel", 0)):
        messages[n].innovations.add(measurement=name, value=n, variance=1.0)
    found = read_states(tmp_path / "a.mcap", *messages).innovations
    assert [found.names[k] for k in found.which] == ["gnss", "wheel", "wheel"]
    np.testing.assert_array_equal(found.stamp_ns - START_NS, [0, 0, 2])


def test_slopes_of_truth_and_estimator_are_columns(tmp_path):
    said = GradeState(
        stamp_ns=START_NS,
        grade_rad=-0.02,
        grade_std_rad=0.001,
        body_pitch_rad=0.004,
        body_pitch_std_rad=0.002,
        inputs=["accelerometer"],
    )
    place = {"latitude_deg": 50.0, "longitude_deg": 14.0}
    messages = [
        (keys.EST_GRADE, said),
        (keys.TRUTH_STATE, TruthState(stamp_ns=START_NS, **place, pitch_rad=0.03, grade_rad=-0.02)),
        (keys.TRUTH_STATE, TruthState(stamp_ns=START_NS + S, **place, pitch_rad=0.03)),
    ]
    path = tmp_path / "a.mcap"
    ride = read(path, messages, truth=keys.TRUTH_STATE.path, grade=keys.EST_GRADE.path)
    assert [getattr(ride.grade, each.name)[0] for each in fields(GradeSeries)] == [
        *(START_NS, -0.02, 0.001),
        *(0.004, 0.002),
    ]
    np.testing.assert_array_equal(ride.truth.grade_rad, [-0.02, np.nan])
    np.testing.assert_allclose(ride.truth.body_pitch_rad, [0.01, np.nan])


def test_truth_that_does_not_know_says_nan_and_zero_is_zero(tmp_path):
    messages = [
        (keys.TRUTH_STATE, TruthState(stamp_ns=START_NS, latitude_deg=50.0, speed_mps=0.0)),
        (keys.TRUTH_STATE, TruthState(stamp_ns=START_NS + S, yaw_rad=4.0, position_std_m=0.1)),
    ]
    found = read(tmp_path / "a.mcap", messages, truth=keys.TRUTH_STATE.path).truth
    np.testing.assert_array_equal(found.speed_mps, [0.0, np.nan])
    np.testing.assert_allclose(found.yaw_rad, [np.nan, 4.0 - 2 * np.pi])
    np.testing.assert_array_equal(found.position_std_m, [np.nan, 0.1])
    np.testing.assert_allclose(found.p_l[0], 0.0, atol=MM)


def test_fix_is_valid_only_with_a_position_and_its_course_becomes_a_yaw(tmp_path):
    messages = [
        (keys.GNSS_FIX, GnssFix(stamp_ns=START_NS + k, speed_mps=1.0, course_deg=course, **flags))
        for k, (course, flags) in enumerate(
            [(0.0, {"valid": True}), (90.0, {}), (200.0, {"valid": True, "invalid_llh": True})]
        )
    ]
    found = read(tmp_path / "a.mcap", messages, fixes=True).fixes
    np.testing.assert_array_equal(found.valid, [True, False, False])
    np.testing.assert_allclose(np.degrees(found.course_yaw_rad), [90.0, 0.0, -110.0])


def test_fix_without_a_height_is_at_its_place_in_the_plane(tmp_path):
    fixes = [
        GnssFix(stamp_ns=START_NS + n, latitude_deg=50.0 + 1e-4 * n, longitude_deg=14.0, valid=True)
        for n in range(3)
    ]
    told = read(tmp_path / "a.mcap", [(keys.GNSS_FIX, each) for each in fixes], fixes=True).fixes
    assert np.isfinite(told.p_l).all()
    for each in fixes:
        each.height_ellipsoid_m = 250.0
    known = read(
        tmp_path / "b.mcap", [(keys.GNSS_FIX, each) for each in fixes], fixes=True, level=LEVEL
    ).fixes
    np.testing.assert_allclose(told.p_l[:, :2], known.p_l[:, :2], atol=2 * MM)


def test_only_what_is_asked_for_is_read_and_the_level_is_kept(tmp_path):
    messages = [
        (keys.EST_STATE, state(START_NS)),
        (keys.EST_SMOOTHED, state(START_NS)),
        (keys.TRUTH_STATE, TruthState(stamp_ns=START_NS, latitude_deg=50.0, longitude_deg=14.0)),
    ]
    paths = [keys.EST_SMOOTHED.path, keys.EST_NOW.path]
    ride = read(tmp_path / "a.mcap", messages, states=paths, level=LEVEL)
    assert list(ride.states) == [keys.EST_SMOOTHED.path]
    assert ride.truth is None
    assert ride.fixes is None
    assert ride.level is LEVEL


def test_record_without_any_of_it_gives_nothing(tmp_path):
    with RecordFile(tmp_path / "a.mcap", VEHICLE):
        pass
    with open_record(tmp_path / "a.mcap") as record:
        assert read_ride(record) == RideSeries(None, {}, None, None)
        assert read_ride(record, level=LEVEL, fixes=True).fixes is None


@pytest.mark.parametrize("wanted", [{"states": [keys.EST_STATE.path]}, {}])
def test_level_lies_at_the_first_state_without_truth(tmp_path, wanted):
    message = state(START_NS, latitude_deg=49.0)
    ride = read(tmp_path / "a.mcap", [(keys.EST_STATE, message)], **wanted)
    if wanted:
        assert ride.level == LocalLevel.at_deg(49.0, 14.0, 250.0)
    else:
        assert ride.level is None
