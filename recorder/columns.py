"""A ride of a record as series: states, truth and fixes as arrays, in one frame and in order.

One pass over the record, only the keys and columns asked for (`message_columns`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.message import Message
from numpy.typing import NDArray

from tramstream import keys
from tramstream.estimation.series import (
    Array,
    FixSeries,
    GradeSeries,
    Innovations,
    Instants,
    Slot,
    StateSeries,
    TruthSeries,
    wrapped_rad,
)
from tramstream.geodesy import LocalLevel
from tramstream.proto.estimate_pb2 import GradeState, MotionState
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import TruthState
from tramstream.recorder.message_columns import Columns, read_columns
from tramstream.recorder.reader import Record

_UPPER = np.triu_indices(len(Slot))


class RideSeries(NamedTuple):
    """What `read_ride` found; a key without messages is absent."""

    level: LocalLevel | None
    """Frame `l` of all positions; None if there is none."""
    states: dict[str, StateSeries]
    truth: TruthSeries | None
    fixes: FixSeries | None
    grade: GradeSeries | None = None


def read_ride(
    record: Record,
    states: Sequence[str] = (),
    truth: str = "",
    fixes: bool = False,
    level: LocalLevel | None = None,
    grade: str = "",
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
    grade : str
        Key path of GradeState messages; empty for none.
    """
    types: dict[str, type[Message]] = dict.fromkeys(states, MotionState)
    if truth:
        types[truth] = TruthState
    if grade:
        types[grade] = GradeState
    if fixes:
        types[keys.GNSS_FIX.path] = GnssFix
    by_path: dict[str, list[str]] = {}
    for topic in record.channels:
        path = keys.split(topic)[1]
        if path in types and record.type_of(topic) == types[path].DESCRIPTOR.full_name:
            by_path.setdefault(path, []).append(topic)
    topics = {each: _NAMES[types[path]] for path, found in by_path.items() for each in found}
    columns = read_columns(record, topics)
    of = {path: _Messages([columns[each] for each in found]) for path, found in by_path.items()}
    of = {path: messages for path, messages in of.items() if len(messages.order)}
    for path in (truth, *states, keys.GNSS_FIX.path):
        if level is None and path in of:
            level = of[path].level()
    slopes = _grades(of[grade]) if grade in of else None
    if level is None:
        return RideSeries(None, {}, None, None, slopes)
    return RideSeries(
        level,
        {path: _states(of[path], level) for path in states if path in of},
        _truth(of[truth], level) if truth in of else None,
        _fixes(of[keys.GNSS_FIX.path], level) if keys.GNSS_FIX.path in of else None,
        slopes,
    )


_PLACE = ("latitude_deg", "longitude_deg", "height_ellipsoid_m")
_ATTITUDE = ("roll_rad", "pitch_rad", "yaw_rad")
_PROTECTION = ("protection_along_m", "protection_across_m")
_GRADE = ("grade_rad", "grade_std_rad", "body_pitch_rad", "body_pitch_std_rad")
_SPEEDS = ("speed_mps", "acceleration_mps2", "yaw_rate_radps")
_NAMES: dict[type[Message], tuple[str, ...]] = {
    MotionState: (
        *(*_PLACE, *_ATTITUDE, *_PROTECTION, *_SPEEDS),
        *("mode", "standing", "covariance", "innovations"),
    ),
    TruthState: (*_PLACE, *_ATTITUDE, "speed_mps", "position_std_m", "grade_rad"),
    GradeState: _GRADE,
    GnssFix: (*_PLACE, "speed_mps", "course_deg", "vel_n_mps", "valid", "invalid_llh"),
}
"""The columns that make a series."""


class _Messages:
    """Messages of one key, on whatever topics, in order of stamps; of equal stamps the last."""

    def __init__(self, found: list[Columns]) -> None:
        self.found = found
        stamp_ns = self.all("stamp_ns")
        order = np.argsort(stamp_ns, kind="stable")
        last = np.append(stamp_ns[order][1:] != stamp_ns[order][:-1], True)[: len(order)]
        self.order: NDArray[np.intp] = order[last]
        self.stamp_ns: Instants = stamp_ns[self.order]

    def all(self, name: str) -> NDArray[Any]:
        """A column as it was recorded."""
        return np.concatenate([each[name] for each in self.found])

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.all(name)[self.order]

    def rows(self, names: Sequence[str]) -> Array:
        """Columns side by side."""
        return np.column_stack([self[name] for name in names])

    def level(self) -> LocalLevel:
        """The local level at the message that was recorded first."""
        latitude_deg, longitude_deg, height_m = (float(self.all(name)[0]) for name in _PLACE)
        return LocalLevel.at_deg(latitude_deg, longitude_deg, _known(height_m))

    def geodetic(self) -> Array:
        """Rows of latitude, longitude, height; rad, rad, m."""
        geodetic = self.rows(_PLACE)
        geodetic[:, :2] = np.radians(geodetic[:, :2])
        return geodetic


