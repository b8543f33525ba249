"""The simulated ride: messages against the truth that made them, their times and their order."""

from __future__ import annotations

import math
from collections import defaultdict
from functools import cache
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from tramstream import keys
from tramstream.attitude import C_vl
from tramstream.clock import S
from tramstream.geodesy import normal_gravity_mps2
from tramstream.lines.line import Line, built_in_line
from tramstream.processor import Sample
from tramstream.processors.resampling.resampler import Resampler
from tramstream.simulation import scenario
from tramstream.simulation.imu import ImuErrors, ImuScales, inertial
from tramstream.simulation.receiver import GnssErrors
from tramstream.simulation.scenario import (
    Gnss,
    GnssJump,
    Imu,
    Scenario,
    Slip,
    Timing,
    Tunnel,
    Wheels,
)
from tramstream.simulation.simulation import EPOCH_NS, Simulation

Array = NDArray[np.float64]

MM = 1e-3  # m
STILL = ImuErrors(
    gyro_bias_radps=(0.0, 0.0, 0.0),
    gyro_noise_radps_rthz=0.0,
    gyro_instability_radps=0.0,
    gyro_walk_radps2_rthz=0.0,
    accel_bias_mps2=(0.0, 0.0, 0.0),
    accel_noise_mps2_rthz=0.0,
    accel_instability_mps2=0.0,
    accel_walk_mps3_rthz=0.0,
)
FINE = ImuScales(gyro_radps=1e-7, accel_mps2=1e-6, gyro_range_radps=10.0, accel_range_mps2=1e3)
EXACT = GnssErrors(horizontal_std_m=0.0, vertical_std_m=0.0, velocity_std_mps=0.0)


@cache
def line() -> Line:
    return built_in_line()


def by_key(simulation: Simulation) -> dict[str, list[Sample]]:
    found: dict[str, list[Sample]] = defaultdict(list)
    for sample in simulation.samples():
        found[sample.key.path].append(sample)
    return found


def ridden(duration_s: float = 60.0, seed: int = 1, **fields: Any) -> dict[str, list[Sample]]:
    return by_key(Simulation(line(), Scenario(**fields), seed, duration_s))


def encoded(samples: list[Sample]) -> list[bytes]:
    return [sample.message.SerializeToString() for sample in samples]


# Order and times ----------------------------------------------------------------------------------
@pytest.mark.parametrize("name", scenario.names())
def test_messages_come_in_the_order_of_publication_and_are_numbered(name: str) -> None:
    simulation = Simulation(line(), scenario.load(name), 2, 20.0)
    last_ns, sequences, published = 0, defaultdict(int), defaultdict(int)
    for sample in simulation.samples():
        assert sample.publish_ns >= last_ns
        assert sample.publish_ns >= sample.stamp_ns == sample.message.stamp_ns
        last_ns = sample.publish_ns
        path = sample.key.path
        assert sample.publish_ns > published[path]
        assert sample.sequence == sequences[path] + 1 == sample.message.sequence
        sequences[path], published[path] = sample.sequence, sample.publish_ns
        assert isinstance(sample.message, sample.key.type)
    chosen = simulation.scenario
    assert sequences[keys.TRUTH_STATE.path] == 20 * chosen.truth_rate_hz + 1
    for section, key in (
        (chosen.imu, keys.IMU_BATCH), (chosen.gnss, keys.GNSS_FIX), (chosen.wheels, keys.ODO_WHEELS)
    ):  # fmt: skip
        assert (sequences[key.path] > 0) == (section is not None)


def test_same_seed_gives_the_same_messages_and_samples_may_be_taken_twice() -> None:
    simulation = Simulation(line(), scenario.load("city"), 4, 10.0)
    first, again = by_key(simulation), by_key(simulation)
    other = by_key(Simulation(line(), scenario.load("city"), 5, 10.0))
    assert first.keys() == again.keys()
    for path, samples in first.items():
        assert encoded(samples) == encoded(again[path])
        assert [s.publish_ns for s in samples] == [s.publish_ns for s in again[path]]
    assert encoded(first[keys.GNSS_FIX.path]) != encoded(other[keys.GNSS_FIX.path])
    assert encoded(first[keys.TRUTH_STATE.path]) == encoded(other[keys.TRUTH_STATE.path])


