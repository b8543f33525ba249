"""The smoother: filterpy's on frozen derivatives as authority; simulated rides; what cuts one."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
import rides
from filterpy.kalman import KalmanFilter
from numpy.random import Generator
from rides import Errors, Ride, altered, judged, reference, ridden, time_s
from seeds import seeds

from tramstream.analysis.evaluate.consistency import chi_square_interval, quadratic_form
from tramstream.config import Gnss, Imu, Vehicle
from tramstream.estimation.localiser import DEAD_RECKONING, TRACKING, Estimate
from tramstream.estimation.records import numbers, one
from tramstream.lines.line import built_in_line
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.smoothing.smoother import Smoothed, smooth
from tramstream.processors.smoothing.trace import EVERY_NS, Trace, Tracer
from tramstream.processors.tram.localiser import BLIND_S, TramLocaliser
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_model.gnss_position import GnssHeight, GnssPosition
from tramstream.processors.tram_model.gnss_velocity import GnssVelocity
from tramstream.processors.tram_model.lateral_force import LateralForce
from tramstream.processors.tram_model.level_force import LevelForce
from tramstream.processors.tram_model.records import INERTIAL, READING
from tramstream.processors.tram_model.states import SIZE, Ix
from tramstream.processors.tram_model.wheel_path import WheelPath
from tramstream.processors.tram_model.wheel_speed import WheelSpeed
from tramstream.processors.tram_model.zero_angular_rate import ZeroAngularRate
from tramstream.proto.sync_pb2 import SyncFrame
from tramstream.simulation.scenario import Slip, Tunnel

Array = np.ndarray
RELATIVE = 1e-9
"""filterpy inverts matrices; of the deviations that the filter claims."""
ROUNDING = 1e-9
"""Of the filter's variances, after some ten thousand updates."""
STEP_S = 0.05
SPREAD = np.full(SIZE, 0.01)
SPREAD[[Ix.EAST, Ix.NORTH, Ix.UP, Ix.GNSS_EAST, Ix.GNSS_NORTH, Ix.GNSS_UP]] = 1.0
SPREAD[[Ix.SPEED, Ix.PIVOT]] = 0.3
"""Deviations at the start of the frozen filter, and units in which it is well conditioned."""


class TracedLocaliser(TramLocaliser):
    """A localiser with somebody who writes down its way."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.tracer = Tracer()
        super().__init__(vehicle, self.tracer)

    @property
    def traces(self) -> list[Trace]:
        return self.tracer.traces


# The authority ------------------------------------------------------------------------------------
class Frozen:
    """A traced filter beside what filterpy's smoother wants to know of a linear one.

    The motion is not linear, but about the filter's own estimates it is: what it moves beyond its
    derivative is a known shift, which is taken out of the states (`shift`).
    """

    def __init__(self, rng: Generator) -> None:
        vehicle = Vehicle(
            vehicle="test",
            gnss=Gnss(device="none", lever_arm_m=(2.0, 0.3, 3.0)),
            imu=Imu(device="none", lever_arm_m=(-1.0, 0.2, 0.4)),
        )
        self.ekf = TramFilter(vehicle, 9.81)
        self.ekf.set_fix_error(0.05, 0.02, 0.05)
        root = rng.normal(size=(SIZE, SIZE)) / math.sqrt(SIZE)
        self.ekf.P = SPREAD[:, None] * (root @ root.T + 0.1 * np.eye(SIZE)) * SPREAD
        self.ekf.x = rng.normal(size=SIZE) * SPREAD
        self.ekf.state[Ix.SPEED] = 5.0
        self.trace = self.ekf.watcher = Trace(rides.LEVEL, self.ekf)
        self.shift = np.zeros(SIZE)
        self.transitions = [(np.eye(SIZE), np.zeros((SIZE, SIZE)))]
        self.states: list[tuple[Array, Array]] = []
        self.keep()

    def keep(self) -> None:
        """End an epoch: transitions and measurements are behind it."""
        memory, held = self.ekf.memory, numbers(one(READING))
        self.states.append((self.ekf.x[:, 0] - self.shift, self.ekf.P.copy()))
        self.trace.instant(len(self.states) * EVERY_NS, TRACKING, False, memory, held)

    def go(self, act: Callable[[], None], F: Array | None = None) -> None:
        """A transition and its epoch; without F it is the prediction's own."""
        x, P = self.ekf.x[:, 0].copy(), self.ekf.P.copy()
        act()
        if F is None:
            F = self.ekf.F
        self.shift = self.ekf.x[:, 0] - F @ (x - self.shift)
        self.transitions.append((F, self.ekf.P - F @ P @ F.T))

    def filterpy(self) -> tuple[Array, Array]:
        """Smoothed states and covariances."""
        unit, inverse = np.diag(SPREAD), np.diag(1 / SPREAD)
        x, P, _, _ = KalmanFilter(dim_x=SIZE, dim_z=1).rts_smoother(
            np.array([inverse @ x for x, _ in self.states]),
            np.array([inverse @ P @ inverse for _, P in self.states]),
            [inverse @ F @ unit for F, _ in self.transitions],
            [inverse @ Q @ inverse for _, Q in self.transitions],
        )
        return x * SPREAD, SPREAD[:, None] * P * SPREAD


