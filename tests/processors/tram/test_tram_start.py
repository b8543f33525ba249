"""How the filter `tram` begins: standing or moving, either way round, wrongly, or with its memory.

Sensors and driver as in `test_tram_faults`. Fixes at 1 Hz alone are good to about a metre; the
bounds here are those of a filter that has found itself, not of its best.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from rides import LEVEL, Errors, Ride, altered, judged, laid, localised, ridden, run, time_s
from seeds import seeds
from test_tram_faults import PLAN, city

from tramstream.estimation.localiser import HEADING_UNKNOWN, Estimate
from tramstream.events.kinds import Event
from tramstream.lines.line import Line, parse_plan
from tramstream.live import snapshots
from tramstream.processors.tram.localiser import BLIND_S, TramLocaliser
from tramstream.processors.tram_filter.events import FIRST_FIXES_WRONG, RECEIVER_BOASTS
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_sources.fix_noise import FixNoise
from tramstream.proto.sync_pb2 import SyncFrame
from tramstream.simulation.scenario import Tunnel

SEEDS = seeds(2, of=5)
FEW = seeds(1, of=3)
"""Where there are several cases."""
LINE = PLAN + " | 150 |"
MOVING_S = 36.5
"""Between two stops, at 9 m/s."""
PLACE_M = 2.5
"""Of fixes at 1 Hz with 0.5 m an axis: 5 σ."""
YAW_RAD = 0.05
INTO_PHASE = 40
"""Frames of 10 ms."""
SETTLED_S = 15.0
"""From the first heading until it is good: it comes out of a few metres' way."""


@cache
def plain(seed: int) -> Ride:
    return ridden(laid(LINE), city(), seed, 95.0)


def copies(frames: Iterable[SyncFrame]) -> list[SyncFrame]:
    return [SyncFrame.FromString(frame.SerializeToString()) for frame in frames]


def known(errors: Errors) -> Errors:
    """Those with a heading."""
    first = errors.time_s[errors.mode != HEADING_UNKNOWN]
    assert first.size, "the heading was never found"
    return errors.within(float(first[0]), math.inf)


def assert_found(errors: Errors, settled_s: float = SETTLED_S) -> Errors:
    """It knows place and heading, and keeps them; gives the errors from then on."""
    begun = known(errors)
    settled = begun.within(float(begun.time_s[0]) + settled_s, math.inf)
    assert (settled.mode != HEADING_UNKNOWN).all()
    assert np.abs(settled.yaw_rad).max() < YAW_RAD
    assert settled.horizontal_m.max() < PLACE_M
    return settled


def upwards(frames: Iterable[SyncFrame]) -> list[SyncFrame]:
    """What counters say that count up whichever way the vehicle runs."""
    counted: dict[str, tuple[int, int]] = {}
    changed = copies(frames)
    for frame in changed:
        for reading in frame.odometry:
            for wheel in reading.wheels:
                last, total = counted.get(wheel.wheel, (wheel.pulses, 0))
                total += abs(wheel.pulses - last)
                counted[wheel.wheel] = (wheel.pulses, total)
                wheel.pulses = total
    return changed


# Standing and moving ------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", SEEDS)
def test_from_standstill_the_heading_is_known_soon_after_the_departure(seed: int) -> None:
    ride = plain(seed)
    errors = localised(ride)
    standing = errors.within(0.0, ride.departure_s(1))
    assert (standing.mode == HEADING_UNKNOWN).all()
    assert standing.horizontal_m.max() < PLACE_M
    settled = assert_found(errors)
    assert known(errors).time_s[0] < ride.departure_s(1) + 8.0
    assert np.abs(settled.speed_mps).max() < 0.1


@pytest.mark.parametrize("seed", SEEDS)
def test_in_motion_the_heading_is_known_after_a_few_fixes(seed: int) -> None:
    ride = plain(seed)
    errors = localised(ride, ride.between(MOVING_S, 100.0))
    assert known(errors).time_s[0] < MOVING_S + 5.0
    assert_found(errors)