def test_options_of_one_sensor_change_nothing_in_another() -> None:
    chosen = scenario.load("city")
    assert chosen.gnss is not None
    plain = by_key(Simulation(line(), chosen, 4, 20.0))
    changed = msgspec.structs.replace(
        chosen, gnss=msgspec.structs.replace(chosen.gnss, rate_hz=1.0), events=()
    )
    other = by_key(Simulation(line(), changed, 4, 20.0))
    for key in (keys.IMU_BATCH, keys.ODO_WHEELS, keys.TRUTH_STATE):
        assert encoded(plain[key.path]) == encoded(other[key.path])
    without = by_key(Simulation(line(), msgspec.structs.replace(changed, gnss=None), 4, 20.0))
    assert encoded(plain[keys.IMU_BATCH.path]) == encoded(without[keys.IMU_BATCH.path])


def test_stamps_and_publications_are_as_late_as_the_scenario_says() -> None:
    timing = Timing(stamp_offset_s=0.02, stamp_jitter_s=0.001, latency_s=0.1, latency_jitter_s=0.05)
    samples = ridden(400.0, gnss=Gnss(rate_hz=5.0, timing=timing))[keys.GNSS_FIX.path]
    true_ns = EPOCH_NS + np.arange(len(samples)) * S // 5
    stamped = (np.array([sample.stamp_ns for sample in samples]) - true_ns) / S
    sent = (np.array([sample.publish_ns for sample in samples]) - true_ns) / S
    assert np.mean(stamped) == pytest.approx(0.02, abs=4 * 0.001 / math.sqrt(len(samples)))
    assert np.std(stamped) == pytest.approx(0.001, rel=4 / math.sqrt(2 * len(samples)))
    assert 0.1 <= np.min(sent) < 0.101
    assert 0.149 < np.max(sent) <= 0.15


def test_batch_is_published_when_its_last_sample_is_there() -> None:
    samples = ridden(5.0, imu=Imu(rate_hz=1000.0, batch=25))[keys.IMU_BATCH.path]
    assert len(samples) == 200
    for number, sample in enumerate(samples):
        assert sample.stamp_ns == EPOCH_NS + number * 25_000_000
        assert sample.publish_ns == sample.stamp_ns + 24_000_000
        assert sample.message.first_sample_sequence == number * 25
        assert len(sample.message.gyro_x) == len(sample.message.accel_z) == 25


# Truth in the messages ----------------------------------------------------------------------------
def columns(samples: list[Sample], names: tuple[str, str, str], scale: float) -> Array:
    rows = [np.concatenate([getattr(s.message, name) for s in samples]) for name in names]
    return np.stack(rows, axis=1) * scale


@pytest.mark.parametrize("reverse", [False, True])
def test_inertial_samples_are_the_truth_at_the_mounted_case(reverse: bool) -> None:
    section = Imu(
        rate_hz=200.0,
        lever_arm_m=(2.0, 0.3, 1.0),
        lever_arm_error_m=(0.5, 0.0, 0.0),
        mounting_deg=(0.0, 0.0, 90.0),
        misalignment_deg=(1.0, -2.0, 3.0),
        errors=STILL,
        scales=FINE,
    )
    simulation = Simulation(line(), Scenario(imu=section, reverse=reverse), 1, 400.0)
    samples = by_key(simulation)[keys.IMU_BATCH.path]
    count = 20 * len(samples)
    level = line().level
    gravity = float(normal_gravity_mps2(level.latitude_rad, level.height_m))
    motion = simulation.ride.motion(np.arange(count) / 200.0)
    up_l = level.up_l(line().position_l(motion.arc_length_m))
    f_v, omega_v = inertial(motion, gravity, (2.5, 0.3, 1.0), up_l)
    # The case means what the configuration says, turned by what it does not know.
    C_bv = C_vl(*np.radians([1.0, -2.0, 3.0])) @ C_vl(*np.radians([0.0, 0.0, 90.0]))
    accel = columns(samples, ("accel_x", "accel_y", "accel_z"), 1e-6)
    gyro = columns(samples, ("gyro_x", "gyro_y", "gyro_z"), 1e-7)
    np.testing.assert_allclose(accel, f_v @ C_bv.T, atol=0.51e-6)
    np.testing.assert_allclose(gyro, omega_v @ C_bv.T, atol=0.51e-7)