def _known(height_m: float) -> float:
    return 0.0 if math.isnan(height_m) else height_m


def _states(messages: _Messages, level: LocalLevel) -> StateSeries:
    geodetic, protection = messages.geodetic(), messages.rows(_PROTECTION)
    triangle = np.concatenate([_triangles(each["covariance"]) for each in messages.found])
    covariance = np.empty((len(geodetic), len(Slot), len(Slot)))
    covariance[:, _UPPER[0], _UPPER[1]] = triangle[messages.order]
    covariance[:, _UPPER[1], _UPPER[0]] = triangle[messages.order]
    return StateSeries(
        stamp_ns=messages.stamp_ns,
        geodetic=geodetic,
        p_l=level.from_geodetic(geodetic),
        speed_mps=messages["speed_mps"],
        acceleration_mps2=messages["acceleration_mps2"],
        attitude_rad=wrapped_rad(messages.rows(_ATTITUDE)),
        yaw_rate_radps=messages["yaw_rate_radps"],
        covariance=covariance,
        mode=messages["mode"],
        standing=messages["standing"],
        # A level of exactly nothing is a field that was not set.
        protection_m=np.where(protection > 0, protection, np.nan),
        innovations=_innovations([each.elements("innovations") for each in messages.found]),
    )


def _triangles(rows: NDArray[Any]) -> Array:
    """Upper triangles of covariances; NaN where there is none of this size."""
    triangles = np.full((len(rows), len(_UPPER[0])), math.nan)
    if rows.ndim == 2 and rows.shape[1] == triangles.shape[1]:
        return rows
    for triangle, row in zip(triangles, rows, strict=True):
        if len(row) == len(triangle):
            triangle[:] = row
    return triangles


def _innovations(found: list[Columns]) -> Innovations:
    def all_(name: str) -> NDArray[Any]:
        return np.concatenate([each[name] for each in found])

    stamp_ns, texts = all_("stamp_ns"), all_("measurement").tolist()
    which = {name: number for number, name in enumerate(dict.fromkeys(texts))}
    order = np.argsort(stamp_ns, kind="stable")
    return Innovations(
        stamp_ns=stamp_ns[order],
        names=tuple(which),
        which=np.array([which[text] for text in texts], dtype=np.int64)[order],
        value=all_("value")[order],
        variance=all_("variance")[order],
        accepted=all_("accepted")[order],
    )


def _truth(messages: _Messages, level: LocalLevel) -> TruthSeries:
    """What is absent is NaN."""
    return TruthSeries(
        stamp_ns=messages.stamp_ns,
        p_l=level.from_geodetic(messages.geodetic()),
        speed_mps=messages["speed_mps"],
        attitude_rad=wrapped_rad(messages.rows(_ATTITUDE)),
        position_std_m=messages["position_std_m"],
        grade_rad=messages["grade_rad"],
    )


def _grades(messages: _Messages) -> GradeSeries:
    return GradeSeries(messages.stamp_ns, *(messages[name] for name in _GRADE))


def _fixes(messages: _Messages, level: LocalLevel) -> FixSeries:
    # A receiver that gives no velocity leaves speed and course 0.
    moves = ~np.isnan(messages["vel_n_mps"]) | (messages["speed_mps"] != 0.0)
    course_deg = np.where(moves, messages["course_deg"], math.nan)
    geodetic = messages.geodetic()
    untold = np.isnan(geodetic[:, 2])  # the place in the plane is right at any height nearby
    geodetic[untold, 2] = level.height_m
    return FixSeries(
        stamp_ns=messages.stamp_ns,
        valid=messages["valid"] & ~messages["invalid_llh"],
        p_l=level.from_geodetic(geodetic),
        speed_mps=np.where(moves, messages["speed_mps"], math.nan),
        course_yaw_rad=wrapped_rad(np.radians(90.0 - course_deg)),
    )
