"""Kernels of the model `tram` against finite differences and filterpy's dense algebra."""

from __future__ import annotations

import math

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from numpy.random import Generator

from tramstream.config import Ekf, Gnss, Imu, Vehicle, Wheels
from tramstream.estimation.kalman import Array, compiled, predict_covariance, update_scalar
from tramstream.estimation.localiser import (
    COVARIANCE,
    HEADING_UNKNOWN,
    LEVEL_ERROR,
    LEVEL_STD,
    VALUES,
)
from tramstream.estimation.records import Records, numbers, one
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_model import axes, level_force, motion, update
from tramstream.processors.tram_model.gnss_position import GnssHeight, GnssPosition
from tramstream.processors.tram_model.gnss_velocity import GnssVelocity
from tramstream.processors.tram_model.lateral_force import LateralForce
from tramstream.processors.tram_model.level_force import LevelForce
from tramstream.processors.tram_model.measurement import Measurement
from tramstream.processors.tram_model.prediction_to_now import KEPT
from tramstream.processors.tram_model.records import INERTIAL, MEMORY, READING
from tramstream.processors.tram_model.slow_error import SlowError
from tramstream.processors.tram_model.states import COLUMNS, ENTRIES, PATTERN, ROWS, SIZE, Ix
from tramstream.processors.tram_model.track import TrackDistance, TrackGrade, TrackHeading
from tramstream.processors.tram_model.vertical_constraint import VerticalConstraint
from tramstream.processors.tram_model.wheel_path import WheelPath
from tramstream.processors.tram_model.wheel_speed import WheelSpeed
from tramstream.processors.tram_model.zero_angular_rate import ZeroAngularRate
from tramstream.processors.tram_model.zero_velocity import ZeroVelocity

RELATIVE = 1e-9
"""Kernels against filterpy: double precision, another order of additions."""
DT_S = 1e-4
"""Short, for A is the derivative to first order in it."""
SECOND_ORDER = 0.02
"""What is left out of A: terms with dt, and products of two small angles or biases."""
STEP = 1e-6
INFINITE = 1e30
GRAVITY = 9.81

SPREAD = np.full(SIZE, 0.01)
SPREAD[[Ix.EAST, Ix.NORTH]] = 300.0
SPREAD[[Ix.UP, Ix.SPEED]] = 10.0
SPREAD[[Ix.ROLL, Ix.PITCH]] = 0.05
SPREAD[Ix.YAW] = 3.0
SPREAD[[Ix.GNSS_EAST, Ix.GNSS_NORTH, Ix.GNSS_UP]] = 1.0
SPREAD[[Ix.MAP_EAST, Ix.MAP_NORTH]] = 1.0
SPREAD[[Ix.MOUNT_ROLL, Ix.MOUNT_PITCH, Ix.MOUNT_YAW]] = 0.002


def vehicle() -> Vehicle:
    return Vehicle(
        vehicle="test",
        gnss=Gnss(device="none", lever_arm_m=(2.0, 0.3, 3.0)),
        imu=Imu(device="none", lever_arm_m=(-1.0, 0.2, 0.4)),
        wheels=Wheels(track_m=1.435),
        ekf=Ekf(side_slip_std_m_rts=1e-2, wheel_creep_m_rtm=1e-3),
    )


def state(rng: Generator) -> Array:
    x = np.empty(SIZE)
    x[: Ix.MAP_EAST] = rng.normal(size=int(Ix.MAP_EAST)) * SPREAD[: Ix.MAP_EAST]
    x[Ix.MAP_EAST :] = 0.6, -0.8
    return x


def reading(rng: Generator) -> Array:
    """Numbers of one `Reading`."""
    u = one(READING)
    u["angular_rate"] = rng.normal(0.0, 0.2, 3)
    u["specific_force"] = rng.normal((0.0, 0.0, GRAVITY), 1.0)
    u["accelerometer"] = 1.0
    return numbers(u)