@pytest.mark.parametrize("seed", SEEDS)
def test_antenna_is_not_taken_for_the_origin_while_the_heading_is_unknown(seed: int) -> None:
    """Where the origin is about the antenna nobody knows yet; how far below it is known."""
    lever_arm_m = (4.0, 0.5, 6.0)
    chosen = city(gnss={"lever_arm_m": lever_arm_m})
    errors = localised(ridden(laid(PLAN), chosen, seed, 20.0))
    blind = errors.within(1.0, 11.5)
    assert (blind.mode == HEADING_UNKNOWN).all()
    claimed_m = np.sqrt(np.trace(blind.covariance[:, :2, :2], axis1=1, axis2=2))
    assert (blind.horizontal_m < 1.5 * claimed_m).all()
    assert (claimed_m > math.hypot(*lever_arm_m[:2])).all()
    up_m = np.abs(blind.p_l[:, 2])
    assert (up_m < 3.0 * np.sqrt(blind.covariance[:, 2, 2])).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_speed_of_a_vehicle_that_stands_is_not_claimed_to_be_none(seed: int) -> None:
    """Its departure is seen when a wheel has turned, some tenths of a second later."""
    ride = plain(seed)
    errors = localised(ride).within(ride.arrival_s(2), ride.departure_s(2) + 5.0)
    normal = errors.speed_mps / np.sqrt(errors.covariance[:, 3, 3])
    assert np.mean(normal**2) < 2.0
    claimed_mps = np.sqrt(errors.covariance[errors.standing, 3, 3])
    assert claimed_mps.min() >= 0.002  # as docs/localisation.md says,
    assert claimed_mps.max() < 0.003  # and hardly more: nothing is hidden behind a wide claim


def test_first_state_comes_with_the_first_valid_fix() -> None:
    chosen = city(events=(Tunnel(start_s=0.0, duration_s=8.5),), gnss={"reacquisition_s": 0.0})
    ride = ridden(laid(LINE), chosen, 1, 12.0)
    for frames in (ride.frames, ride.between(3.2, 100.0)):
        valid_s = [time_s(fix.stamp_ns) for frame in frames for fix in frame.gnss if fix.valid]
        errors = localised(ride, frames)
        assert valid_s[0] > 8.0
        assert 0.0 <= errors.time_s[0] - valid_s[0] < 5.0
        assert errors.mode[0] == HEADING_UNKNOWN


# Either way round ---------------------------------------------------------------------------------
@pytest.mark.parametrize("counters", ["signed", "upwards", "none"])
@pytest.mark.parametrize("seed", FEW)
def test_runs_backwards_for_the_whole_ride(seed: int, counters: str) -> None:
    chosen = city(reverse=True, wheels=None) if counters == "none" else city(reverse=True)
    ride = ridden(laid(LINE), chosen, seed, 75.0)
    frames = upwards(ride.frames) if counters == "upwards" else ride.frames
    settled = assert_found(localised(ride, frames))
    assert settled.speed.min() < -8.0
    assert settled.speed.max() < 1.0


def moved_on(frames: Iterable[SyncFrame], by_ns: int, pulses: dict[str, int]) -> list[SyncFrame]:
    """Frames of a later ride, whose counters go on from `pulses`."""
    changed = copies(frames)
    for frame in changed:
        parts: list[Any] = [frame, *frame.gnss, *frame.odometry, *frame.ahead]
        for part in [*parts, frame.imu] if frame.HasField("imu") else parts:
            part.stamp_ns += by_ns
        for reading in frame.odometry:
            for wheel in reading.wheels:
                wheel.pulses += pulses[wheel.wheel]
    return changed


@pytest.mark.parametrize("counters", ["signed", "upwards"])
@pytest.mark.parametrize("seed", [1, 2])
def test_cab_changes_at_a_terminus_and_the_heading_remains(seed: int, counters: str) -> None:
    there = ridden(laid("| 100 L60/70 150 |"), city(), seed)
    arrived_s = there.arrival_s(2)
    end = there.simulation.ride.motion([arrived_s])
    segments, stops_m = parse_plan("| 150 R60/70 100 |")
    p_l = there.simulation.line.position_l(end.arc_length_m)[0]
    line = Line(segments, stops_m, LEVEL, float(end.yaw_rad[0]) + math.pi, tuple(p_l.tolist()))
    back = ridden(line, city(reverse=True), seed)
    last = there.frames[-1]
    pulses = {
        wheel.wheel: wheel.pulses
        for frame in there.frames[-10:]
        for reading in frame.odometry
        for wheel in reading.wheels
    }
    by_ns = last.stamp_ns + 10_000_000 - back.frames[0].stamp_ns
    returning = moved_on(back.frames, by_ns, pulses)
    frames = [*there.frames, *returning]
    frames = upwards(frames) if counters == "upwards" else frames
    localiser = TramLocaliser(there.simulation.vehicle)
    kept = run(localiser, frames)
    heading = {each.mode for each in kept if time_s(each.stamp_ns) > arrived_s}
    assert HEADING_UNKNOWN not in heading
    earlier = [replace(e, stamp_ns=e.stamp_ns - by_ns) for e in kept if e.stamp_ns > last.stamp_ns]
    errors = judged(back.simulation, localiser, earlier)
    assert np.abs(errors.yaw_rad).max() < YAW_RAD
    assert errors.horizontal_m.max() < PLACE_M
    assert errors.speed.min() < -8.0
    assert np.abs(errors.speed_mps).max() < 0.2


