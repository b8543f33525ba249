"""kaspar2023: derivatives, filterpy's dense algebra as authority, exact sensors, the errata."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter

from tramstream import attitude
from tramstream.clock import S
from tramstream.config import Gnss, Imu, Vehicle, Wheels
from tramstream.errors import ConfigError
from tramstream.estimation.localiser import Estimate
from tramstream.geodesy import LocalLevel, normal_gravity_mps2
from tramstream.live import snapshots
from tramstream.processors.kaspar2023 import model
from tramstream.processors.kaspar2023.events import HEADING_LOST, WHEELS_JUMPED
from tramstream.processors.kaspar2023.filter import Kaspar2023Filter
from tramstream.processors.kaspar2023.localiser import Kaspar2023Localiser
from tramstream.processors.kaspar2023.model import COLUMNS, ROWS, SIZE, STEP_S, Ix
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry, WheelReading
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame

DIFFERENCE = 1e-5
"""Step of central differences, in each slot's own unit."""
DERIVATIVE = 1e-7
"""What they are good for, relative to the largest entry."""
RELATIVE = 1e-9
"""Two orders of summation over some hundred terms."""
LEVER = np.array([2.0, -0.7, 3.1])
RNG = np.random.default_rng(2023)
START_NS = 1_700_000_000 * S
MM = 1e-3
LEVEL = LocalLevel.at_deg(50.08, 14.42, 250.0)
GRAVITY_MPS2 = float(normal_gravity_mps2(LEVEL.latitude_rad, LEVEL.height_m))


def random_state(seed: int) -> np.ndarray:
    """A vehicle on the way, tilted, with every constant away from 0; shape (25, 1)."""
    rng = np.random.default_rng(seed)
    x = rng.normal(0.0, 0.1, (SIZE, 1))
    x[[Ix.EAST, Ix.NORTH, Ix.UP], 0] = rng.normal(0.0, 1e3, 3)
    x[Ix.SPEED], x[Ix.ACCELERATION] = rng.uniform(0.0, 15.0), rng.normal()
    x[Ix.YAW] = rng.uniform(-math.pi, math.pi)
    return x


