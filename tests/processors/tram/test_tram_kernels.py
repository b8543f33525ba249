"""Kernels of the model `tram` against finite differences and filterpy's dense algebra."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from numpy.random import Generator

from tramstream.config import Gnss, Imu, Vehicle, Wheels
from tramstream.estimation.kalman import Array, predict_covariance, update_pair, update_scalar
from tramstream.estimation.localiser import VALUES
from tramstream.processors.tram import measurements
from tramstream.processors.tram import motion as kernels
from tramstream.processors.tram.axes import say
from tramstream.processors.tram.filter import TramFilter, parameters
from tramstream.processors.tram.predictor_kernels import READING, say_ahead
from tramstream.processors.tram.states import COLUMNS, ENTRIES, ROWS, SIZE, Ix, Pm

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
SPREAD[[Ix.MOUNT_ROLL, Ix.MOUNT_PITCH, Ix.MOUNT_YAW]] = 0.002


def constants() -> Array:
    vehicle = Vehicle(
        vehicle="test",
        gnss=Gnss(device="none", lever_arm_m=(2.0, 0.3, 3.0)),
        imu=Imu(device="none", lever_arm_m=(-1.0, 0.2, 0.4)),
        wheels=Wheels(track_m=1.435),
    )
    c = parameters(vehicle, GRAVITY)
    c[Pm.GNSS_DECAY], c[Pm.GNSS_DENSITY], c[Pm.GNSS_UP_DENSITY] = 0.05, 0.02, 0.05
    c[Pm.SIDE_DENSITY], c[Pm.SLIP_DENSITY], c[Pm.SCALE_WALK] = 1e-4, 1e-6, 1e-9
    return c


def state(rng: Generator) -> Array:
    return rng.normal(size=SIZE) * SPREAD


def reading(rng: Generator) -> Array:
    u = np.zeros(10)
    u[:3] = rng.normal(0.0, 0.2, 3)
    u[3:6] = rng.normal((0.0, 0.0, GRAVITY), 1.0)
    u[9] = 1.0
    return u


def covariance(rng: Generator) -> Array:
    root = rng.normal(size=(SIZE, SIZE)) * SPREAD[:, None] * 0.1
    return np.asarray(root @ root.T)


def tram_filter(x: Array, P: Array) -> TramFilter:
    ekf = TramFilter(constants())
    ekf.x, ekf.P = x, P
    return ekf


def dense(values: Array) -> Array:
    F = np.eye(SIZE)
    for row, column, value in zip(ROWS, COLUMNS, values, strict=True):
        F[row, column] += value
    return F


def moved(x: Array, u: Array, dt_s: float, c: Array) -> Array:
    after = x.copy()
    kernels.move(after, c, u, dt_s)
    return after


@pytest.mark.parametrize("seed", range(5))
def test_transition_is_the_derivative_of_the_motion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, u, c = state(rng), reading(rng), constants()
    c[Pm.IMU_X : Pm.IMU_Z + 1] = 0.0  # how a lever's share follows the biases is left out
    x[Ix.PIVOT] = 0.0
    values = np.zeros(len(ENTRIES))
    kernels.transition(x, c, u, DT_S, values)
    F = dense(values)
    for column in set(Ix) - {Ix.PIVOT}:
        step = np.zeros(SIZE)
        step[column] = STEP
        slope = (moved(x + step, u, DT_S, c) - moved(x - step, u, DT_S, c)) / (2 * STEP)
        scale = np.maximum(np.abs(F[:, column] - np.eye(SIZE)[column]) / DT_S, 1.0)
        wrong = np.abs(F[:, column] - slope) / DT_S > SECOND_ORDER * scale
        assert not wrong.any(), (column.name, [Ix(row).name for row in np.flatnonzero(wrong)])


def test_prediction_is_filterpys_dense_one() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        x, P, u = state(rng), covariance(rng), reading(rng)
        ekf = tram_filter(x, P)
        values = np.zeros(len(ENTRIES))
        kernels.transition(x, ekf.parameters, u, 0.01, values)
        Q = np.zeros((SIZE, SIZE))
        kernels.add_noise(x, Q, ekf.parameters, 0.01)
        dense_filter = ExtendedKalmanFilter(dim_x=SIZE, dim_z=1)
        dense_filter.x, dense_filter.P = x.reshape(-1, 1), P
        dense_filter.F, dense_filter.Q = dense(values), Q
        dense_filter.predict()
        ekf.predict(u, 0.01)
        np.testing.assert_allclose(ekf.P, dense_filter.P, rtol=RELATIVE, atol=1e-15)
        np.testing.assert_array_equal(ekf.P, ekf.P.T)
        np.testing.assert_array_equal(ekf.x[:, 0], moved(x, u, 0.01, ekf.parameters))


def test_process_noise_is_positive() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        Q = np.zeros((SIZE, SIZE))
        kernels.add_noise(state(rng), Q, constants(), 0.01)
        np.testing.assert_array_equal(Q, Q.T)
        assert np.linalg.eigvalsh(Q).min() > -1e-18


def test_update_is_filterpys_dense_one() -> None:
    rng = np.random.default_rng(3)
    for count in (1, 2, 4):
        x, P = state(rng), covariance(rng)
        H, R = rng.normal(size=(count, SIZE)), np.diag(rng.uniform(0.1, 2.0, count))
        z = rng.normal(size=(count, 1))
        ekf, dense_filter = tram_filter(x, P), ExtendedKalmanFilter(dim_x=SIZE, dim_z=count)
        dense_filter.x, dense_filter.P = x.reshape(-1, 1), P
        arguments = (z, lambda _, H=H: H, lambda x, H=H: H @ x, R)
        ekf.update(*arguments)
        dense_filter.update(*arguments)
        np.testing.assert_allclose(ekf.x, dense_filter.x, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(ekf.P, dense_filter.P, rtol=1e-7, atol=1e-7)
        for name in ("y", "S", "K"):
            expected = getattr(dense_filter, name)
            np.testing.assert_allclose(getattr(ekf, name), expected, rtol=RELATIVE, err_msg=name)
        assert math.isclose(ekf.log_likelihood, dense_filter.log_likelihood, rel_tol=RELATIVE)


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
    out, gains = np.array([[y[0], 0.0], [y[1], 0.0]]), np.zeros(2 * SIZE)
    pair(x, P, (first, a), (second, b), out, gains, R)
    np.testing.assert_allclose(x, expected_x, rtol=RELATIVE)
    np.testing.assert_allclose(P, expected_P, rtol=RELATIVE, atol=RELATIVE * P.max())
    distance = out[0, 0] ** 2 / out[0, 1] + out[1, 0] ** 2 / out[1, 1]
    assert math.isclose(distance, float(y @ np.linalg.solve(S, y)), rel_tol=RELATIVE)


def pair(
    x: Array,
    P: Array,
    first: tuple[Array, Array],
    second: tuple[Array, Array],
    out: Array,
    gains: Array,
    R: float,
    gate: float = INFINITE,
    knee: float = INFINITE,
) -> None:
    (columns, a), (columns2, b) = first, second
    rows = (columns, a, len(columns), columns2, b, len(columns2))
    update_pair(x, P, *rows, R, 0.0, gate, knee, gains[:SIZE], gains[SIZE:], out)


def test_pair_beyond_the_gate_changes_nothing() -> None:
    P, x = np.eye(SIZE), np.zeros(SIZE)
    out, gains = np.array([[9.0, 0.0], [0.0, 0.0]]), np.zeros(2 * SIZE)
    row = (np.array([0]), np.ones(1))
    pair(x, P, row, (np.array([1]), np.ones(1)), out, gains, 1.0, gate=30.0)
    np.testing.assert_array_equal(P, np.eye(SIZE))
    np.testing.assert_array_equal(x, np.zeros(SIZE))
    assert out[0, 1] < 0.0 > out[1, 1]


def test_pair_beyond_the_knee_moves_the_state_less_than_its_weight_would() -> None:
    moves = []
    for knee in (INFINITE, 9.0):
        P, x = np.eye(SIZE), np.zeros(SIZE)
        out, gains = np.array([[8.0, 0.0], [0.0, 0.0]]), np.zeros(2 * SIZE)
        rows = (np.array([0]), np.ones(1)), (np.array([1]), np.ones(1))
        pair(x, P, *rows, out, gains, 1.0, knee=knee)
        moves.append(float(x[0]))
    assert 0.0 < moves[1] < 0.9 * moves[0]


def test_sparse_prediction_with_no_entries_leaves_the_covariance() -> None:
    P = covariance(np.random.default_rng(6))
    before = P.copy()
    predict_covariance(P, ROWS, COLUMNS, np.zeros(len(ENTRIES)), 0, np.zeros((SIZE, SIZE)))
    np.testing.assert_allclose(P, before, rtol=RELATIVE)


Innovate = Callable[[Array, Array], Array]
"""Takes memory and an array for what is reported; gives the innovations."""


def at_position(m: Array, out: Array) -> Array:
    z, R = np.array([10.0, 20.0, 5.0]), np.ones(3)
    measurements.position(m, constants(), z, R, INFINITE, INFINITE, out)
    return out[:, 0]


def at_velocity(m: Array, out: Array) -> Array:
    measurements.velocity(m, constants(), np.array([3.0, 4.0]), 1.0, INFINITE, INFINITE, out)
    return out[:2, 0]


def at_wheel(m: Array, out: Array) -> Array:
    return np.array(measurements.path(m, constants(), 0, 0.1, 1.0, INFINITE)[:1])


def at_rim(m: Array, out: Array) -> Array:
    return np.array(measurements.rim(m, constants(), 1, 4.0, 1.0, INFINITE)[:1])


@pytest.mark.parametrize("innovate", [at_position, at_velocity, at_wheel, at_rim])
def test_rows_of_the_measurements_are_their_derivatives(innovate: Innovate) -> None:
    """Against finite differences; a lever's turn with roll and pitch is kept to first order."""
    rng = np.random.default_rng(7)
    m, out = np.zeros(kernels.MEMORY), np.zeros((3, 2))
    x = state(rng)
    x[[Ix.ROLL, Ix.PITCH]] = 0.0
    for column in set(Ix) - NOT_IN_MEMORY:
        y = []
        for sign in (1.0, -1.0):
            m[:] = 0.0
            m[kernels.STATE] = x
            m[kernels.STATE][column] += sign * STEP
            m[kernels.YAW_RATE] = 0.2
            y.append(innovate(m, out).copy())
        slope = -(y[0] - y[1]) / (2 * STEP)
        for k, expected in enumerate(slope):
            H = seen_row(m, k)
            assert H[column] == pytest.approx(expected, abs=0.02), (column.name, k)