def test_fixes_are_the_truth_of_the_antenna() -> None:
    section = Gnss(
        lever_arm_m=(3.0, 0.2, 3.1), lever_arm_error_m=(-0.5, 0.0, 0.0), errors=EXACT, rate_hz=2.0
    )
    simulation = Simulation(line(), Scenario(gnss=section), 1, 300.0)
    samples = by_key(simulation)[keys.GNSS_FIX.path]
    truth = simulation.truth([sample.stamp_ns for sample in samples])
    motion = truth.motion
    turn = C_vl(motion.roll_rad, motion.pitch_rad, motion.yaw_rad)
    antenna = truth.p_l + np.einsum("nvl,v->nl", turn, [2.5, 0.2, 3.1])
    for row, sample in enumerate(samples):
        fix = sample.message
        assert fix.valid
        geodetic = [math.radians(fix.latitude_deg), math.radians(fix.longitude_deg)]
        p_l = line().level.from_geodetic([*geodetic, fix.height_ellipsoid_m])
        np.testing.assert_allclose(p_l, antenna[row], atol=0.01 * MM)
        assert fix.height_msl_m == pytest.approx(fix.height_ellipsoid_m - 44.5)
        speed = math.hypot(fix.vel_n_mps, fix.vel_e_mps)
        assert fix.speed_mps == pytest.approx(speed)
        turning = abs(motion.yaw_rate_radps[row]) * 3.2
        assert speed == pytest.approx(motion.speed_mps[row], abs=turning + 0.01)
        course = math.radians(90.0 - fix.course_deg)
        if motion.speed_mps[row] > 1.0 and turning < 1e-6:
            assert math.cos(course - motion.yaw_rad[row]) == pytest.approx(1.0, abs=1e-6)


def test_accuracy_is_stated_as_a_u_blox_receiver_does() -> None:
    section = Gnss(errors=GnssErrors(horizontal_std_m=0.3, vertical_std_m=0.7))
    fix = ridden(1.0, gnss=section)[keys.GNSS_FIX.path][0].message
    assert fix.horizontal_std_m == pytest.approx(math.sqrt(2) * 0.3)
    assert fix.vertical_std_m == 0.7
    assert fix.speed_std_mps == pytest.approx(0.05)


def test_receiver_without_velocity_has_no_velocity_fields() -> None:
    fix = ridden(1.0, gnss=Gnss(velocity=False))[keys.GNSS_FIX.path][0].message
    assert not fix.HasField("vel_n_mps")
    assert fix.source == "NMEA"
    assert fix.valid


def test_no_fix_is_valid_in_a_tunnel() -> None:
    tunnel = Tunnel(start_s=10.0, duration_s=20.0)
    samples = ridden(60.0, gnss=Gnss(rate_hz=1.0, reacquisition_s=2.0), events=(tunnel,))
    fixes = [sample.message for sample in samples[keys.GNSS_FIX.path]]
    valid = [fix.valid for fix in fixes]
    assert valid == [not 10 <= second < 32 for second in range(len(valid))]
    assert fixes[15].fix_type == 0
    assert fixes[15].latitude_deg == fixes[9].latitude_deg


def test_jump_moves_the_fixes_and_the_truth_stays() -> None:
    jump = GnssJump(start_s=20.0, duration_s=10.0, east_m=30.0)
    plain = ridden(40.0, gnss=Gnss(rate_hz=1.0))
    jumped = ridden(40.0, gnss=Gnss(rate_hz=1.0), events=(jump,))
    level = line().level
    moved = []
    for one, other in zip(plain[keys.GNSS_FIX.path], jumped[keys.GNSS_FIX.path], strict=True):
        pair = [
            level.from_geodetic(
                [
                    math.radians(fix.latitude_deg),
                    math.radians(fix.longitude_deg),
                    fix.height_ellipsoid_m,
                ]
            )
            for fix in (one.message, other.message)
        ]
        moved.append(pair[1] - pair[0])
    expected = np.zeros((len(moved), 3))
    expected[20:30, 0] = 30.0
    np.testing.assert_allclose(moved, expected, atol=0.01 * MM)
    assert encoded(plain[keys.TRUTH_STATE.path]) == encoded(jumped[keys.TRUTH_STATE.path])


