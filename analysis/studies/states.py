"""What a filter said on a simulated ride, as columns, and the truth beside it."""

from __future__ import annotations

from array import array

import numpy as np

from tramstream.estimation.series import (
    Array,
    Innovations,
    Instants,
    Slot,
    StateSeries,
    TruthSeries,
)
from tramstream.geodesy import LocalLevel
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.simulation.simulation import Simulation

NUMBERS = 13
"""Of a state, beside stamp and covariance."""


class SaidStates:
    """What a model said, in flat columns."""

    def __init__(self, model: str) -> None:
        self.model = model
        self.steps = 0
        self.step_us = float("nan")
        self.stamp_ns = array("q")
        self.numbers = array("d")
        self.covariance = array("d")

    def keep(self, state: MotionState) -> None:
        self.stamp_ns.append(state.stamp_ns)
        self.numbers.extend((state.latitude_deg, state.longitude_deg, state.height_ellipsoid_m))
        self.numbers.extend((state.roll_rad, state.pitch_rad, state.yaw_rad))
        self.numbers.extend((state.speed_mps, state.acceleration_mps2, state.yaw_rate_radps))
        self.numbers.extend((state.mode, state.standing))
        self.numbers.extend((state.protection_along_m, state.protection_across_m))
        self.covariance.extend(state.covariance)

    def states(self, level: LocalLevel) -> StateSeries:
        """What it said as columns, positions in `level`."""
        count = len(self.stamp_ns)
        columns = np.array(self.numbers).reshape(count, NUMBERS)
        geodetic = geodetic_rad(columns[:, :3])
        triangle = np.array(self.covariance).reshape(count, len(Slot) * (len(Slot) + 1) // 2)
        covariance = np.empty((count, len(Slot), len(Slot)))
        rows, columns_of = np.triu_indices(len(Slot))
        covariance[:, rows, columns_of] = covariance[:, columns_of, rows] = triangle
        return StateSeries(
            stamp_ns=np.array(self.stamp_ns, dtype=np.int64),
            geodetic=geodetic,
            p_l=level.from_geodetic(geodetic),
            speed_mps=columns[:, 6],
            acceleration_mps2=columns[:, 7],
            attitude_rad=columns[:, 3:6],
            yaw_rate_radps=columns[:, 8],
            covariance=covariance,
            mode=columns[:, 9].astype(np.int64),
            standing=columns[:, 10] != 0.0,
            protection_m=columns[:, 11:13],
            innovations=_NO_INNOVATIONS,
        )


_NO_INNOVATIONS = Innovations(
    stamp_ns=np.empty(0, dtype=np.int64),
    names=(),
    which=np.empty(0, dtype=np.int64),
    value=np.empty(0),
    variance=np.empty(0),
    accepted=np.empty(0, dtype=np.bool_),
)


def geodetic_rad(rows: Array) -> Array:
    """Latitude, longitude, height: degrees to radians."""
    return rows * (np.pi / 180.0, np.pi / 180.0, 1.0)


def truth_at(simulation: Simulation, stamp_ns: Instants) -> TruthSeries:
    """The truth, its attitude against level and east of the place, as that of the states."""
    truth = simulation.truth(stamp_ns)
    motion = truth.motion
    attitude = np.stack(simulation.ride.attitude(motion), axis=1)
    unknown = np.full(len(stamp_ns), np.nan)
    grade = simulation.ride.grade_rad(motion)
    return TruthSeries(stamp_ns, truth.p_l, motion.speed_mps, attitude, unknown, grade)