def gravity_at(x: Array) -> Array:
    """Specific force of a vehicle that stands as `x` says, m/s²."""
    roll, pitch = x[Ix.ROLL], x[Ix.PITCH]
    cos = math.cos(pitch)
    return GRAVITY * np.array([-math.sin(pitch), cos * math.sin(roll), cos * math.cos(roll)])


def covariance(rng: Generator) -> Array:
    root = rng.normal(size=(SIZE, SIZE)) * SPREAD[:, None] * 0.1
    return np.asarray(root @ root.T)


def tram_filter(x: Array, P: Array) -> TramFilter:
    ekf = TramFilter(vehicle(), GRAVITY)
    ekf.set_fix_error(0.05, 0.02, 0.05)
    ekf.set_slow_fix_error(0.002, 0.001)
    ekf.x, ekf.P = x, P
    return ekf


def constants() -> Records:
    """Parameters that are changed here and nowhere else."""
    return TramFilter(vehicle(), GRAVITY).parameters.copy()


def given(c: Records) -> tuple[Array, Array]:
    """Parameters and situation, as kernels take them."""
    ekf = tram_filter(np.zeros(SIZE), np.eye(SIZE))
    return numbers(c), numbers(ekf.situation)


def predicted(x: Array, P: Array, u: Array, dt_s: float, c: Records) -> Records:
    """Memory after a prediction."""
    f = one(MEMORY)
    f["x"], f["P"] = x, P
    motion.predict(numbers(f), *given(c), u, dt_s)
    return f


def transition(x: Array, u: Array, dt_s: float, c: Records) -> Array:
    F = np.eye(SIZE)
    F[ROWS, COLUMNS] += predicted(x, np.eye(SIZE), u, dt_s, c)["A"][0][ROWS, COLUMNS]
    return F


def moved(x: Array, u: Array, dt_s: float, c: Records) -> Array:
    return np.array(predicted(x, np.eye(SIZE), u, dt_s, c)["x"][0])


def noise(x: Array, c: Records, dt_s: float) -> Array:
    """Q, added to nothing by a prediction with nothing else to move."""
    return np.array(predicted(x, np.zeros((SIZE, SIZE)), numbers(one(READING)), dt_s, c)["P"][0])


@pytest.mark.parametrize("seed", range(5))
def test_transition_is_the_derivative_of_the_motion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, u, c = state(rng), reading(rng), constants()
    c["imu_lever"] = 0.0  # how a lever's share follows the biases is left out
    x[Ix.PIVOT] = 0.0
    u.view(READING)[0]["specific_force"] = gravity_at(x)  # as the mounting's entries have it
    F = transition(x, u, DT_S, c)
    for column in set(Ix) - {Ix.PIVOT}:
        step = np.zeros(SIZE)
        step[column] = STEP
        slope = (moved(x + step, u, DT_S, c) - moved(x - step, u, DT_S, c)) / (2 * STEP)
        scale = np.maximum(np.abs(F[:, column] - np.eye(SIZE)[column]) / DT_S, 1.0)
        wrong = np.abs(F[:, column] - slope) / DT_S > SECOND_ORDER * scale
        assert not wrong.any(), (column.name, [Ix(row).name for row in np.flatnonzero(wrong)])


def test_motion_tells_no_more_of_the_mounting_than_a_standstill() -> None:
    """Pitch, mounting and bias drive the speed by just the sum that shows when nothing moves.

    Whatever is read: else its bias would tell the pitch from the mounting.
    """
    rng = np.random.default_rng(3)
    x, u, c = state(rng), reading(rng), constants()
    h = np.zeros(SIZE)
    level_force.jacobian(x, c[0], h)
    gained = transition(x, u, DT_S, c)[Ix.SPEED] / DT_S
    columns = [Ix.PITCH, Ix.ACCEL_X, Ix.MOUNT_YAW, Ix.MOUNT_PITCH]
    np.testing.assert_allclose(gained[columns], -h[columns], rtol=RELATIVE)


