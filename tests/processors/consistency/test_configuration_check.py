"""What of a configuration the data contradict is said within a minute of motion, and nothing else.

Rides of one kind: half a minute at a stop, a departure on straight track, curves, another stop. The
vehicle is as the scenario says; what its configuration says is altered, or the truth against it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import pytest
from rides import altered, laid

from tramstream import keys
from tramstream.config import Vehicle
from tramstream.events.messages import facts_of, sentence_of
from tramstream.graph import Graph
from tramstream.lines.line import Line
from tramstream.processor import Sample
from tramstream.processors.consistency import events
from tramstream.processors.consistency.processor import ConfigurationCheck
from tramstream.processors.resampling.resampler import Resampler
from tramstream.simulation import scenario
from tramstream.simulation.body import Body
from tramstream.simulation.event_kinds import ImuMoved
from tramstream.simulation.scenario import Scenario
from tramstream.simulation.simulation import EPOCH_NS, Simulation

PLAN = "| 150 L40/30 20 R40/30 120 L60/40 80 | 200 |"
STOOD_S = 12.0
"""The first stop; after it a minute of motion."""
DURATION_S = STOOD_S + 60.0
FIRST_STOP_S = 5.0
DEPARTURE_S = 20.0
"""A departure takes ten seconds; so much after it its force is judged."""
BOGIES_M = 6.4
WAITED_S = 35.0
"""The scale is said once the force has had time to bear witness."""
EVENT = keys.EVENT.at("configuration_check")
SEEDS = (1, 2)
Change = Callable[[Vehicle], Vehicle]


@cache
def base() -> Scenario:
    """The sensors of the city's trams, the IMU at 100 Hz; the first stop is short."""
    chosen = scenario.load("city")
    driver = {"dwell_s": 15.0, "first_dwell_s": STOOD_S}
    return altered(chosen, imu={"rate_hz": 100.0, "batch": 1}, resampler=None, driver=driver)


@cache
def line() -> Line:
    return laid(PLAN)


@cache
def sent(changed: Scenario, seed: int = 1) -> tuple[list[Sample], Vehicle]:
    """Samples of a ride in the resampler's order, and the configuration of the vehicle."""
    simulation = Simulation(line(), changed, seed, DURATION_S)
    graph = Graph([Resampler(simulation.vehicle)])
    made = [each for sample in simulation.samples() for each in graph.step(sample)]
    wanted = (keys.SYNC_FRAME, keys.SYNC_LATE)
    return [each for each in made if each.key in wanted], simulation.vehicle


def told(
    changed: Scenario | None = None, change: Change = lambda vehicle: vehicle, seed: int = 1
) -> Iterator[tuple[str, float, dict[str, Any]]]:
    """Kind, time of the ride and facts of what is said."""
    samples, vehicle = sent(changed or base(), seed)
    check = ConfigurationCheck(change(vehicle))
    for sample in samples:
        for made in check.step(sample):
            if made.key == EVENT:
                assert sentence_of(made.message)
                time_s = (made.stamp_ns - EPOCH_NS) / 1e9
                yield made.message.kind, time_s, facts_of(made.message)


def only(found: Iterator[tuple[str, float, dict[str, Any]]], kind: Any) -> tuple[float, Any]:
    """Time and facts of the one thing that is said."""
    everything = list(found)
    assert [name for name, _, _ in everything] == [kind.name]
    return everything[0][1], everything[0][2]


def turned(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Scenario:
    """The IMU's case is turned against what is configured, degrees."""
    return altered(base(), imu={"misalignment_deg": (roll, pitch, yaw)})


def wheels(factor: float) -> Change:
    """The configured way of a pulse is wrong by a factor."""
    return lambda vehicle: altered(
        vehicle, wheels={"m_per_pulse": factor * vehicle.wheels.m_per_pulse}
    )


def late(**sections: float) -> Scenario:
    """Stamps of sections are later than the truth, s."""
    changes = {
        name: {"timing": {"stamp_offset_s": offset_s, "latency_s": 0.1}}
        for name, offset_s in sections.items()
    }
    return altered(base(), **changes)


# All is well --------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_configuration_that_fits_is_not_spoken_of(seed: int) -> None:
    assert list(told(seed=seed)) == []


def test_other_cab_leading_is_not_spoken_of() -> None:
    assert list(told(altered(base(), reverse=True))) == []


@pytest.mark.parametrize("factor", [0.92, 1.08])
def test_worn_or_new_tyres_are_not_spoken_of(factor: float) -> None:
    assert list(told(change=wheels(factor))) == []


def test_mounting_within_its_deviation_is_not_spoken_of() -> None:
    assert list(told(turned(2.0, -2.0, 3.0))) == []


@pytest.mark.parametrize("absent", ["imu", "gnss", "wheels"])
def test_absent_sensor_is_no_contradiction(absent: str) -> None:
    assert list(told(altered(base(), **{absent: None}))) == []


def test_receiver_without_velocity_is_no_contradiction() -> None:
    assert list(told(altered(base(), gnss={"velocity": False}))) == []


# Mounting -----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("roll", "pitch"), [(10.0, 0.0), (0.0, -10.0), (90.0, 0.0), (0.0, 90.0), (180.0, 0.0)]
)
def test_tilted_case_is_said_at_the_first_stand_with_the_mounting_that_fits(
    roll: float, pitch: float
) -> None:
    for seed in SEEDS:
        found = list(told(turned(roll, pitch), seed=seed))
        kind, time_s, facts = found[0]
        assert kind == events.MOUNTING_TILTED.name
        assert time_s < FIRST_STOP_S
        assert facts["tilt_deg"] == pytest.approx(max(abs(roll), abs(pitch)), abs=3.0)
        again = set_to(facts, turned_by=(roll, pitch, 0.0), seed=seed)
        assert events.MOUNTING_TILTED.name not in {kind for kind, _, _ in again}


