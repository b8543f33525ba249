"""One ride calibrated: what is known, how well, what goes together, and what is wrong with it.

Before any figure stands the verdict: a record without motion, without fixes, with wheels or an
axis that do not live has no figures. A figure that the ride does not tell is not one either: it is
said to be unknown, with its deviation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.odometry import clocks
from tramstream.analysis.odometry.batch import Found, solve
from tramstream.analysis.odometry.level import Level, levelled
from tramstream.analysis.odometry.material import Inertial, Ride, WheelWay
from tramstream.analysis.odometry.moves import changes_in
from tramstream.analysis.odometry.nominal import nominal_of
from tramstream.analysis.odometry.rows import Constant
from tramstream.analysis.odometry.slips import Slip, mended
from tramstream.analysis.odometry.stated import stated_of
from tramstream.analysis.odometry.ways import Way
from tramstream.processors.consistency.mounting import TURN_LIMIT_DEG

Array = NDArray[np.float64]

LEAST_WAY_M = 500.0
LEAST_FIXES = 60
DELAY_FLOOR_S = 0.003
"""What the model of the motion leaves of a delay, however well readings agree: rides of ten minutes
all found 3.5 ms that were not there. More rides do not help against it."""
ANTENNA_FLOOR_M = 0.05
"""Likewise of the antenna: cant and slope lean it, and that the pivot does not slip is a model."""
SCALE_FLOOR = 0.00002
"""Likewise of a wheel: the plan of the local level, the slope."""
RECEIVER_DELAY, WHEEL_DELAY = "receiver delay", "wheel delay"
ANTENNA_AHEAD, ANTENNA_LEFT = "antenna ahead", "antenna left"
"""Names of figures; that of a wheel's is `scale` and the wheel."""
LIMITS = {"1": 0.005, "m": 1.0, "s": 0.05}
"""A figure of a larger deviation is not told."""
GROSS = 0.25
"""A wheel that is further off is another unit: the check of the configuration names it."""
FITTING = 0.12
MOST_MISFIT = 2.0
VERTICAL = "the antenna's height cannot be told from a ride: nothing in it leans enough"


@dataclass(frozen=True)
class Figure:
    """One constant."""

    name: str
    """`scale left`, `antenna ahead` …"""
    value: float
    std: float
    unit: str

    @property
    def told(self) -> bool:
        return self.std < LIMITS[self.unit]


@dataclass(frozen=True)
class Calibration:
    """What a ride says."""

    verdict: str
    """Why there are no figures; empty where there are."""
    figures: tuple[Figure, ...] = ()
    correlation: Array = field(default_factory=lambda: np.empty((0, 0)))
    """In the order of the figures."""
    clock: clocks.Apart = clocks.NONE
    """The clock that is seconds off."""
    slips: tuple[Slip, ...] = ()
    fix_error: float = math.nan
    """Size of the fixes' error over what is stated."""
    misfit: float = math.nan
    way_m: float = 0.0
    moving_s: float = 0.0
    notes: tuple[str, ...] = ()

    def figure(self, name: str) -> Figure | None:
        return next((each for each in self.figures if each.name == name), None)


def calibrate(ride: Ride) -> Calibration:
    """Calibrate by one ride."""
    wheels = _chosen(ride)
    verdict = _unfit(ride, wheels)
    if verdict:
        return Calibration(verdict)
    way = Way(wheels)
    level = levelled(ride, ride.imu, way)
    behind, level = _together(ride, level, way)
    mended_way, slips, slipping = mended(way, level)
    fixes_delay = clocks.fixes_behind_wheels(mended_way, ride.fixes)
    third = clocks.fixes_behind_imu(level.time_s, level.turned_rad, ride.fixes)
    if third.clear and behind.clear:
        third = third._replace(delay_s=third.delay_s - behind.delay_s)
    if not fixes_delay.clear and third.clear and behind.clear:
        fixes_delay = third._replace(delay_s=third.delay_s + behind.delay_s)
    shift_s = fixes_delay.delay_s if fixes_delay.clear else 0.0
    fixes = replace(ride.fixes, time_s=ride.fixes.time_s - shift_s)
    moved = _moved(ride, behind, wheels, level)
    stated = stated_of(ride.vehicle)
    nominal = nominal_of(mended_way, level, fixes, slipping, stated.error_tau_s, _height_m(ride))
    if nominal is None:
        return Calibration("IMU, wheels and fixes have no minute in common")
    found = solve(nominal, stated)
    if found is None or not np.all(np.isfinite(found.value)):
        why = moved or "the readings do not fit one vehicle: no constants explain them"
        return Calibration(why)
    apart = clocks.apart(behind, fixes_delay, third)
    gone = float(np.abs(np.diff(way.at(level.time_s))).sum())
    made = Calibration(
        verdict=_gross(found, wheels) or (moved if _fitting(found) else "") or _misfit(found),
        clock=apart,
        slips=tuple(slips),
        fix_error=found.fix_error,
        misfit=found.misfit,
        way_m=gone,
        moving_s=float((~nominal.standing).sum()),
        notes=_notes(ride, behind, level, found),
    )
    if made.verdict:
        return made
    figures, correlation = _figures(ride, wheels, found, shift_s, behind)
    return replace(made, figures=figures, correlation=correlation)