@pytest.mark.parametrize("wheels", [("left", "right"), ("right",), ("left",)])
def test_pulses_are_the_way_of_each_wheel(wheels: tuple[Any, ...]) -> None:
    simulation = Simulation(line(), Scenario(wheels=Wheels(wheels=wheels)), 1, 300.0)
    samples = by_key(simulation)[keys.ODO_WHEELS.path]
    last = samples[-1]
    truth = simulation.truth(last.stamp_ns).motion
    readings = {reading.wheel: reading.pulses for reading in last.message.wheels}
    assert tuple(readings) == wheels
    half_turn = 1.435 / 2 * float(truth.yaw_rad - simulation.truth(EPOCH_NS).motion.yaw_rad)
    for side, sign in (("left", -1.0), ("right", 1.0)):
        if side in readings:
            way = readings[side] * 2 * math.pi * 0.3 / 2048
            # On grades the turn about the vehicle's z is a little less than the yaw.
            assert way == pytest.approx(float(truth.arc_length_m) + sign * half_turn, abs=0.01)
    assert {sample.message.doors_open for sample in samples} == {True, False}
    assert all(sample.message.HasField("motor_force_n") for sample in samples)


def test_slip_stays_in_the_count_of_its_wheel() -> None:
    slip = Slip(start_s=15.0, duration_s=2.0, wheels=("right",), speed_error_mps=1.0)
    section = Wheels(doors=False, motor_force=False)
    plain = ridden(30.0, wheels=section)[keys.ODO_WHEELS.path]
    slipped = ridden(30.0, wheels=section, events=(slip,))[keys.ODO_WHEELS.path]
    for one, other in zip(plain, slipped, strict=True):
        left, right = (
            b.pulses - a.pulses
            for a, b in zip(one.message.wheels, other.message.wheels, strict=True)
        )
        assert left == 0
        time_s = (one.stamp_ns - EPOCH_NS) / S
        assert right * 2 * math.pi * 0.3 / 2048 == pytest.approx(
            min(max(time_s - 15.0, 0.0), 2.0), abs=2 * MM
        )
    assert not plain[0].message.HasField("doors_open")


def test_truth_messages_are_the_truth() -> None:
    simulation = Simulation(line(), Scenario(reverse=True), 1, 100.0)
    for sample in by_key(simulation)[keys.TRUTH_STATE.path][::97]:
        truth = simulation.truth(sample.stamp_ns)
        message = sample.message
        assert message.arc_length_m == truth.motion.arc_length_m
        assert message.speed_mps == truth.motion.speed_mps <= 0
        # What the accelerometer of a vehicle at rest there would show of its attitude.
        up_v = C_vl(truth.motion.roll_rad, truth.motion.pitch_rad, truth.motion.yaw_rad) @ (
            line().level.up_l(truth.p_l)
        )
        assert message.pitch_rad == pytest.approx(-math.asin(up_v[0]), abs=1e-8)
        assert message.roll_rad == pytest.approx(math.atan2(up_v[1], up_v[2]), abs=1e-6)
        assert math.cos(message.yaw_rad - truth.motion.yaw_rad) == pytest.approx(1.0)
        geodetic = [math.radians(message.latitude_deg), math.radians(message.longitude_deg)]
        p_l = line().level.from_geodetic([*geodetic, message.height_ellipsoid_m])
        np.testing.assert_allclose(p_l, truth.p_l, atol=0.01 * MM)