def test_prediction_is_filterpys_dense_one() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        x, P, u = state(rng), covariance(rng), reading(rng)
        ekf = tram_filter(x, P)
        F = transition(x, u, 0.01, constants())
        dense_filter = ExtendedKalmanFilter(dim_x=SIZE, dim_z=1)
        dense_filter.x, dense_filter.P = x.reshape(-1, 1), P
        dense_filter.F, dense_filter.Q = F, noise(x, constants(), 0.01)
        dense_filter.predict()
        ekf.predict(u, 0.01)
        np.testing.assert_allclose(ekf.P, dense_filter.P, rtol=RELATIVE, atol=1e-15)
        np.testing.assert_array_equal(ekf.P, ekf.P.T)
        np.testing.assert_array_equal(ekf.F, F)
        np.testing.assert_array_equal(ekf.x[:, 0], moved(x, u, 0.01, constants()))


def test_process_noise_is_positive() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        Q = noise(state(rng), constants(), 0.01)
        np.testing.assert_array_equal(Q, Q.T)
        assert np.linalg.eigvalsh(Q).min() > -1e-18


def readings(rng: Generator) -> Records:
    """Inertial readings whose steady rates are those of the last one."""
    inertial = one(INERTIAL)
    for _ in range(2):
        scalars = rng.normal((0.0, 0.0, 0.0, 0.0, 0.0, GRAVITY), 0.2).tolist()
        axes.take_reading(numbers(inertial), np.eye(3), *scalars, 0.0)
    return inertial


def measurements(rng: Generator, x: Array, gate: float) -> dict[str, Measurement]:
    """One of each kind that nearly fits the state `x`."""
    east, north, up = (x[:3] + rng.normal(0.0, 0.5, 3)).tolist()
    inertial = readings(rng)
    now = numbers(inertial["now"])
    return {
        "position": GnssPosition(east, north, 0.4, 0.09, gate, gate),
        "height": GnssHeight(up, 0.5, gate),
        "velocity": GnssVelocity(3.0, 4.0, 0.3, gate, gate),
        "left path": WheelPath(0, float(x[Ix.PATH_A]) + 0.1, 0.2, gate),
        "right path": WheelPath(1, float(x[Ix.PATH_B]) + 0.1, 0.2, gate),
        "left speed": WheelSpeed(0, float(x[Ix.SPEED]) + 0.2, 0.1, gate),
        "right speed": WheelSpeed(1, float(x[Ix.SPEED]) + 0.2, 0.1, gate),
        "zero velocity": ZeroVelocity(0.5, gate),
        "zero angular rate": ZeroAngularRate(now, 0.1, 0.2, 0.3),
        "level force": LevelForce(now, 0.3, gate),
        "lateral force": LateralForce(numbers(inertial), gate),
        "slow error": SlowError(0.3),
        "vertical constraint": VerticalConstraint(),
        "track distance": TrackDistance(0.6, 0.8, 0.4, 0.1, gate),
        "track heading": TrackHeading(0.6, 0.8, 0.02, 0.01, *x[[0, 1, 6]].tolist(), 0.01, gate),
        "track grade": TrackGrade(0.01, 0.01, gate),
    }


KINDS = list(measurements(np.random.default_rng(0), np.zeros(SIZE), INFINITE))