def without(*slots: Ix) -> Array:
    """Transition that makes states anew."""
    F = np.eye(SIZE)
    F[slots, slots] = 0.0
    return F


def refused(taken: bool) -> None:
    assert not taken


def travelled(seed: int, count: int = 60) -> Frozen:
    """Every kind of change that the filter knows, in any order."""
    rng = np.random.default_rng(seed)
    frozen = Frozen(rng)
    ekf, eye = frozen.ekf, np.eye(SIZE)
    fix_slots = (Ix.GNSS_EAST, Ix.GNSS_NORTH)

    def reading() -> Array:
        u = one(READING)
        u["angular_rate"] = rng.normal((0.0, 0.0, 0.1), 0.1)
        u["specific_force"] = rng.normal((0.0, 0.5, 9.81), 0.1)
        u["accelerometer"] = 1.0
        return numbers(u)

    def readings() -> Array:
        inertial = one(INERTIAL)
        inertial["now"] = reading().view(READING)
        inertial["steady_rate"] = inertial["now"]["angular_rate"]
        return numbers(inertial)

    def measure() -> None:
        kind, (east, north, up) = rng.integers(5), ekf.x[:3, 0].tolist()
        if kind == 0:
            a, b, c = rng.normal(0.0, 2.5, 3).tolist()
            ekf.apply(GnssPosition(east + a, north + b, 0.3**2))
            ekf.apply(GnssHeight(up + 3.0 + c, 0.5**2))
        elif kind == 1:
            yaw, aside = ekf.state[Ix.YAW], rng.normal()
            ekf.apply(GnssVelocity(5.0 * math.cos(yaw), 5.0 * math.sin(yaw) + aside, 0.3**2))
        elif kind == 2:
            wheel, way = int(rng.integers(2)), float(rng.normal(0.25, 0.1))
            ekf.apply(WheelPath(wheel, way, 1e-3))
            frozen.shift[Ix.PATH_A + wheel] -= way
        elif kind == 3:
            ekf.apply(WheelSpeed(int(rng.integers(2)), float(rng.normal(5.0, 0.1)), 0.1**2))
        else:
            ekf.apply(LateralForce(readings()))

    for number in range(count):
        kind = rng.integers(8)
        if kind < 4:
            frozen.go(lambda: ekf.predict(reading(), STEP_S))
        elif kind == 4:
            frozen.go(lambda: ekf.rest(STEP_S), eye)
        elif kind == 5:
            frozen.go(lambda: ekf.restart_path(1, 1e-4), without(Ix.PATH_B))
        elif kind == 6:
            frozen.go(lambda: ekf.forget(fix_slots, (0.5, 0.7)), without(*fix_slots))
        else:
            frozen.go(lambda: ekf.widen(Ix.SPEED, 0.1), eye)
        for _ in range(rng.integers(3)):
            measure()
        if number == count // 2:
            frozen.keep()
            frozen.go(lambda: refused(ekf.zero_velocity()), without(Ix.SPEED))
            ekf.zero_velocity()
            ekf.apply(ZeroAngularRate(reading(), 1e-4, 1e-4, 1e-4))
            ekf.apply(LevelForce(reading(), 1e-4))
        frozen.keep()
    return frozen


