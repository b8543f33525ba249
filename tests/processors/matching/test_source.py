"""What the map matcher follows: states and fixes of anybody, put into a frame near the vehicle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from networks import LEVEL

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Map, Vehicle
from tramstream.errors import ConfigError
from tramstream.estimation.localiser import HEADING_UNKNOWN, TRACKING
from tramstream.geodesy import convergence_rad
from tramstream.memory.stage import from_plain, to_plain
from tramstream.processors.matching.processor import MapMatcher
from tramstream.processors.matching.source import (
    FixesMemory,
    Ground,
    ReceiverFixes,
    States,
    StatesMemory,
)
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.gnss_pb2 import GnssFix

UM = 1e-6
START = LEVEL.to_geodetic((3000.0, -2000.0, 10.0))


def deg(geodetic: np.ndarray) -> tuple[float, float, float]:
    latitude, longitude, height = geodetic.tolist()
    return math.degrees(latitude), math.degrees(longitude), height


def test_ground_is_the_exact_level_frame_to_a_micrometre() -> None:
    ground = Ground()
    assert list(ground.put(*deg(START))) == [0.0, 0.0, 0.0, 0.0]
    level = ground.level
    assert level is not None
    for moved in ((30.0, -40.0, 2.0), (-49.0, 49.0, -5.0), (0.0, 49.0, 0.0)):
        geodetic = level.to_geodetic(moved)
        *found, lean = ground.put(*deg(geodetic))
        assert ground.level is level
        np.testing.assert_allclose(found, moved, atol=UM)
        exact = float(convergence_rad(level, geodetic[1]))
        assert lean == pytest.approx(exact, abs=1e-10)


def test_ground_is_laid_anew_where_the_vehicle_is_far_from_it() -> None:
    ground = Ground()
    ground.put(*deg(START))
    before = ground.level
    assert before is not None
    assert list(ground.put(*deg(before.to_geodetic((51.0, 0.0, 0.0))))) == [0.0] * 4
    assert ground.level is not before


def state(stamp_s: float, **fields: object) -> MotionState:
    latitude, longitude, height = deg(START)
    return MotionState(
        stamp_ns=round(stamp_s * S),
        mode=TRACKING,
        latitude_deg=latitude,
        longitude_deg=longitude,
        height_ellipsoid_m=height,
        **{"speed_mps": 5.0, "along_std_m": 2.0, "across_std_m": 1.0, **fields},
    )


def test_state_without_a_covariance_has_that_of_its_deviations() -> None:
    estimate = States().take(state(1.0, yaw_rad=math.pi / 2.0, yaw_std_rad=0.1))
    assert estimate is not None
    np.testing.assert_allclose(np.diag(estimate.covariance)[[0, 1, 6]], [1.0, 4.0, 0.01], atol=1e-9)


def test_covariance_of_a_state_is_taken_as_it_is() -> None:
    full = np.arange(49.0).reshape(7, 7)
    full = full + full.T
    estimate = States().take(state(1.0, covariance=full[np.triu_indices(7)].tolist()))
    assert estimate is not None
    np.testing.assert_array_equal(estimate.covariance, full)


def test_state_that_is_no_number_is_left_out() -> None:
    assert States().take(state(1.0, speed_mps=math.nan)) is None
    nowhere = state(1.0)
    nowhere.latitude_deg = math.inf
    assert States().take(nowhere) is None


def test_filter_is_held_to_the_track_as_long_as_its_states_show_it() -> None:
    states = States()
    states.take(state(1.0))
    assert not states.held
    taking = state(1.1)
    taking.innovations.add(measurement="track_across", value=0.1, variance=1.0, accepted=True)
    states.take(taking)
    assert states.held
    other = States(from_plain(StatesMemory, to_plain(states.memory)))
    for k in range(1, 25):  # 0.5 m each
        states.take(state(1.1 + 0.1 * k))
        assert states.held == (0.5 * k < 10.0)
    assert other.held
    refused = state(5.0)
    refused.innovations.add(measurement="track_across", value=9.0, variance=1.0, accepted=False)
    states.take(refused)
    assert not states.held


def fix(stamp_s: float, north_mps: float, east_mps: float = 0.0, **fields: object) -> GnssFix:
    latitude, longitude, height = deg(START)
    return GnssFix(
        stamp_ns=round(stamp_s * S),
        valid=True,
        latitude_deg=latitude,
        longitude_deg=longitude,
        height_ellipsoid_m=height,
        horizontal_std_m=math.sqrt(2.0),
        vel_n_mps=north_mps,
        vel_e_mps=east_mps,
        speed_std_mps=0.1,
        **fields,
    )


def test_course_of_a_moving_fix_is_the_heading_and_is_kept_for_a_while() -> None:
    fixes = ReceiverFixes()
    first = fixes.take(fix(1.0, 0.2))
    assert first is not None
    assert (first.mode, first.standing) == (HEADING_UNKNOWN, True)
    moving = fixes.take(fix(2.0, 5.0))
    assert moving is not None
    assert (moving.mode, moving.standing) == (TRACKING, False)
    assert moving.yaw_rad == pytest.approx(math.pi / 2.0)
    assert moving.speed_mps == pytest.approx(5.0)
    assert moving.covariance[0, 0] == pytest.approx(1.0)
    other = ReceiverFixes(from_plain(FixesMemory, to_plain(fixes.memory)))
    for each in (fixes, other):
        stopped = each.take(fix(4.0, 0.0))
        assert stopped is not None
        assert stopped.mode == TRACKING
        later = each.take(fix(8.0, 0.0))
        assert later is not None
        assert later.mode == HEADING_UNKNOWN
    invalid = fix(9.0, 5.0)
    invalid.valid = False
    assert fixes.take(invalid) is None


@pytest.mark.parametrize(
    ("source", "type_"),
    [
        (keys.EST_STATE.path, MotionState),
        (keys.GNSS_FIX.path, GnssFix),
        ("est/theirs/state", MotionState),
    ],
)
def test_source_is_what_the_settings_name(source: str, type_: type) -> None:
    matcher = MapMatcher(Vehicle(vehicle="t1", map=Map(network="none", source=source)))
    (key,) = matcher.inputs
    assert (key.path, key.type) == (source, type_)


def test_source_that_is_no_place_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"\$\.map\.source: raw/imu/batch carries tramstream\."):
        MapMatcher(Vehicle(vehicle="t1", map=Map(network="none", source=keys.IMU_BATCH.path)))


def said(stamp_s: float, *names: str) -> MotionState:
    """A state with innovations of measurements."""
    message = state(stamp_s)
    for name in names:
        message.innovations.add(measurement=name, variance=1.0, accepted=True)
    return message


def test_localiser_that_takes_fixes_alone_is_known_by_its_states_and_no_other() -> None:
    source = States()
    assert not source.alone
    for second in range(4):
        source.take(said(second, "gnss_east", "gnss_north"))
    assert not source.alone, "a filter may wait for its wheels a moment"
    source.take(said(6.0, "gnss_east", "track_across"))
    assert source.alone
    source.take(said(6.1, "wheel_a"))
    assert not source.alone
    for second in range(7, 60):
        source.take(said(second, "zero_angular_rate_x"))
    assert not source.alone, "in an outage as well"


def test_what_is_known_of_a_localiser_is_remembered() -> None:
    source, again = States(), States()
    source.take(said(1.0, "gnss_east"))
    source.take(said(7.0, "gnss_east"))
    restored = from_plain(StatesMemory, to_plain(source.memory))
    again = States(restored)
    assert again.alone
    assert ReceiverFixes().alone
