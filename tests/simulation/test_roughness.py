"""What shakes the vehicle: strength and frequency against the figures asked for, and nothing that
adds up."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tramstream import keys
from tramstream.geodesy import LocalLevel
from tramstream.lines.line import Line, parse_plan
from tramstream.simulation.ride import Limits, Ride
from tramstream.simulation.roughness import Roughness, Shaking
from tramstream.simulation.scenario import Imu, Scenario, Track
from tramstream.simulation.simulation import Simulation

Array = NDArray[np.float64]

HZ = 400.0


@cache
def ride(speed_mps: float = 10.0, reverse: bool = False) -> Ride:
    segments, stops_m = parse_plan("| 1500 | 1500 |")
    line = Line(segments, stops_m, LocalLevel.at_deg(50.0, 14.0, 250.0))
    limits = Limits(speed_mps=speed_mps, acceleration_mps2=1.0, jerk_mps3=1.0, dwell_s=20.0)
    return Ride(line, limits, reverse)


def felt(
    speed_mps: float = 10.0,
    pivots_m: tuple[float, ...] = (0.0,),
    reverse: bool = False,
    **fields: Any,
) -> tuple[Array, Array, Array]:
    """Times, forces and rates of a whole ride."""
    of = ride(speed_mps, reverse)
    time_s = np.arange(0.0, of.duration_s + 5.0, 1.0 / HZ)
    shaking = Shaking(Roughness(**fields), of, pivots_m, np.random.default_rng(2))
    return time_s, *shaking.felt(of.motion(time_s), time_s)


def cruising(time_s: Array, speed_mps: float = 10.0) -> NDArray[np.bool_]:
    found: NDArray[np.bool_] = np.abs(ride(speed_mps).motion(time_s).speed_mps - speed_mps) < 1e-9
    return found


def test_waves_are_as_strong_as_asked_for_at_10_mps_and_grow_with_the_speed() -> None:
    asked: dict[str, Any] = {"waves_mps2": (0.1, 0.2, 0.3), "waves_radps": (0.01, 0.02, 0.005)}
    for speed in (10.0, 5.0):
        time_s, force, rate = felt(speed, **asked)
        moving = cruising(time_s, speed)
        strength = np.std(force[moving], axis=0) / (speed / 10.0) ** 2
        np.testing.assert_allclose(strength, asked["waves_mps2"], rtol=0.1)
        strength = np.std(rate[moving], axis=0) / (speed / 10.0)
        np.testing.assert_allclose(strength, asked["waves_radps"], rtol=0.1)


@pytest.mark.parametrize("speed", [5.0, 10.0])
def test_frequencies_of_waves_are_the_speed_over_their_lengths(speed: float) -> None:
    time_s, force, _ = felt(speed, waves_mps2=(0.0, 0.0, 0.3), wave_length_m=(1.0, 2.5))
    moving = np.flatnonzero(cruising(time_s, speed))[: int(60 * HZ)]
    power = np.abs(np.fft.rfft(force[moving, 2] * np.hanning(len(moving)))) ** 2
    hz = np.fft.rfftfreq(len(moving), 1.0 / HZ)
    within = (hz > speed / 2.5 - 0.2) & (hz < speed / 1.0 + 0.2)
    assert power[within].sum() / power.sum() > 0.999
    half = (hz > speed / 1.6) & within  # lengths are even in their logarithm
    assert 0.2 < power[half].sum() / power.sum() < 0.8


@pytest.mark.parametrize("reverse", [False, True])
def test_nothing_that_is_felt_adds_up_to_a_speed_or_a_turn(reverse: bool) -> None:
    time_s, force, rate = felt(
        reverse=reverse,
        waves_mps2=(0.3, 0.3, 0.3),
        waves_radps=(0.02, 0.02, 0.02),
        joint_m=20.0,
        joint_mps2=(0.2, 0.0, 2.0),
        jolts_per_km=5.0,
        jolt_mps2=(0.2, 1.0, 2.0),
        idle_mps2=(0.2, 0.2, 0.2),
    )
    stops = ride(reverse=reverse).dwells_s[:, 0] + 10.0
    for until_s in stops[1:]:
        gone = time_s < until_s
        speed = np.sum(force[gone], axis=0) / HZ
        assert np.abs(speed).max() < 0.01  # m/s, of 150 s with 0.3 m/s²; white noise: 0.2
        assert np.degrees(np.abs(np.sum(rate[gone], axis=0) / HZ)).max() < 0.3


def test_joints_are_felt_by_each_pivot_at_its_time_as_strong_as_the_speed() -> None:
    time_s, force, _ = felt(
        pivots_m=(0.0, -6.0), joint_m=25.0, joint_mps2=(0.0, 0.0, 2.0), knock_hz=10.0
    )
    moving = cruising(time_s)
    assert np.abs(force[moving, 2]).max() == pytest.approx(2.0, rel=0.05)
    motion = ride().motion(time_s)
    calm = np.abs(force[:, 2]) < 1e-3
    since = np.minimum(motion.arc_length_m % 25.0, (motion.arc_length_m - 6.0) % 25.0)
    assert calm[moving & (since > 9.0)].all()
    strong = np.abs(force[:, 2]) > 1.0
    assert (since[moving & strong] < 2.0).all()
    joints = np.floor(motion.arc_length_m[moving & strong] / 25.0)
    assert len(np.unique(joints)) > 50


def test_machines_shake_while_the_vehicle_stands_at_25_to_30_hz() -> None:
    time_s, force, rate = felt(idle_mps2=(0.1, 0.2, 0.3), idle_radps=(0.01, 0.0, 0.0))
    standing = ride().motion(time_s).standing
    arrival_s, departure_s = ride().dwells_s[1]
    stop = (time_s > arrival_s) & (time_s < departure_s)
    np.testing.assert_allclose(np.std(force[stop], axis=0), (0.1, 0.2, 0.3), rtol=0.1)
    assert np.std(rate[stop, 0]) == pytest.approx(0.01, rel=0.1)
    assert not np.any(np.abs(force[cruising(time_s)]) > 1e-12)
    power = np.abs(np.fft.rfft(force[stop, 2] * np.hanning(stop.sum()))) ** 2
    hz = np.fft.rfftfreq(int(stop.sum()), 1.0 / HZ)
    assert power[(hz > 24.8) & (hz < 30.2)].sum() / power.sum() > 0.999
    assert standing[stop].all()


def test_imu_feels_what_is_asked_for_and_the_rest_of_the_ride_stays_as_it_is() -> None:
    def recorded(track: Track) -> dict[str, list[bytes]]:
        chosen = Scenario(imu=Imu(rate_hz=200.0), track=track)
        samples = Simulation(ride().line, chosen, 5, 60.0).samples()
        found: dict[str, list[bytes]] = {}
        for each in samples:
            found.setdefault(each.key.path, []).append(each.message.SerializeToString())
        return found

    rough = Track(roughness=Roughness(waves_mps2=(0.0, 0.0, 0.3)))
    plain, shaken, again = recorded(Track()), recorded(rough), recorded(rough)
    assert shaken == again
    assert plain[keys.TRUTH_STATE.path] == shaken[keys.TRUTH_STATE.path]
    assert plain[keys.IMU_BATCH.path] != shaken[keys.IMU_BATCH.path]
    nothing = Track(roughness=Roughness(joint_mps2=(0.0, 0.0, 1.0)))  # welded
    assert recorded(nothing) == plain


def test_reversed_ride_feels_the_same_rails() -> None:
    asked: dict[str, Any] = {"waves_mps2": (0.0, 0.0, 0.3)}
    _, there, _ = felt(**asked)
    _, reversed_, _ = felt(reverse=True, **asked)
    np.testing.assert_allclose(np.std(reversed_[:, 2]), np.std(there[:, 2]), rtol=0.05)
    assert math.isfinite(float(reversed_.sum()))