NOT_IN_MEMORY = {Ix.GYRO_Z}
"""The yaw rate that the last prediction left follows it; here it stands still."""


def seen_row(m: Array, k: int) -> Array:
    """Row of H of scalar number `k` of the last call, as a smoother reads it."""
    H = np.zeros(SIZE)
    count = int(m[kernels.SEEN][3 * k + 2])
    columns = m[kernels.H_COLUMNS][k * kernels.ROW_LENGTH :][:count].astype(int)
    H[columns] = kernels.row(m, k)[:count]
    return H


@pytest.mark.parametrize("count", [0, 1])
def test_prediction_to_now_says_what_the_filter_itself_would(count: int) -> None:
    rng = np.random.default_rng(11)
    m, c = np.zeros(kernels.MEMORY), constants()
    m[kernels.STATE], m[kernels.COVARIANCE] = state(rng), covariance(rng).ravel()
    m[Ix.PIVOT] = 2.0
    readings = np.zeros((1, READING))
    readings[0, :10], readings[0, 10] = reading(rng), 0.01
    to, found, expected = m * 0.0, np.zeros(VALUES), np.zeros(VALUES)
    say_ahead(m, to, c, readings, 0, count, found)
    for row in readings[:count]:
        kernels.predict(m, c, row[:10], row[10])
    say(m, c, True, expected)
    np.testing.assert_allclose(found, expected, rtol=RELATIVE, atol=1e-12)