@pytest.mark.parametrize("kind", KINDS)
def test_what_runs_is_filterpys_dense_update(kind: str) -> None:
    """Scalar by scalar as the vehicle takes them, and what filterpy would say of them together."""
    rng = np.random.default_rng(KINDS.index(kind))
    for _ in range(5):
        x, P = state(rng), covariance(rng) + np.diag(SPREAD * 0.01) ** 2
        ekf = tram_filter(x, P)
        ekf.apply(measurements(rng, x, INFINITE)[kind])
        count, H, y, R = len(ekf.y), ekf.H, ekf.y, ekf.R
        dense_filter = ExtendedKalmanFilter(dim_x=SIZE, dim_z=count)
        dense_filter.x, dense_filter.P = x.reshape(-1, 1).copy(), P.copy()
        dense_filter.update(y, lambda _, H=H: H, lambda _, y=y: np.zeros_like(y), R)
        after = dense_filter.x.copy()
        if kind.endswith("path"):  # it counts from here on
            slot = Ix.PATH_A if kind == "left path" else Ix.PATH_B
            after[slot] -= float(x[slot]) + 0.1
        scale = np.sqrt(np.diag(P))
        np.testing.assert_allclose(ekf.x[:, 0] / scale, after[:, 0] / scale, atol=1e-7)
        both = np.outer(scale, scale)
        np.testing.assert_allclose(ekf.P / both, dense_filter.P / both, atol=1e-7)
        np.testing.assert_allclose(ekf.y, dense_filter.y, rtol=1e-8)
        np.testing.assert_allclose(ekf.S, dense_filter.S, rtol=1e-8)
        gained = np.sqrt(np.diag(dense_filter.S))
        np.testing.assert_allclose(
            ekf.K * gained / scale[:, None], dense_filter.K * gained / scale[:, None], atol=1e-7
        )
        assert math.isclose(ekf.log_likelihood, dense_filter.log_likelihood, rel_tol=1e-7)


def test_refused_measurement_changes_nothing_and_says_how_far_off_it_was() -> None:
    rng = np.random.default_rng(8)
    x, P = state(rng), covariance(rng)
    ekf = tram_filter(x, P)
    verdicts = ekf.apply(GnssPosition(float(x[0]) + 1e5, float(x[1]), 1.0))
    assert ekf.refused
    assert not any(verdict.accepted for verdict in verdicts)
    np.testing.assert_array_equal(ekf.x[:, 0], x)
    np.testing.assert_array_equal(ekf.P, P)
    np.testing.assert_allclose(ekf.S, ekf.H @ P @ ekf.H.T + ekf.R, rtol=1e-9)
    np.testing.assert_array_equal(ekf.K, 0.0)


def told_slow(std_m: float, then_m: float | None) -> TramFilter:
    """A filter that takes three fixes with a slow error of `std_m`, and learns that it is less."""
    P = np.zeros((SIZE, SIZE))
    P[Ix.EAST, Ix.EAST] = P[Ix.NORTH, Ix.NORTH] = 4.0
    P[Ix.GNSS_SLOW_EAST, Ix.GNSS_SLOW_EAST] = P[Ix.GNSS_SLOW_NORTH, Ix.GNSS_SLOW_NORTH] = std_m**2
    ekf = tram_filter(np.zeros(SIZE), P)
    for k in range(3):
        ekf.apply(GnssPosition(1.0 + 0.1 * k, -2.0, 0.3, gate=INFINITE, knee=INFINITE))
    if then_m is not None:
        ekf.apply(SlowError(1.0 / (1.0 / then_m**2 - 1.0 / std_m**2)))
    return ekf


def test_slow_error_that_turns_out_to_be_smaller_is_as_if_it_had_been_known() -> None:
    """Identity: the same as a filter that began with the smaller one."""
    found, known = told_slow(2.0, 0.5), told_slow(0.5, None)
    np.testing.assert_allclose(found.x, known.x, atol=1e-9)
    np.testing.assert_allclose(found.P, known.P, atol=1e-9)


def test_doubt_that_is_exchanged_leaves_what_fixes_have_told() -> None:
    """The sum of place and error is as sure as before; each of them is not."""
    ekf = told_slow(0.5, None)
    before = ekf.P.copy()
    ekf.exchange(Ix.EAST, Ix.GNSS_SLOW_EAST, 0.7)
    row = np.zeros(SIZE)
    row[[Ix.EAST, Ix.GNSS_SLOW_EAST]] = 1.0
    assert row @ ekf.P @ row == pytest.approx(row @ before @ row)
    for slot in (Ix.EAST, Ix.GNSS_SLOW_EAST):
        assert ekf.P[slot, slot] == pytest.approx(before[slot, slot] + 0.49)


