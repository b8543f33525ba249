"""The processor `segments` on short simulated rides, its body on springs, against their truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest
from msgspec.structs import replace

from tramstream import keys
from tramstream.analysis.segments import judging, learning
from tramstream.analysis.segments.rides import Ridden, World, frames, ridden
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.processor import Sample
from tramstream.processors.segments.kernels import Ix
from tramstream.processors.segments.processor import SegmentFinder
from tramstream.proto.estimate_pb2 import LinePlace, SegmentEvent
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Landmark
from tramstream.proto.sync_pb2 import SyncFrame
from tramstream.simulation.simulation import EPOCH_NS
from tramstream.tracks.signature import of_line

RIDE_S = 230.0
"""Three stops and six turns."""
DEGREE = math.radians(1.0)


@cache
def ride(wheels: bool, base: str = "tram") -> Ridden:
    return ridden(World(base=base, wheels=wheels), 1, duration_s=RIDE_S)


@cache
def stream(wheels: bool, base: str = "tram") -> tuple[Sample, ...]:
    return tuple(frames(ride(wheels, base).simulation))


class Said(NamedTuple):
    events: list[SegmentEvent]
    places: list[LinePlace]
    kinds: list[str]
    finder: SegmentFinder


def said(samples: Iterable[Sample], vehicle: Vehicle, lines: Any = ()) -> Said:
    found = Said([], [], [], SegmentFinder(vehicle, lines))
    for sample in samples:
        for made in found.finder.step(sample):
            if made.key is keys.EST_SEGMENT:
                found.events.append(made.message)
            elif made.key is keys.MAP_PLACE:
                found.places.append(made.message)
            elif made.key.quantity == "event":
                found.kinds.append(made.message.kind)
    return found


def changed(samples: Iterable[Sample], change: Callable[[SyncFrame, float], None]) -> list[Sample]:
    """Frames that somebody has tampered with; the function gets the time of the ride too."""
    made = []
    for sample in samples:
        frame = SyncFrame()
        frame.CopyFrom(sample.message)
        change(frame, (frame.stamp_ns - EPOCH_NS) / S)
        made.append(sample._replace(message=frame))
    return made


def with_segments(vehicle: Vehicle, **told: Any) -> Vehicle:
    return replace(vehicle, sections={**vehicle.sections, "segments": told})


@pytest.mark.parametrize("wheels", [True, False])
def test_stops_and_turns_are_those_of_the_ride(wheels: bool) -> None:
    of = ride(wheels)
    found = said(stream(wheels), of.simulation.vehicle)
    stops, turns = judging.stops(of, found.events), judging.turns(of, found.events)
    assert stops.f1 == 1.0
    assert stops.hits >= 3
    assert turns.missed == turns.false == 0
    assert turns.hits >= 4
    assert np.sqrt(np.mean(turns.angle_rad**2)) < 0.5 * DEGREE
    assert np.all(np.abs(turns.radius) < 0.05)


@pytest.mark.parametrize(("wheels", "limit_m"), [(True, 0.5), (False, 6.0)])
def test_way_between_stops_is_that_of_the_ride(wheels: bool, limit_m: float) -> None:
    """Without wheels by integrated acceleration, with its drift removed at stops, over grades."""
    of = ride(wheels)
    found = said(stream(wheels), of.simulation.vehicle)
    stands = [each for each in found.events if each.kind == SegmentEvent.STOP]
    true = of.simulation.line.stops_m[: len(stands)]
    for (one, other), way in zip(pairwise(stands), np.diff(true), strict=True):
        assert other.start_m - one.start_m == pytest.approx(way, abs=limit_m)


def test_stated_deviation_of_the_way_without_wheels_holds_the_error() -> None:
    of = ride(False)
    found = said(stream(False), of.simulation.vehicle)
    memory = found.finder.memory.motion
    end = of.simulation.truth([memory.stamp_ns]).motion
    error = memory.x[Ix.WAY] - float(end.arc_length_m[0])
    assert abs(error) < 4.0 * math.sqrt(memory.P[Ix.WAY, Ix.WAY])
    speed = memory.x[Ix.SPEED] - float(end.speed_mps[0])
    assert abs(speed) < 4.0 * math.sqrt(memory.P[Ix.SPEED, Ix.SPEED]) + 0.02


def test_imu_upside_down_without_calibration_finds_its_mounting() -> None:
    """Said with angle and limit, and the turns keep their sides."""

    def turn_over(frame: SyncFrame, _: float) -> None:
        imu = frame.imu
        imu.gyro_y_radps, imu.gyro_z_radps = -imu.gyro_y_radps, -imu.gyro_z_radps
        imu.accel_y_mps2, imu.accel_z_mps2 = -imu.accel_y_mps2, -imu.accel_z_mps2

    of = ride(True)
    found = said(changed(stream(True), turn_over), of.simulation.vehicle)
    assert "segments.mounting_contradicts" in found.kinds
    turns = judging.turns(of, found.events)
    assert turns.missed == turns.false == 0
    assert np.sqrt(np.mean(turns.angle_rad**2)) < DEGREE


def test_wheels_that_stop_counting_are_said_and_the_way_goes_on() -> None:
    frozen: dict[str, int] = {}

    def die(frame: SyncFrame, time_s: float) -> None:
        for odometry in frame.odometry:
            for wheel in odometry.wheels:
                if time_s > 38.0:
                    wheel.pulses = frozen[wheel.wheel]
                else:
                    frozen[wheel.wheel] = wheel.pulses

    of = ride(True)
    found = said(changed(stream(True), die), of.simulation.vehicle)
    assert "segments.wheels_refused" in found.kinds
    memory = found.finder.memory.motion
    end = of.simulation.truth([memory.stamp_ns]).motion
    assert memory.x[Ix.WAY] == pytest.approx(float(end.arc_length_m[0]), abs=15.0)


def test_stuck_gyroscope_is_said() -> None:
    def stick(frame: SyncFrame, time_s: float) -> None:
        if time_s > 33.0:
            frame.imu.gyro_z_radps = 0.001

    of = ride(True)
    found = said(changed(stream(True), stick), of.simulation.vehicle)
    assert "segments.gyro_stuck" in found.kinds


def test_place_is_found_on_the_line_without_a_receiver() -> None:
    of = ride(True)
    found = said(stream(True), of.simulation.vehicle, [of_line(of.simulation.line, "built-in")])
    last = found.places[-1]
    true = float(of.simulation.truth([last.stamp_ns]).motion.arc_length_m[0])
    assert last.state == LinePlace.PLACED
    assert last.chainage_m == pytest.approx(true, abs=5.0)
    assert abs(last.chainage_m - true) < 4.0 * last.chainage_std_m
    assert "segments.placed" in found.kinds


def test_landmark_is_taken_with_the_frame_that_follows_it() -> None:
    of, samples = ride(True), list(stream(True)[:6000])
    mark = Landmark(stamp_ns=samples[5500].stamp_ns, name="beacon", line="x", chainage_m=100.0)
    samples.insert(1000, Sample(keys.LANDMARK, mark, mark.stamp_ns, 1))
    found = said(samples, of.simulation.vehicle, [of_line(of.simulation.line, "built-in")])
    assert not found.finder.memory.landmarks


def test_areas_are_entered_and_left_by_fixes() -> None:
    of = ride(True)
    level, line = of.simulation.line.level, of.simulation.line
    middle = np.degrees(level.to_geodetic(line.position_l(np.array([131.0])))[0])
    vehicle = with_segments(
        of.simulation.vehicle,
        areas={
            "stop 2": {
                "latitude_deg": float(middle[0]),
                "longitude_deg": float(middle[1]),
                "radius_m": 40.0,
            }
        },
    )

    def locate(frame: SyncFrame, _: float) -> None:
        if frame.sequence % 100 == 0:
            truth = of.simulation.truth([frame.stamp_ns])
            place = np.degrees(level.to_geodetic(truth.p_l)[0])
            frame.gnss.append(
                GnssFix(
                    stamp_ns=frame.stamp_ns,
                    valid=True,
                    latitude_deg=float(place[0]),
                    longitude_deg=float(place[1]),
                    height_ellipsoid_m=300.0,
                    horizontal_std_m=1.0,
                )
            )

    found = said(changed(stream(True)[:11000], locate), vehicle)
    borders = [each for each in found.events if each.name]
    assert [each.kind for each in borders] == [SegmentEvent.AREA_ENTERED, SegmentEvent.AREA_LEFT]
    assert borders[0].start_m == pytest.approx(91.0, abs=15.0)
    assert borders[1].end_m == pytest.approx(175.0, abs=15.0)


def test_line_learned_from_two_rides_is_the_line() -> None:
    """Their wheels differ by 3 %; curves, stops and spread, against exact headings."""
    traces = []
    for seed, scale in ((1, 0.015), (2, -0.015)):
        one = ridden(World(scale=scale), seed, duration_s=RIDE_S)
        traces.append(learning.trace_of(one.simulation.vehicle, frames(one.simulation)))
    short = min(len(each.yaw_rad) for each in traces)
    traces = [each._replace(yaw_rad=each.yaw_rad[: short + 1]) for each in traces]
    made = learning.learn(traces, "7", "0")
    exact = of_line(ride(True).simulation.line).seen_by(3.2, 6.4)
    turned = made.yaw_rad[-60] - made.yaw_rad[0]
    true = exact[: len(made.yaw_rad) + 30] - exact[0]
    assert np.min(np.abs(true[-90:] - turned)) < 2.0 * DEGREE
    assert made.rides == 2
    assert len(made.stops_m) >= 3
    true_m = ride(True).simulation.line.stops_m[:3]
    np.testing.assert_allclose(made.stops_m[:3], true_m, atol=10.0)