def test_raw_positions_of_kaspar2023_are_as_good_as_the_works() -> None:
    # docs/theory.md, section 3.4: raw horizontal P90 about 1.07 m. Correlated over 20 s, 4,000
    # fixes are about 100 independent ones: P90 of 100 draws deviates by 6 %.
    chosen = msgspec.structs.replace(scenario.load("kaspar2023"), imu=None, wheels=None)
    errors = []
    for seed in range(3):
        simulation = Simulation(line(), chosen, seed)
        samples = by_key(simulation)[keys.GNSS_FIX.path]
        truth = simulation.truth([sample.stamp_ns for sample in samples])
        degrees = [
            [s.message.latitude_deg, s.message.longitude_deg, s.message.height_ellipsoid_m]
            for s in samples
        ]
        geodetic = np.array(degrees) * [math.pi / 180, math.pi / 180, 1.0]
        errors.append(line().level.from_geodetic(geodetic) - truth.p_l)
    away = np.linalg.norm(np.concatenate(errors)[:, :2], axis=1)
    assert np.percentile(away, 90) == pytest.approx(1.07, rel=0.12)


# The vehicle --------------------------------------------------------------------------------------
def test_configuration_knows_the_sensors_but_not_their_errors() -> None:
    simulation = Simulation(line(), scenario.load("city"), 1, 1.0)
    vehicle, chosen = simulation.vehicle, simulation.scenario
    assert vehicle.imu is not None
    assert vehicle.gnss is not None
    assert chosen.imu is not None
    assert chosen.gnss is not None
    assert vehicle.imu.lever_arm_m == chosen.imu.lever_arm_m
    assert vehicle.imu.mounting_deg == chosen.imu.mounting_deg
    assert vehicle.imu.gyro_noise_radps_rthz == chosen.imu.errors.gyro_noise_radps_rthz
    assert vehicle.gnss.lever_arm_m == chosen.gnss.lever_arm_m
    assert vehicle.gnss.receiver_delay_s == chosen.gnss.timing.latency_s
    assert vehicle.gnss.error_tau_s == pytest.approx(-1 / math.log(0.95))
    assert vehicle.wheels.m_per_pulse == pytest.approx(2 * math.pi * 0.3 / 2048)
    assert vehicle.wheels.delay_s == 0.0
    assert vehicle.resampler.factor == 20
    from tramstream import config, config_file

    text = config_file.to_json(vehicle)
    assert msgspec.json.decode(text.encode(), type=config.Vehicle) == vehicle


def test_configuration_leaves_out_what_is_not_there() -> None:
    vehicle = Simulation(line(), scenario.load("pusman2017"), 1, 1.0).vehicle
    assert vehicle.gnss is None
    assert vehicle.odometer is None
    assert vehicle.resampler.method == "lowpass"
    one = Simulation(line(), Scenario(wheels=Wheels(wheels=("left",))), 1, 1.0).vehicle
    assert one.odometer is not None
    assert list(one.odometer.wheels) == ["left"]


@pytest.mark.parametrize(
    ("name", "rate_hz"), [("kaspar2023", 100), ("city", 100), ("pusman2017", 80)]
)
def test_resampler_of_the_configuration_orders_the_ride(name: str, rate_hz: int) -> None:
    simulation = Simulation(line(), scenario.load(name), 1, 12.0)
    resampler = Resampler(simulation.vehicle)
    inputs = {key.path for key in Resampler.inputs}
    made: dict[str, int] = defaultdict(int)
    for sample in simulation.samples():
        if sample.key.path in inputs:
            for output in resampler.step(sample):
                made[output.key.path] += 1
    # The low-pass of pusman2017 needs 0.1 s on either side.
    assert made[keys.SYNC_IMU.path] == pytest.approx(12 * rate_hz, abs=20)
    assert made[keys.SYNC_FRAME.path] == pytest.approx(11.7 * rate_hz, abs=20)
    assert keys.SYNC_LATE.path not in made
    assert keys.SYNC_GAP.path not in made


def test_duration_is_that_of_the_ride_unless_it_is_cut_short() -> None:
    whole = Simulation(line(), Scenario(end_s=7.0))
    assert whole.duration_s == pytest.approx(whole.ride.duration_s + 7.0)
    assert Simulation(line(), Scenario(), duration_s=3.0).duration_s == 3.0
    assert len(ridden(3.0)[keys.TRUTH_STATE.path]) == 61