def test_parameters_are_frozen() -> None:
    ekf = tram_filter(np.zeros(SIZE), np.eye(SIZE))
    with pytest.raises(ValueError, match="read-only"):
        ekf.parameters["gravity"] = 0.0


def test_heading_that_is_set_moves_the_position_from_the_antenna_to_the_pivot() -> None:
    ekf = tram_filter(np.zeros(SIZE), np.eye(SIZE))
    ekf.forget_heading()
    fix = GnssPosition(10.0, 20.0, 1.0, gate=INFINITE, knee=INFINITE)
    ekf.apply(fix)
    innovation = ekf.y[:, 0]
    np.testing.assert_allclose(innovation, (10.0, 20.0))  # no lever arm
    ekf = tram_filter(np.zeros(SIZE), np.eye(SIZE))
    ekf.forget_heading()
    ekf.set_heading(math.pi / 2, 0.1)
    np.testing.assert_allclose(ekf.x[[Ix.EAST, Ix.NORTH, Ix.UP], 0], (0.3, -2.0, -3.0), atol=1e-12)
    ekf.apply(fix)
    np.testing.assert_allclose(ekf.y[:, 0], (10.0, 20.0))  # the antenna is where it was


def test_pivot_behind_the_origin_moves_nothing_while_the_heading_is_unknown() -> None:
    """Truth: the antenna's place does not depend on where the vehicle pivots."""
    x, P = np.zeros(SIZE), np.zeros((SIZE, SIZE))
    x[Ix.PIVOT], P[Ix.PIVOT, Ix.PIVOT] = 3.2, 0.25
    P[Ix.EAST, Ix.EAST] = P[Ix.NORTH, Ix.NORTH] = 4.0
    ekf = tram_filter(x, P)
    ekf.forget_heading()
    fix = GnssPosition(10.0, 20.0, 1.0, gate=INFINITE, knee=INFINITE)
    ekf.apply(fix)
    np.testing.assert_allclose(ekf.y[:, 0], (10.0, 20.0))
    assert ekf.P[Ix.PIVOT, Ix.PIVOT] == 0.25
    estimate = ekf.estimate(0, HEADING_UNKNOWN, False, [])
    np.testing.assert_allclose(estimate.p_l[:2], ekf.x[:2, 0])
    antenna = ekf.x[:2, 0].copy()
    ekf.set_heading(math.pi / 2, 0.1)
    np.testing.assert_allclose(antenna - ekf.x[:2, 0], (-0.3, 2.0 + 3.2))
    # The pivot's place is as uncertain as how far it lies behind the antenna.
    assert ekf.P[Ix.NORTH, Ix.PIVOT] == pytest.approx(-0.25)
    ekf.apply(fix)
    np.testing.assert_allclose(ekf.y[:, 0], (10.0, 20.0) - antenna)


