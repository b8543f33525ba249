"""Vertical force and shaking in the model `tram`: derivatives, noise, and what a jolt does."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from seeds import seeds

from tramstream.config import Ekf, Gnss, Imu, Vehicle
from tramstream.estimation.kalman import Array
from tramstream.estimation.records import numbers, one
from tramstream.geodesy import LocalLevel
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_model.lateral_force import LateralForce
from tramstream.processors.tram_model.records import INERTIAL, READING, READING_S
from tramstream.processors.tram_model.states import SIZE, Ix
from tramstream.processors.tram_model.vertical_constraint import VerticalConstraint
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


def level_reading(pitch_rate: float = 0.0, force: float = GRAVITY) -> Array:
    """Numbers of one `Reading`."""
    u = one(READING)
    u["angular_rate"] = 0.0, pitch_rate, 0.0
    u["specific_force"] = 0.0, 0.0, force
    u["accelerometer"] = 1.0
    return numbers(u)


def driving(vehicle: Vehicle) -> TramFilter:
    """A filter that knows itself to run at `SPEED_MPS` on the level."""
    ekf = TramFilter(vehicle, GRAVITY)
    ekf.P = 0.0
    ekf.reset(Ix.SPEED, SPEED_MPS, 0.02)
    ekf.forget((Ix.PITCH,), (math.radians(0.1),))
    return ekf


def read(ekf: TramFilter, u: Array) -> None:
    """Go through one reading; where the vertical force is used, with its constraint."""
    ekf.predict(u, READING_S)
    inertial = one(INERTIAL)
    inertial["now"] = u.view(READING)
    ekf.apply(LateralForce(numbers(inertial), math.inf))
    if ekf.parameters["vertical_density"][0] > 0.0:
        ekf.apply(VerticalConstraint())


def predicted(x: Array, u: Array) -> TramFilter:
    ekf = TramFilter(car(), GRAVITY)
    ekf.x, ekf.P = x, 1.0
    ekf.predict(u, DT_S)
    return ekf


@pytest.mark.parametrize("seed", seeds(2, of=5, first=0))
def test_heaving_is_differentiated_where_nothing_shakes_in_the_derivative(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, u = rng.normal(0.0, 0.01, SIZE), level_reading()
    x[Ix.SPEED] = 8.0
    x[[Ix.PIVOT, Ix.MOUNT_ROLL, Ix.MOUNT_PITCH, Ix.MOUNT_YAW]] = 0.0
    u[:3] = rng.normal(0.0, 0.2, 3)
    F = predicted(x, u).F
    for column in (Ix.ROLL, Ix.PITCH, Ix.GYRO_Y, Ix.ACCEL_Z, Ix.HEAVE):
        above, below = x.copy(), x.copy()
        above[column] += STEP
        below[column] -= STEP
        slope = (predicted(above, u).x - predicted(below, u).x)[:, 0] / (2 * STEP)
        for row in (Ix.UP, Ix.HEAVE):
            expected = float(slope[row] - np.eye(SIZE)[row, column]) / DT_S
            found = float(F[row, column] - np.eye(SIZE)[row, column]) / DT_S
            assert found == pytest.approx(expected, abs=SECOND_ORDER * max(1.0, abs(expected)))
    assert F[Ix.HEAVE, Ix.SPEED] == 0.0


def test_noise_of_a_heaving_vehicle_is_positive() -> None:
    ekf = driving(car())
    ekf.P = 0.0
    ekf.predict(level_reading(), READING_S)
    Q = ekf.P
    np.testing.assert_array_equal(Q, Q.T)
    assert np.linalg.eigvalsh(Q).min() > -1e-18
    assert Q[Ix.HEAVE, Ix.PITCH] > 0.0


def test_without_it_the_vertical_force_changes_nothing() -> None:
    after = []
    for force in (GRAVITY, GRAVITY + 3.0):
        ekf = driving(Vehicle(vehicle="tram", imu=Imu(device="none")))
        read(ekf, level_reading(force=force))
        after.append(np.column_stack([ekf.x, ekf.P]))
    np.testing.assert_array_equal(*after)


def test_step_of_the_gyroscope_that_no_force_confirms_is_taken_back() -> None:
    """A jolt of 1° in 0.1 s that only the gyroscope sees: a vehicle at 10 m/s cannot have dived."""
    jolt = math.radians(1.0)
    left = {}
    for used in (True, False):
        vehicle = car()
        if not used:
            unused = msgspec.structs.replace(vehicle.ekf, vertical_std_mps2_rthz=0.0)
            vehicle = msgspec.structs.replace(vehicle, ekf=unused)
        ekf = driving(vehicle)
        ekf.set_motion_noise(float(ekf.situation["accel_density"][0]), (1e-4**2, 0.03**2, 1e-4**2))
        for step in range(100):
            read(ekf, level_reading(pitch_rate=jolt / 0.1 if step < 10 else 0.0))
        left[used] = abs(ekf.state[Ix.PITCH])
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
    ekf = navigation.ekf
    ekf.P = 0.0
    ekf.predict(navigation.between, READING_S)
    roll, pitch, yaw = np.diag(ekf.P)[Ix.ROLL : Ix.YAW + 1] / READING_S
    variance = 0.5 * (2.0 * amplitude) ** 2  # of white readings that differ as much
    expected = 1e-4**2 + aliasing**2 * variance * READING_S
    assert pitch == pytest.approx(expected, rel=0.02)
    assert roll == pytest.approx(1e-4**2, rel=0.02)
    assert yaw == pytest.approx(1e-4**2, rel=0.02)
