"""Rides out of a record: inertial samples averaged between nodes, fixes and wheels put beside them.

Where inertial samples are missing for longer than a few nodes the record is cut, and each part is a
ride of its own: an attitude cannot be carried over such a gap.
"""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream import keys
from tramstream.analysis.calibration.inertial import Samples, inertial_samples
from tramstream.analysis.mounting.drive import (
    NODE_S,
    Array,
    Drive,
    Fixes,
    Flags,
    Inertial,
    no_fixes,
)
from tramstream.analysis.mounting.known import WHITE_SHARE, WHITE_TAU_S
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.geodesy import C_nl, LocalLevel, normal_gravity_mps2
from tramstream.recorder.message_columns import Columns, read_columns
from tramstream.recorder.reader import Record

BRIDGED_NODES = 3
"""Nodes without a sample that are filled with their neighbours' mean."""
LEAST_S = 60.0
"""A ride that is shorter is left out."""
LONGEST_S = 4500.0
"""A ride that is longer is cut: a pass keeps 10 kB a node."""
STILL_S = 3.0
"""Halts that are shorter tell little."""
STILL_MPS = 0.25
"""Mean speed over that time, of fixes that say their velocity."""
MARGIN_S = 1.5
"""Left out at both ends of a halt that only fixes tell."""
SPEED_STD_MPS = 0.1
"""Where a receiver does not say how good its velocity is."""
HEAVY = 1.0
"""Where it does not say how good its place is, m."""


class Readings(NamedTuple):
    """All inertial samples of a record as means on one grid, and what was seen of each axis."""

    start_ns: int
    f_b: Array
    """(n, 3); NaN where there was no sample."""
    omega_b: Array
    lowest: Array
    """(6,): least and greatest reading of each axis, gyroscopes first, SI."""
    highest: Array
    ends: NDArray[np.int64]
    """(6,): how many samples are the least or the greatest reading of their axis."""
    samples: int
    rate_hz: float


def readings_of(record: Record) -> Readings | None:
    """Average the inertial samples of a record; None if it has none."""
    start_ns, sums, counts = -1, np.zeros((6, 0)), np.zeros(0)
    low, high = np.full(6, np.inf), np.full(6, -np.inf)
    ends, total, rate = np.zeros(6, np.int64), 0, math.nan
    for samples in inertial_samples(record):
        if not len(samples.length):
            continue
        stamp_ns, values = _spread(samples)
        if start_ns < 0:
            start_ns, rate = int(stamp_ns[0]), 1e9 / float(samples.period_ns[0])
        node = (stamp_ns - start_ns) // round(NODE_S * S)
        fine = (node >= 0) & (node < 10_000_000)
        node, values = node[fine], values[:, fine]
        if not len(node):
            continue
        room = int(node.max()) + 1
        if room > len(counts):
            grown = max(room, 2 * len(counts))
            sums = np.pad(sums, ((0, 0), (0, grown - len(counts))))
            counts = np.pad(counts, (0, grown - len(counts)))
        counts[:room] += np.bincount(node, minlength=room)
        for axis in range(6):
            sums[axis, :room] += np.bincount(node, values[axis], minlength=room)
            for which, bound in ((values[axis].min(), low), (values[axis].max(), high)):
                better = which < bound[axis] if bound is low else which > bound[axis]
                if better:
                    bound[axis] = which
        total += len(node)
        for axis in range(6):
            ends[axis] += np.count_nonzero(
                (values[axis] == low[axis]) | (values[axis] == high[axis])
            )
    if start_ns < 0 or not total:
        return None
    last = int(np.flatnonzero(counts)[-1]) + 1
    with np.errstate(invalid="ignore", divide="ignore"):
        means = (sums[:, :last] / counts[:last]).T
    return Readings(start_ns, means[:, 3:], means[:, :3], low, high, ends, total, rate)


def _spread(samples: Samples) -> tuple[NDArray[np.int64], Array]:
    """Instants and values in SI of samples, in columns."""
    length = samples.length
    number = np.arange(int(length.sum())) - np.repeat(np.cumsum(length) - length, length)
    past = (number * np.repeat(samples.period_ns, length)).astype(np.int64)
    stamp_ns = np.repeat(samples.stamp_ns, length) + past
    values = samples.counts.astype(float)
    values[:3] *= np.repeat(samples.gyro_scale_radps, length)
    values[3:] *= np.repeat(samples.accel_scale_mps2, length)
    return stamp_ns, values


class Placed(NamedTuple):
    """Fixes by instant."""

    stamp_ns: NDArray[np.int64]
    p_l: Array
    p_std_m: Array
    vel_l: Array
    vel_std_mps: Array
    level: LocalLevel


