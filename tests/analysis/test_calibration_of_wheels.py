"""Wheels, antenna, delays and clocks out of a ride whose truth is known; what has no figures."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rides import altered, laid

from tramstream.analysis.fleet.changes import states
from tramstream.analysis.fleet.outcome import Outcome
from tramstream.analysis.fleet.places import Place
from tramstream.analysis.fleet.table import rows_of
from tramstream.analysis.notebook.rides import simulate
from tramstream.analysis.odometry import finding
from tramstream.analysis.odometry.calibration import Calibration, calibrate
from tramstream.analysis.odometry.finding import fragment
from tramstream.analysis.odometry.material import FixColumns, Inertial, Ride, WheelWay, read_ride
from tramstream.analysis.odometry.moves import moved_at
from tramstream.analysis.odometry.wording import of_ride
from tramstream.calibration_file import read
from tramstream.simulation import scenario
from tramstream.simulation.event_kinds import ImuStuck, Slide

PLAN = "| 150 L40/60 120 R40/90 160 L60/70 200 | 90 R35/80 150 L40/100 180 R50/60 220 |"
RADIUS_M = 0.3
ERROR_M = (-0.004, -0.0025)
"""Of the wheels: left, right."""
AHEAD_M, LEFT_M = 3.1, 0.25
RECEIVER_S, WHEELS_S = 0.015, 0.012
STDS = 4.0
SLIDE_S, SLIDE_END_S, SLID = 62.0, 63.0, 0.5


@pytest.fixture(scope="module")
def ride(tmp_path_factory: pytest.TempPathFactory) -> Ride:
    """Two minutes and a half with curves, two departures, a slide; the IMU at 100 Hz."""
    chosen = altered(
        scenario.load("city"),
        imu={"rate_hz": 100.0, "batch": 1},
        resampler=None,
        driver={"dwell_s": 12.0, "first_dwell_s": 12.0},
        gnss={
            "lever_arm_m": (3.0, 0.0, 3.2),
            "lever_arm_error_m": (0.1, LEFT_M, 0.0),
            "timing": {"stamp_offset_s": RECEIVER_S},
        },
        wheels={
            "axle": {"radius_error_m": ERROR_M},
            "timing": {"stamp_offset_s": WHEELS_S},
            "slides_per_stop": 0.0,
            "slips_per_stop": 0.0,
        },
        events=(Slide(start_s=SLIDE_S, duration_s=SLIDE_END_S - SLIDE_S, factor=SLID),),
    )
    path = tmp_path_factory.mktemp("ride") / "ride.mcap"
    simulate(chosen, line=laid(PLAN), seed=3, out=path).close()
    return read_ride(path)


@pytest.fixture(scope="module")
def found(ride: Ride) -> Calibration:
    return calibrate(ride)


def test_every_constant_is_where_it_is_within_its_deviation(found: Calibration) -> None:
    assert found.verdict == ""
    truth = {
        "scale left": ERROR_M[0] / RADIUS_M,
        "scale right": ERROR_M[1] / RADIUS_M,
        "antenna ahead": AHEAD_M,
        "antenna left": LEFT_M,
        "receiver delay": RECEIVER_S,
        "wheel delay": WHEELS_S,
    }
    assert [each.name for each in found.figures] == list(truth)
    for each in found.figures:
        assert each.value == pytest.approx(truth[each.name], abs=STDS * each.std), each
    limits = {"1": 0.002, "m": 0.3, "s": 0.03}
    assert all(each.std < limits[each.unit] for each in found.figures)


def test_what_goes_together_is_said(found: Calibration) -> None:
    np.testing.assert_allclose(np.diagonal(found.correlation), 1.0)
    assert found.correlation[0, 1] > 0.9  # both wheels are known by one way
    told = list(of_ride(found))
    assert any("correlation of scale left and scale right" in line for line in told)
    assert any("height cannot be told" in line for line in told)


def test_slide_is_found_with_the_way_that_is_missing(found: Calibration, ride: Ride) -> None:
    left = [each for each in found.slips if each.wheel == "left"]
    (slide,) = [each for each in left if each.start_s < SLIDE_END_S and each.end_s > SLIDE_S]
    assert slide.start_s == pytest.approx(SLIDE_S, abs=0.7)
    assert slide.end_s == pytest.approx(SLIDE_END_S, abs=0.7)
    one = next(each for each in ride.wheels if each.name == "left")
    counted = np.interp([SLIDE_S, SLIDE_END_S], one.time_s - WHEELS_S, one.way_m)
    assert slide.way_m == pytest.approx(-(counted[1] - counted[0]) * (1 - SLID) / SLID, abs=0.15)


# Clocks -------------------------------------------------------------------------------------------
def late(ride: Ride, sensor: str, by_s: float) -> Ride:
    """Stamps of one sensor are later."""
    if sensor == "gnss":
        return replace(ride, fixes=replace(ride.fixes, time_s=ride.fixes.time_s + by_s))
    if sensor == "imu":
        return replace(ride, imu=replace(ride.imu, time_s=ride.imu.time_s + by_s))
    moved = tuple(replace(one, time_s=one.time_s + by_s) for one in ride.wheels)
    return replace(ride, wheels=moved)


@pytest.mark.parametrize(("sensor", "by_s"), [("gnss", 3.0), ("imu", -3.0), ("wheels", 3.0)])
def test_clock_that_is_seconds_off_is_named_with_its_offset(
    ride: Ride, found: Calibration, sensor: str, by_s: float
) -> None:
    off = calibrate(late(ride, sensor, by_s))
    assert off.clock.sensor == sensor
    assert off.clock.offset_s == pytest.approx(by_s, abs=0.06)
    # The delays hold the whole of it, far better: against those of the ride as it was.
    receiver = by_s * {"gnss": 1, "imu": -1, "wheels": 0}[sensor]
    wheels = by_s * {"gnss": 0, "imu": -1, "wheels": 1}[sensor]
    for name, expected in (("receiver delay", receiver), ("wheel delay", wheels)):
        now, before = off.figure(name), found.figure(name)
        assert now is not None
        assert before is not None
        assert now.value - before.value == pytest.approx(expected, abs=0.01)


def test_clocks_that_agree_are_not_named(found: Calibration) -> None:
    assert found.clock.sensor == ""


# No figures ---------------------------------------------------------------------------------------
def without_motion(ride: Ride) -> Ride:
    """The first stand."""
    still, end_s = ride.imu.time_s < 11.0, 11.0
    imu = Inertial(ride.imu.time_s[still], ride.imu.rate_radps[still], ride.imu.force_mps2[still])
    wheels = tuple(
        replace(one, time_s=one.time_s[one.time_s < end_s], way_m=one.way_m[one.time_s < end_s])
        for one in ride.wheels
    )
    return replace(ride, imu=imu, wheels=wheels, fixes=chosen_fixes(ride, end_s))


def chosen_fixes(ride: Ride, end_s: float) -> FixColumns:
    """Fixes until an instant."""
    kept = ride.fixes.time_s < end_s
    return FixColumns(**{name: column[kept] for name, column in vars(ride.fixes).items()})


def without_fixes(ride: Ride) -> Ride:
    return replace(ride, fixes=chosen_fixes(ride, 0.0))


def with_dead_wheel(ride: Ride) -> Ride:
    left, right = ride.wheels
    return replace(ride, wheels=(replace(left, way_m=0.0 * left.way_m), right))


def with_stuck_axis(ride: Ride) -> Ride:
    return replace(ride, imu=replace(ride.imu, trouble=("gyro z",)))


def with_other_unit(ride: Ride) -> Ride:
    wheels: tuple[WheelWay, ...] = tuple(replace(one, way_m=one.way_m / 2) for one in ride.wheels)
    return replace(ride, wheels=wheels)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (without_motion, "too little motion"),
        (without_fixes, "usable fixes"),
        (with_dead_wheel, "do not count while the vehicle moves: left"),
        (with_stuck_axis, "stuck or dead for seconds: gyro z"),
        (with_other_unit, "the wheels' configured constant is another's"),
    ],
)
def test_ride_that_tells_nothing_has_a_verdict_and_no_figures(
    ride: Ride, spoil: object, says: str
) -> None:
    assert callable(spoil)
    verdict = calibrate(spoil(ride))
    assert says in verdict.verdict
    assert verdict.figures == ()
    told = list(of_ride(verdict))
    assert told[-1].startswith("no figures: ")


def test_ride_in_which_the_imu_was_moved_has_the_instant_and_no_figures(ride: Ride) -> None:
    at_s = 100.0
    verdict = calibrate(moved_at(ride, at_s, np.radians([0.0, 4.0, 3.0])))
    (told,) = re.findall(r"was moved (\d+) s after the beginning", verdict.verdict)
    assert float(told) == pytest.approx(at_s, abs=10.0)
    assert verdict.figures == ()


def test_axis_that_repeats_itself_is_seen_in_the_samples(tmp_path: Path) -> None:
    """The simulator's stuck axis, through a record."""
    stuck = ImuStuck(axes=("gyro_z",), start_s=8.0, duration_s=5.0)
    chosen = altered(
        scenario.load("city"), imu={"rate_hz": 100.0, "batch": 1}, resampler=None, events=(stuck,)
    )
    simulate(chosen, line=laid(PLAN), seed=1, duration_s=15.0, out=tmp_path / "s.mcap").close()
    assert read_ride(tmp_path / "s.mcap").imu.trouble == ("gyro z",)


# The calibration ----------------------------------------------------------------------------------
def test_calibration_of_a_vehicle_is_one_that_its_configuration_takes(
    ride: Ride, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(finding, "read_ride", lambda *_: ride)
    one = finding.find([tmp_path / "ride.mcap"])
    rows = rows_of("calibrate", [Outcome(Place("ride.mcap", ()), one)])
    text = fragment(states(rows), [one.detail])
    (tmp_path / "c.toml").write_text(text)
    sections, provenance = read(tmp_path / "c.toml")
    left = sections["wheels"]["each"]["left"]
    true = ride.vehicle.wheels.m_per_pulse * (1 + ERROR_M[0] / RADIUS_M)
    assert left["m_per_pulse"] == pytest.approx(true, rel=STDS * left["scale_std"])
    assert sections["wheels"]["delay_s"] == pytest.approx(WHEELS_S, abs=0.01)
    assert provenance.tool == "calibrate"
