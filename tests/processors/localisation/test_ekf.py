"""The localisation filter as a processor: bad input, what is published, memory."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cache
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rides import Ride, altered, time_s
from test_tram_outages import assert_covariance
from test_tram_start import copies, plain

from tramstream import keys
from tramstream.clock import S
from tramstream.estimation.events import (
    FIX_JAMMED,
    FIX_NO_NUMBER,
    FIX_NOWHERE,
    FIX_SPOOFED,
    FIX_TOO_FAR,
    FIX_TOO_HIGH,
    FIX_TOO_POOR,
)
from tramstream.estimation.localiser import DEAD_RECKONING, HEADING_UNKNOWN, TRACKING
from tramstream.events import Kind
from tramstream.live import snapshots
from tramstream.processor import Sample
from tramstream.processors.localisation.events import NO_NUMBER
from tramstream.processors.localisation.processor import MARGIN, LocalisationFilter
from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.processors.tram_filter.events import (
    ACCURACY_UNSTATED,
    IMPOSSIBLE_READING,
    IMPOSSIBLE_VELOCITY,
    NO_WHEELS,
    TIME_BACKWARDS,
)
from tramstream.proto.gnss_pb2 import JAMMING_CRITICAL, SPOOFING_INDICATED, GnssFix
from tramstream.proto.raw_pb2 import Odometry, WheelReading
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame

EVENT, LOG = keys.EVENT.at("ekf"), keys.LOG.at("ekf")
KINDS = {kind.name: kind for kind in LocalisationFilter.events}
MOVING_S = 30.0
PLACE_M = 2.5
"""Of fixes at 1 Hz with 0.5 m an axis: 5 σ."""
EXAMPLES = 40
STANDING, RUNNING = 500, 3500
"""Frames of `plain`: before the departure, and on the way."""


class Node:
    """A processor, and all that it said, by key."""

    def __init__(self, ride: Ride, **changes: Any) -> None:
        self.processor = LocalisationFilter(altered(ride.simulation.vehicle, **changes))
        self.states: list[Any] = []
        self.now: list[Any] = []
        self.told: list[tuple[float, Kind]] = []
        self.samples: list[Sample] = []

    def step(self, frames: Iterable[SyncFrame]) -> Node:
        for number, frame in enumerate(frames):
            before = frame.SerializeToString() if number % 100 == 0 else b""
            for sample in self.processor.step(
                Sample(keys.SYNC_FRAME, frame, frame.stamp_ns, number)
            ):
                self._note(sample, time_s(frame.stamp_ns))
            assert not before or before == frame.SerializeToString(), "it changed its input"
        return self

    def _note(self, sample: Sample, time_s: float) -> None:
        self.samples.append(sample)
        if sample.key == EVENT:
            self.told.append((time_s, KINDS[sample.message.kind]))
        elif sample.key not in (keys.EST_PARAMETERS, LOG):
            if sample.key is keys.EST_STATE:
                self.states.append(sample.message)
            elif sample.key is keys.EST_NOW:
                self.now.append(sample.message)
            assert_numbers(sample.message)

    def events(self) -> set[Kind]:
        return {kind for _, kind in self.told}


def assert_numbers(message: Any) -> None:
    """Every number in a message is one, and no deviation is negative."""
    for field, value in message.ListFields():
        if field.name == "innovations":
            for each in value:
                assert math.isfinite(each.value)
                assert math.isfinite(each.variance)
        elif field.name.endswith(("_std_m", "_std_mps", "_std_rad")):
            assert 0.0 <= value < math.inf
        elif field.cpp_type in (field.CPPTYPE_DOUBLE, field.CPPTYPE_FLOAT):
            assert np.isfinite(np.asarray(value)).all(), field.name


def full(state: Any) -> np.ndarray:
    """The published covariance, (7, 7)."""
    P = np.zeros((7, 7))
    P[np.triu_indices(7)] = state.covariance
    return P + np.triu(P, 1).T


def off_m(ride: Ride, state: Any) -> float:
    """Horizontal error of a published place."""
    truth = ride.simulation.truth(np.array([state.stamp_ns])).p_l[0]
    angles = math.radians(state.latitude_deg), math.radians(state.longitude_deg)
    geodetic = np.array([*angles, state.height_ellipsoid_m])
    place = ride.simulation.line.level.from_geodetic(geodetic)
    return math.hypot(*(place - truth)[:2])


@cache
def whole() -> Node:
    ride = plain(1)
    return Node(ride).step(ride.between(-1.0, 60.0))


@cache
def memory(number: int, count: int = 200) -> tuple[bytes, list[SyncFrame]]:
    """The filter after so many frames, and those that follow."""
    ride = plain(1)
    node = Node(ride).step(ride.frames[:number])
    state = snapshots.pack(node.processor.snapshot())
    return state, ride.frames[number : number + count]


# Bad input ----------------------------------------------------------------------------------------
BAD: dict[str, tuple[dict[str, float], Kind]] = {
    "latitude NaN": ({"latitude_deg": math.nan}, FIX_NO_NUMBER),
    "longitude infinite": ({"longitude_deg": math.inf}, FIX_NO_NUMBER),
    "height NaN": ({"height_ellipsoid_m": math.nan}, FIX_NO_NUMBER),
    "nowhere": ({"latitude_deg": 123.0}, FIX_NOWHERE),
    "in orbit": ({"height_ellipsoid_m": 4e5}, FIX_TOO_HIGH),
    "velocity NaN": ({"vel_e_mps": math.nan, "vel_n_mps": 0.0}, IMPOSSIBLE_VELOCITY),
    "velocity half": ({"vel_e_mps": 1.0}, IMPOSSIBLE_VELOCITY),
    "velocity of a rocket": ({"vel_e_mps": 1e200, "vel_n_mps": 1e200}, IMPOSSIBLE_VELOCITY),
    "accuracy NaN": ({"horizontal_std_m": math.nan}, ACCURACY_UNSTATED),
    "accuracy 0": ({"horizontal_std_m": 0.0}, ACCURACY_UNSTATED),
    "accuracy negative": ({"horizontal_std_m": -1.0}, ACCURACY_UNSTATED),
    "accuracy 1e9": ({"horizontal_std_m": 1e9}, FIX_TOO_POOR),
    "spoofed": ({"spoofing": SPOOFING_INDICATED}, FIX_SPOOFED),
    "jammed": ({"jamming": JAMMING_CRITICAL}, FIX_JAMMED),
    "other hemisphere": ({"latitude_deg": -33.9, "longitude_deg": 151.2}, FIX_TOO_FAR),
}


def set_fields(fix: GnssFix, values: dict[str, float]) -> None:
    for name, value in values.items():
        setattr(fix, name, value)


@pytest.mark.parametrize("name", BAD)
def test_bad_fixes_are_said_and_do_no_harm(name: str) -> None:
    values, kind = BAD[name]
    ride, (state, frames) = plain(1), memory(RUNNING, 2000)
    frames = copies(frames)
    begin_s = time_s(frames[0].stamp_ns)
    for frame in frames:
        for fix in frame.gnss:
            # Of those without an accuracy some are good: the others must not spoil them.
            good = "accuracy" in name and frame.stamp_ns // S % 3 == 0
            if time_s(fix.stamp_ns) < begin_s + 12.5 and not good:
                set_fields(fix, values)
    node = Node(ride)
    node.processor.restore(snapshots.unpack(state))
    node.step(frames)
    times = [time for time, told in node.told if told is kind]
    assert 1 <= len(times) <= 2  # repeated every ten seconds, not with every fix
    assert times[0] < begin_s + 2.5
    for said in node.states[::100]:
        assert off_m(ride, said) < PLACE_M
        assert_covariance(full(said))
    assert node.states[-1].mode == TRACKING


@pytest.mark.parametrize("name", [each for each in BAD if "velocity" not in each])
def test_bad_first_fix_does_no_harm(name: str) -> None:
    values, _ = BAD[name]
    ride = plain(1)
    frames = copies(ride.between(-1.0, 22.0))
    first = next(fix for frame in frames for fix in frame.gnss)
    set_fields(first, values)
    node = Node(ride).step(frames)
    assert node.events()
    assert node.states[-1].mode == TRACKING
    assert off_m(ride, node.states[-1]) < PLACE_M
    assert time_s(node.states[0].stamp_ns) < 5.0


def test_one_bad_number_of_other_fields_does_no_harm() -> None:
    ride = plain(1)
    frames = copies(ride.between(-1.0, 50.0))
    wild = (math.nan, math.inf, -math.inf, 1e300, -1e300)
    for value, frame in zip(wild, frames[RUNNING : RUNNING + 500 : 100], strict=True):
        frame.imu.gyro_z_radps = value
    for value, frame in zip(wild, frames[RUNNING + 50 : RUNNING + 550 : 100], strict=True):
        frame.imu.accel_x_mps2 = value
        for mean in frame.ahead:
            mean.accel_x_mps2 = value
    node = Node(ride).step(frames)
    assert IMPOSSIBLE_READING in node.events()
    assert off_m(ride, node.states[-1]) < PLACE_M
    assert off_m(ride, node.now[-1]) < PLACE_M
    assert node.now[-1].stamp_ns > frames[-1].stamp_ns


def test_odometry_that_never_comes_is_said() -> None:
    ride = plain(1)
    frames = copies(ride.between(-1.0, 35.0))
    for frame in frames:
        frame.ClearField("odometry")
    node = Node(ride).step(frames)
    times = [time for time, told in node.told if told is NO_WHEELS]
    assert times[0] < 7.0
    assert np.diff(times).min() > 9.0
    assert node.states[-1].mode == TRACKING
    assert off_m(ride, node.states[-1]) < PLACE_M


def test_time_that_runs_backwards_is_said_and_published_nowhere() -> None:
    ride = plain(1)
    frames = ride.between(-1.0, 37.0)
    node = Node(ride).step([*frames[:RUNNING], frames[RUNNING - 200], *frames[RUNNING:]])
    assert node.events() == {TIME_BACKWARDS}
    for stream in (node.states, node.now):
        stamps = [each.stamp_ns for each in stream]
        assert stamps == sorted(set(stamps))


# Random garbage -----------------------------------------------------------------------------------
numbers = st.floats() | st.sampled_from([0.0, -1.0, 1e9, math.nan, math.inf, 50.08, 14.42])
offsets_ns = st.integers(-(10**9), 10**9) | st.integers(-(10**4), 10**4)
counts = st.integers(-(2**63), 2**63 - 1)
FIX_FIELDS = (
    "latitude_deg",
    "longitude_deg",
    "height_ellipsoid_m",
    "horizontal_std_m",
    "vertical_std_m",
    "vel_n_mps",
    "vel_e_mps",
    "speed_std_mps",
)
fixes = st.fixed_dictionaries({"valid": st.booleans()}, optional=dict.fromkeys(FIX_FIELDS, numbers))
wheels = st.fixed_dictionaries(
    {"wheel": st.sampled_from(["left", "right", "other"])},
    optional={"pulses": counts, "speed_mps": numbers},
)
means = st.fixed_dictionaries(
    {},
    optional={
        f"{kind}_{axis}_{unit}": numbers
        for kind, unit in (("gyro", "radps"), ("accel", "mps2"))
        for axis in "xyz"
    },
)
garbage = st.lists(
    st.tuples(
        st.integers(0, 150),
        offsets_ns,
        st.one_of(
            st.tuples(st.just("gnss"), fixes),
            st.tuples(st.just("wheel"), wheels),
            st.tuples(st.just("yaw_rate"), numbers),
            st.tuples(st.just("imu"), means),
            st.tuples(st.just("ahead"), means),
            st.tuples(st.just("no imu"), st.none()),
        ),
    ),
    min_size=1,
    max_size=30,
)


def throw(frame: SyncFrame, kind: str, values: Any, offset_ns: int) -> None:
    """Put garbage into a frame; what is not said of a fix stays as it was."""
    stamp_ns = frame.stamp_ns + offset_ns
    if kind == "gnss":
        fix = frame.gnss.add(latitude_deg=50.08, longitude_deg=14.42, height_ellipsoid_m=250.0)
        fix.stamp_ns = stamp_ns
        for name, value in values.items():
            setattr(fix, name, value)
    elif kind == "wheel":
        reading = Odometry(stamp_ns=stamp_ns)
        reading.wheels.append(WheelReading(**values))
        frame.odometry.append(reading)
    elif kind == "yaw_rate":
        frame.odometry.append(Odometry(stamp_ns=stamp_ns, yaw_rate_radps=values))
    elif kind == "no imu":
        frame.ClearField("imu")
    elif kind == "ahead":
        frame.ahead.append(ImuMean(stamp_ns=stamp_ns, **values))
    else:
        for name, value in values.items():
            setattr(frame.imu, name, value)


@settings(max_examples=EXAMPLES)
@given(begin=st.sampled_from([0, STANDING, RUNNING]), thrown=garbage)
def test_no_garbage_makes_it_raise_or_publish_what_is_no_number(
    begin: int, thrown: list[tuple[int, int, tuple[str, Any]]]
) -> None:
    state, frames = memory(begin)
    node = Node(plain(1))
    node.processor.restore(snapshots.unpack(state))
    changed = copies(frames)
    for number, offset_ns, (kind, values) in thrown:
        throw(changed[number], kind, values, offset_ns)
    node.step(changed)  # which looks at every message
    assert NO_NUMBER not in node.events()
    if begin == RUNNING:
        assert len(node.states) > 100
    localiser = node.processor.localiser
    assert isinstance(localiser, TramLocaliser)
    if localiser._navigation is not None:
        assert_covariance(localiser._navigation.ekf.P)


# What is published --------------------------------------------------------------------------------
def test_messages_are_numbered_and_stamped() -> None:
    node = whole()
    for key in (keys.EST_STATE, keys.EST_NOW, keys.EST_PARAMETERS):
        samples = [sample for sample in node.samples if sample.key is key]
        assert [sample.sequence for sample in samples] == list(range(1, len(samples) + 1))
        assert all(sample.message.sequence == sample.sequence for sample in samples)
        assert all(sample.message.stamp_ns == sample.stamp_ns for sample in samples)
    assert {sample.key for sample in node.samples} <= set(LocalisationFilter.outputs)


def test_states_come_with_every_frame_and_say_what_they_rest_on() -> None:
    ride, node = plain(1), whole()
    frames = ride.between(-1.0, 60.0)
    assert [state.stamp_ns for state in node.states] == [each.stamp_ns for each in frames]
    modes = [state.mode for state in node.states]
    first = modes.index(TRACKING)
    assert set(modes[:first]) == {HEADING_UNKNOWN}
    assert set(modes[first:]) == {TRACKING}
    assert not node.events()


def test_state_for_now_goes_on_to_the_newest_mean() -> None:
    ride, node = plain(1), whole()
    newest = [frame.ahead[-1].stamp_ns for frame in ride.between(-1.0, 60.0) if frame.ahead]
    stamps = [state.stamp_ns for state in node.now]
    assert stamps == newest[-len(stamps) :]
    assert len(newest) - len(stamps) < 300  # those before the first fix
    by_stamp = {state.stamp_ns: state for state in node.states}
    for ahead in node.now[RUNNING::50]:
        later = by_stamp.get(ahead.stamp_ns)
        if later is None:  # beyond the last horizon
            continue
        assert ahead.speed_mps == pytest.approx(later.speed_mps, abs=0.05)
        assert ahead.yaw_rad == pytest.approx(later.yaw_rad, abs=0.02)
        assert abs(off_m(ride, ahead) - off_m(ride, later)) < 0.3


@pytest.mark.parametrize("risk", [0.1, 0.001, 1e-6])
def test_protection_levels_follow_the_integrity_risk(risk: float) -> None:
    ride = plain(1)
    node = Node(ride, ekf={"integrity_risk": risk}).step(ride.between(-1.0, 25.0))
    # Along and across share the risk, and each has two sides.
    factor = MARGIN * NormalDist().inv_cdf(1.0 - risk / 4.0)
    for state in node.states[::100]:
        assert state.protection_along_m == pytest.approx(factor * state.along_std_m)
        assert state.protection_across_m == pytest.approx(factor * state.across_std_m)
        values, _ = np.linalg.eigh(full(state)[:2, :2])
        if state.mode == HEADING_UNKNOWN:  # along is not known: the greatest of any direction
            assert state.along_std_m == pytest.approx(math.sqrt(values[-1]))
            assert state.across_std_m == state.along_std_m
        else:
            both = state.along_std_m**2 + state.across_std_m**2
            assert both == pytest.approx(values.sum())


def test_protection_levels_hold_the_error() -> None:
    ride, node = plain(1), whole()
    for state in node.states[::50]:
        level = math.hypot(state.protection_along_m, state.protection_across_m)
        assert off_m(ride, state) < level


def test_fixes_that_end_leave_dead_reckoning() -> None:
    ride = plain(1)
    frames = copies(ride.between(-1.0, 37.0))
    for frame in frames:
        if time_s(frame.stamp_ns) > MOVING_S:
            frame.ClearField("gnss")
    node = Node(ride).step(frames)
    assert node.states[-1].mode == DEAD_RECKONING
    assert node.states[-1].across_std_m > node.states[round(100.0 * MOVING_S)].across_std_m


# Memory -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("cut", [200, 1350, 1800])
def test_restart_from_memory_is_bit_identical(cut: int) -> None:
    ride = plain(1)
    frames = ride.frames[: cut + 400]
    first, second, through = Node(ride), Node(ride), Node(ride)
    first.step(frames[:cut])
    second.processor.restore(snapshots.unpack(snapshots.pack(first.processor.snapshot())))
    second.step(frames[cut:])
    through.step(frames)

    def written(samples: list[Sample]) -> list[bytes]:
        return [sample.message.SerializeToString() for sample in samples]

    assert written(first.samples + second.samples) == written(through.samples)