def _chosen(ride: Ride) -> tuple[WheelWay, ...]:
    """Left and right where there are both, else the first wheel."""
    read = [one for one in ride.wheels if len(one.time_s) > 50]
    left = [one for one in read if one.left_m > 0.0]
    right = [one for one in read if one.left_m < 0.0]
    if left and right:
        return left[0], right[0]
    return tuple(read[:1])


def _unfit(ride: Ride, wheels: tuple[WheelWay, ...]) -> str:
    """Why there can be no figures; empty where nothing speaks against them."""
    fixes = ride.fixes
    span_m = 0.0
    if len(fixes.time_s) > 1:
        middle = np.median(fixes.p_l[:, :2], axis=0)
        span_m = float(np.percentile(np.hypot(*(fixes.p_l[:, :2] - middle).T), 90))
    if not len(ride.imu.time_s):
        return "no inertial samples"
    if not wheels:
        return "no readings of wheels"
    if ride.imu.trouble:
        names = ", ".join(ride.imu.trouble)
        return f"stuck or dead for seconds: {names}; the IMU is to be looked at first"
    ways = {one.name: float(np.abs(np.diff(one.way_m)).sum()) for one in wheels}
    dead = [name for name, way_m in ways.items() if way_m < 1.0]
    if dead and (span_m > 100.0 or len(dead) < len(ways)):
        names = ", ".join(dead)
        return f"wheels that do not count while the vehicle moves: {names}"
    most_m = max(ways.values())
    if most_m < LEAST_WAY_M:
        return (
            f"too little motion: {most_m:.0f} m by the wheels, {LEAST_WAY_M:.0f} are needed, with "
            "curves for the antenna and several departures for the delays"
        )
    if len(fixes.time_s) < LEAST_FIXES:
        return f"{len(fixes.time_s)} usable fixes, {LEAST_FIXES} are needed"
    return ""


def _gross(found: Found, wheels: tuple[WheelWay, ...]) -> str:
    """Whether the wheels are of another kind than is configured."""
    used = found.value[: len(wheels)]
    if np.any(np.abs(used) > GROSS):
        factors = ", ".join(f"{one.name} {1 + x:.3f}" for one, x in zip(wheels, used, strict=True))
        return f"the wheels' configured constant is another's ({factors} times): correct it first"
    return ""


def _fitting(found: Found) -> bool:
    """Whether the wheels are near enough to explain forces by them."""
    return bool(np.all(np.abs(found.value[:2]) < FITTING))


def _misfit(found: Found) -> str:
    """Why figures that were found are none."""
    if found.misfit > MOST_MISFIT:
        return (
            f"the readings do not fit one vehicle: they are {found.misfit:.1f} times as far off as "
            "their deviations allow"
        )
    return ""


def _moved(ride: Ride, behind: clocks.Delay, wheels: tuple[WheelWay, ...], level: Level) -> str:
    """Where the IMU was moved within the ride; empty where it was not, or nobody can tell."""
    if not behind.clear or abs(level.turn_deg) > TURN_LIMIT_DEG:
        return ""
    on_imu = Way(wheels).shifted(-behind.delay_s).wheels
    found = changes_in(ride, wheels=on_imu)
    if not found:
        return ""
    first = found[0]
    tilt, std = math.degrees(first.tilt_rad), math.degrees(first.tilt_std_rad)
    return (
        f"the IMU was moved {first.time_s:.0f} s after the beginning, by a tilt of {tilt:.1f}° "
        f"(± {std:.1f}°): cut the record there, and calibrate each part"
    )