@pytest.mark.parametrize("seed", seeds(1, of=4, first=0))
def test_smoother_is_filterpys_on_frozen_derivatives(seed: int) -> None:
    frozen = travelled(seed)
    smoothed = smooth(frozen.trace)
    x, P = frozen.filterpy()
    gained = 0.0
    for k, (filtered, before) in enumerate(frozen.states):
        std = np.sqrt(np.diag(before))
        # What the shifts took out of a state they took out of the filter's and the smoother's.
        change = smoothed.x[k] - unsmoothed(frozen.trace, k)
        np.testing.assert_array_less(np.abs(change - (x[k] - filtered)) / std, RELATIVE)
        difference = (smoothed.covariance(k) - P[k]) / std[:, None] / std
        np.testing.assert_array_less(np.abs(difference), RELATIVE)
        gained = max(gained, float(np.abs(change / std).max()))
    assert gained > 0.5  # it has done something


def unsmoothed(trace: Trace, k: int) -> Array:
    """The filter's state at instant `k`."""
    state: Array = np.concatenate(trace.instants)["x"][k]
    return state


# Rides --------------------------------------------------------------------------------------------
SLIP_S = 76.0, 79.0
TUNNEL_S = 90.0, 130.0
MOVING_S = 80.0
"""Between the second stop and the third."""


@cache
def ride_of(seed: int, duration_s: float) -> Ride:
    """The reference's ride along the built-in line."""
    return ridden(built_in_line(), reference(), seed, duration_s)


def eventful(seed: int = 1) -> Ride:
    """A ride on which both wheels slip, and fixes are missing for a while."""
    events = (
        Slip(start_s=SLIP_S[0], duration_s=SLIP_S[1] - SLIP_S[0], speed_error_mps=1.0),
        Tunnel(start_s=TUNNEL_S[0], duration_s=TUNNEL_S[1] - TUNNEL_S[0]),
    )
    return ridden(built_in_line(), altered(reference(), events=events), seed, 180.0)


def went(
    ride: Ride, frames: list[SyncFrame] | None = None
) -> tuple[TracedLocaliser, list[Estimate]]:
    """A traced localiser after a ride, and all that it said of it with a heading."""
    localiser = TracedLocaliser(ride.simulation.vehicle)
    said = [localiser.take(frame) for frame in frames or ride.frames]
    return localiser, [each for each in said if each is not None and each.mode >= TRACKING]


def both(ride: Ride) -> tuple[Errors, Errors]:
    """Errors of filter and smoother at the same instants."""
    localiser, said = went(ride)
    by_stamp = {each.stamp_ns: each for each in said}
    smoothed = [
        each
        for trace in localiser.traces
        for each in smooth(trace).estimates()
        if each.stamp_ns in by_stamp
    ]
    filtered = [by_stamp[each.stamp_ns] for each in smoothed]
    errors = [judged(ride.simulation, localiser, each) for each in (filtered, smoothed)]
    return errors[0], errors[1]


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def only(localiser: TracedLocaliser) -> Smoothed:
    (trace,) = localiser.traces
    return smooth(trace)


def test_tracing_changes_nothing() -> None:
    ride = eventful()
    traced, plain = (kind(ride.simulation.vehicle) for kind in (TracedLocaliser, TramLocaliser))
    for frame in ride.frames:
        a, b = traced.take(frame), plain.take(frame)
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            np.testing.assert_array_equal(a.motion, b.motion)
            np.testing.assert_array_equal(a.covariance, b.covariance)
    assert traced.complaints() == plain.complaints()


def test_last_instant_is_the_filters_and_the_first_is_the_departure() -> None:
    ride = ride_of(1, 120.0)
    localiser, said = went(ride)
    smoothed = only(localiser)
    estimates = list(smoothed.estimates())
    last = next(each for each in reversed(said) if each.stamp_ns == estimates[-1].stamp_ns)
    np.testing.assert_array_equal(estimates[-1].motion, last.motion)
    np.testing.assert_array_equal(estimates[-1].covariance, last.covariance)
    assert last.stamp_ns > ride.frames[-1].stamp_ns - EVERY_NS
    departed_s = ride.departure_s(1)
    assert departed_s < time_s(estimates[0].stamp_ns) < departed_s + 2.0
    assert time_s(estimates[0].stamp_ns) < time_s(said[0].stamp_ns)  # the filter knew it later
    assert set(np.diff(smoothed.stamp_ns[1:]).tolist()) == {EVERY_NS}


def test_smoothing_twice_gives_the_same() -> None:
    localiser, _ = went(ride_of(1, 120.0))
    first, second = only(localiser), only(localiser)
    np.testing.assert_array_equal(first.instants, second.instants)


