"""Keys of a record as columns: states, truth and fixes as arrays.

One pass over the record, only the keys asked for; a message leaves its numbers in flat typed arrays
and is gone.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.message import Message
from numpy.typing import NDArray

from tramstream import keys
from tramstream.estimation.series import (
    Array,
    FixSeries,
    Innovations,
    Instants,
    Slot,
    StateSeries,
    TruthSeries,
    wrapped_rad,
)
from tramstream.geodesy import LocalLevel
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import TruthState
from tramstream.recorder.reader import Record

_UPPER = np.triu_indices(len(Slot))
_TRIANGLE = len(_UPPER[0])
_NO_COVARIANCE = [math.nan] * _TRIANGLE
_NAN = math.nan


class RideSeries(NamedTuple):
    """What `read_ride` found; a key without messages is absent."""

    level: LocalLevel | None
    """Frame `l` of all positions; None if there is none."""
    states: dict[str, StateSeries]
    truth: TruthSeries | None
    fixes: FixSeries | None


def read_ride(
    record: Record,
    states: Sequence[str] = (),
    truth: str = "",
    fixes: bool = False,
    level: LocalLevel | None = None,
) -> RideSeries:
    """Read the keys asked for.

    Parameters
    ----------
    record : Record
    states : sequence of str
        Key paths of MotionState messages.
    truth : str
        Key path of TruthState messages; empty for none.
    fixes : bool
        Read `raw/gnss/fix` too.
    level : LocalLevel, optional
        Of the positions; without one it lies at the first truth, else state, else fix.
    """
    of_states = {path: _States() for path in states}
    of_truth, of_fixes = _Truth(), _Fixes()
    wanted: dict[str, _Columns] = dict(of_states)
    if truth:
        wanted[truth] = of_truth
    if fixes:
        wanted[keys.GNSS_FIX.path] = of_fixes
    by_topic = {
        topic: columns
        for topic in record.channels
        if (columns := wanted.get(keys.split(topic)[1])) is not None
        and record.type_of(topic) == columns.type.DESCRIPTOR.full_name
    }
    for entry, message in record.decoded(by_topic.__contains__):
        by_topic[entry.topic].add(message)
    for columns in (of_truth, *of_states.values(), of_fixes):
        level = level or columns.level()
    if level is None:
        return RideSeries(None, {}, None, None)
    return RideSeries(
        level,
        {path: columns.series(level) for path, columns in of_states.items() if columns.stamp_ns},
        of_truth.series(level) if of_truth.stamp_ns else None,
        of_fixes.series(level) if of_fixes.stamp_ns else None,
    )


class _Columns:
    """Where the messages of a key leave their stamps and `width` numbers each.

    The first three numbers are latitude and longitude in degrees and height.
    """

    width = 0
    type: type[Message]

    def __init__(self) -> None:
        self.stamp_ns = array("q")
        self.numbers = array("d")

    def add(self, message: Any) -> None:
        """Take what the series needs of a message."""
        raise NotImplementedError

    def level(self) -> LocalLevel | None:
        """The local level at the first message."""
        return LocalLevel.at_deg(*self.numbers[:3]) if self.stamp_ns else None

    def columns(self) -> tuple[NDArray[np.intp], Instants, Array]:
        """Which messages to keep, in order of stamps; of equal stamps the last. Their numbers."""
        stamp_ns = np.frombuffer(self.stamp_ns, dtype=np.int64)
        order = np.argsort(stamp_ns, kind="stable")
        after = stamp_ns[order][1:]
        order = order[np.append(after != stamp_ns[order][:-1], True)]
        numbers = np.frombuffer(self.numbers).reshape(-1, self.width)
        return order, stamp_ns[order], numbers[order]


def _geodetic(numbers: Array) -> Array:
    """Rows of latitude, longitude, height out of the first three columns."""
    geodetic = numbers[:, :3].copy()
    geodetic[:, :2] = np.radians(geodetic[:, :2])
    return geodetic


class _States(_Columns):
    """MotionState."""

    type = MotionState
    width = 13

    def __init__(self) -> None:
        super().__init__()
        self.covariance = array("d")
        self.names: dict[str, int] = {}
        self.innovation_stamp_ns = array("q")
        self.innovation_which = array("q")
        self.innovation_numbers = array("d")

    def add(self, message: Any) -> None:
        stamp_ns = message.stamp_ns
        self.stamp_ns.append(stamp_ns)
        self.numbers.extend(
            (
                message.latitude_deg,
                message.longitude_deg,
                message.height_ellipsoid_m,
                message.speed_mps,
                message.acceleration_mps2,
                message.roll_rad,
                message.pitch_rad,
                message.yaw_rad,
                message.yaw_rate_radps,
                message.mode,
                message.standing,
                message.protection_along_m,
                message.protection_across_m,
            )
        )
        covariance = message.covariance
        self.covariance.extend(covariance if len(covariance) == _TRIANGLE else _NO_COVARIANCE)
        names = self.names
        for innovation in message.innovations:
            self.innovation_stamp_ns.append(stamp_ns)
            self.innovation_which.append(names.setdefault(innovation.measurement, len(names)))
            self.innovation_numbers.extend(
                (innovation.value, innovation.variance, innovation.accepted)
            )

    def series(self, level: LocalLevel) -> StateSeries:
        order, stamp_ns, numbers = self.columns()
        geodetic = _geodetic(numbers)
        triangle = np.frombuffer(self.covariance).reshape(-1, _TRIANGLE)[order]
        covariance = np.empty((len(order), len(Slot), len(Slot)))
        covariance[:, _UPPER[0], _UPPER[1]] = triangle
        covariance[:, _UPPER[1], _UPPER[0]] = triangle
        protection = numbers[:, 11:13]
        return StateSeries(
            stamp_ns=stamp_ns,
            geodetic=geodetic,
            p_l=level.from_geodetic(geodetic),
            speed_mps=numbers[:, 3],
            acceleration_mps2=numbers[:, 4],
            attitude_rad=wrapped_rad(numbers[:, 5:8]),
            yaw_rate_radps=numbers[:, 8],
            covariance=covariance,
            mode=numbers[:, 9].astype(np.int64),
            standing=numbers[:, 10] != 0,
            # A level of exactly nothing is a field that was not set.
            protection_m=np.where(protection > 0, protection, np.nan),
            innovations=self._innovations(),
        )

    def _innovations(self) -> Innovations:
        stamp_ns = np.frombuffer(self.innovation_stamp_ns, dtype=np.int64)
        order = np.argsort(stamp_ns, kind="stable")
        numbers = np.frombuffer(self.innovation_numbers).reshape(-1, 3)[order]
        return Innovations(
            stamp_ns=stamp_ns[order],
            names=tuple(self.names),
            which=np.frombuffer(self.innovation_which, dtype=np.int64)[order],
            value=numbers[:, 0],
            variance=numbers[:, 1],
            accepted=numbers[:, 2] != 0,
        )


class _Truth(_Columns):
    """TruthState; what is absent is NaN."""

    type = TruthState
    width = 8
    optional = ("speed_mps", "roll_rad", "pitch_rad", "yaw_rad", "position_std_m")

    def add(self, message: Any) -> None:
        self.stamp_ns.append(message.stamp_ns)
        self.numbers.extend(
            (message.latitude_deg, message.longitude_deg, message.height_ellipsoid_m)
        )
        has = message.HasField
        self.numbers.extend(getattr(message, name) if has(name) else _NAN for name in self.optional)

    def series(self, level: LocalLevel) -> TruthSeries:
        _, stamp_ns, numbers = self.columns()
        return TruthSeries(
            stamp_ns=stamp_ns,
            p_l=level.from_geodetic(_geodetic(numbers)),
            speed_mps=numbers[:, 3],
            attitude_rad=wrapped_rad(numbers[:, 4:7]),
            position_std_m=numbers[:, 7],
        )


class _Fixes(_Columns):
    """GnssFix."""

    type = GnssFix
    width = 6

    def add(self, message: Any) -> None:
        # A receiver that gives no velocity leaves speed and course 0.
        moves = message.HasField("vel_n_mps") or message.speed_mps != 0.0
        self.stamp_ns.append(message.stamp_ns)
        self.numbers.extend(
            (
                message.latitude_deg,
                message.longitude_deg,
                message.height_ellipsoid_m,
                message.speed_mps if moves else _NAN,
                message.course_deg if moves else _NAN,
                message.valid and not message.invalid_llh,
            )
        )

    def series(self, level: LocalLevel) -> FixSeries:
        _, stamp_ns, numbers = self.columns()
        return FixSeries(
            stamp_ns=stamp_ns,
            valid=numbers[:, 5] != 0,
            p_l=level.from_geodetic(_geodetic(numbers)),
            speed_mps=numbers[:, 3],
            course_yaw_rad=wrapped_rad(np.radians(90.0 - numbers[:, 4])),
        )