def _height_m(ride: Ride) -> float:
    """Of the antenna above the rail's point, as configured."""
    return ride.vehicle.gnss.lever_arm_m[2] if ride.vehicle.gnss is not None else 0.0


def _together(ride: Ride, level: Level, way: Way) -> tuple[clocks.Delay, Level]:
    """How far the IMU's stamps are behind the wheels', and the ride with the two on one clock.

    First by the force as it is, then, where the clocks are near each other, without the slope's,
    and without the wheels' slips.
    """
    if ride.vehicle.imu is None:
        return clocks.UNKNOWN, level
    behind = clocks.imu_behind_wheels(way, level.time_s, level.force_mps2)
    if not behind.clear:
        return behind, level
    for _ in range(2):
        level = levelled(ride, _earlier(ride.imu, behind), way)
        better, _, _ = mended(way, level)
        more = clocks.imu_behind_wheels(better, level.time_s, level.driving_mps2)
        if more.clear and abs(more.delay_s) < 0.3:
            behind = more._replace(delay_s=behind.delay_s + more.delay_s)
    return behind, levelled(ride, _earlier(ride.imu, behind), way)


def _earlier(imu: Inertial, delay: clocks.Delay) -> Inertial:
    """The IMU on the wheels' clock."""
    return replace(imu, time_s=imu.time_s - delay.delay_s) if delay.clear else imu


def _figures(
    ride: Ride,
    wheels: tuple[WheelWay, ...],
    found: Found,
    shift_s: float,
    behind: clocks.Delay,
) -> tuple[tuple[Figure, ...], Array]:
    """Constants with their deviations, delays as against the IMU's clock."""
    value, P = found.value, found.covariance
    imu_s = behind.delay_s if behind.clear else 0.0
    imu_std = math.hypot(behind.std_s, DELAY_FLOOR_S) if behind.clear else 1.0
    names = [f"scale {one.name}" for one in wheels]
    at = [int(Constant.SCALE_A), int(Constant.SCALE_B)][: len(wheels)]
    names += [ANTENNA_AHEAD, ANTENNA_LEFT, RECEIVER_DELAY, WHEEL_DELAY]
    size = len(names)
    J = np.zeros((size, P.shape[0] + 1))
    for row, column in enumerate([*at, int(Constant.AHEAD), int(Constant.LEFT)]):
        J[row, column] = 1.0
    J[size - 2, int(Constant.DELAY)] = 1.0
    J[size - 2 :, -1] = -1.0
    whole = np.zeros((P.shape[0] + 1,) * 2)
    whole[:-1, :-1] = P
    whole[-1, -1] = imu_std**2
    covariance = J @ whole @ J.T
    floors = [SCALE_FLOOR] * len(wheels) + [ANTENNA_FLOOR_M] * 2 + [DELAY_FLOOR_S, 0.0]
    covariance += np.diag(np.square(floors))
    values = [float(value[k]) for k in at]
    values += [float(value[Constant.AHEAD]), float(value[Constant.LEFT])]
    values += [shift_s + float(value[Constant.DELAY]) - imu_s, -imu_s]
    std = np.sqrt(np.diagonal(covariance))
    units = ["1"] * len(wheels) + ["m", "m", "s", "s"]
    figures = tuple(Figure(*each) for each in zip(names, values, std.tolist(), units, strict=True))
    return figures, covariance / np.outer(std, std)


def _notes(ride: Ride, behind: clocks.Delay, level: Level, found: Found) -> tuple[str, ...]:
    notes = [VERTICAL]
    if not behind.clear:
        notes.append("IMU and wheels could not be compared: their delay is not known")
    if ride.vehicle.ekf.pivot_m == 0.0 and ride.vehicle.ekf.pivot_std_m != 0.0:
        notes.append(
            "the antenna is found from the point that does not slip sideways; where the vehicle's "
            "origin is before it ($.ekf.pivot_m), its lever arm is shorter by that"
        )
    if found.fix_error > 1.5:
        notes.append(f"the fixes are {found.fix_error:.1f} times as bad as their receiver states")
    if not level.stands:
        notes.append("the vehicle never stands: the gyroscope's bias is known less well")
    if abs(level.turn_deg) > max(5.0 * level.turn_std_deg, 1.0):
        notes.append(
            f"the IMU's case is turned by {level.turn_deg:.1f}° (± {level.turn_std_deg:.1f}) about "
            "the vertical against its configuration; `tramstream align` finds all three angles"
        )
    return tuple(notes)
