"""The tables of the modes: what the code does is what they say, and nothing else."""

from __future__ import annotations

import cmath
import math
import re
from collections.abc import Iterable
from pathlib import Path

import pytest
from rides import Ride, time_s
from test_tram_start import copies, plain

from tramstream.config import Vehicle
from tramstream.estimation.localiser import DEAD_RECKONING, HEADING_UNKNOWN, STARTING, TRACKING
from tramstream.live import snapshots
from tramstream.processors.tram import heading
from tramstream.processors.tram import localiser as localisers
from tramstream.processors.tram.localiser import BACK_S, BLIND_S, SILENT_S, TramLocaliser
from tramstream.processors.tram_filter import alignment
from tramstream.processors.tram_filter.modes import (
    BRIDGED_S,
    DEAD_RECKONING_S,
    HELD_S,
    RATE_HELD_S,
    TRANSITIONS,
    Drive,
    Event,
    Phase,
    drive_by_reading,
    drive_without_reading,
    published_mode,
)
from tramstream.proto.sync_pb2 import SyncFrame

PAGE = Path(__file__).parents[3] / "docs" / "localisation.md"
MS = 1_000_000
NS = 1e9


class Told(TramLocaliser):
    """A localiser that tells which transitions it has gone through."""

    gone: set[tuple[Phase, Event]]

    def _on(self, event: Event) -> None:
        self.gone.add((self.phase, event))
        super()._on(event)


def gone_through(ride: Ride, frames: Iterable[SyncFrame]) -> set[tuple[Phase, Event]]:
    localiser = Told(ride.simulation.vehicle)
    localiser.gone = set()
    for frame in frames:
        localiser.take(frame)
    return localiser.gone


def instants(ride: Ride) -> tuple[dict[Phase, float], float]:
    """When a phase has lasted for half a second; when it has stood for a second in the last one."""
    localiser, begun, found = TramLocaliser(ride.simulation.vehicle), {}, {}
    moved_s = stop_s = 0.0
    for frame in ride.frames:
        estimate = localiser.take(frame)
        now_s = time_s(frame.stamp_ns)
        if now_s > begun.setdefault(localiser.phase, now_s) + 0.5:
            found.setdefault(localiser.phase, now_s)
        if estimate is None or not estimate.standing or localiser.phase is not Phase.RUNNING:
            moved_s = now_s
        if stop_s == 0.0 and now_s > moved_s + 1.0:
            stop_s = now_s
    return found, stop_s


def silent(ride: Ride, start_s: float, lasts_s: float, fields: Iterable[str]) -> list[SyncFrame]:
    """A ride until 5 s after a while in which something is missing; a wheel reading ends that."""
    frames = copies(ride.between(-1.0, start_s + lasts_s + 5.0))
    for frame in frames:
        after_s = time_s(frame.stamp_ns) - start_s
        if after_s > lasts_s and frame.odometry:
            break
        if after_s > 0.0:
            for field in fields:
                frame.ClearField(field)
    return frames


def without_wheels(frames: list[SyncFrame], from_s: float) -> list[SyncFrame]:
    for frame in frames:
        if time_s(frame.stamp_ns) > from_s:
            frame.ClearField("odometry")
    return frames


def frozen_wheels(ride: Ride, from_s: float, lasts_s: float = 14.0) -> list[SyncFrame]:
    """A ride whose counters stand from a moment on."""
    frames = copies(ride.between(-1.0, from_s + lasts_s))
    last: dict[str, int] = {}
    for frame in frames:
        if time_s(frame.stamp_ns) > from_s:
            for reading in frame.odometry:
                for wheel in reading.wheels:
                    wheel.pulses = last.setdefault(wheel.wheel, wheel.pulses)
    return frames


def turned(ride: Ride, from_s: float) -> list[SyncFrame]:
    """A ride whose gyroscope turns by itself for two seconds."""
    frames = copies(ride.between(-1.0, from_s + 15.0))
    for frame in frames:
        if from_s < time_s(frame.stamp_ns) < from_s + 2.0:
            frame.imu.gyro_z_radps += 0.4
    return frames


def mounted_otherwise(ride: Ride, turned_deg: float, lasts_s: float) -> list[SyncFrame]:
    """A ride whose IMU's case is turned about the vertical against what is configured."""
    frames = copies(ride.between(-1.0, lasts_s))
    turn = cmath.exp(-1j * math.radians(turned_deg))
    for frame in frames:
        imu = frame.imu
        force = turn * complex(imu.accel_x_mps2, imu.accel_y_mps2)
        rate = turn * complex(imu.gyro_x_radps, imu.gyro_y_radps)
        imu.accel_x_mps2, imu.accel_y_mps2 = force.real, force.imag
        imu.gyro_x_radps, imu.gyro_y_radps = rate.real, rate.imag
    return frames


