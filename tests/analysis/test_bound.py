"""The bound against closed forms, a filter written down by hand, and the filter itself."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rides import altered, laid, localised, reference, ridden

from tramstream.analysis.studies import bound
from tramstream.analysis.studies.bound import STEP_S, Series
from tramstream.errors import ConfigError
from tramstream.geodesy import normal_gravity_mps2
from tramstream.processors.tram_model.states import Ix
from tramstream.simulation.scenario import Scenario, Slip, Tunnel, load
from tramstream.simulation.simulation import Simulation

Array = NDArray[np.float64]

STRAIGHT = "| 900 |"
BENT = "| 60 L80/70 80 R60/90 70 | 90 L40/80 120 |"


@cache
def scenario(**changes: Any) -> Scenario:
    """The reference's sensors with some fields of their sections changed, named `section.field`."""
    chosen = reference()
    for name, value in changes.items():
        section, *fields = name.split("__")
        change: Any = value
        for field in reversed(fields):
            change = {field: change}
        chosen = altered(chosen, **{section: change})
    return chosen


def simulated(plan: str, duration_s: float | None = None, **changes: Any) -> Simulation:
    return Simulation(laid(plan, 0.0), scenario(**changes), 1, duration_s)


def series(plan: str, duration_s: float | None = None, **changes: Any) -> Series:
    return bound.series(simulated(plan, duration_s, **changes))


# Closed forms -------------------------------------------------------------------------------------
def test_fixes_of_a_vehicle_that_stands_average_as_an_autoregressive_process_does() -> None:
    """Information of n fixes with correlation ρ: (1 + (n − 1)(1 − ρ)/(1 + ρ))/σ²."""
    found = series(STRAIGHT, 60.0, driver__first_dwell_s=100.0, gnss__errors__horizontal_std_m=0.7)
    count = np.floor(found.time_s + 1e-9)
    rho = 0.95
    expected = 0.7**2 / (1.0 + count * (1.0 - rho) / (1.0 + rho))
    for axis in (0, 1):
        # The place before the first fix is known to a kilometre, which counts as nothing.
        np.testing.assert_allclose(found.covariance[:, axis, axis], expected, rtol=1e-5)
    np.testing.assert_allclose(found.covariance[:, 0, 1], 0.0, atol=1e-9)


def test_white_errors_average_as_one_over_n() -> None:
    found = series(
        STRAIGHT, 30.0, driver__first_dwell_s=100.0, gnss__errors__decay=0.0, gnss__rate_hz=5.0
    )
    count = np.floor(5.0 * found.time_s + 1e-9) + 1.0
    np.testing.assert_allclose(found.covariance[:, 0, 0], 0.5**2 / count, rtol=1e-5)


def test_bias_of_a_gyroscope_at_rest_follows_the_scalar_riccati_equation() -> None:
    """Its stationary solution is P = q/2 + √(q²/4 + q r) before a reading."""
    found = series(
        STRAIGHT,
        60.0,
        driver__first_dwell_s=100.0,
        imu__errors__gyro_instability_radps=0.0,
        imu__scales__gyro_radps=1e-9,
    )
    errors = reference().imu.errors
    q = errors.gyro_walk_radps2_rthz**2 * STEP_S
    r = errors.gyro_noise_radps_rthz**2 / STEP_S
    before = q / 2.0 + math.sqrt(q * q / 4.0 + q * r)
    np.testing.assert_allclose(found.std[-1, Ix.GYRO_Z] ** 2, before * r / (before + r), rtol=1e-6)


def test_along_a_straight_track_it_is_a_filter_written_down_by_hand() -> None:
    """Without wheels; east is along the track, and what is across does not touch it.

    States: place, speed, pitch, biases of gyroscope and accelerometer, error and delay of fixes,
    height and its error, speed along z and that accelerometer's bias.
    """
    simulation = simulated(STRAIGHT, 90.0, wheels=None, imu__mounting_std_deg=0.0)
    found = bound.series(simulation)
    motion = simulation.ride.motion(np.arange(9001) * STEP_S)
    place, speed, pitch = by_hand(simulation, motion.speed_mps, motion.standing)
    np.testing.assert_allclose(np.sqrt(found.covariance[:, 0, 0]), place, rtol=1e-4)
    np.testing.assert_allclose(found.std[:, Ix.SPEED], speed, rtol=1e-4, atol=2e-6)
    np.testing.assert_allclose(found.std[:, Ix.PITCH], pitch, rtol=1e-4)