def test_scalar_update_is_the_dense_one() -> None:
    """With variances of one size the comparison holds to nine digits."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        root = rng.normal(size=(SIZE, SIZE))
        P, x = root @ root.T, rng.normal(size=SIZE)
        columns, values = rng.choice(SIZE, 5, replace=False), rng.normal(size=5)
        H = np.zeros((1, SIZE))
        H[0, columns] = values
        dense_filter = ExtendedKalmanFilter(dim_x=SIZE, dim_z=1)
        dense_filter.x, dense_filter.P = x.reshape(-1, 1).copy(), P.copy()
        y = 0.7
        z = H @ dense_filter.x + y
        dense_filter.update(z, lambda _, H=H: H, lambda x, H=H: H @ x, np.eye(1) * 3.0)
        K = np.zeros(SIZE)
        S = update_scalar(x, P, columns, values, 5, y, 3.0, INFINITE, K)
        assert math.isclose(S, float(dense_filter.S[0, 0]), rel_tol=RELATIVE)
        np.testing.assert_allclose(x, dense_filter.x[:, 0], rtol=RELATIVE, atol=RELATIVE)
        np.testing.assert_allclose(P, dense_filter.P, rtol=RELATIVE, atol=RELATIVE * P.max())
        np.testing.assert_allclose(K, dense_filter.K[:, 0], rtol=RELATIVE, atol=RELATIVE)


def test_pair_is_the_joint_update_and_reports_white_innovations() -> None:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(SIZE, SIZE))
    P, x = root @ root.T, rng.normal(size=SIZE)
    first, second = np.array([0, 4, 7]), np.array([1, 4])
    a, b = rng.normal(size=3), rng.normal(size=2)
    H = np.zeros((2, SIZE))
    H[0, first], H[1, second] = a, b
    y, R = np.array([0.4, -0.3]), 2.0
    S = H @ P @ H.T + R * np.eye(2)
    K = P @ H.T @ np.linalg.inv(S)
    expected_x, expected_P = x + K @ y, P - K @ S @ K.T
    f = pair(x, P, ((first, a), (second, b)), (0.4, -0.3), R)
    np.testing.assert_allclose(f["x"][0], expected_x, rtol=RELATIVE)
    np.testing.assert_allclose(f["P"][0], expected_P, rtol=RELATIVE, atol=RELATIVE * P.max())
    distance = float((f["y"][0, :2] ** 2 / f["S"][0, :2]).sum())
    assert math.isclose(distance, float(y @ np.linalg.solve(S, y)), rel_tol=RELATIVE)


Row = tuple[Array, Array]
"""Columns and values of a row of H."""


def pair(
    x: Array,
    P: Array,
    rows: tuple[Row, Row],
    y: tuple[float, float],
    R: float,
    gate: float = INFINITE,
    knee: float = INFINITE,
) -> Records:
    """Memory after two scalars that belong together."""
    f = one(MEMORY)
    f["x"], f["P"], f["y"][0, :2] = x, P, y
    for k, (columns, values) in enumerate(rows):
        f["H"][0, k, columns] = values
    take_pair(numbers(f), rows[0][0], rows[1][0], R, gate, knee)
    return f


@compiled
def take_pair(m: Array, a: Array, b: Array, R: float, gate: float, knee: float) -> None:
    update.update_pair(m.view(MEMORY)[0], a, b, R, 0.0, gate, knee)


def test_pair_beyond_the_gate_changes_nothing() -> None:
    P, x = np.eye(SIZE), np.zeros(SIZE)
    f = pair(x, P, (ROW, OTHER_ROW), (9.0, 0.0), 1.0, gate=30.0)
    np.testing.assert_array_equal(f["P"][0], np.eye(SIZE))
    np.testing.assert_array_equal(f["x"][0], np.zeros(SIZE))
    assert (f["S"][0, :2] < 0.0).all()


def test_pair_beyond_the_knee_moves_the_state_less_than_its_weight_would() -> None:
    moves = []
    for knee in (INFINITE, 9.0):
        f = pair(np.zeros(SIZE), np.eye(SIZE), (ROW, OTHER_ROW), (8.0, 0.0), 1.0, knee=knee)
        moves.append(float(f["x"][0, 0]))
    assert 0.0 < moves[1] < 0.9 * moves[0]


ROW, OTHER_ROW = (np.array([0]), np.ones(1)), (np.array([1]), np.ones(1))


def test_sparse_prediction_with_no_entries_leaves_the_covariance() -> None:
    P = covariance(np.random.default_rng(6))
    before = P.copy()
    predict_covariance(P, PATTERN, np.zeros(len(ENTRIES)), 0, np.zeros((SIZE, SIZE)))
    np.testing.assert_allclose(P, before, rtol=RELATIVE)


LEFT_OUT = {
    "velocity": {Ix.GYRO_Z},  # the yaw rate that the last prediction left stands still here
    "left speed": {Ix.GYRO_Z},
    "right speed": {Ix.GYRO_Z},
    # Forces across the one that is read enter as the motion has them, not as they are read.
    "level force": {Ix.MOUNT_YAW, Ix.MOUNT_PITCH},
    "lateral force": {Ix.MOUNT_ROLL, Ix.MOUNT_YAW, Ix.PIVOT, Ix.GYRO_X, Ix.GYRO_Y},
}
"""Derivatives that a row of H leaves out or takes elsewhere on purpose."""


# How far the track is, is told by the map, not by the state: its row is tested with the track.
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "track distance"])
def test_rows_of_the_measurements_are_their_derivatives(kind: str) -> None:
    """Against finite differences; a lever's turn with roll and pitch is kept to first order."""
    rng = np.random.default_rng(7)
    x = state(rng)
    x[[Ix.ROLL, Ix.PITCH]] = 0.0
    measurement = measurements(rng, x, INFINITE)[kind]
    # How the force on the case's lever follows a bias is left out: 1.4 m, 0.05 m/s² per rad/s.
    within = 0.05 if kind == "lateral force" else 0.02
    for column in set(Ix) - LEFT_OUT.get(kind, set()):
        y = []
        for sign in (1.0, -1.0):
            ekf = tram_filter(x, np.zeros((SIZE, SIZE)))
            ekf.fields["yaw_rate"] = 0.2
            ekf.state[column] += sign * STEP
            ekf.apply(measurement)
            y.append(ekf.y[:, 0])
        slope = -(y[0] - y[1]) / (2 * STEP)
        for k, expected in enumerate(slope):
            assert ekf.H[k, column] == pytest.approx(expected, abs=within), (column.name, k)