def set_back(ride: Ride, at_s: float) -> list[SyncFrame]:
    """A ride until `at_s`, and then once more, with a clock a day younger."""
    frames = ride.between(-1.0, at_s)
    again = copies(frames) if time_s(frames[-1].stamp_ns) > BACK_S + 1 else copies(ride.frames)
    for frame in again:
        frame.stamp_ns -= 86_400 * 1_000_000_000
        frame.ClearField("gnss")
        frame.ClearField("odometry")
        frame.imu.stamp_ns = frame.stamp_ns
    return [*frames, *again]


def test_every_transition_of_the_table_happens_and_no_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ride = plain(1)
    at, stop_s = instants(ride)
    both, everything = ("imu", "odometry"), ("imu", "odometry", "gnss")
    running = at[Phase.RUNNING]
    seeking = running - 2.5  # it takes four seconds from the departure to the heading
    blind_s = BLIND_S + 0.5
    waiting = copies(ride.frames)[:100]
    for frame in waiting:
        frame.ClearField("gnss")
    seen: set[tuple[Phase, Event]] = set()
    for frames in (
        silent(ride, seeking, blind_s, everything),
        silent(ride, running + 5.0, blind_s, both),
        silent(ride, stop_s, 2 * SILENT_S, both),
        silent(ride, stop_s, blind_s, both),
        without_wheels(silent(ride, stop_s, blind_s, both), stop_s),
        [*waiting, *set_back(ride, 0.0)[-1000:]],
        set_back(ride, at[Phase.RESTING]),
        set_back(ride, seeking),
        set_back(ride, running),
        turned(ride, running + 3.0),
        frozen_wheels(ride, 0.0, ride.departure_s(1) + 10.0),
        mounted_otherwise(ride, 10.0, ride.departure_s(1) + 20.0),
        frozen_wheels(ride, stop_s, ride.departure_s(2) + 10.0 - stop_s),
    ):
        seen |= gone_through(ride, frames)
    with monkeypatch.context() as patched:
        patched.setattr(alignment, "ENOUGH_RAD", 1e-6)
        patched.setattr(localisers, "LATELY_S", 60.0)
        seen |= gone_through(ride, frozen_wheels(ride, ride.departure_s(1) + 8.0, 8.0))
        seen |= gone_through(ride, mounted_otherwise(ride, 90.0, ride.departure_s(1) + 20.0))
    monkeypatch.setattr(heading, "KEEP_S", 0.5)
    seen |= gone_through(ride, ride.between(-1.0, running))
    assert seen == set(TRANSITIONS)


def test_an_event_that_has_no_place_in_a_phase_is_a_bug() -> None:
    localiser = TramLocaliser(plain(1).simulation.vehicle)
    with pytest.raises(KeyError):
        localiser._on(Event.DEPARTURE)


def test_page_shows_the_table_of_transitions() -> None:
    rows = re.findall(r"^\| (\w+) \| ([^|]+) \| (\w+) \|$", PAGE.read_text(), flags=re.MULTILINE)
    shown = {(Phase(before), Event(event)): Phase(after) for before, event, after in rows}
    assert shown == dict(TRANSITIONS)


def test_published_mode_follows_from_the_phase_and_the_age_of_the_last_fix() -> None:
    assert published_mode(Phase.WAITING, 0.0) == STARTING
    assert published_mode(Phase.RESTING, 0.0) == HEADING_UNKNOWN
    assert published_mode(Phase.SEEKING, 99.0) == HEADING_UNKNOWN
    assert published_mode(Phase.RUNNING, DEAD_RECKONING_S) == TRACKING
    assert published_mode(Phase.RUNNING, DEAD_RECKONING_S + 0.01) == DEAD_RECKONING


def test_reading_drives_the_motion_through_the_pause_before_it() -> None:
    assert drive_by_reading(0.01, one_before=True) is Drive.INERTIAL
    assert drive_by_reading(0.0, one_before=False) is Drive.INERTIAL
    assert drive_by_reading(HELD_S + 0.01, one_before=True) is Drive.BRIDGED
    assert drive_by_reading(HELD_S + 0.01, one_before=False) is Drive.COASTING
    assert drive_by_reading(BRIDGED_S + 0.01, one_before=True) is Drive.COASTING


def test_without_a_reading_the_bus_drives_the_motion_or_nothing() -> None:
    held, rate_held = int(HELD_S * NS), int(RATE_HELD_S * NS)
    assert drive_without_reading(held - MS, 0, rate_read=True) is None
    assert drive_without_reading(held, 0, rate_read=True) is Drive.YAW_RATE
    assert drive_without_reading(held, rate_held, rate_read=False) is None
    assert drive_without_reading(held, rate_held + MS, rate_read=False) is Drive.COASTING


def test_memory_of_an_older_version_is_refused_and_nothing_is_changed() -> None:
    """Whoever restores it begins afresh, and says so."""
    localiser = TramLocaliser(Vehicle(vehicle="t1"))
    before = localiser.snapshot()
    older: dict[str, object] = {**before, "aligned": False}
    del older["phase"]
    with pytest.raises(TypeError, match="another version"):
        localiser.restore(older)
    assert snapshots.pack(localiser.snapshot()) == snapshots.pack(before)
