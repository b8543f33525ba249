"""Tracks whose slopes are known, and what rides would say of them: passes made without a filter."""

from __future__ import annotations

import hashlib
import math
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from google.protobuf.message import Message
from looking import START_NS, VEHICLE
from networks import BOTH, LEVEL, laid, network_of, straight
from numpy.typing import NDArray

from tramstream import keys
from tramstream.analysis.grade_map.cells import Cells, cells_of
from tramstream.analysis.grade_map.passes import Passes, Ride
from tramstream.clock import S
from tramstream.estimation.series import Innovations, StateSeries
from tramstream.keys import Key
from tramstream.mapping.lines import path_of
from tramstream.processors.matching.offline import Place
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.health_pb2 import ClockReference
from tramstream.proto.raw_pb2 import ImuBatch
from tramstream.recorder.file.writer import RecordFile
from tramstream.tracks.grades import GRADES_ENTRY, NO_GRADES
from tramstream.tracks.network import Network

Array = NDArray[np.float64]

BIAS_RAD, NOISE_RAD = 1e-3, 3e-4
"""Deviations of what rides have wrong all along, and of each cell's own."""
STD_RAD = math.hypot(BIAS_RAD, NOISE_RAD)
"""What the rides state."""


@cache
def straight_track(length_m: float = 2000.0) -> Network:
    """One track, both ways."""
    return network_of([laid(straight(length_m))], rules=[BOTH])


def hills(network: Network) -> tuple[Array, Array]:
    """Slope of each cell's track as drawn, rad, and its height, m: waves of about 400 m, 4 % steep.

    Each track has whole waves, so that it is level and as high as all others at its ends.
    """
    cells = cells_of(network)
    grade = np.empty(cells.starts[-1])
    height = np.empty(cells.starts[-1])
    for track in range(network.track_count):
        own = slice(cells.starts[track], cells.starts[track + 1])
        at = (np.arange(own.stop - own.start) + 0.5) * cells.width_m[track]
        length_m = float(network.length_m[track])
        wave = math.tau * max(round(length_m / 400.0), 1) / length_m
        grade[own] = np.arctan(0.04 * np.sin(wave * at))
        height[own] = LEVEL.height_m - 0.04 / wave * (np.cos(wave * at) - 1.0)
    return grade, height


def passing(
    network: Network,
    seed: int,
    sign: int = 1,
    bias_rad: float = 0.0,
    noise_rad: float = NOISE_RAD,
    vehicle: str = "",
    cells: slice = slice(None),
) -> Ride:
    """A ride over all cells one way: slopes with noise and a bias."""
    rng = np.random.default_rng(seed)
    cut: Cells = cells_of(network)
    grade, height = hills(network)
    cell = np.arange(cut.starts[-1])[cells]
    told = grade[cell] + sign * bias_rad + noise_rad * rng.standard_normal(len(cell))
    count = len(cell)
    passes = Passes(
        cell.astype(np.int32),
        np.full(count, sign, np.int8),
        told.astype(np.float32),
        np.full(count, math.hypot(BIAS_RAD, noise_rad), np.float32),
        (height[cell] + rng.standard_normal()).astype(np.float32),
        np.full(count, 1.0, np.float32),
    )
    digest = hashlib.blake2b(b"%d" % seed, digest_size=8).hexdigest()
    start_ns = 1_780_000_000_000_000_000 + seed * 86_400_000_000_000
    way_m = 5.0 * count
    return Ride(
        f"ride{seed}.mcap",
        digest,
        vehicle or f"tram{seed}",
        start_ns,
        0.0,
        0.01,
        False,
        way_m,
        0.0,
        0.0,
        0.0,
        passes,
    )


# Smoothed states ----------------------------------------------------------------------------------
STATES_HZ = 10.0
SPEED_MPS = 10.0
PITCH_STD_RAD = 5e-4
UPPER = [(i, k) for i in range(7) for k in range(i, 7)]
"""Of `MotionState.covariance`, row by row."""