def test_no_covariance_grows_and_none_is_negative() -> None:
    localiser, _ = went(eventful())
    (trace,) = localiser.traces
    smoothed = smooth(trace)
    triangles = np.concatenate(trace.instants)["triangle"]
    lower = np.tril_indices(SIZE)
    for k in range(0, len(trace), 7):
        P = np.zeros((SIZE, SIZE))
        P[lower] = triangles[k]
        P += np.tril(P, -1).T
        std = np.sqrt(np.maximum(np.diag(P), 1e-30))
        after = smoothed.covariance(k) / std[:, None] / std
        before = P / std[:, None] / std
        assert np.linalg.eigvalsh(after).min() > -ROUNDING
        assert np.linalg.eigvalsh(before - after).min() > -ROUNDING


def test_states_without_variance_stay() -> None:
    ride = ride_of(1, 120.0)
    vehicle = altered(
        ride.simulation.vehicle, ekf={"pivot_std_m": 0.0}, wheels={"delay_std_s": 0.0}
    )
    localiser = TracedLocaliser(vehicle)
    for frame in ride.frames:
        localiser.take(frame)
    smoothed = only(localiser)
    for slot in (Ix.PIVOT, Ix.WHEEL_DELAY):
        assert not smoothed.x[:, slot].any()
        assert not smoothed.covariance(50)[slot].any()
    assert np.isfinite(smoothed.x).all()
    assert np.isfinite(smoothed.instants["triangle"]).all()


def test_tunnel_is_bridged_from_both_ends() -> None:
    filtered, smoothed = both(eventful())
    begin_s, end_s = TUNNEL_S
    before, middle, end = (
        place_std_m(smoothed, each) for each in (begin_s - 5.0, 0.5 * (begin_s + end_s), end_s)
    )
    assert max(middle, end) < 1.3 * before
    assert end < 0.5 * place_std_m(filtered, end_s)  # the filter is least sure there
    inside = smoothed.within(begin_s + 10.0, end_s)
    assert (inside.mode == DEAD_RECKONING).all()  # as it was for the filter
    assert rms(inside.horizontal_m) < 3.0 * middle


def place_std_m(errors: Errors, time_s: float) -> float:
    """Horizontal deviation that is claimed."""
    return math.sqrt(np.trace(errors.at(time_s).covariance[0, :2, :2]))


def test_slip_is_not_in_the_smoothed_speed() -> None:
    _, smoothed = both(eventful())
    slipping = smoothed.within(SLIP_S[0], SLIP_S[1] + 1.0)
    assert np.abs(slipping.speed_mps).max() < 0.02
    normal = slipping.speed_mps / np.sqrt(slipping.covariance[:, 3, 3])
    assert np.abs(normal).max() < 4.0


def test_pause_parts_the_ride() -> None:
    ride = ride_of(1, 240.0)
    again_s = MOVING_S + 1.5 * BLIND_S
    localiser, _ = went(ride, [*ride.between(0.0, MOVING_S), *ride.between(again_s, 240.0)])
    first, second = (smooth(trace) for trace in localiser.traces)
    assert MOVING_S - 0.1 < time_s(int(first.stamp_ns[-1])) <= MOVING_S
    assert time_s(int(second.stamp_ns[0])) > again_s
    # The first part is that of a ride that ended there.
    alone, _ = went(ride, ride.between(0.0, MOVING_S))
    np.testing.assert_array_equal(first.instants, only(alone).instants)


def test_vehicle_that_was_parked_goes_on_in_a_trace_of_its_own() -> None:
    ride = ridden(built_in_line(), altered(reference(), driver={"dwell_s": 60.0}), 1, 200.0)
    silent_s = ride.arrival_s(2) + 5.0
    awake_s = silent_s + 3.0 * BLIND_S
    frames = [*ride.between(0.0, silent_s), *ride.between(awake_s, 200.0)]
    localiser, _ = went(ride, frames)
    first, second = (smooth(trace) for trace in localiser.traces)
    assert time_s(int(first.stamp_ns[-1])) <= silent_s
    assert awake_s < time_s(int(second.stamp_ns[0])) < awake_s + 1.0
    stands = np.array(
        [awake_s + 1.0 < time_s(int(stamp)) < ride.departure_s(2) for stamp in second.stamp_ns]
    )
    assert second.standing[stands].all()
    errors = judged(ride.simulation, localiser, list(second.estimates()))
    assert np.abs(errors.yaw_rad).max() < 0.02