# Fewer wheels -------------------------------------------------------------------------------------
@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("seed", FEW)
def test_one_wheel_will_do(seed: int, side: str) -> None:
    ride = ridden(laid(LINE), city(wheels={"wheels": (side,)}), seed, 75.0)
    settled = assert_found(localised(ride))
    assert np.abs(settled.speed_mps).max() < 0.1


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("seed", FEW)
def test_no_wheels_will_do(seed: int, velocity: bool) -> None:
    ride = ridden(laid(LINE), city(wheels=None, gnss={"velocity": velocity}), seed, 75.0)
    settled = assert_found(localised(ride))
    assert np.abs(settled.speed_mps).max() < 0.5


# Wrong beginnings ---------------------------------------------------------------------------------
def misled(frames: Iterable[SyncFrame], count: int) -> list[SyncFrame]:
    """The first fixes are 50 m too far north."""
    changed = copies(frames)
    first = [fix for frame in changed for fix in frame.gnss][:count]
    for fix in first:
        fix.latitude_deg += math.degrees(50.0 / 6_371_000.0)
    return changed


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("seed", FEW)
def test_first_fixes_that_are_50_m_wrong_are_overruled(seed: int, count: int, moving: bool) -> None:
    ride = plain(seed)
    begin_s = MOVING_S if moving else 0.0
    frames = misled(ride.between(begin_s - 0.1, begin_s + 30.0), count)
    localiser = TramLocaliser(ride.simulation.vehicle)
    errors = judged(ride.simulation, localiser, run(localiser, frames))
    assert errors.horizontal_m[0] > 40.0
    later = known(errors).within(begin_s + count + 12.0, math.inf)
    assert later.horizontal_m.max() < PLACE_M
    assert np.abs(known(errors).yaw_rad).max() < 0.1
    assert FIRST_FIXES_WRONG in [event.kind for event in localiser.complaints()]


@pytest.mark.parametrize("turned_rad", [0.5 * math.pi, math.pi])
def test_memory_with_a_wrong_heading_is_overcome(turned_rad: float) -> None:
    ride = ridden(laid(PLAN + " | 150 L100/60 80 | 200 R60/80 150 |"), city(), 1)
    localiser = TramLocaliser(ride.simulation.vehicle)
    run(localiser, ride.between(-1.0, 40.0))
    state = localiser.snapshot()
    state["navigation"]["filter"]["x"][Ix.YAW] += turned_rad
    localiser.restore(state)
    errors = judged(ride.simulation, localiser, run(localiser, ride.between(40.0, math.inf)))
    assert errors.yaw_rad[0] == pytest.approx(turned_rad, abs=0.1) or turned_rad == math.pi
    assert localiser.complaints()
    end = errors.within(errors.time_s[-1] - 20.0, math.inf)
    assert end.horizontal_m.max() < PLACE_M
    assert np.abs(end.yaw_rad).max() < YAW_RAD


# Memory -------------------------------------------------------------------------------------------
def same(one: Estimate | None, other: Estimate | None) -> bool:
    if one is None or other is None:
        return one is other
    return (
        one.motion.tobytes() == other.motion.tobytes()
        and one.covariance.tobytes() == other.covariance.tobytes()
        and (one.mode, one.standing, one.verdicts) == (other.mode, other.standing, other.verdicts)
    )


def phase(localiser: TramLocaliser) -> str:
    """What the localiser is doing."""
    if localiser.memory.parked is not None:
        return "parked"
    if localiser._search is not None:
        return "trying" if localiser._search.trying else "keeping"
    return localiser.phase.value