def set_to(
    facts: dict[str, Any], turned_by: tuple[float, float, float], seed: int
) -> list[tuple[str, float, dict[str, Any]]]:
    """What is said once the cure has been taken."""
    angles = tuple(facts[f"mounting_{axis}_deg"] for axis in ("roll", "pitch", "yaw"))
    return list(
        told(turned(*turned_by), lambda each: altered(each, imu={"mounting_deg": angles}), seed)
    )


@pytest.mark.parametrize("yaw", [10.0, -10.0, 90.0])
def test_case_turned_about_the_vertical_is_said_at_the_first_departure(yaw: float) -> None:
    for seed in SEEDS:
        time_s, facts = only(told(turned(yaw=yaw), seed=seed), events.MOUNTING_TURNED)
        assert STOOD_S < time_s < STOOD_S + DEPARTURE_S
        assert abs(facts["turned_deg"]) == pytest.approx(abs(yaw), abs=4.0)
        assert set_to(facts, (0.0, 0.0, yaw), seed) == []


def test_case_that_lies_on_its_side_and_is_turned_is_put_right_in_two_steps() -> None:
    found = list(told(turned(90.0, 0.0, 60.0)))
    kinds = [kind for kind, _, _ in found]
    assert kinds == [events.MOUNTING_TILTED.name, events.MOUNTING_TURNED.name]
    assert set_to(found[1][2], (90.0, 0.0, 60.0), 1) == []


@pytest.mark.parametrize("turn", [(2.0, 0.0, 0.0), (0.0, -5.0, 0.0), (20.0, 15.0, 10.0)])
def test_case_that_is_moved_on_the_way_is_said_with_the_instant_and_the_turn(
    turn: tuple[float, float, float],
) -> None:
    """It is said within fifteen seconds; the instant is found within two, the tilt within 1°."""
    moved_s = STOOD_S + 36.0
    event = ImuMoved(start_s=moved_s, duration_s=1000.0, turned_deg=turn)
    found = [
        (time_s, facts)
        for kind, time_s, facts in told(altered(base(), events=(event,)))
        if kind == events.MOUNT_CHANGED.name
    ]
    ((time_s, facts),) = found
    assert time_s < moved_s + 15.0
    assert time_s - facts["ago_s"] == pytest.approx(moved_s, abs=2.0)
    # The cases of the city's trams are turned by 90° about the vertical: x and y change places.
    assert facts["tilt_deg"] == pytest.approx(math.hypot(*turn[:2]), abs=1.5)
    assert facts["origin"] == "the configuration"


def test_force_in_another_unit_is_said_at_the_first_stand() -> None:
    """In g instead of m/s²."""
    samples, vehicle = sent(base())
    check = ConfigurationCheck(vehicle)
    kinds = []
    for sample in samples[:1000]:
        message = type(sample.message)()
        message.CopyFrom(sample.message)
        if message.HasField("imu"):
            for axis in "xyz":
                name = f"accel_{axis}_mps2"
                setattr(message.imu, name, getattr(message.imu, name) / 9.81)
        made = check.step(sample._replace(message=message))
        kinds += [each.message.kind for each in made if each.key == EVENT]
    assert kinds == [events.GRAVITY_WRONG.name]


# Wheels and fixes ---------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("factor", "likely"),
    [
        (1.2, "a wheel of another size, or other pulses a turn"),
        (0.8, "a wheel of another size, or other pulses a turn"),
        (2.0, "both edges of a pulse counted for one"),
        (3.6, "km/h taken for m/s"),
        (1000.0, "millimetres taken for metres"),
    ],
)
def test_scale_of_the_wheels_is_said_within_a_minute_with_what_it_looks_like(
    factor: float, likely: str
) -> None:
    for seed in SEEDS:
        time_s, facts = only(told(change=wheels(factor), seed=seed), events.WHEEL_SCALE)
        assert time_s < STOOD_S + WAITED_S
        assert factor * facts["factor"] == pytest.approx(1.0, abs=0.02)
        assert facts["likely"] == likely