@pytest.mark.parametrize("count", [0, 1])
def test_prediction_to_now_says_what_the_filter_itself_would(count: int) -> None:
    rng = np.random.default_rng(11)
    x = state(rng)
    x[Ix.PIVOT] = 2.0
    ekf = tram_filter(x, covariance(rng))
    kept = np.zeros(1, KEPT)
    kept["reading"], kept["duration"] = reading(rng).view(READING), 0.01
    found, expected = np.zeros(VALUES), np.zeros(VALUES)
    scratch = numbers(one(MEMORY)), numbers(kept), 0, count, numbers(one(READING))
    ekf.estimate_ahead(*scratch, found)
    if count:
        ekf.predict(numbers(kept["reading"]), 0.01)
    axes.estimate(ekf.memory, numbers(ekf.parameters), True, expected)
    assert np.isnan(found[LEVEL_ERROR:COVARIANCE]).all(), "only the horizon tells a level"
    assert np.isfinite(expected[LEVEL_ERROR:COVARIANCE]).all()
    found[LEVEL_ERROR:COVARIANCE] = expected[LEVEL_ERROR:COVARIANCE]
    np.testing.assert_allclose(found, expected, rtol=RELATIVE, atol=1e-12)


def test_level_is_what_the_accelerometer_shows_whatever_is_known_of_the_pitch() -> None:
    """A vehicle that stands: gravity ties pitch, mounting and bias together, and none apart."""
    rng = np.random.default_rng(12)
    x, values = state(rng) * 0.0, np.zeros(VALUES)
    P = np.zeros((SIZE, SIZE))
    for slot, std in ((Ix.PITCH, 0.06), (Ix.MOUNT_PITCH, 0.02), (Ix.ACCEL_X, 0.15)):
        P[slot, slot] = std * std
    ekf = tram_filter(x, P)
    now = reading(rng) * 0.0
    now.view(READING)["specific_force"] = (-0.3, 0.0, GRAVITY)
    now.view(READING)["accelerometer"] = 1.0
    for _ in range(50):
        ekf.apply(LevelForce(now, 0.01**2))
    axes.estimate(ekf.memory, numbers(ekf.parameters), True, values)
    shown = math.asin(0.3 / GRAVITY)
    assert values[Ix.PITCH] + values[LEVEL_ERROR] == pytest.approx(shown, abs=2e-4)
    assert values[LEVEL_STD] == pytest.approx(0.01 / math.sqrt(50.0) / GRAVITY, rel=0.05)
    assert math.sqrt(values[COVARIANCE + 8 * Ix.PITCH]) > 0.02, "how much of it is pitch"
