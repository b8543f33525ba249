"""Poses of a record in the format of the TUM RGB-D benchmark, which evo and others read.

A line is `time x y z qx qy qz qw`: seconds, metres, the turn from the vehicle's axes (forward,
left, up) to east, north, up at the first pose of the record. Truth and estimate of one record have
the same origin, so that what is between them is the error.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tramstream import keys, mounting
from tramstream.clock import S
from tramstream.errors import RecordError
from tramstream.geodesy import LocalLevel
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.raw_pb2 import TruthState
from tramstream.recorder.exports.window import Window
from tramstream.recorder.reader import Record

TYPES = (MotionState, TruthState)


def tum(record: Record, window: Window) -> dict[str, str]:
    """Poses of the keys that have some, by key.

    Raises
    ------
    RecordError
        If none has.
    """
    names = {type_.DESCRIPTOR.full_name for type_ in TYPES}
    topics = [info.topic for info in record.channels.values() if info.schema in names]
    level = _origin(record, topics)
    found = {}
    for topic in topics:
        lines = [_line(message, level) for _, message in window.decoded(record, topic)]
        text = "".join(line for line in lines if line)
        if text:
            found[keys.split(topic)[1]] = text
    if not found:
        raise RecordError(
            f"{record.paths[0]}: has no pose{window.told}",
            cure="`tramstream reprocess` makes est/ekf/state",
        )
    return found


def _origin(record: Record, topics: list[str]) -> LocalLevel:
    """The first pose of the record, whatever part of it is wanted."""
    for _, message in record.decoded(topics.__contains__):
        if _placed(message):
            return LocalLevel.at_deg(
                message.latitude_deg, message.longitude_deg, message.height_ellipsoid_m
            )
    return LocalLevel.at_deg(0.0, 0.0, 0.0)


def _placed(message: Any) -> bool:
    """Whether it says where the vehicle is; a filter that starts does not."""
    return not isinstance(message, MotionState) or message.mode != MotionState.STARTING


def _line(message: Any, level: LocalLevel) -> str:
    if not _placed(message):
        return ""
    geodetic = [
        *np.radians([message.latitude_deg, message.longitude_deg]),
        message.height_ellipsoid_m,
    ]
    east, north, up = level.from_geodetic(np.array(geodetic))
    roll_deg, pitch_deg, yaw_deg = (
        math.degrees(each) for each in (message.roll_rad, message.pitch_rad, message.yaw_rad)
    )
    w, x, y, z = mounting.quaternion_of((roll_deg, pitch_deg, yaw_deg))
    time_s = f"{message.stamp_ns // S}.{message.stamp_ns % S:09d}"
    pose = " ".join(f"{value:.9f}" for value in (east, north, up, -x, -y, -z, w))
    return f"{time_s} {pose}\n"