def test_wheels_that_count_backwards_are_said_at_the_first_departure() -> None:
    samples, vehicle = sent(base())
    check = ConfigurationCheck(vehicle)
    found = []
    for sample in samples:
        message = type(sample.message)()
        message.CopyFrom(sample.message)
        if sample.key == keys.SYNC_FRAME:
            for reading in message.odometry:
                for wheel in reading.wheels:
                    wheel.pulses = -wheel.pulses
        made = check.step(sample._replace(message=message))
        found += [each for each in made if each.key == EVENT]
    assert [each.message.kind for each in found] == [events.WHEELS_BACKWARDS.name]
    assert (found[0].stamp_ns - EPOCH_NS) / 1e9 < STOOD_S + DEPARTURE_S


def test_fixes_in_knots_are_told_from_wheels_by_the_force() -> None:
    samples, vehicle = sent(base())
    check = ConfigurationCheck(vehicle)
    found = []
    for sample in samples:
        message = type(sample.message)()
        message.CopyFrom(sample.message)
        if sample.key == keys.SYNC_FRAME:
            for fix in message.gnss:
                fix.vel_n_mps, fix.vel_e_mps = 1.944 * fix.vel_n_mps, 1.944 * fix.vel_e_mps
        made = check.step(sample._replace(message=message))
        found += [each.message for each in made if each.key == EVENT]
    assert {each.kind for each in found} == {events.FIX_SPEED_SCALE.name}
    assert facts_of(found[0])["likely"] == "knots taken for m/s"


@pytest.mark.parametrize("delay_s", [0.12, -0.15, 0.4])
def test_delay_of_the_fixes_is_said_within_a_minute(delay_s: float) -> None:
    for seed in SEEDS:
        time_s, facts = only(told(late(gnss=delay_s, wheels=0.0), seed=seed), events.FIX_DELAY)
        assert time_s < STOOD_S + WAITED_S
        assert facts["delay_s"] == pytest.approx(delay_s, abs=0.03)


def test_clock_that_is_a_second_behind_is_said_though_nothing_of_it_is_used() -> None:
    found = list(told(late(gnss=-1.0)))
    assert {kind for kind, _, _ in found} == {events.STAMPS_LATE.name}
    _, time_s, facts = found[0]
    assert time_s < STOOD_S
    assert facts["key"] == keys.GNSS_FIX.path
    assert facts["needed_s"] == pytest.approx(1.1, abs=0.15)


# The antenna --------------------------------------------------------------------------------------
@pytest.mark.parametrize(("ahead_m", "left_m"), [(1.5, 0.0), (-1.5, 0.0), (0.0, 1.2)])
def test_antenna_that_is_elsewhere_is_said_after_the_curves(ahead_m: float, left_m: float) -> None:
    changed = altered(base(), gnss={"lever_arm_error_m": (ahead_m, left_m, 0.0)})
    for seed in SEEDS:
        _, facts = only(told(changed, seed=seed), events.LEVER_ARM)
        assert facts["direction"] == ("ahead" if ahead_m else "to the left")
        off_m = facts["found_m"] - facts["configured_m"]
        assert off_m == pytest.approx(ahead_m + left_m, abs=0.5)


# Again --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", SEEDS)
def test_bogies_that_nobody_has_configured_are_said_after_the_curves(seed: int) -> None:
    """Midway between two bogies is what does not slip: the antenna is that much further ahead."""
    stiff = Body(pivots_m=(0.0, -BOGIES_M), pitch_deg_per_mps2=0.0, roll_deg_per_mps2=0.0)
    one_point: Change = lambda vehicle: altered(  # noqa: E731
        vehicle, ekf={"pivot_m": 0.0, "bogie_distance_m": 0.0}, wheels={"bogie": ""}
    )
    time_s, facts = only(told(altered(base(), body=stiff), one_point, seed), events.LEVER_ARM)
    assert time_s < DURATION_S
    assert facts["direction"] == "ahead"
    antenna_m = base().gnss.lever_arm_m[0] + 0.5 * BOGIES_M
    assert facts["found_m"] == pytest.approx(antenna_m, abs=0.8)
    assert "bogie_distance_m" in events.LEVER_ARM.cure


def test_what_holds_is_said_again_after_five_minutes_and_not_before() -> None:
    samples, vehicle = sent(turned(yaw=90.0))
    check = ConfigurationCheck(vehicle)
    rounds = [
        [each for sample in samples for each in check.step(moved(sample, number * DURATION_S))]
        for number in range(6)
    ]
    said = [sum(each.key == EVENT for each in made) for made in rounds]
    assert said[0] == 1
    assert sum(said) == 2


def moved(sample: Sample, by_s: float) -> Sample:
    """The same sample later; all stamps within it too."""
    message = type(sample.message)()
    message.CopyFrom(sample.message)
    by_ns = round(by_s * 1e9)
    message.stamp_ns += by_ns
    if sample.key == keys.SYNC_FRAME:
        for part in (*message.gnss, *message.odometry):
            part.stamp_ns += by_ns
    return sample._replace(message=message, stamp_ns=sample.stamp_ns + by_ns)