class Going(NamedTuple):
    """A way over a network, and how it is gone."""

    runs: tuple[int, ...]
    begin_m: float = 20.0
    length_m: float = 500.0
    backing: bool = False
    """With x of the vehicle against its motion."""
    pitch_off_rad: float = 0.0
    nod: float = 0.0
    """Rad per m/s²."""
    aside: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From, to, how far to the left of the track, m: a detour that the map does not have."""
    stop_every_m: float = 0.0
    """Speeds up and brakes by 1 m/s²; 0: never."""


def states_of(network: Network, going: Going) -> StateSeries:
    """What a smoother that errs by nothing says of a way."""
    at, speed, acceleration = _driven(going)
    path = path_of(network, going.runs, going.begin_m, going.length_m)
    east, north = (np.interp(at, path[:, 0], path[:, k]) for k in (1, 2))
    yaw = np.unwrap(np.arctan2(np.gradient(path[:, 2]), np.gradient(path[:, 1])))
    yaw = np.interp(at, path[:, 0], yaw)
    from_m, to_m, left_m = going.aside
    share = np.clip(np.minimum(at - from_m, to_m - at) / 20.0, 0.0, 1.0) if left_m else 0.0 * at
    east, north = east - share * left_m * np.sin(yaw), north + share * left_m * np.cos(yaw)
    grade, height = _along(network, going, at)
    facing = -1.0 if going.backing else 1.0
    slope = facing * grade
    force = facing * acceleration + 9.81 * np.sin(slope)
    pitch = -slope - going.nod * force + going.pitch_off_rad
    count = len(at)
    geodetic = np.column_stack([network.geodetic_of(np.column_stack([east, north])), height])
    covariance = np.tile(
        np.diag([0.09, 0.09, 1.0, 1e-4, 1e-4, PITCH_STD_RAD**2, 1e-5]), (count, 1, 1)
    )
    attitude = np.column_stack([0 * at, pitch, yaw + (math.pi if going.backing else 0.0)])
    nothing = np.empty(0)
    return StateSeries(
        stamp_ns=START_NS + np.arange(count, dtype=np.int64) * round(S / STATES_HZ),
        geodetic=geodetic,
        p_l=network.level.from_geodetic(geodetic),
        speed_mps=facing * speed,
        acceleration_mps2=facing * acceleration,
        attitude_rad=attitude,
        yaw_rate_radps=0 * at,
        covariance=covariance,
        mode=np.full(count, MotionState.TRACKING),
        standing=speed < 0.05,
        protection_m=np.full((count, 2), np.nan),
        innovations=Innovations(
            nothing.astype(int), (), nothing.astype(int), nothing, nothing, nothing.astype(bool)
        ),
    )


def _driven(going: Going) -> tuple[Array, Array, Array]:
    """Way, speed and acceleration at each instant."""
    step = 1.0 / STATES_HZ
    if not going.stop_every_m:
        at = np.arange(0.0, going.length_m, SPEED_MPS * step)
        return at, np.full(len(at), SPEED_MPS), 0.0 * at
    rows = []
    begin = 0.0
    while begin + going.stop_every_m <= going.length_m:
        half = math.sqrt(going.stop_every_m)  # of the time: 1 m/s² up, then down
        for t in np.arange(0.0, 2 * half, step):
            up = t < half
            gone = t * t / 2 if up else going.stop_every_m - (2 * half - t) ** 2 / 2
            rows.append((begin + gone, t if up else 2 * half - t, 1.0 if up else -1.0))
        rows += [(begin + going.stop_every_m, 0.0, 0.0)] * 50
        begin += going.stop_every_m
    at, speed, acceleration = np.array(rows).T
    return at, speed, acceleration


def _along(network: Network, going: Going, at: Array) -> tuple[Array, Array]:
    """Slope uphill along the way, and height."""
    cells = cells_of(network)
    grade, height = hills(network)
    found = np.zeros((2, len(at)))
    gone = -going.begin_m
    for run in going.runs:
        track, length = run >> 1, float(network.length_m[run >> 1])
        inside = (at >= gone) & (at <= gone + length)
        drawn = at[inside] - gone if run % 2 == 0 else length - (at[inside] - gone)
        own = slice(cells.starts[track], cells.starts[track + 1])
        middle = (np.arange(own.stop - own.start) + 0.5) * cells.width_m[track]
        sign = 1.0 if run % 2 == 0 else -1.0
        found[0, inside] = sign * np.interp(drawn, middle, grade[own])
        found[1, inside] = np.interp(drawn, middle, height[own])
        gone += length
    return found[0], found[1]


def places_of(network: Network, going: Going, states: StateSeries) -> list[Place]:
    """What a matcher that errs by nothing says of them."""
    at = _driven(going)[0]
    places, gone, runs = [], -going.begin_m, list(going.runs)
    for k, way in enumerate(at.tolist()):
        while len(runs) > 1 and way > gone + float(network.length_m[runs[0] >> 1]):
            gone += float(network.length_m[runs.pop(0) >> 1])
        places.append(Place(int(states.stamp_ns[k]), runs[0], way - gone, 0.0, 1.0))
    return places


def write_smoothed(
    path: Path,
    states: StateSeries,
    metadata: dict[str, str] | None = None,
    seed: int = 0,
    inertial: bool = False,
) -> Path:
    """A record that holds smoothed states and nothing else, or one inertial message as well; UTC is
    7 s ahead of its clock."""
    told = {GRADES_ENTRY: NO_GRADES} if metadata is None else metadata
    with RecordFile(path, VEHICLE, told) as record:

        def append(key: Key, message: Message, stamp_ns: int, sequence: int) -> None:
            payload = message.SerializeToString()
            record.append(key.on(VEHICLE), key, payload, stamp_ns, stamp_ns, sequence)

        reference = ClockReference(stamp_ns=seed, host_utc_ns=seed + 7 * S)
        append(keys.CLOCK, reference, int(states.stamp_ns[0]), 1)
        if inertial:
            append(keys.IMU_BATCH, ImuBatch(stamp_ns=1), int(states.stamp_ns[0]), 1)
        for k, stamp_ns in enumerate(states.stamp_ns.tolist()):
            latitude_deg, longitude_deg = np.degrees(states.geodetic[k, :2]).tolist()
            state = MotionState(
                stamp_ns=stamp_ns,
                sequence=k + 1,
                mode=MotionState.TRACKING,
                latitude_deg=latitude_deg,
                longitude_deg=longitude_deg,
                height_ellipsoid_m=float(states.geodetic[k, 2]),
                speed_mps=float(states.speed_mps[k]),
                acceleration_mps2=float(states.acceleration_mps2[k]),
                pitch_rad=float(states.attitude_rad[k, 1]),
                yaw_rad=float(states.attitude_rad[k, 2]),
                standing=bool(states.standing[k]),
                covariance=[float(states.covariance[k][each]) for each in UPPER],
            )
            append(keys.EST_SMOOTHED, state, stamp_ns, k + 1)
    return path