def by_hand(simulation: Simulation, speed: Array, stands: NDArray[np.bool_]) -> Array:
    """Deviations of place, speed and pitch, a column every `EVERY` steps."""
    vehicle, imu, gnss = simulation.vehicle, reference().imu, reference().gnss
    level = simulation.line.level
    g = float(normal_gravity_mps2(level.latitude_rad, level.height_m))
    gyro = imu.errors.gyro_noise_radps_rthz**2 + imu.scales.gyro_radps**2 / 12 / imu.rate_hz
    accel = imu.errors.accel_noise_mps2_rthz**2 + imu.scales.accel_mps2**2 / 12 / imu.rate_hz
    delay, keep = math.hypot(vehicle.gnss.delay_std_s, vehicle.imu.delay_std_s), 0.95**STEP_S
    share = vehicle.imu.delay_std_s**2 / delay**2
    bias = vehicle.imu.accel_bias_std_mps2
    std = [1000.0, 0.0, 0.06, vehicle.imu.gyro_bias_std_radps, bias]
    P = np.diag([*std, gnss.errors.horizontal_std_m, delay, 1000.0, 1.0, 0.0, bias]) ** 2
    rest = np.diag([1.0, 1, 1, 1, 1, keep, 1, 1, keep, 1, 1])
    walk = vehicle.imu.accel_walk_mps3_rthz**2 * STEP_S
    walks = [vehicle.imu.gyro_walk_radps2_rthz**2 * STEP_S, walk]
    renewed = np.array([gnss.errors.horizontal_std_m, 1.0]) ** 2 * (1.0 - keep**2)
    Q = np.diag([0, 0, 0, *walks, renewed[0], 0, 0, renewed[1], 0, walk])
    columns = []
    for k, v in enumerate(speed):
        standing = stands[k] and stands[max(k - 1, 0)]
        F = rest.copy()
        if not standing:
            F[0, 1], F[1, 2], F[1, 4], F[2, 3] = STEP_S, g * STEP_S, -STEP_S, -STEP_S
            middle = (v + speed[k - 1]) / 2
            F[7, 2] = F[9, 3] = -middle * STEP_S
            F[7, 9], F[9, 10] = STEP_S, -STEP_S
            turned = np.array([0, 0, 1, 0, 0, 0, 0, 0, 0, middle, 0])
            noise = np.diag([0, accel, 0, 0, 0, 0, 0, 0, 0, accel, 0])
            Q_run = Q + (noise + gyro * np.outer(turned, turned)) * STEP_S
        if k > 0:
            P = F @ P @ F.T + (Q if standing else Q_run)
        rows: list[tuple[dict[int, float], float]] = [({9: 1.0}, 1e-12)]
        if standing:
            rows += [
                ({1: 1.0}, 1e-12),
                ({3: 1.0}, gyro / STEP_S),
                ({2: -g, 4: 1.0}, accel / STEP_S),
            ]
        if k % 100 == 0:
            rows += [({0: 1.0, 5: 1.0, 6: -v}, 0.0), ({7: 1.0, 8: 1.0}, 0.0)]
        for row, variance in rows:
            H = np.zeros(len(P))
            H[list(row)] = list(row.values())
            P = P - np.outer(P @ H, H @ P) / (H @ P @ H + variance)
        if k % bound.EVERY == 0:
            T = np.array([1.0, 0, 0, 0, 0, 0, -share * v, 0, 0, 0, 0])
            columns.append(np.sqrt([T @ P @ T, P[1, 1], P[2, 2]]))
    return np.transpose(columns)


# Figures ------------------------------------------------------------------------------------------
def test_quantile_of_round_errors_is_that_of_rayleigh() -> None:
    covariance = np.tile(np.eye(2) * 0.49, (5, 1, 1))
    expected = 0.7 * math.sqrt(-2.0 * math.log(0.1))
    assert bound.horizontal_quantile_m(covariance, 0.9) == pytest.approx(expected, abs=1e-5)


def test_quantile_of_errors_on_a_line_is_that_of_one_normal_variable() -> None:
    u = np.array([0.6, 0.8])
    covariance = np.outer(u, u)[None]
    assert bound.horizontal_quantile_m(covariance, 0.9) == pytest.approx(1.644854, abs=0.005)


def test_quantile_of_mixed_errors_is_that_of_a_drawn_sample() -> None:
    rng = np.random.default_rng(7)
    factors = rng.normal(size=(20, 2, 2)) * rng.uniform(0.1, 2.0, size=(20, 1, 1))
    covariance = factors @ factors.transpose(0, 2, 1)
    drawn = np.einsum("kij,knj->kni", factors, rng.normal(size=(20, 20_000, 2)))
    expected = np.quantile(np.hypot(drawn[..., 0], drawn[..., 1]), 0.9)
    assert bound.horizontal_quantile_m(covariance, 0.9) == pytest.approx(expected, rel=0.01)


def test_figures_are_means_along_and_across_the_true_heading() -> None:
    yaw = np.array([0.3, 2.0])
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]).transpose(2, 0, 1)
    covariance = turn @ np.diag([0.04, 0.25]) @ turn.transpose(0, 2, 1)
    std = np.zeros((2, len(Ix)))
    std[:, Ix.YAW], std[:, Ix.SPEED] = (1.0, 0.01), (5.0, 0.02)
    found = bound.figures(Series(np.array([0.0, 1.0]), covariance, std, yaw))
    assert found.along_rms_m == pytest.approx(0.2)
    assert found.across_rms_m == pytest.approx(0.5)
    assert found.speed_std_mps == pytest.approx(0.02)  # the heading is not known before
    assert found.yaw_rms_deg == pytest.approx(math.degrees(0.01))


