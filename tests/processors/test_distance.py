"""The travelled-distance filter against true trajectories, and every way to lose its inputs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2
from streams import MS, START_NS, fix, frame, messages, step_all, wheels

from tramstream import keys, snapshots
from tramstream.clock import S
from tramstream.config import Distance, Vehicle
from tramstream.processor import Sample
from tramstream.processors.distance import MAX_REFUSALS, DistanceFilter
from tramstream.proto.estimate_pb2 import DistanceState
from tramstream.proto.raw_pb2 import Odometry, WheelReading

M_PER_PULSE = Distance().m_per_pulse
STEP_NS = 20 * MS
MM = 1e-3

Motion = Callable[[float], float]


def distance_filter(**fields: float) -> DistanceFilter:
    return DistanceFilter(Vehicle(vehicle="test", distance=Distance(**fields)))


def departure(time_s: float) -> float:
    """Stand for 2 s, 1 m/s² for 10 s, 10 m/s for 10 s, brake with 1 m/s², stand."""
    moving_s = min(max(time_s - 2.0, 0.0), 10.0)
    cruising_s = min(max(time_s - 12.0, 0.0), 10.0)
    braking_s = min(max(time_s - 22.0, 0.0), 10.0)
    return 0.5 * moving_s**2 + 10.0 * cruising_s + 10.0 * braking_s - 0.5 * braking_s**2


def speed_of(motion: Motion, time_s: float) -> float:
    return (motion(time_s + 1e-4) - motion(time_s - 1e-4)) / 2e-4


def pulses_of(motion: Motion, time_s: float, m_per_pulse: float = M_PER_PULSE) -> int:
    return int(np.floor(motion(time_s) / m_per_pulse))


def stamp_at(time_s: float) -> int:
    return START_NS + round(time_s * S)


def wheel_frames(motion: Motion, begin_s: float, end_s: float, offset: int = 0) -> list[Sample]:
    """One frame per reading of two wheels, 50 Hz."""
    frames = []
    for index in range(round(begin_s * 50), round(end_s * 50)):
        count = pulses_of(motion, index / 50) + offset
        stamp_ns = stamp_at(index / 50)
        frames.append(frame(stamp_ns, wheels(stamp_ns, [count, count])))
    return frames


def fix_frames(motion: Motion, begin_s: float, end_s: float, valid: bool = True) -> list[Sample]:
    """One frame per fix, 5 Hz, between the wheels' readings."""
    frames = []
    for index in range(round(begin_s * 5), round(end_s * 5)):
        time_s = index / 5 + 0.01
        speed_mps = abs(speed_of(motion, time_s))
        frames.append(frame(stamp_at(time_s), fix(stamp_at(time_s), speed_mps, valid=valid)))
    return frames


def merged(*streams: list[Sample]) -> list[Sample]:
    return sorted((sample for stream in streams for sample in stream), key=lambda s: s.stamp_ns)


def states(outputs: list[Sample]) -> list[DistanceState]:
    return messages(outputs, keys.EST_DISTANCE)


def errors_m(found: list[DistanceState], motion: Motion) -> np.ndarray:
    return np.array(
        [state.distance_m - motion((state.stamp_ns - START_NS) / S) for state in found]
    )


# On a ride ------------------------------------------------------------------------------------------
def test_quantised_pulses_give_distance_within_two_pulses_and_the_speed() -> None:
    found = states(step_all(distance_filter(), wheel_frames(departure, 0.0, 35.0)))
    assert len(found) == 35 * 50
    assert np.abs(errors_m(found, departure)).max() < 2 * M_PER_PULSE
    for state in found[50:]:
        true_mps = speed_of(departure, (state.stamp_ns - START_NS) / S)
        assert abs(state.speed_mps - true_mps) < 0.1  # a jerk of a whole m/s² at once
    assert all(i.accepted for state in found for i in state.innovations)


def test_state_is_published_for_frames_with_measurements_only() -> None:
    processor = distance_filter()
    assert step_all(processor, [frame(START_NS)]) == []
    (state,) = states(step_all(processor, [frame(START_NS + S, wheels(START_NS, [5]))]))
    assert state.stamp_ns == START_NS
    assert state.distance_m == 0.0


