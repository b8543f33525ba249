"""The travelled-distance filter against true trajectories, and every way to lose its inputs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rides import altered, laid, ridden, time_s
from scipy.stats import chi2
from streams import MS, START_NS, fix, frame, messages, step_all, wheels

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Distance, Vehicle, Wheels
from tramstream.live import snapshots
from tramstream.processor import Sample
from tramstream.processors.distance.processor import MAX_REFUSALS, DistanceFilter
from tramstream.proto.estimate_pb2 import DistanceState
from tramstream.proto.raw_pb2 import Odometry, WheelReading
from tramstream.proto.sync_pb2 import SyncFrame
from tramstream.simulation import scenario

M_PER_PULSE = Wheels().m_per_pulse
STEP_NS = 20 * MS
MM = 1e-3

Motion = Callable[[float], float]


def distance_filter(**fields: float) -> DistanceFilter:
    """A filter that believes the stamps, which are exact here unless a test says otherwise."""
    wheels = {name: fields.pop(name) for name in ("stamp_std_s", "m_per_pulse") if name in fields}
    wheels = {"stamp_std_s": 0.0, **wheels}
    return DistanceFilter(
        Vehicle(vehicle="test", wheels=Wheels(**wheels), distance=Distance(**fields))
    )


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
    return np.array([state.distance_m - motion((state.stamp_ns - START_NS) / S) for state in found])


# On a ride ----------------------------------------------------------------------------------------
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


def test_ride_in_reverse_goes_on_backwards_by_the_receivers_speed_alone() -> None:
    """The speed over ground has no sign; wheels are lost while the vehicle backs, braking and all.

    Truth is the simulated ride: distance falls as the vehicle's way does, speed is below zero.
    """
    chosen = altered(scenario.load("kaspar2023"), reverse=True, driver={"speed_mps": 9.0})
    chosen = altered(chosen, gnss={"velocity": True, "rate_hz": 5.0, "errors": {"decay": 0.0}})
    ride = ridden(laid("| 200 | 100 |"), chosen, 1, 60.0)
    lost_s = ride.departure_s(1) + 8.0
    frames = [SyncFrame.FromString(each.SerializeToString()) for each in ride.frames]
    for each in frames:
        if time_s(each.stamp_ns) > lost_s:
            del each.odometry[:]
    sent = [Sample(keys.SYNC_FRAME, each, each.stamp_ns, 1) for each in frames]
    found = states(step_all(DistanceFilter(ride.simulation.vehicle), sent))
    found = [state for state in found if lost_s < time_s(state.stamp_ns) < ride.arrival_s(2)]
    truth = ride.simulation.truth(np.array([state.stamp_ns for state in found]))
    backing = truth.motion.speed_mps < -1.0
    assert backing.sum() > 50
    speed_mps = np.array([state.speed_mps for state in found])
    assert (speed_mps[backing] < 0.0).all()
    assert np.abs(speed_mps - truth.motion.speed_mps)[backing].max() < 1.0
    accepted = [i.accepted for state in found for i in state.innovations]
    assert np.mean(accepted) > 0.95
    way_m = -np.linalg.norm(np.diff(truth.p_l[[0, -1]], axis=0))
    assert found[-1].distance_m - found[0].distance_m == pytest.approx(way_m, abs=2.0)


# Consistency --------------------------------------------------------------------------------------
ACCELERATION_STD_MPS2 = 0.8
COARSE_M_PER_PULSE = 0.05


def final_nees(seed: int, break_s: float = 0.0) -> float:
    """NEES at the end of a ride that obeys the filter's model.

    Noise makes up a third of a pulse² together with the rounding. In a break the wheels are away
    and counted from zero afterwards; GNSS speed goes on.
    """
    rng = np.random.default_rng(seed)
    processor = distance_filter(
        acceleration_std_mps2=ACCELERATION_STD_MPS2, m_per_pulse=COARSE_M_PER_PULSE
    )
    s, v, start_m, zero_m = 0.0, rng.normal(8.0, 1.0), None, 0.0
    time_s, break_at_s, outputs = 0.0, 10.0, []
    while time_s < 20.0 + break_s:
        dt_s = round(float(rng.uniform(0.05, 0.15)), 6)
        a = rng.normal(0.0, ACCELERATION_STD_MPS2)
        s, v = s + v * dt_s + 0.5 * a * dt_s**2, v + a * dt_s
        time_s += dt_s
        stamp_ns = stamp_at(time_s)
        if start_m is None:
            start_m = s
        if break_at_s <= time_s < break_at_s + break_s:
            zero_m = s
            sample = fix(stamp_ns, abs(v + rng.normal(0.0, 0.1)))
        else:
            noise = rng.normal(0.0, np.sqrt(1 / 3 - 1 / 12))
            sample = wheels(stamp_ns, [round((s - zero_m) / COARSE_M_PER_PULSE + noise)])
        outputs += processor.step(frame(stamp_ns, sample))
    state = states(outputs)[-1]
    error = np.array([state.distance_m - (s - start_m), state.speed_mps - v])
    return float(error @ np.linalg.solve(np.reshape(state.covariance, (2, 2)), error))


def test_jitter_of_the_stamps_is_smoothed_and_not_believed() -> None:
    """With jitter of 3 ms the speed is known much better than from one reading to the next."""
    rng = np.random.default_rng(8)
    std_s = 0.003
    frames = []
    for index in range(35 * 50):
        count = pulses_of(departure, index / 50)
        stamp_ns = stamp_at(index / 50 + rng.normal(0.0, std_s))
        frames.append(frame(stamp_ns, wheels(stamp_ns, [count, count])))
    found = states(step_all(distance_filter(stamp_std_s=std_s), frames))
    cruising = [s for s in found if stamp_at(14.0) < s.stamp_ns < stamp_at(21.0)]
    error = np.array([s.speed_mps - 10.0 for s in cruising])
    claimed = np.array([s.speed_std_mps for s in cruising])
    one_step_mps = np.sqrt(2.0) * 10.0 * std_s / 0.02
    assert np.sqrt(np.mean(error**2)) < one_step_mps / 15.0
    assert 0.3 < np.mean(error**2) / np.mean(claimed**2) < 1.5
    assert np.sqrt(np.mean(errors_m(cruising, departure) ** 2)) < 10.0 * std_s


@pytest.mark.parametrize("break_s", [0.0, 8.0])
def test_nees_lies_inside_both_bounds(break_s: float) -> None:
    runs = 80
    total = sum(final_nees(seed, break_s) for seed in range(runs))
    low, high = chi2.ppf([0.025, 0.975], 2 * runs)
    assert low <= total <= high


def test_published_deviations_are_those_of_the_covariance() -> None:
    for state in states(step_all(distance_filter(), fix_frames(departure, 0.0, 5.0))):
        P = np.reshape(state.covariance, (2, 2))
        assert np.array_equal(P, P.T)
        np.testing.assert_allclose(
            np.sqrt(np.diag(P)), [state.distance_std_m, state.speed_std_mps], rtol=1e-12
        )


# Faults -------------------------------------------------------------------------------------------
def test_reset_counter_goes_on_from_the_estimate() -> None:
    before = wheel_frames(departure, 0.0, 15.0)
    after = wheel_frames(departure, 15.0, 35.0, offset=-pulses_of(departure, 15.0))
    found = states(step_all(distance_filter(), [*before, *after]))
    assert np.abs(errors_m(found, departure)).max() < 3 * MM
    assert all(i.accepted for state in found for i in state.innovations)


def test_one_spike_of_the_wheels_is_refused_and_leaves_no_trace() -> None:
    frames = wheel_frames(departure, 0.0, 35.0)
    clean = states(step_all(distance_filter(), frames))
    spiked = list(frames)
    stamp_ns = frames[800].stamp_ns
    count = pulses_of(departure, 16.0) + 500
    spiked[800] = frame(stamp_ns, wheels(stamp_ns, [count, count]))
    found = states(step_all(distance_filter(), spiked))
    refused = [n for n, state in enumerate(found) if not state.innovations[0].accepted]
    assert refused == [800]
    assert found[800].innovations[0].value == pytest.approx(500 * M_PER_PULSE, abs=5 * MM)
    assert abs(found[-1].distance_m - clean[-1].distance_m) < MM


def test_slipping_wheels_lose_their_path_for_a_second_and_not_the_distance() -> None:
    def slipping(time_s: float) -> float:
        """Two metres too much from second 16 to 16.5."""
        return departure(time_s) + 4.0 * min(max(time_s - 16.0, 0.0), 0.5)

    sent = merged(wheel_frames(slipping, 0.0, 35.0), fix_frames(departure, 0.0, 35.0))
    found = states(step_all(distance_filter(), sent))
    error = np.abs(errors_m(found, departure))
    assert error[-1] < 3 * found[-1].distance_std_m
    assert found[-1].distance_std_m < 0.5
    late = [state for state in found if state.stamp_ns > stamp_at(20.0)]
    assert all(i.accepted for state in late for i in state.innovations)


def test_wheels_lost_midway_and_back_again() -> None:
    lost_s, back_s = 14.0, 20.0
    sent = merged(
        wheel_frames(departure, 0.0, lost_s),
        # A bridge that counts what it hears: pulses of the break are missing in its sum.
        wheel_frames(
            departure,
            back_s,
            35.0,
            offset=pulses_of(departure, lost_s) - pulses_of(departure, back_s),
        ),
        fix_frames(departure, 0.0, 35.0),
    )
    found = states(step_all(distance_filter(), sent))
    error, std = errors_m(found, departure), np.array([state.distance_std_m for state in found])
    assert (np.abs(error) < 4 * std + MM).all()
    assert found[-1].distance_m == pytest.approx(200.0, abs=1.0)
    assert found[-1].speed_mps == pytest.approx(0.0, abs=0.05)


def test_error_made_before_the_wheels_were_tied_stays_in_the_covariance() -> None:
    sent = merged(fix_frames(departure, 0.0, 15.0), wheel_frames(departure, 15.0, 35.0))
    found = states(step_all(distance_filter(), sent))
    tied = next(state for state in found if state.innovations[0].measurement == "wheel_path")
    assert tied.distance_std_m > 0.05
    assert found[-1].distance_std_m == pytest.approx(tied.distance_std_m, rel=0.01)


def test_wheel_that_drops_out_of_the_reading_does_not_move_the_tram() -> None:
    frames = []
    for index in range(35 * 50):
        left = pulses_of(departure, index / 50)
        right = round(1.013 * left)  # another radius: metres apart after a while
        counts = [left, right] if index < 900 else [left]
        stamp_ns = stamp_at(index / 50)
        frames.append(frame(stamp_ns, wheels(stamp_ns, counts)))
    found = states(step_all(distance_filter(), frames))
    assert all(i.accepted for state in found for i in state.innovations)
    steps = np.diff([state.distance_m for state in found])
    assert np.abs(steps).max() < 10.2 * 0.02


def test_path_that_stays_refused_is_tied_anew_even_while_wheel_speeds_are_right() -> None:
    processor = distance_filter()
    refused = 0
    for index in range(200):
        stamp_ns = START_NS + index * STEP_NS
        count = 200 * index + (1000 if index >= 100 else 0)  # 0.9 m: less than a reset
        speed_mps = 200 * M_PER_PULSE / 0.02
        reading = WheelReading(wheel="left", pulses=count, speed_mps=speed_mps)
        message = Odometry(stamp_ns=stamp_ns, wheels=[reading])
        sample = Sample(keys.ODO_WHEELS, message, stamp_ns, index)
        (state,) = states(step_all(processor, [frame(stamp_ns, sample)]))
        refused += not state.innovations[0].accepted
    assert refused == MAX_REFUSALS
    assert state.innovations[0].accepted
    assert state.distance_m == pytest.approx(199 * 200 * M_PER_PULSE, abs=0.05)


def test_invalid_fixes_are_ignored_and_counted() -> None:
    processor = distance_filter()
    assert step_all(processor, fix_frames(departure, 0.0, 10.0, valid=False)) == []
    (ledger,) = processor.ledgers()
    assert (ledger.received, ledger.delivered, ledger.dropped) == (50, 0, 50)


def test_reading_without_wheels_is_ignored() -> None:
    processor = distance_filter()
    message = Odometry(stamp_ns=START_NS, doors_open=True)
    sample = Sample(keys.ODO_WHEELS, message, START_NS, 1)
    assert step_all(processor, [frame(START_NS, sample)]) == []


def test_speed_that_is_no_number_is_refused() -> None:
    processor = distance_filter()
    step_all(processor, wheel_frames(departure, 0.0, 5.0))
    stamp_ns = stamp_at(5.0)
    (state,) = states(step_all(processor, [frame(stamp_ns, fix(stamp_ns, float("nan")))]))
    assert not state.innovations[0].accepted
    assert np.isfinite([state.distance_m, state.speed_mps]).all()


def test_after_a_gap_as_long_as_a_tunnel_speed_is_unknown_and_distance_uncertain() -> None:
    processor = distance_filter()
    step_all(processor, wheel_frames(departure, 0.0, 15.0))
    stamp_ns = stamp_at(15.0 + 300.0)
    (state,) = states(step_all(processor, [frame(stamp_ns, fix(stamp_ns, 8.0))]))
    assert state.innovations[0].accepted
    assert state.speed_mps == pytest.approx(8.0, abs=0.1)
    assert state.distance_std_m > 1000.0


def test_reversed_stamps_neither_raise_nor_turn_time_back() -> None:
    processor = distance_filter()
    found = states(step_all(processor, list(reversed(wheel_frames(departure, 0.0, 5.0)))))
    assert len({state.stamp_ns for state in found}) == 1


# Memory -------------------------------------------------------------------------------------------
def eventful() -> list[Sample]:
    """Wheels, fixes, a reset, a spike, a loss, invalid fixes."""
    return merged(
        wheel_frames(departure, 0.0, 6.0),
        wheel_frames(departure, 6.0, 7.0, offset=-pulses_of(departure, 6.0)),
        wheel_frames(departure, 9.0, 12.0, offset=300),
        fix_frames(departure, 0.0, 10.0),
        fix_frames(departure, 10.0, 11.0, valid=False),
    )


@settings(max_examples=20)
@given(data=st.data())
def test_restored_filter_goes_on_with_the_same_bytes(data: st.DataObject) -> None:
    samples = eventful()
    whole = [m.SerializeToString() for m in states(step_all(distance_filter(), samples))]
    cut = data.draw(st.integers(0, len(samples)))
    before, after = distance_filter(), distance_filter()
    outputs = step_all(before, samples[:cut])
    state = snapshots.pack(before.snapshot())
    step_all(before, samples[cut:])
    after.restore(snapshots.unpack(state))
    assert snapshots.pack(after.snapshot()) == state
    outputs += step_all(after, samples[cut:])
    assert [m.SerializeToString() for m in states(outputs)] == whole
