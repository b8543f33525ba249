"""Rides of the world that the filter `tram` is told of, and what it says of its errors on them.

What the filter has to find is drawn for each ride from the filter's own prior: biases, mounting,
scale of the vertical gyroscope, radii of the wheels, delays. A tenth of the fixes' error is white,
as the filter takes it to be (`WHITE_SHARE`), the rest lasts as the configuration says.
In such a world a right covariance gives a mean NEES of its dimension, a right S a mean NIS of 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from rides import Array, Ride, altered, laid, reference, ridden
from scipy.special import ndtr, stdtrit

from tramstream import keys
from tramstream.analysis.evaluate.consistency import (
    CONFIDENCE,
    Interval,
    autocorrelation_time,
    chi_square_interval,
    quadratic_form,
)
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.series import Slot, wrapped_rad
from tramstream.lines.line import built_in_line
from tramstream.mounting import about_axes
from tramstream.processor import Sample
from tramstream.processors.localisation.processor import LocalisationFilter
from tramstream.processors.smoothing.trace import (
    ANEW,
    INSTANT,
    PREDICTION,
    SCALAR_TAIL,
    Trace,
)
from tramstream.processors.tram_filter.start import GYRO_SCALE_STD
from tramstream.processors.tram_model.states import ENTRY_COUNT, SIZE, Ix
from tramstream.processors.tram_sources.fix_noise import WHITE_SHARE
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.sync_pb2 import SyncFrame
from tramstream.simulation.scenario import Scenario
from tramstream.simulation.simulation import Simulation

SEEDS = range(1, 21)
DURATION_S = 66.0
"""Departure after 11 or 12 s, a stop after a minute."""
EVERY = 10
"""Judged states: ten a second."""
PLAN = "| 100 L60/70 150 | 200 R80/60 300 |"
BRISK = {
    "speed_mps": 12.0,
    "acceleration_mps2": 0.8,
    "jerk_mps3": 0.5,
    "lateral_mps2": 1.3,
    "dwell_s": 15.0,
    "first_dwell_s": 12.0,
}
MOVING_MPS = 1e-6
"""Of the true speed."""
HORIZONTAL_STD_M, VERTICAL_STD_M = 0.5, 1.0
KNOWN = (MotionState.TRACKING, MotionState.DEAD_RECKONING)
_UPPER = np.triu_indices(len(Slot))


def drawn(base: Scenario, vehicle: Vehicle, seed: int) -> Scenario:
    """A scenario in which all that `vehicle` does not know exactly comes out of its prior."""
    imu, gnss, wheels = vehicle.imu, vehicle.gnss, vehicle.wheels
    assert imu is not None
    assert gnss is not None
    assert base.wheels is not None
    rng = np.random.default_rng((seed, 1))

    def three(std: float) -> tuple[float, ...]:
        return tuple(rng.normal(0.0, std, 3).tolist())

    left, right = rng.normal(0.0, wheels.scale_std * base.wheels.axle.radius_m, 2).tolist()
    return altered(
        base,
        imu={
            "misalignment_deg": three(max(about_axes(imu.mounting_std_deg))),
            "errors": {
                "gyro_bias_radps": three(imu.gyro_bias_std_radps),
                "accel_bias_mps2": three(imu.accel_bias_std_mps2),
                "gyro_scale": (0.0, 0.0, float(rng.normal(0.0, GYRO_SCALE_STD))),
            },
        },
        wheels={
            "axle": {"radius_error_m": (left, right)},
            "timing": {"stamp_offset_s": float(rng.normal(0.0, wheels.delay_std_s))},
        },
        gnss={
            "timing": {
                "stamp_offset_s": float(
                    rng.normal(0.0, math.hypot(gnss.delay_std_s, imu.delay_std_s))
                )
            },
        },
    )


@cache
def ride_of(seed: int) -> tuple[Ride, Vehicle]:
    """The ride with its vehicle, whose priors are those that were drawn from.

    Odd seeds ride on the built-in line without GNSS velocity, as in kaspar2023; even ones briskly
    on a line with curves, with it.
    """
    base, line = reference(), built_in_line()
    if seed % 2 == 0:
        base, line = altered(base, driver=BRISK, gnss={"velocity": True}), laid(PLAN)
    vehicle = Simulation(line, altered(base, imu={"errors": UNBIASED}), seed, 1.0).vehicle
    ride = ridden(line, drawn(base, vehicle, seed), seed, DURATION_S)
    for frame in ride.frames:
        frame.ClearField("ahead")  # `est/ekf/now` is not judged
    misplace(ride, vehicle, seed)
    return ride, vehicle


def misplace(ride: Ride, vehicle: Vehicle, seed: int) -> None:
    """Give the fixes errors that only walk while the vehicle stands, as the filter takes them to.

    The simulator's own forget at a stop as they do on the way, and the filter is modest there.
    """
    simulation, gnss = ride.simulation, ride.simulation.scenario.gnss
    assert gnss is not None
    assert vehicle.gnss is not None
    fixes = [fix for frame in ride.frames for fix in frame.gnss]
    delay_ns = round(gnss.timing.stamp_offset_s * S)
    truth = simulation.truth(np.array([fix.stamp_ns - delay_ns for fix in fixes]))
    rng = np.random.default_rng((seed, 2))
    stds = np.array([HORIZONTAL_STD_M, HORIZONTAL_STD_M, VERTICAL_STD_M])
    correlated = math.sqrt(1.0 - WHITE_SHARE**2) * stds
    error, before_ns = rng.normal(0.0, correlated), fixes[0].stamp_ns
    for fix, p_l, stands in zip(fixes, truth.p_l, truth.motion.standing, strict=True):
        dt = (fix.stamp_ns - before_ns) / S / vehicle.gnss.error_tau_s
        keep, driven = (1.0, 2.0 * dt) if stands else (math.exp(-dt), 1.0 - math.exp(-2.0 * dt))
        error = keep * error + rng.normal(0.0, math.sqrt(driven) * correlated)
        seen = p_l + error + rng.normal(0.0, WHITE_SHARE * stds)
        latitude, longitude, height = simulation.line.level.to_geodetic(seen).tolist()
        fix.latitude_deg, fix.longitude_deg = math.degrees(latitude), math.degrees(longitude)
        fix.height_ellipsoid_m, before_ns = height, fix.stamp_ns


UNBIASED = {"gyro_bias_radps": (0.0, 0.0, 0.0), "accel_bias_mps2": (0.0, 0.0, 0.0)}
"""A simulated vehicle's configuration knows of large biases; these priors are the plain ones."""