def test_of_two_directions_only_the_taken_one_is_smoothed() -> None:
    backwards = altered(reference(), reverse=True)
    ride = ridden(built_in_line(), backwards, 1, 120.0)
    # Wheels that count up both ways do not tell the direction.
    for frame in ride.frames:
        for reading in frame.odometry:
            for wheel in reading.wheels:
                wheel.pulses = abs(wheel.pulses)
    localiser, _ = went(ride)
    (trace,) = localiser.traces
    errors = judged(ride.simulation, localiser, list(smooth(trace).estimates()))
    assert np.abs(errors.yaw_rad).max() < 0.2
    assert errors.speed.min() < -3.0


def test_what_is_no_number_is_not_smoothed() -> None:
    ride = ride_of(1, 120.0)
    localiser, _ = went(ride, ride.between(0.0, 80.0))
    navigation = localiser._navigation
    assert navigation is not None
    navigation.ekf.state[Ix.EAST] = math.nan
    for frame in ride.between(80.0, 81.0):
        localiser.take(frame)
    smoothed = only(localiser)
    assert np.isfinite(smoothed.x).all()
    assert np.isfinite(smoothed.instants["triangle"]).all()
    assert time_s(int(smoothed.stamp_ns[-1])) <= 80.0


def test_memory_that_is_put_back_begins_anew() -> None:
    ride = ride_of(1, 120.0)
    plain = TramLocaliser(ride.simulation.vehicle)
    for frame in ride.between(0.0, 60.0):
        plain.take(frame)
    traced = TracedLocaliser(ride.simulation.vehicle)
    traced.restore(plain.snapshot())
    for frame in ride.between(60.0, 120.0):
        plain.take(frame)
        traced.take(frame)
    smoothed = only(traced)
    assert 60.0 < time_s(int(smoothed.stamp_ns[0])) <= 60.2
    np.testing.assert_array_equal(
        traced.snapshot()["navigation"]["filter"]["P"],
        plain.snapshot()["navigation"]["filter"]["P"],
    )


def test_processor_says_it_in_order_with_protection_levels() -> None:
    from tramstream import keys
    from tramstream.processor import Sample, Smoothing

    ride = ride_of(1, 120.0)
    processor = LocalisationFilter(ride.simulation.vehicle)
    assert isinstance(processor, Smoothing)
    processor.keep()
    for number, frame in enumerate(ride.frames):
        processor.step(Sample(keys.SYNC_FRAME, frame, frame.stamp_ns, number))
    said = list(processor.smoothed())
    assert [each.sequence for each in said] == list(range(1, len(said) + 1))
    stamps = [each.message.stamp_ns for each in said]
    assert stamps == sorted(set(stamps))
    assert 0 < said[0].message.protection_along_m < 10.0
    assert not said[0].message.innovations


# What it is worth ---------------------------------------------------------------------------------
def test_smoothed_is_better_by_a_third_on_a_few_short_rides() -> None:
    squares = np.array([gains(seed, 240.0) for seed in (1, 2)]).sum(axis=0)
    better = np.sqrt(squares[1] / squares[0])
    assert (better < 0.7).all(), dict(zip(("place", "speed", "yaw"), better, strict=True))


def gains(seed: int, duration_s: float) -> Array:
    """Sums of squared errors of filter and smoother: place, speed, yaw."""
    return np.array(
        [
            [
                np.square(each).sum()
                for each in (errors.p_l[:, :2], errors.speed_mps, errors.yaw_rad)
            ]
            for errors in both(ride_of(seed, duration_s))
        ]
    )


@pytest.mark.study
def test_smoothed_is_better_by_30_percent() -> None:
    squares = np.array([gains(seed, 900.0) for seed in range(11, 21)]).sum(axis=0)
    better = np.sqrt(squares[1] / squares[0])
    assert (better < 0.7).all(), dict(zip(("place", "speed", "yaw"), better, strict=True))


@pytest.mark.study
def test_smoothed_errors_are_as_large_as_claimed() -> None:
    """One instant a ride: errors of one ride hang together from its beginning to its end."""
    rides, slots = range(101, 141), np.array([0, 1, 3, 6])
    errors, claimed = [], []
    for seed in rides:
        _, smoothed = both(ride_of.__wrapped__(seed, 200.0))
        at = smoothed.at(120.0)
        errors.append([at.p_l[0, 0], at.p_l[0, 1], at.speed_mps[0], at.yaw_rad[0]])
        claimed.append(at.covariance[0][np.ix_(slots, slots)])
    nees = quadratic_form(np.array(claimed), np.array(errors))
    bounds = chi_square_interval(4 * len(rides))
    assert bounds.low < nees.sum() < bounds.high, nees.mean()