def test_measurements_of_one_frame_are_taken_in_the_order_of_their_stamps() -> None:
    first = frame(START_NS, wheels(START_NS, [0]))
    sent = [wheels(START_NS + n * MS, [n]) for n in (20, 40)] + [fix(START_NS + 30 * MS, 0.05)]
    one, other = distance_filter(), distance_filter()
    together = step_all(one, [first, frame(START_NS + 50 * MS, *reversed(sent))])
    apart = step_all(other, [first, *(frame(s.stamp_ns, s) for s in merged(sent))])
    assert states(together)[-1].distance_m == states(apart)[-1].distance_m
    assert [i.measurement for i in states(together)[-1].innovations] == [
        "wheel_path",
        "gnss_speed",
        "wheel_path",
    ]


def test_speed_of_gnss_alone_is_integrated() -> None:
    found = states(step_all(distance_filter(), fix_frames(departure, 0.0, 35.0)))
    assert abs(errors_m(found, departure)[-1]) < 3 * found[-1].distance_std_m
    assert found[-1].distance_std_m < 2.0
    assert found[-1].distance_m == pytest.approx(200.0, abs=1.0)


def test_wheels_that_give_a_speed_are_integrated() -> None:
    frames = []
    for index in range(35 * 50):
        speed_mps = speed_of(departure, index / 50)
        reading = WheelReading(wheel="left", speed_mps=speed_mps)
        message = Odometry(stamp_ns=stamp_at(index / 50), wheels=[reading])
        sample = Sample(keys.ODO_WHEELS, message, message.stamp_ns, index)
        frames.append(frame(message.stamp_ns, sample))
    found = states(step_all(distance_filter(), frames))
    assert found[-1].distance_m == pytest.approx(200.0, abs=0.5)
    assert found[-1].innovations[0].measurement == "wheel_speed"


def test_backward_motion_is_counted_backwards_and_gnss_speed_follows_its_sign() -> None:
    def backward(time_s: float) -> float:
        return -departure(time_s)

    sent = merged(wheel_frames(backward, 0.0, 35.0), fix_frames(backward, 0.0, 35.0))
    found = states(step_all(distance_filter(), sent))
    assert found[-1].distance_m == pytest.approx(-200.0, abs=2 * MM)
    assert min(state.speed_mps for state in found) == pytest.approx(-10.0, abs=0.05)


# Consistency ----------------------------------------------------------------------------------------
def test_nees_lies_inside_both_bounds_for_simulated_white_acceleration() -> None:
    """Truth by the filter's own model; noise makes up a third of a pulse² with the rounding."""
    runs, readings, acceleration_std, m_per_pulse = 100, 150, 0.8, 0.05
    nees = np.zeros(runs)
    for run in range(runs):
        rng = np.random.default_rng(run)
        processor = distance_filter(acceleration_std_mps2=acceleration_std, m_per_pulse=m_per_pulse)
        s, v = 0.0, rng.normal(5.0, 1.0)
        stamp_ns = START_NS
        for _ in range(readings):
            dt_s = float(rng.uniform(0.05, 0.2))
            a = rng.normal(0.0, acceleration_std)
            s, v = s + v * dt_s + 0.5 * a * dt_s**2, v + a * dt_s
            stamp_ns += round(dt_s * S)
            count = round(s / m_per_pulse + rng.normal(0.0, np.sqrt(1 / 3 - 1 / 12)))
            outputs = processor.step(frame(stamp_ns, wheels(stamp_ns, [count])))
            if stamp_ns - START_NS < S:  # the tie's own error is part of the answer
                first = s
        (state,) = states(outputs)
        del first
        start_m = nees_start(run, m_per_pulse, acceleration_std)
        error = np.array([state.distance_m - (s - start_m), state.speed_mps - v])
        P = np.reshape(state.covariance, (2, 2))
        nees[run] = error @ np.linalg.solve(P, error)
    low, high = chi2.ppf([0.025, 0.975], 2 * runs)
    assert low <= nees.sum() <= high