def random_covariance(seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(0.0, 1.0, (SIZE, SIZE))
    return root @ root.T / SIZE + 0.01 * np.eye(SIZE)


def differences(function: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    columns = []
    for slot in range(SIZE):
        step = np.zeros((SIZE, 1))
        step[slot] = DIFFERENCE
        columns.append((function(x + step) - function(x - step)) / (2.0 * DIFFERENCE))
    return np.hstack(columns)


def moved(x: np.ndarray, dt_s: float) -> np.ndarray:
    x = x.copy()
    model.move(x, dt_s)
    return x


MEASUREMENTS: dict[str, tuple[Any, Any, tuple[Any, ...], int]] = {
    "antenna": (model.antenna, model.antenna_jacobian, (LEVER, 0.007), 3),
    "inertial": (model.inertial, model.inertial_jacobian, (GRAVITY_MPS2,), 4),
    "wheels": (model.wheels, model.wheels_jacobian, (21.7, 0.7175), 2),
    "one wheel": (model.one_wheel, model.one_wheel_jacobian, (21.7,), 1),
}


# Equations ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("dt_s", [STEP_S, 0.3])
def test_transition_is_the_derivative_of_the_motion(seed: int, dt_s: float) -> None:
    x = random_state(seed)
    values = np.empty(len(ROWS))
    model.transition(x, dt_s, values)
    F = np.eye(SIZE)
    np.add.at(F, (ROWS, COLUMNS), values)
    expected = differences(lambda at: moved(at, dt_s), x)
    np.testing.assert_allclose(F, expected, atol=DERIVATIVE * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", MEASUREMENTS)
def test_jacobian_is_the_derivative_of_the_measurement(name: str, seed: int) -> None:
    function, jacobian, arguments, rows = MEASUREMENTS[name]
    x = random_state(seed)
    expected = differences(lambda at: function(at, *arguments), x)
    H = jacobian(x, *arguments)
    assert H.shape == (rows, SIZE)
    np.testing.assert_allclose(H, expected, atol=DERIVATIVE * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(5))
def test_erratum_337_euler_rates_are_not_the_rotation_of_the_rates(seed: int) -> None:
    x = random_state(seed)
    x[[Ix.ROLL, Ix.PITCH], 0] = [0.2, -0.3]
    roll, pitch, yaw = x[[Ix.ROLL, Ix.PITCH, Ix.YAW], 0]
    omega = tuple(x[[Ix.RATE_X, Ix.RATE_Y, Ix.RATE_Z], 0])
    _, pitch_rate, yaw_rate = attitude.euler_rates(roll, pitch, omega)
    after = moved(x, STEP_S)
    assert after[Ix.PITCH, 0] - pitch == pytest.approx(STEP_S * pitch_rate, rel=RELATIVE)
    assert after[Ix.YAW, 0] - yaw == pytest.approx(STEP_S * yaw_rate, rel=RELATIVE)
    assert after[Ix.ROLL, 0] == roll  # does not move in the work


def test_erratum_326_right_wheel_has_its_own_constant() -> None:
    x = np.zeros((SIZE, 1))
    x[Ix.SPEED], x[Ix.RATE_Z] = 8.0, 0.1
    x[Ix.WHEEL_LEFT], x[Ix.WHEEL_RIGHT] = -0.8, -1.1
    left, right = model.wheels(x, 21.0, 0.7)[:, 0]
    assert left == pytest.approx((8.0 - 0.07) * (21.0 - 0.8))
    assert right == pytest.approx((8.0 + 0.07) * (21.0 - 1.1))


def test_erratum_410_each_gyroscope_has_its_own_errors() -> None:
    x = np.zeros((SIZE, 1))
    x[[Ix.RATE_X, Ix.RATE_Y, Ix.RATE_Z], 0] = [0.1, 0.2, 0.3]
    x[[Ix.GYRO_SCALE_X, Ix.GYRO_SCALE_Y, Ix.GYRO_SCALE_Z], 0] = [0.01, 0.02, 0.03]
    x[[Ix.GYRO_INSTABILITY_X, Ix.GYRO_INSTABILITY_Y, Ix.GYRO_INSTABILITY_Z], 0] = [1.0, 2.0, 3.0]
    x[[Ix.GYRO_WALK_X, Ix.GYRO_WALK_Y, Ix.GYRO_WALK_Z], 0] = [10.0, 20.0, 30.0]
    readings = model.inertial(x, GRAVITY_MPS2)[1:, 0]
    np.testing.assert_allclose(readings, [11.0 + 0.101, 22.0 + 0.204, 33.0 + 0.309])


def test_uphill_vehicle_that_stands_feels_gravity_push_forwards() -> None:
    x = np.zeros((SIZE, 1))
    x[Ix.PITCH] = -0.05  # nose up
    assert model.inertial(x, 9.81)[0, 0] == pytest.approx(9.81 * math.sin(0.05))


def test_process_noise_is_that_of_theory_section_3() -> None:
    T = 0.01
    Q = model.process_noise(9e-7, 7.563e-5)
    np.testing.assert_array_equal(Q, np.diag(np.diag(Q)))
    assert Q[Ix.SPEED, Ix.SPEED] == pytest.approx((0.5 * 4.0 * T**2 / 2.0) ** 2)
    assert Q[Ix.YAW, Ix.YAW] == pytest.approx((0.21 * T / 2.0) ** 2)
    published = (4.0 * T**3 / 6.0 + 4.2 * math.sin(0.21 * T)) / 2.0  # (4.16) without its factor T
    assert Q[Ix.EAST, Ix.EAST] == pytest.approx(published**2)
    assert Q[Ix.ROLL, Ix.ROLL] == 0.0
    assert Q[Ix.GYRO_WALK_Z, Ix.GYRO_WALK_Z] == pytest.approx(7.563e-5**2 * T)


# The filter is filterpy's -------------------------------------------------------------------------
class Dense(ExtendedKalmanFilter):  # type: ignore[misc]
    """filterpy as it is, with the motion of the model."""

    def predict_x(self, u: Any = 0) -> None:
        self.x = moved(self.x, STEP_S)


def pair(seed: int) -> tuple[Kaspar2023Filter, Dense]:
    ours = Kaspar2023Filter(model.process_noise(1e-4, 1e-4))
    theirs = Dense(dim_x=SIZE, dim_z=4)
    theirs.Q = ours.Q
    for kalman in (ours, theirs):
        kalman.x, kalman.P = random_state(seed), random_covariance(seed)
    return ours, theirs


def assert_same(ours: Kaspar2023Filter, theirs: Dense, names: tuple[str, ...]) -> None:
    for name in names:
        mine, reference = getattr(ours, name), getattr(theirs, name)
        assert np.shape(mine) == np.shape(reference), name
        scale = np.abs(reference).max()
        np.testing.assert_allclose(
            mine, reference, rtol=RELATIVE, atol=RELATIVE * scale, err_msg=name
        )


@pytest.mark.parametrize("seed", range(8))
def test_predict_equals_filterpys_dense_result(seed: int) -> None:
    ours, theirs = pair(seed)
    theirs.F = differences(lambda at: moved(at, STEP_S), ours.x)
    ours.predict()
    assert_same(ours, theirs := _with_exact_transition(theirs, ours.F), ("F",))
    theirs.predict()
    assert_same(ours, theirs, ("x", "P", "x_prior", "P_prior"))
    np.testing.assert_array_equal(ours.P, ours.P.T)


def _with_exact_transition(theirs: Dense, F: np.ndarray) -> Dense:
    """Differences have shown that F is right; the algebra is compared with it to more digits."""
    np.testing.assert_allclose(F, theirs.F, atol=1e-6)
    theirs.F = F.copy()
    return theirs


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("name", MEASUREMENTS)
def test_update_equals_filterpys_dense_result(name: str, seed: int) -> None:
    function, jacobian, arguments, rows = MEASUREMENTS[name]
    ours, theirs = pair(seed)
    rng = np.random.default_rng(seed)
    z = function(ours.x, *arguments) + rng.normal(0.0, 1.0, (rows, 1))
    R = np.diag(rng.uniform(1e-4, 1.0, rows))
    for kalman in (ours, theirs):
        kalman.update(z, jacobian, function, R, arguments, arguments)
    names = ("x", "P", "y", "S", "SI", "K", "z", "x_post", "P_post", "log_likelihood")
    assert_same(ours, theirs, (*names, "likelihood", "mahalanobis"))
    np.testing.assert_array_equal(ours.P, ours.P.T)
    innovation, variance = ours.taken.T
    assert np.sum(innovation**2 / variance) == pytest.approx(theirs.mahalanobis**2)
    assert np.prod(variance) == pytest.approx(np.linalg.det(theirs.S))


def test_rare_calls_go_to_filterpy() -> None:
    function, jacobian, arguments, rows = MEASUREMENTS["wheels"]
    R = np.array([[0.3, 0.1], [0.1, 0.3]])
    ours, theirs = pair(1)
    z = function(ours.x, *arguments) + 0.1
    for kalman in (ours, theirs):
        kalman.update(z, jacobian, function, R, arguments, arguments)
        kalman.update(z, jacobian, function, 0.5 * np.eye(rows), arguments, arguments, np.subtract)
        kalman.update(None, jacobian, function)
    assert_same(ours, theirs, ("x", "P", "x_post", "P_post"))


def test_predict_and_update_leave_what_they_were_given() -> None:
    ours, _ = pair(3)
    x, P = ours.x, ours.P
    kept = x.copy(), P.copy()
    function, jacobian, arguments, rows = MEASUREMENTS["antenna"]
    ours.predict()
    ours.update(np.zeros((rows, 1)), jacobian, function, np.eye(rows), arguments, arguments)
    np.testing.assert_array_equal(x, kept[0])
    np.testing.assert_array_equal(P, kept[1])


def test_measurement_that_is_no_number_changes_nothing() -> None:
    ours, _ = pair(4)
    x, P = ours.x.copy(), ours.P.copy()
    function, jacobian, arguments, _ = MEASUREMENTS["one wheel"]
    ours.update(np.array([[math.nan]]), jacobian, function, np.eye(1), arguments, arguments)
    np.testing.assert_array_equal(ours.x, x)
    np.testing.assert_array_equal(ours.P, P)


# The localiser on exact sensors -------------------------------------------------------------------
GYRO_BIAS = np.array([0.002, -0.003, 0.004])
ACCEL_BIAS_MPS2 = 0.05
RADIUS_RATIO = (1.04, 1.05)
"""Left and right wheel against the nominal radius."""
DWELL_S, RISE_S = 5.0, 20.0
SPEED_MPS = 8.0


def vehicle(**wheels: float) -> Vehicle:
    return Vehicle(
        vehicle="test",
        imu=Imu(device="none", mounting_deg=(0.0, 0.0, 90.0)),
        gnss=Gnss(device="none", lever_arm_m=(1.0, 0.2, 3.0)),
        wheels=Wheels(**wheels),
    )


class Drive:
    """Stand, speed up smoothly, go on along a circle (a straight for curvature 0), planar."""

    def __init__(self, curvature_per_m: float, yaw_rad: float = 0.7) -> None:
        self.curvature_per_m, self.yaw_rad = curvature_per_m, yaw_rad

    def way(self, t: float) -> tuple[float, float, float]:
        """Way, speed, acceleration."""
        u = min(max((t - DWELL_S) / RISE_S, 0.0), 1.0)
        way = SPEED_MPS * RISE_S * (u**3 - u**4 / 2.0)
        way += SPEED_MPS * max(t - DWELL_S - RISE_S, 0.0)
        rate = SPEED_MPS * (6.0 * u - 6.0 * u**2) / RISE_S if 0.0 < u < 1.0 else 0.0
        return way, SPEED_MPS * (3.0 * u**2 - 2.0 * u**3), rate

    def truth(self, t: float) -> tuple[np.ndarray, float, float, float]:
        """Position, yaw, speed, yaw rate."""
        way, speed, _ = self.way(t)
        turned = way * self.curvature_per_m
        chord = way * np.sinc(turned / 2.0 / math.pi)
        heading = self.yaw_rad + turned / 2.0
        p_l = np.array([chord * math.cos(heading), chord * math.sin(heading), 0.0])
        return p_l, self.yaw_rad + turned, speed, speed * self.curvature_per_m

    def mean(self, t: float, stamp_ns: int) -> ImuMean:
        _, _, _, rate = self.truth(t)
        _, speed, acceleration = self.way(t)
        f_v = np.array([acceleration + ACCEL_BIAS_MPS2, speed * rate, GRAVITY_MPS2])
        omega_v = np.array([0.0, 0.0, rate]) + GYRO_BIAS
        fields = [*(C_BV @ omega_v), *(C_BV @ f_v)]
        names = [f"{kind}_{axis}" for kind in ("gyro", "accel") for axis in "xyz"]
        units = ["radps"] * 3 + ["mps2"] * 3
        values = {f"{n}_{u}": v for n, u, v in zip(names, units, fields, strict=True)}
        return ImuMean(stamp_ns=stamp_ns, sample_count=20, interval_s=STEP_S, **values)

    def fix(self, t: float, stamp_ns: int) -> GnssFix:
        p_l, yaw, _, _ = self.truth(t)
        p_l = p_l + attitude.C_vl(0.0, 0.0, yaw).T @ np.array([1.0, 0.2, 3.0])
        latitude, longitude, height = LEVEL.to_geodetic(p_l)
        return GnssFix(
            stamp_ns=stamp_ns,
            valid=True,
            latitude_deg=math.degrees(latitude),
            longitude_deg=math.degrees(longitude),
            height_ellipsoid_m=height,
            horizontal_std_m=0.5 * math.sqrt(2.0),
            vertical_std_m=1.0,
        )

    def wheels(self, t: float, stamp_ns: int, names: tuple[str, ...]) -> Odometry:
        way, *_ = self.way(t)
        lever = {"left": -0.7175, "right": 0.7175}
        readings = []
        for name in names:
            ratio = RADIUS_RATIO[name == "right"]
            path = way * (1.0 + lever.get(name, 0.0) * self.curvature_per_m)
            pulses = math.floor(path / ratio / 0.00092038845)
            readings.append(WheelReading(wheel=name, pulses=pulses))
        return Odometry(stamp_ns=stamp_ns, wheels=readings)

    def frames(
        self, duration_s: float, names: tuple[str, ...] = ("left", "right")
    ) -> Iterator[SyncFrame]:
        for step in range(1, round(duration_s / STEP_S) + 1):
            t, stamp_ns = step * STEP_S, START_NS + step * 10_000_000
            frame = SyncFrame(stamp_ns=stamp_ns, imu=self.mean(t, stamp_ns))
            if step % 2 == 0 and names:
                frame.odometry.append(self.wheels(t, stamp_ns, names))
            if step % 100 == 0:  # the fix is 3 ms older than the frame
                frame.gnss.append(self.fix(t - 0.003, stamp_ns - 3_000_000))
            yield frame


C_BV = attitude.C_vl(0.0, 0.0, math.pi / 2.0)


def run(localiser: Kaspar2023Localiser, frames: Iterator[SyncFrame]) -> list[Estimate]:
    found = [localiser.take(frame) for frame in frames]
    return [estimate for estimate in found if estimate is not None]


def error_of(drive: Drive, localiser: Kaspar2023Localiser, estimate: Estimate) -> np.ndarray:
    """Position, yaw and speed against the truth."""
    p_l, yaw, speed, _ = drive.truth((estimate.stamp_ns - START_NS) / S)
    assert localiser.level is not None
    origin_l = LEVEL.from_geodetic(localiser.level.to_geodetic(np.zeros(3)))
    turn = math.remainder(estimate.yaw_rad - yaw, math.tau)
    return np.array([*(estimate.p_l - (p_l - origin_l)), turn, estimate.speed_mps - speed])


@pytest.mark.parametrize("curvature_per_m", [0.0, 1.0 / 60.0, -1.0 / 25.0])
def test_exact_sensors_lead_to_the_truth(curvature_per_m: float) -> None:
    drive, localiser = Drive(curvature_per_m), Kaspar2023Localiser(vehicle())
    last = run(localiser, drive.frames(120.0))[-1]
    assert last.mode == MotionState.TRACKING
    east, north, up, yaw, speed = error_of(drive, localiser, last)
    assert math.hypot(east, north) < 50 * MM
    assert abs(up) < 200 * MM
    assert abs(yaw) < math.radians(0.3)
    assert abs(speed) < 20 * MM
    learned = {each.name: each for each in localiser.learned()}
    assert learned["gyro_bias_z"].value == pytest.approx(GYRO_BIAS[2], abs=3e-4)
    k = 0.02 / 0.00092038845
    assert learned["wheel_left"].value == pytest.approx(k / 1.04 - k, abs=0.05)
    assert learned["wheel_right"].value == pytest.approx(k / 1.05 - k, abs=0.05)


def test_single_wheel_is_taken_without_the_turning_term() -> None:
    drive, localiser = Drive(1.0 / 60.0), Kaspar2023Localiser(vehicle())
    estimates = run(localiser, drive.frames(120.0, ("middle",)))
    names = {verdict.measurement for each in estimates for verdict in each.verdicts}
    assert "wheel" in names
    assert not names & {"wheel_left", "wheel_right"}
    east, north, _, yaw, speed = error_of(drive, localiser, estimates[-1])
    assert math.hypot(east, north) < 100 * MM
    assert abs(yaw) < math.radians(0.5)
    assert abs(speed) < 30 * MM


def test_heading_is_unknown_until_the_fixes_have_moved() -> None:
    drive, localiser = Drive(-1.0 / 25.0), Kaspar2023Localiser(vehicle())
    estimates = run(localiser, drive.frames(40.0))
    modes = [estimate.mode for estimate in estimates]
    first = modes.index(MotionState.TRACKING)
    assert set(modes[:first]) == {MotionState.HEADING_UNKNOWN}
    assert set(modes[first:]) == {MotionState.TRACKING}
    way, *_ = drive.way((estimates[first].stamp_ns - START_NS) / S)
    assert 5.0 <= way < 5.0 + SPEED_MPS
    assert abs(error_of(drive, localiser, estimates[first])[3]) < math.radians(3.0)
    assert estimates[first - 1].covariance[6, 6] > 3.0
    standing = estimates[300]
    assert standing.standing
    assert np.abs(error_of(drive, localiser, standing)[:2]).max() < 1.1  # lever arm not resolved


def test_silent_receiver_makes_it_dead_reckoning() -> None:
    drive, localiser = Drive(0.0), Kaspar2023Localiser(vehicle())
    frames = list(drive.frames(90.0))
    for frame in frames[6000:]:
        del frame.gnss[:]
    last = run(localiser, iter(frames))[-1]
    assert last.mode == MotionState.DEAD_RECKONING
    east, north, *_ = error_of(drive, localiser, last)
    assert math.hypot(east, north) < 3.0
    assert last.covariance[0, 0] > 0.01


def test_gap_in_inertial_data_loses_the_heading_and_keeps_what_was_learned() -> None:
    drive, localiser = Drive(1.0 / 60.0), Kaspar2023Localiser(vehicle())
    frames = list(drive.frames(150.0))
    before = run(localiser, iter(frames[:8000]))[-1]
    assert before.mode == MotionState.TRACKING
    bias = localiser.learned()
    estimate = localiser.take(frames[8300])
    assert estimate is not None
    assert estimate.mode == MotionState.HEADING_UNKNOWN
    (event,) = localiser.complaints()
    assert event.kind is HEADING_LOST
    assert event.facts["silence_s"] == pytest.approx(3.0, abs=0.1)
    assert localiser.complaints() == []
    assert [each.name for each in localiser.learned()] == [each.name for each in bias]
    last = run(localiser, iter(frames[8301:]))[-1]
    assert last.mode == MotionState.TRACKING
    assert math.hypot(*error_of(drive, localiser, last)[:2]) < 0.3


def test_wheels_that_jump_are_told_and_not_used() -> None:
    drive, localiser = Drive(0.0), Kaspar2023Localiser(vehicle())
    frames = list(drive.frames(60.0))
    for frame in frames[5000:]:
        for wheel in (wheel for odometry in frame.odometry for wheel in odometry.wheels):
            wheel.pulses -= 20_000
    last = run(localiser, iter(frames))[-1]
    (event,) = localiser.complaints()
    assert event.kind is WHEELS_JUMPED
    assert event.facts["pulses"] == pytest.approx(-20_000, abs=500)
    assert abs(error_of(drive, localiser, last)[4]) < 30 * MM


def test_nothing_is_known_before_the_first_fix_or_without_inertial_data() -> None:
    drive, localiser = Drive(0.0), Kaspar2023Localiser(vehicle())
    assert run(localiser, drive.frames(0.9)) == []
    assert localiser.level is None
    localiser.see(next(drive.frames(0.01)).imu)
    assert localiser.ahead() is None
    first = next(frame for frame in drive.frames(1.0) if frame.gnss)
    first.gnss[0].valid = False
    assert localiser.take(first) is None
    bare = SyncFrame(stamp_ns=first.stamp_ns, gnss=first.gnss)
    assert localiser.take(bare) is None


def test_vehicle_without_imu_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"\$\.imu"):
        Kaspar2023Localiser(Vehicle(vehicle="test"))


def test_ahead_predicts_to_the_newest_mean_and_leaves_the_filter() -> None:
    drive, localiser = Drive(1.0 / 60.0), Kaspar2023Localiser(vehicle())
    frames = list(drive.frames(61.0))
    for late, frame in zip(frames[:6000], frames[30:6030], strict=True):
        localiser.take(late)
        before = localiser.snapshot()
        localiser.see(frame.imu)
        ahead = localiser.ahead()
        after = localiser.snapshot()
        assert before["x"].tobytes() == after["x"].tobytes()
        assert before["P"].tobytes() == after["P"].tobytes()
    assert ahead is not None
    assert ahead.stamp_ns == frames[6029].stamp_ns
    assert math.hypot(*error_of(drive, localiser, ahead)[:2]) < 100 * MM
    now = localiser.take(frames[6000])
    assert now is not None
    np.testing.assert_array_less(np.diag(now.covariance)[:3], np.diag(ahead.covariance)[:3])


def test_restored_localiser_goes_on_to_the_bit() -> None:
    drive = Drive(-1.0 / 25.0)
    frames = list(drive.frames(30.0))
    for cut in (50, 700, 1200, 2500):
        whole, restored = Kaspar2023Localiser(vehicle()), Kaspar2023Localiser(vehicle())
        run(whole, iter(frames[:cut]))
        restored.restore(snapshots.unpack(snapshots.pack(whole.snapshot())))
        whole_after = run(whole, iter(frames[cut:]))
        restored_after = run(restored, iter(frames[cut:]))
        assert len(whole_after) == len(restored_after)
        for one, other in zip(whole_after, restored_after, strict=True):
            assert one.p_l == other.p_l
            assert one.verdicts == other.verdicts
            assert one.covariance.tobytes() == other.covariance.tobytes()
        assert snapshots.pack(whole.snapshot()) == snapshots.pack(restored.snapshot())