def restarts(ride: Ride, frames: list[SyncFrame], wanted: Iterable[str]) -> None:
    """Restart some frames into each phase; every restarted one goes on as the first does."""
    whole = TramLocaliser(ride.simulation.vehicle)
    others: list[TramLocaliser] = []
    waiting, lasted = list(wanted), 0
    for frame in frames:
        estimate = whole.take(frame)
        said = whole.complaints()
        for other in others:
            assert same(other.take(frame), estimate)
            assert other.complaints() == said
        for mean in frame.ahead:
            for each in (whole, *others):
                each.see(mean)
        ahead = whole.ahead()
        assert all(same(other.ahead(), ahead) for other in others)
        lasted = lasted + 1 if waiting and phase(whole) == waiting[0] else 0
        if lasted == INTO_PHASE:
            waiting.pop(0)
            other = TramLocaliser(ride.simulation.vehicle)
            other.restore(snapshots.unpack(snapshots.pack(whole.snapshot())))
            others.append(other)
    assert not waiting
    assert others[-1].snapshot().keys() == whole.snapshot().keys()


def test_restart_from_memory_is_bit_identical_in_every_phase() -> None:
    ride = ridden(laid(LINE), city(), 1, 30.0)
    restarts(ride, ride.frames, ["resting", "keeping", "running"])


def test_restart_from_memory_is_bit_identical_while_both_directions_are_tried() -> None:
    # On a straight at constant speed nothing tells them apart, until it brakes.
    ride = ridden(laid("| 600 |"), city(wheels=None), 1, 78.0)
    restarts(ride, ride.between(40.0, 78.0), ["trying", "running"])


def test_restart_from_memory_is_bit_identical_while_parked() -> None:
    ride = ridden(laid("| 100 | 100 |"), altered(city(), driver={"dwell_s": 60.0}), 1, 100.0)
    silent_s = ride.arrival_s(2) + 5.0
    awake_s = silent_s + 2.0 * BLIND_S
    frames = copies([*ride.between(-1.0, silent_s), *ride.between(awake_s, 100.0)])
    for frame in frames:
        if awake_s < time_s(frame.stamp_ns) < awake_s + 3.0:  # nothing yet that tells
            del frame.odometry[:]
            del frame.gnss[:]
    restarts(ride, frames, ["parked", "running"])


def test_what_the_opposite_direction_says_of_the_sensors_is_not_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A filter that goes the wrong way sees fixes drift: that tells of itself alone."""
    ride, learn, marks = plain(1), FixNoise.learn, {True: 0, False: 0}

    def marked(self: FixNoise, stamp_ns: int, ekf: TramFilter, *rest: Any) -> list[Event]:
        true_yaw = float(ride.simulation.truth([stamp_ns]).motion.yaw_rad[0])
        opposite = abs(math.remainder(ekf.state[Ix.YAW] - true_yaw, math.tau)) > 0.5 * math.pi
        marks[opposite] += 1
        mark = RECEIVER_BOASTS(key=str(opposite), times=9.0, stated_m=0.5)
        return [*learn(self, stamp_ns, ekf, *rest), mark]

    monkeypatch.setattr(FixNoise, "learn", marked)
    localiser = TramLocaliser(ride.simulation.vehicle)
    said = set()
    frames = upwards(ride.between(-1.0, 40.0))
    for frame in frames:
        localiser.take(frame)
        said |= {each.facts["key"] for each in localiser.complaints()}
    assert marks[True] > 0, "no other direction was tried"
    assert marks[False] > 0
    assert said == {"False"}


# A long silence -----------------------------------------------------------------------------------
@pytest.mark.parametrize("wheels", [True, False])
@pytest.mark.parametrize("seed", FEW)
def test_vehicle_that_stood_is_taken_up_again_after_a_long_silence(seed: int, wheels: bool) -> None:
    chosen = altered(city(), driver={"dwell_s": 90.0})
    chosen = chosen if wheels else altered(chosen, wheels=None, gnss={"velocity": True})
    ride = ridden(laid("| 100 L60/70 60 | 200 |"), chosen, seed, 145.0)
    silent_s, awake_s = ride.arrival_s(2) + 10.0, ride.departure_s(2) - 15.0
    assert awake_s - silent_s > 4.0 * BLIND_S
    errors = localised(ride, [*ride.between(-1.0, silent_s), *ride.between(awake_s, 145.0)])
    # Wheels tell at once; without them the vehicle must first be seen to stand.
    after = errors.within(awake_s + (1.0 if wheels else 6.0), 145.0)
    assert (after.mode != HEADING_UNKNOWN).all()
    assert np.abs(after.yaw_rad).max() < YAW_RAD
    assert after.horizontal_m.max() < PLACE_M
