"""Inertial samples that were lost, and drawn straight through the gap by whoever recorded them.

A car in streets, with fixes of a few centimetres every two seconds, no wheels: while 1.5 s of each
corner are a line between two readings, heading and speed change unseen.
"""

from __future__ import annotations

import numpy as np
import pytest
from rides import Errors, Ride, altered, judged, laid, reference, ridden, time_s
from seeds import seeds
from test_fixes_alone import CAR, STREETS, rms
from test_tram_start import copies

from tramstream.processors.tram.localiser import TramLocaliser
from tramstream.processors.tram_filter.events import DRAWN_STRAIGHT
from tramstream.proto.sync_pb2 import SyncFrame

SEEDS = seeds(1, of=3)
GAP_S = 1.5
STD_M = 0.03
CORNERING_RADPS = 0.25
AXES = [f"gyro_{axis}_radps" for axis in "xyz"] + [f"accel_{axis}_mps2" for axis in "xyz"]


def car(seed: int) -> Ride:
    gnss = {"errors": {"horizontal_std_m": STD_M, "vertical_std_m": 2.0 * STD_M}}
    ride = ridden(laid(STREETS), altered(reference(), driver=CAR, wheels=None, gnss=gnss), seed)
    for frame in ride.frames:
        frame.ClearField("ahead")
        for number in reversed(range(len(frame.gnss))):
            if round(time_s(frame.gnss[number].stamp_ns)) % 2:
                del frame.gnss[number]
    return ride


def drawn(ride: Ride) -> tuple[list[SyncFrame], list[float]]:
    """The ride with a line instead of the first 1.5 s of each corner; when each begins."""
    frames, begun = copies(ride.frames), []
    count = round(GAP_S * 100.0)
    turns = np.abs([frame.imu.gyro_z_radps for frame in frames]) > CORNERING_RADPS
    at = 0
    while at < len(frames) - count - 1:
        if not turns[at]:
            at += 1
            continue
        first, last = frames[at - 1].imu, frames[at + count].imu
        for axis in AXES:
            line = np.linspace(getattr(first, axis), getattr(last, axis), count + 2)
            for k in range(count):
                setattr(frames[at + k].imu, axis, line[k + 1])
        begun.append(time_s(frames[at].stamp_ns))
        at += 5 * count
    return frames, begun


def gone(ride: Ride, frames: list[SyncFrame]) -> tuple[Errors, list[float]]:
    """Errors of a filter, and when it says that readings were drawn."""
    localiser, kept, said = TramLocaliser(ride.simulation.vehicle), [], []
    for number, frame in enumerate(frames):
        estimate = localiser.take(frame)
        found = [each.kind for each in localiser.complaints()]
        said += [time_s(frame.stamp_ns)] * found.count(DRAWN_STRAIGHT)
        if estimate is not None and number % 5 == 0:
            kept.append(estimate)
    return judged(ride.simulation, localiser, kept), said


@pytest.mark.parametrize("seed", SEEDS)
def test_lines_through_every_corner_leave_it_within_a_metre(seed: int) -> None:
    ride = car(seed)
    frames, begun = drawn(ride)
    assert len(begun) >= 5
    errors, said = gone(ride, frames)
    assert rms(errors.within(40.0, 1e9).horizontal_m) < 1.0
    assert len(said) == len(begun)
    assert all(0.0 < told - start < 0.2 for told, start in zip(said, begun, strict=True))


def test_what_was_measured_is_never_taken_for_drawn() -> None:
    ride = car(1)
    assert gone(ride, ride.frames)[1] == []