# More sensors, less error -------------------------------------------------------------------------
MORE: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "second wheel": ({"wheels__wheels": ("left",)}, {}),
    "first wheel": ({"wheels": None}, {"wheels__wheels": ("right",)}),
    "velocity": ({}, {"gnss__velocity": True}),
    "more fixes": ({}, {"gnss__rate_hz": 4.0}),
    "fixes in the tunnel": ({"gnss__errors__white_horizontal_std_m": 0.4}, {}),
    "better gyroscopes": ({}, {"imu__errors__gyro_noise_radps_rthz": 1e-5}),
    "calmer bias": ({}, {"imu__errors__gyro_walk_radps2_rthz": 1e-6}),
    "known mounting": ({}, {"imu__mounting_std_deg": 0.0}),
}


@pytest.mark.parametrize("name", MORE)
def test_more_knowledge_never_raises_it(name: str) -> None:
    less, more = (series(BENT, 150.0, **changes) for changes in MORE[name])
    spared = np.linalg.eigvalsh(less.covariance - more.covariance)
    assert spared.min() > -1e-6 * less.covariance.max()
    named = [slot for slot in Ix if slot not in (Ix.SCALE_A, Ix.SCALE_B, Ix.PATH_A, Ix.PATH_B)]
    assert np.all(more.std[:, named] <= less.std[:, named] * (1.0 + 1e-6) + 1e-9)


def test_second_wheel_holds_the_heading() -> None:
    one = bound.bound(simulated(BENT, wheels__wheels=("left",)))
    two = bound.bound(simulated(BENT))
    assert two.yaw_rms_deg < 0.9 * one.yaw_rms_deg
    assert two.across_rms_m < one.across_rms_m


def test_tunnel_lets_it_grow() -> None:
    chosen = altered(reference(), events=(Tunnel(start_s=60.0, duration_s=60.0),))
    dark = bound.series(Simulation(laid(BENT, 0.0), chosen, 1, 118.0))
    light = series(BENT, 118.0)
    trace = np.trace(dark.covariance, axis1=1, axis2=2)
    at_60, at_115 = (int(np.searchsorted(dark.time_s, t)) for t in (59.0, 115.0))
    assert trace[at_115] > 1.5 * trace[at_60]
    np.testing.assert_array_equal(dark.covariance[:at_60], light.covariance[:at_60])


def test_wheel_that_slips_is_worth_no_more_than_none() -> None:
    slip = Slip(start_s=40.0, duration_s=30.0, wheels=("left",), factor=1.2)
    one = {"wheels__wheels": ("left",)}
    clean = series(BENT, 100.0, **one)
    slipping = series(BENT, 100.0, events=(slip,), **one)
    without = series(BENT, 100.0, wheels=None)
    before, at_60, end = (np.searchsorted(clean.time_s, t) for t in (39.0, 60.0, 99.0))
    np.testing.assert_array_equal(slipping.covariance[:before], clean.covariance[:before])
    speed = Ix.SPEED
    assert 2.0 * clean.std[at_60, speed] < slipping.std[at_60, speed] < without.std[at_60, speed]
    assert slipping.std[end, speed] < 1.5 * clean.std[end, speed]  # it counts again


# Against the filter -------------------------------------------------------------------------------
def test_scenario_without_inertial_sensor_has_none() -> None:
    with pytest.raises(ConfigError, match="IMU"):
        series(STRAIGHT, 10.0, imu=None)


@pytest.mark.parametrize("name", ["city", "kaspar2023"])
def test_bound_of_a_whole_scenario_is_finite_and_below_raw_fixes(name: str) -> None:
    chosen = load(name)
    found = bound.bound(Simulation(laid(BENT, 0.0), chosen, 1, 120.0))
    raw = math.sqrt(2.0 * math.log(10.0)) * chosen.gnss.errors.horizontal_std_m
    lever_m = math.hypot(*chosen.gnss.lever_arm_m[:2])  # counts until the heading is known
    assert 0.0 < found.position_p90_m < raw + lever_m
    assert 0.0 < found.speed_std_mps < 0.1
    assert 0.0 < found.yaw_rms_deg < 5.0


@pytest.mark.study
def test_filter_is_not_better_and_hardly_worse() -> None:
    """Mean of eᵀC⁻¹e at the end of 40 rides: χ² of 80 degrees of freedom, 99 % bounds."""
    line, chosen = laid(BENT, 0.0), scenario()
    duration_s = 140.0
    found = bound.series(Simulation(line, chosen, 1, duration_s))
    C = found.covariance[int(np.searchsorted(found.time_s, duration_s - 1.0))]
    ratios = []
    for seed in range(40):
        errors = localised(ridden(line, chosen, seed, duration_s)).at(duration_s - 1.0)
        e = errors.p_l[0, :2]
        ratios.append(e @ np.linalg.solve(C, e))
    low, high = 0.64, 1.45
    assert low < np.mean(ratios) / 2.0 < high * 1.15**2