@dataclass(frozen=True)
class Judged:
    """What the filter said on one ride, held to the truth."""

    nees: dict[str, Array]
    """Of each quantity, at instants at which the heading is known."""
    nis: dict[str, Array]
    """y²/S of the innovations that it accepted."""
    accepted: dict[str, float]
    """Share of them."""


class Figure(NamedTuple):
    """A mean over all rides, and where it is for a filter that is right."""

    mean: float
    bounds: Interval
    effective: float
    """Independent samples that the mean is worth."""


def figure(series: Sequence[Array], dimensions: int = 1, figures: int = 1) -> Figure:
    """Judge several rides together.

    The bounds are those of `consistency.mean_bounds`, of 95 % for so many `figures` at once
    (Bonferroni): of fourteen at 95 % each, one would lie outside every other time.
    """
    known = [each for each in series if len(each)]
    effective = sum(map(len, known)) / autocorrelation_time(*known)
    student = stdtrit(max(effective / 4.0, 1.0), (1.0 - CONFIDENCE) / 2.0 / figures)
    low, high = chi_square_interval(dimensions * effective, float(ndtr(student)))
    bounds = Interval(low / effective, high / effective)
    return Figure(float(np.concatenate(known).mean()), bounds, effective)


def judged(
    seed: int,
    change: Callable[[Vehicle], Vehicle] | None = None,
    stated: float = 1.0,
    taped: bool = False,
) -> Judged:
    """Let the filter go through a ride.

    Parameters
    ----------
    change : callable, optional
        What the vehicle's configuration says otherwise.
    stated : float
        Factor on the deviations that the receiver states of its fixes.
    taped : bool
        Judge what standstill and lateral force show too: they are in no message, but on the tape.
    """
    ride, vehicle = ride_of(seed)
    processor = LocalisationFilter(change(vehicle) if change is not None else vehicle)
    if taped:
        processor.keep()
    states: list[MotionState] = []
    innovations: dict[str, list[tuple[float, bool]]] = {}
    for number, frame in enumerate(ride.frames):
        if frame.gnss and stated != 1.0:
            frame = restated(frame, stated)
        outputs = processor.step(Sample(keys.SYNC_FRAME, frame, frame.stamp_ns, number))
        for state in (each.message for each in outputs if each.key is keys.EST_STATE):
            if number % EVERY == 0 and state.mode in KNOWN:
                states.append(state)
            for each in state.innovations:
                kept = innovations.setdefault(each.measurement, [])
                kept.append((each.value**2 / each.variance, each.accepted))
    for trace in processor.traces:
        for name, square in unpublished(trace):
            innovations.setdefault(name, []).append((square, True))
    return Judged(
        nees(ride.simulation, states),
        {
            name: np.array([each for each, took in kept if took])
            for name, kept in innovations.items()
        },
        {name: float(np.mean([took for _, took in kept])) for name, kept in innovations.items()},
    )