def fixes_of(record: Record, vehicle: Vehicle) -> Placed | None:
    """Read valid fixes as places and velocities in a local level; None if there are none."""
    topic = _topic(record, keys.GNSS_FIX)
    if not topic:
        return None
    names = (
        "valid", "latitude_deg", "longitude_deg", "height_ellipsoid_m", "horizontal_std_m",
        "vertical_std_m", "vel_n_mps", "vel_e_mps", "vel_d_mps", "speed_std_mps",
    )  # fmt: skip
    columns = read_columns(record, {topic: names})[topic]
    if not len(columns):
        return None
    limit_m = vehicle.gnss.max_accuracy_m if vehicle.gnss is not None else 100.0
    height, told = _numbers(columns, "height_ellipsoid_m"), _numbers(columns, "horizontal_std_m")
    fine = np.asarray(columns["valid"], dtype=bool) & (told <= limit_m) & np.isfinite(height)
    rows = np.flatnonzero(fine)
    if not len(rows):
        return None
    order = rows[np.argsort(columns.stamp_ns[rows], kind="stable")]
    place = [
        np.radians(_numbers(columns, f"{name}_deg")[order]) for name in ("latitude", "longitude")
    ]
    geodetic = np.stack([*place, height[order]], axis=1)
    level = LocalLevel(*map(float, geodetic[0]))
    turn = C_nl(level, geodetic)
    velocity = np.stack(
        [_numbers(columns, "vel_e_mps"), _numbers(columns, "vel_n_mps"),
         -_numbers(columns, "vel_d_mps")], axis=1,
    )[order]  # fmt: skip
    std = np.where(told > 0, told / math.sqrt(2), HEAVY)[order]
    upwards = _numbers(columns, "vertical_std_m")[order]
    upwards = np.where(upwards > 0, upwards, 2 * std)
    speed = _numbers(columns, "speed_std_mps")[order]
    speed = np.where(speed > 0, speed, SPEED_STD_MPS)
    p_std = np.stack([std, std, upwards], axis=1)
    floor_m = vehicle.gnss.error_floor_m if vehicle.gnss is not None else 0.005
    if vehicle.gnss is None or vehicle.gnss.error_tau_s > WHITE_TAU_S:
        p_std = p_std * WHITE_SHARE
    return Placed(
        columns.stamp_ns[order],
        level.from_geodetic(geodetic),
        np.maximum(p_std, floor_m),
        np.einsum("nji,nj->ni", turn, velocity),
        np.repeat(speed[:, None], 3, axis=1),
        level,
    )


def _numbers(columns: Columns, name: str) -> Array:
    """A column whose absent values are NaN."""
    found: Array = np.ma.filled(np.ma.asarray(columns[name]).astype(float), np.nan)
    return found


def _topic(record: Record, key: keys.Key) -> str:
    return next((each for each in record.channels if keys.split(each)[1] == key.path), "")


class Wheels(NamedTuple):
    """Way of the wheels by instant, mean of all that count."""

    stamp_ns: NDArray[np.int64]
    way_m: Array
    rate_hz: float


def wheels_of(record: Record, vehicle: Vehicle) -> Wheels | None:
    """Read the way that the wheels went; None if the record does not have it."""
    topic = _topic(record, keys.ODO_WHEELS)
    if not topic:
        return None
    rows = read_columns(record, {topic: ("wheels",)})[topic].elements("wheels")
    ways: list[tuple[NDArray[np.int64], Array]] = []
    names = np.asarray(rows["wheel"]) if len(rows) else np.zeros(0)
    for name in sorted(set(names.tolist())):
        own = np.flatnonzero(names == name)
        counted = np.ma.asarray(rows["pulses"])[own]
        if np.ma.getmaskarray(counted).any() or len(own) < 10:
            continue
        each = vehicle.wheels.each.get(str(name))
        scale = each.m_per_pulse if each is not None else vehicle.wheels.m_per_pulse
        gone = np.diff(counted.data.astype(np.int64), prepend=counted.data[0]).astype(float)
        gone[np.abs(gone) > 1e6] = 0.0  # the way since the reading before is not known
        ways.append((rows.stamp_ns[own], np.cumsum(gone) * scale))
    if not ways:
        return None
    stamp_ns = ways[0][0]
    order = np.argsort(stamp_ns, kind="stable")
    stamp_ns = stamp_ns[order]
    mean = np.mean(
        [np.interp(stamp_ns.astype(float), s.astype(float), way) for s, way in ways], axis=0
    )
    rate = S / max(float(np.median(np.diff(stamp_ns))), 1.0)
    delay_ns = round(vehicle.wheels.delay_s * S)
    return Wheels(stamp_ns - delay_ns, mean, rate)


def drives_of(record: Record, vehicle: Vehicle) -> tuple[list[Drive], Readings | None]:
    """Cut a record into rides without gaps."""
    readings = readings_of(record)
    if readings is None:
        return [], None
    placed, wheels = fixes_of(record, vehicle), wheels_of(record, vehicle)
    filled = _bridged(readings)
    known = np.isfinite(filled[:, 0])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(np.int8), [0]])))
    drives = []
    for first, end in edges.reshape(-1, 2).tolist():
        pieces = math.ceil((end - first) * NODE_S / LONGEST_S)
        cuts = np.linspace(first, end, pieces + 1).astype(int)
        for begin, stop in itertools.pairwise(cuts):
            if (stop - begin) * NODE_S >= LEAST_S:
                start_ns = readings.start_ns + int(begin) * round(NODE_S * S)
                drives.append(_drive(start_ns, filled[begin:stop], placed, wheels))
    return drives, readings


