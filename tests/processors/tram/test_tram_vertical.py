"""Vertical force and shaking in the model `tram`: derivatives, noise, and what a jolt does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tramstream.config import Ekf, Gnss, Imu, Vehicle
from tramstream.estimation.kalman import Array
from tramstream.geodesy import LocalLevel
from tramstream.processors.tram import measurements
from tramstream.processors.tram import motion as kernels
from tramstream.processors.tram.filter import READING_S, parameters
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram.states import COLUMNS, ENTRIES, ROWS, SIZE, Ix, Pm
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame

GRAVITY = 9.81
DT_S = 1e-4
STEP = 1e-6
SECOND_ORDER = 0.02
"""What is left out of A: terms with dt, and products of small ones."""
SPEED_MPS = 10.0


def car(aliasing: float = 0.0) -> Vehicle:
    return Vehicle(
        vehicle="car",
        gnss=Gnss(device="none"),
        imu=Imu(device="none", gyro_noise_radps_rthz=1e-4, gyro_aliasing=aliasing),
        ekf=Ekf(vertical_std_mps2_rthz=0.05, heave_std_m_rts=0.1, sway_std_mps2_rthz=0.1),
    )


def level_reading() -> Array:
    u = np.zeros(10)
    u[5], u[9] = GRAVITY, 1.0
    return u


def driving() -> Array:
    """Memory of a filter that knows itself to run at `SPEED_MPS` on the level."""
    m = np.zeros(kernels.MEMORY)
    m[kernels.STATE][Ix.SPEED] = SPEED_MPS
    P = m[kernels.COVARIANCE].reshape(SIZE, SIZE)
    P[Ix.PITCH, Ix.PITCH] = math.radians(0.1) ** 2
    P[Ix.SPEED, Ix.SPEED] = 0.02**2
    return m


@pytest.mark.parametrize("seed", range(5))
def test_heaving_is_differentiated_where_nothing_shakes_in_the_derivative(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, u, c = rng.normal(0.0, 0.01, SIZE), level_reading(), parameters(car(), GRAVITY)
    x[Ix.SPEED] = 8.0
    x[[Ix.PIVOT, Ix.MOUNT_ROLL, Ix.MOUNT_PITCH, Ix.MOUNT_YAW]] = 0.0
    u[:3] = rng.normal(0.0, 0.2, 3)
    values = np.zeros(len(ENTRIES))
    kernels.transition(x, c, u, DT_S, values)
    F = np.eye(SIZE)
    np.add.at(F, (ROWS, COLUMNS), values)
    for column in (Ix.ROLL, Ix.PITCH, Ix.GYRO_Y, Ix.ACCEL_Z, Ix.HEAVE):
        above, below = x.copy(), x.copy()
        above[column] += STEP
        below[column] -= STEP
        kernels.move(above, c, u, DT_S)
        kernels.move(below, c, u, DT_S)
        slope = (above - below) / (2 * STEP)
        for row in (Ix.UP, Ix.HEAVE):
            expected = float(slope[row] - np.eye(SIZE)[row, column]) / DT_S
            found = float(F[row, column] - np.eye(SIZE)[row, column]) / DT_S
            assert found == pytest.approx(expected, abs=SECOND_ORDER * max(1.0, abs(expected)))
    assert F[Ix.HEAVE, Ix.SPEED] == 0.0


def test_noise_of_a_heaving_vehicle_is_positive() -> None:
    m = driving()
    Q = np.zeros((SIZE, SIZE))
    kernels.add_noise(m[kernels.STATE], Q, parameters(car(), GRAVITY), READING_S)
    np.testing.assert_array_equal(Q, Q.T)
    assert np.linalg.eigvalsh(Q).min() > -1e-18
    assert Q[Ix.HEAVE, Ix.PITCH] > 0.0


def test_without_it_the_vertical_force_changes_nothing() -> None:
    c = parameters(Vehicle(vehicle="tram", imu=Imu(device="none")), GRAVITY)
    after = []
    for force in (GRAVITY, GRAVITY + 3.0):
        m, u = driving(), level_reading()
        u[5] = force
        kernels.predict(m, c, u, READING_S)
        measurements.inertial(m, c, u, np.zeros(3), math.inf)
        after.append(m[: SIZE + SIZE * SIZE])
    np.testing.assert_array_equal(*after)


def test_step_of_the_gyroscope_that_no_force_confirms_is_taken_back() -> None:
    """A jolt of 1° in 0.1 s that only the gyroscope sees: a vehicle at 10 m/s cannot have dived."""
    jolt = math.radians(1.0)
    left = {}
    for used in (True, False):
        c = parameters(car(), GRAVITY)
        c[Pm.PITCH_DENSITY] = 0.03**2
        if not used:
            c[Pm.VERTICAL_DENSITY] = 0.0
        m = driving()
        for step in range(100):
            u = level_reading()
            u[1] = jolt / 0.1 if step < 10 else 0.0
            kernels.predict(m, c, u, READING_S)
            measurements.inertial(m, c, u, np.zeros(3), math.inf)
        left[used] = abs(float(m[kernels.STATE][Ix.PITCH]))
    assert left[False] == pytest.approx(jolt, rel=0.1)
    assert left[True] < 0.3 * jolt


def test_shaking_widens_what_an_angle_may_have_done_on_its_axis_alone() -> None:
    aliasing, amplitude = 0.35, 0.2
    navigation = Navigation(car(aliasing), LocalLevel.at_deg(50.0, 14.0, 200.0))
    for k in range(200):
        stamp_ns = 10_000_000 * (k + 1)
        mean = ImuMean(stamp_ns=stamp_ns, accel_z_mps2=GRAVITY)
        mean.gyro_y_radps = amplitude * (-1) ** k
        navigation.read(SyncFrame(stamp_ns=stamp_ns, imu=mean))
    c = navigation.ekf.parameters
    variance = 0.5 * (2.0 * amplitude) ** 2  # of white readings that differ as much
    expected = 1e-4**2 + aliasing**2 * variance * READING_S
    assert c[Pm.PITCH_DENSITY] == pytest.approx(expected, rel=0.02)
    assert c[Pm.ROLL_DENSITY] == c[Pm.YAW_DENSITY] == pytest.approx(1e-4**2)