def restated(frame: SyncFrame, factor: float) -> SyncFrame:
    """A copy whose receiver states other deviations of its fixes."""
    copy = SyncFrame.FromString(frame.SerializeToString())
    for fix in copy.gnss:
        fix.horizontal_std_m *= factor
        fix.vertical_std_m *= factor
    return copy


# Errors -------------------------------------------------------------------------------------------
def nees(simulation: Simulation, states: Sequence[MotionState]) -> dict[str, Array]:
    """Squared errors over what is claimed of them; speed where the vehicle moves."""
    level = simulation.line.level
    rows = np.array(
        [(each.latitude_deg, each.longitude_deg, each.height_ellipsoid_m) for each in states]
    )
    geodetic = rows * (math.pi / 180.0, math.pi / 180.0, 1.0)
    truth = simulation.truth(np.array([each.stamp_ns for each in states]))
    motion = truth.motion
    roll, pitch, yaw = simulation.ride.attitude(motion)
    said = np.array(
        [(each.speed_mps, each.roll_rad, each.pitch_rad, each.yaw_rad) for each in states]
    )
    true = np.stack([motion.speed_mps, roll, pitch, yaw], axis=1)
    error = np.concatenate([level.from_geodetic(geodetic) - truth.p_l, said - true], axis=1)
    error[:, Slot.YAW] = wrapped_rad(error[:, Slot.YAW])
    P = np.empty((len(states), len(Slot), len(Slot)))
    P[:, _UPPER[0], _UPPER[1]] = P[:, _UPPER[1], _UPPER[0]] = [each.covariance for each in states]
    # East and north become along and across.
    turn = np.tile(np.eye(len(Slot)), (len(states), 1, 1))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(yaw)
    turn[:, 0, 1] = np.sin(yaw)
    turn[:, 1, 0] = -turn[:, 0, 1]
    error = np.einsum("nij,nj->ni", turn, error)
    P = turn @ P @ np.swapaxes(turn, 1, 2)
    moves = np.abs(motion.speed_mps) > MOVING_MPS

    def squares(*slots: Slot, where: Array | slice = slice(None)) -> Array:
        chosen = np.array(slots)
        return quadratic_form(P[:, chosen][:, :, chosen], error[:, chosen])[where]

    return {
        "place": squares(Slot.EAST, Slot.NORTH),
        "along": squares(Slot.EAST),
        "across": squares(Slot.NORTH),
        "up": squares(Slot.UP),
        "speed, moving": squares(Slot.SPEED, where=moves),
        "speed, standing": squares(Slot.SPEED, where=~moves),
        "roll": squares(Slot.ROLL),
        "pitch": squares(Slot.PITCH),
        "yaw": squares(Slot.YAW),
        "place, speed, yaw": squares(Slot.EAST, Slot.NORTH, Slot.SPEED, Slot.YAW),
    }


# Innovations --------------------------------------------------------------------------------------
UNPUBLISHED = {
    frozenset({Ix.SPEED}): "standstill speed",
    frozenset({Ix.GYRO_X}): "standstill rates",
    frozenset({Ix.GYRO_Y}): "standstill rates",
    frozenset({Ix.GYRO_Z}): "standstill rates",
    frozenset({Ix.PITCH, Ix.ACCEL_X, Ix.MOUNT_YAW, Ix.MOUNT_PITCH}): "standstill gravity",
    frozenset(
        {
            Ix.SPEED,
            Ix.ROLL,
            Ix.PITCH,
            Ix.GYRO_Z,
            Ix.ACCEL_Y,
            Ix.MOUNT_ROLL,
            Ix.MOUNT_YAW,
            Ix.GYRO_SCALE,
            Ix.MOUNT_PITCH,
        }
    ): "lateral force",
}
"""By the states that a row of H reads; what else is on the tape is published too."""


def unpublished(trace: Trace) -> Iterator[tuple[str, float]]:
    """Give y²/S of the scalars on a tape that no message tells of, in order of time."""
    found = []
    for block, end in reversed(trace.tape):
        at = end
        while at > 0:
            at -= 1
            kind = block[at]
            if kind == PREDICTION:
                at -= ENTRY_COUNT
            elif kind == ANEW:
                at -= 1
            elif kind != INSTANT:
                at -= SCALAR_TAIL - 1
                count, y, variance = int(block[at]), block[at + 1], block[at + 2]
                name = UNPUBLISHED.get(frozenset(block[at - count : at].astype(int).tolist()))
                at -= 2 * count + SIZE
                if name is not None:
                    found.append((name, float(y * y / variance)))
    return reversed(found)