def _bridged(readings: Readings) -> Array:
    """Means with short gaps filled, (n, 6), forces first."""
    values = np.concatenate([readings.f_b, readings.omega_b], axis=1)
    missing = ~np.isfinite(values[:, 0])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(np.int8), [0]])))
    for first, end in edges.reshape(-1, 2).tolist():
        if first > 0 and end < len(values) and end - first <= BRIDGED_NODES:
            values[first:end] = (values[first - 1] + values[end]) / 2
    return values


def _drive(start_ns: int, values: Array, placed: Placed | None, wheels: Wheels | None) -> Drive:
    count = len(values)
    step_ns = round(NODE_S * S)
    fixes, up_l, gravity = no_fixes(), np.tile([0.0, 0.0, 1.0], (count, 1)), 9.81
    if placed is not None:
        inside = (placed.stamp_ns >= start_ns) & (
            placed.stamp_ns <= start_ns + (count - 1) * step_ns
        )
        past = placed.stamp_ns[inside] - start_ns
        node = (past + step_ns // 2) // step_ns
        fixes = Fixes(
            node,
            (past - node * step_ns) / S,
            placed.p_l[inside],
            placed.p_std_m[inside],
            placed.vel_l[inside],
            placed.vel_std_mps[inside],
        )
        gravity = float(normal_gravity_mps2(placed.level.latitude_rad, placed.level.height_m))
        if len(node):
            columns = [np.interp(np.arange(count), node, each) for each in fixes.p_l.T]
            up_l = placed.level.up_l(np.stack(columns, axis=1))
    speed, std = np.full(count, np.nan), 1.0
    if wheels is not None:
        speed, std = _wheel_speed(wheels, start_ns, count)
    return Drive(
        NODE_S, start_ns, Inertial(values[:, :3].copy(), values[:, 3:].copy()), fixes,
        speed, std, standing_of(speed, fixes, count), up_l, gravity,
    )  # fmt: skip


def _wheel_speed(wheels: Wheels, start_ns: int, count: int) -> tuple[Array, float]:
    """Speed at nodes, of the way from half a node before to half a node after."""
    edge_s = (np.arange(count + 1) - 0.5) * NODE_S
    at_s = (wheels.stamp_ns - start_ns) / S
    way = np.interp(edge_s, at_s, wheels.way_m)
    speed = np.diff(way) / NODE_S
    after = np.searchsorted(at_s, edge_s)
    after = np.clip(after, 1, len(at_s) - 1)
    gap = at_s[after] - at_s[after - 1]
    inside = (edge_s >= at_s[0]) & (edge_s <= at_s[-1]) & (gap < 3 * NODE_S)
    fine = inside[:-1] & inside[1:]
    speed[~fine] = np.nan
    pulse = np.diff(wheels.way_m)
    smallest = float(np.min(np.abs(pulse[pulse != 0]), initial=0.001))
    return speed, max(0.01, smallest / NODE_S)


def standing_of(wheel_mps: Array, fixes: Fixes, count: int) -> Flags:
    """Nodes at which the vehicle surely stands: no wheel turns, or the fixes' velocity is none.

    Fixes without velocity tell nothing here, and a halt's ends are left out.
    """
    still: Flags = np.zeros(count, bool)
    told = np.isfinite(wheel_mps)
    if told.sum() > count / 2:
        return _lasting(told & (np.abs(wheel_mps) < 1e-6), 0.5)
    moves = np.isfinite(fixes.vel_l[:, 0]) if len(fixes.node) else np.zeros(0, bool)
    if moves.sum() < 20:
        return still
    node, velocity = fixes.node[moves], fixes.vel_l[moves]
    window = max(round(STILL_S / NODE_S), 1)
    kernel = np.ones(window) / window
    mean = [
        np.convolve(np.interp(np.arange(count), node, each), kernel, "same") for each in velocity.T
    ]
    per_window = max(STILL_S / max(float(np.median(np.diff(node))) * NODE_S, 1e-3), 1.0)
    std = float(np.median(fixes.vel_std_mps[moves, 0])) / math.sqrt(per_window)
    limit = max(STILL_MPS, 3 * std)
    if limit > 2 * STILL_MPS:
        return still
    slow = np.hypot(mean[0], mean[1]) < limit
    return _lasting(slow, MARGIN_S + STILL_S / 2)


def _lasting(flags: Flags, margin_s: float) -> Flags:
    """Runs of flags without their ends."""
    found = np.zeros(len(flags), bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    margin = round(margin_s / NODE_S)
    for first, end in edges.reshape(-1, 2).tolist():
        begin = first + (margin if first > 0 else 0)
        stop = end - (margin if end < len(flags) else 0)
        if stop > begin:
            found[begin:stop] = True
    return found


def describe(record: Record) -> dict[str, Any]:
    """Which kinds of reading a record has, for the verdict."""
    return {
        "fixes": bool(_topic(record, keys.GNSS_FIX)),
        "wheels": bool(_topic(record, keys.ODO_WHEELS)),
    }
