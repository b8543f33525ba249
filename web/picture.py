"""What the page shows, computed from the messages of one vehicle: pure, without bus or server.

Two things are sent: the *frame*, ten times a second, what moves; and the *status*, once a second,
what is looked at now and then: nodes, devices, events, satellites.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from itertools import islice
from typing import Any

from tramstream import keys
from tramstream.boundary import name_of
from tramstream.clock import S
from tramstream.events.messages import sentence_of
from tramstream.monitor.board import board
from tramstream.monitor.stats import Stats
from tramstream.proto.health_pb2 import Event
from tramstream.transport.descriptions import Decoder
from tramstream.transport.envelope import Envelope
from tramstream.web.columns import COLUMNS, History, rounded

LISTENED = (
    keys.EST_NOW.path,
    keys.EST_STATE.path,
    keys.EST_GRADE.path,
    keys.EST_STOPPING.path,
    keys.GNSS_FIX.path,
    keys.GNSS_SATELLITES.path,
    keys.IMU_BATCH.path,
    keys.MAP_MATCH.path,
    keys.ODO_WHEELS.path,
    keys.TRUTH_STATE.path,
    "health/**",
)
EVENTS_KEPT, EVENTS_SENT = 200, 20
"""A page has all of them when it opens, and then the last ones again and again, by number."""
FRESH_S = 2.0
"""What came longer ago is shown as missing, not as if it were of now."""
_RINEX = {0: "G", 1: "S", 2: "E", 3: "C", 5: "J", 6: "R", 7: "I"}
"""Letters of satellite systems by u-blox' numbers."""
FIXES_KEPT = 32
"""Between two frames; a receiver gives 25 a second at most."""


class Picture:
    """What is known of one vehicle.

    Parameters
    ----------
    stats : Stats
        Figures of the keys, fed by whoever calls `add`.
    decode : Decoder
    vehicle : str
    """

    def __init__(self, stats: Stats, decode: Decoder, vehicle: str) -> None:
        self.vehicle = vehicle
        self.history = History()
        self.events: deque[dict[str, Any]] = deque(maxlen=EVENTS_KEPT)
        self.events_seen = 0
        self._stats = stats
        self._decode = decode
        self._refused: dict[str, int] = {}
        self._innovations: dict[str, float] = {}
        self._fixes: deque[list[float]] = deque(maxlen=FIXES_KEPT)
        self._takers: dict[str, Callable[[Any], None]] = {
            keys.EST_STATE.path: self._take_innovations,
            keys.GNSS_FIX.path: self._take_fix,
        }

    def add(self, envelope: Envelope) -> None:
        """Take what must not be missed between two frames: innovations, fixes, events."""
        path = keys.split(envelope.topic)[1]
        take = self._takers.get(path)
        if take is None and path.startswith("health/") and path.endswith("/event"):
            take = self._take_event
        if take is not None and (message := self._decode(envelope)) is not None:
            take(message)

    def _take_innovations(self, message: Any) -> None:
        for each in message.innovations:
            sensor = _sensor_of(each.measurement)
            if not each.accepted:
                self._refused[sensor] = self._refused.get(sensor, 0) + 1
            if each.variance > 0:
                ratio = each.value / math.sqrt(each.variance)
                if abs(ratio) >= abs(self._innovations.get(sensor, 0.0)):
                    self._innovations[sensor] = ratio

    def _take_fix(self, message: Any) -> None:
        if message.valid:
            self._fixes.append([message.latitude_deg, message.longitude_deg])

    def _take_event(self, message: Any) -> None:
        if message.severity == Event.DEBUG:
            return
        self.events_seen += 1
        self.events.append(
            {
                "number": self.events_seen,
                "t_s": message.stamp_ns / S,
                "source": message.source,
                "kind": message.kind,
                "level": name_of(Event.Severity, message.severity).lower(),
                "text": sentence_of(message),
            }
        )

    # Ten times a second ---------------------------------------------------------------------------
    def frame(self, now_ns: int) -> dict[str, Any]:
        """What moves; also adds a row to the history. To be called once an instant."""
        state = self._last(keys.EST_STATE, now_ns)
        now = self._last(keys.EST_NOW, now_ns) or state
        fix = self._last(keys.GNSS_FIX, now_ns)
        wheels = self._last(keys.ODO_WHEELS, now_ns)
        match = self._last(keys.MAP_MATCH, now_ns)
        grade = self._last(keys.EST_GRADE, now_ns)
        refused, self._refused = self._refused, {}
        innovations, self._innovations = self._innovations, {}
        fixes, self._fixes = list(self._fixes), deque(maxlen=FIXES_KEPT)
        found: dict[str, Any] = {
            "type": "frame",
            "now_s": now_ns / S,
            "state": _motion(now, state),
            "gnss": _fix(fix),
            "wheels": _wheels(wheels),
            "match": _match(match),
            "grade": _grade(grade),
            "stopping": _stopping(self._last(keys.EST_STOPPING, now_ns)),
            "truth": _truth(self._last(keys.TRUTH_STATE, now_ns)),
            "refused": refused,
            "innovations": {name: round(value, 2) for name, value in innovations.items()},
            "fixes": fixes,
        }
        placed = now if now is not None else fix
        row = _row(found, placed.stamp_ns) if placed is not None else None
        if row is not None:
            self.history.add(row)
            found["row"] = [rounded(value) for value in row]
        return found

    def _last(self, key: keys.Key, now_ns: int) -> Any | None:
        """The newest message of a key, unless it came too long ago."""
        stats = self._stats.by_topic.get(key.on(self.vehicle))
        if stats is None or stats.last is None:
            return None
        age_s = stats.age_s(now_ns)
        patience_s = max(FRESH_S, 3.0 / key.rate_hz if key.rate_hz else 0.0)
        return None if age_s is None or age_s > patience_s else self._decode(stats.last)

    # Once a second --------------------------------------------------------------------------------
    def status(self, now_ns: int, all_events: bool = False) -> dict[str, Any]:
        """Nodes, devices, satellites, and the last events, or all that are kept."""
        rows = board(self._stats, self.vehicle, now_ns, self._decode).as_dict()
        begin = 0 if all_events else max(0, len(self.events) - EVENTS_SENT)
        imu = self._last(keys.IMU_BATCH, now_ns)
        return {
            "type": "status",
            "vehicle": self.vehicle,
            "nodes": rows["nodes"],
            "devices": rows["devices"],
            "rates_hz": {row["key"]: row["rate_hz"] for row in rows["keys"]},
            "lost": rows["lost"],
            "events": list(islice(self.events, begin, None)),
            "satellites": _satellites(self._last(keys.GNSS_SATELLITES, now_ns)),
            "imu_degc": _temperature(imu),
        }


def _sensor_of(measurement: str) -> str:
    """`gnss_velocity_east` is of gnss, `wheel_a` of wheels, what the track says of map."""
    if measurement.startswith("gnss"):
        return "gnss"
    if measurement.startswith(("wheel", "odo")):
        return "wheels"
    if measurement.startswith(("track", "map")):
        return "map"
    return "other"


def _motion(now: Any | None, state: Any | None) -> dict[str, Any] | None:
    """Place and motion predicted to now, with what the filter says of its certainty."""
    if now is None:
        return None
    certain = state if state is not None else now
    oriented = now.mode in (type(now).TRACKING, type(now).DEAD_RECKONING)
    return {
        "t_s": now.stamp_ns / S,
        "mode": name_of(type(now).Mode, now.mode),
        "latitude_deg": round(now.latitude_deg, 8),
        "longitude_deg": round(now.longitude_deg, 8),
        "height_m": rounded(now.height_ellipsoid_m),
        "speed_mps": rounded(now.speed_mps),
        "acceleration_mps2": rounded(now.acceleration_mps2),
        "heading_deg": rounded(_heading_deg(now.yaw_rad)) if oriented else None,
        "roll_deg": rounded(math.degrees(now.roll_rad)),
        "pitch_deg": rounded(math.degrees(now.pitch_rad)),
        "standing": now.standing,
        "along_std_m": rounded(certain.along_std_m),
        "across_std_m": rounded(certain.across_std_m),
        "speed_std_mps": rounded(certain.speed_std_mps),
        "heading_std_deg": rounded(math.degrees(certain.yaw_std_rad)),
        "protection_along_m": rounded(certain.protection_along_m),
        "protection_across_m": rounded(certain.protection_across_m),
    }


def _heading_deg(yaw_rad: float) -> float:
    """Clockwise from north, as people read it."""
    return (90.0 - math.degrees(yaw_rad)) % 360.0


def _fix(fix: Any | None) -> dict[str, Any] | None:
    if fix is None:
        return None
    return {
        "fix": name_of(type(fix).FixType, fix.fix_type),
        "carrier": name_of(type(fix).Carrier, fix.carrier),
        "valid": fix.valid,
        "speed_mps": rounded(fix.speed_mps),
        "satellites": fix.satellites_used,
        "std_m": rounded(fix.horizontal_std_m),
        "latitude_deg": round(fix.latitude_deg, 8),
        "longitude_deg": round(fix.longitude_deg, 8),
    }


def _wheels(odometry: Any | None) -> dict[str, Any] | None:
    """Mean speed of the wheels that tell one, doors, motor force."""
    if odometry is None:
        return None
    speeds = [each.speed_mps for each in odometry.wheels if each.HasField("speed_mps")]
    return {
        "speed_mps": rounded(sum(speeds) / len(speeds)) if speeds else None,
        "doors_open": odometry.doors_open if odometry.HasField("doors_open") else None,
        "force_n": rounded(odometry.motor_force_n) if odometry.HasField("motor_force_n") else None,
    }


def _match(match: Any | None) -> dict[str, Any] | None:
    if match is None:
        return None
    return {
        "state": name_of(type(match).State, match.state),
        "edge": match.edge,
        "run": match.run,
        "chainage_m": rounded(match.chainage_m),
        "std_m": rounded(match.chainage_std_m),
        "probability": rounded(match.probability),
        "off": rounded(match.off_probability),
        "side": name_of(type(match).Side, match.side),
        "latitude_deg": round(match.latitude_deg, 8),
        "longitude_deg": round(match.longitude_deg, 8),
        "alternatives": [
            {"edge": each.edge, "run": each.run, "probability": rounded(each.probability)}
            for each in match.alternatives
        ],
        "references": [
            {
                "line": each.line,
                "direction": each.direction,
                "chainage_m": rounded(each.chainage_m),
            }
            for each in match.references
        ],
    }


def _grade(grade: Any | None) -> dict[str, Any] | None:
    if grade is None:
        return None
    return {
        "percent": rounded(100 * math.tan(grade.grade_rad)),
        "std_percent": rounded(100 * math.tan(grade.grade_std_rad)),
        "inputs": list(grade.inputs),
        "mass_kg": rounded(grade.mass_kg) if grade.HasField("mass_kg") else None,
        "mass_std_kg": rounded(grade.mass_std_kg) if grade.HasField("mass_std_kg") else None,
    }


def _stopping(stopping: Any | None) -> dict[str, Any] | None:
    if stopping is None:
        return None
    return {
        "grade_ahead_percent": rounded(100 * math.tan(stopping.grade_ahead_rad)),
        "mapped_m": rounded(stopping.mapped_m),
        "stops": [
            {
                "deceleration_mps2": each.deceleration_mps2,
                "distance_m": rounded(each.distance_m) if each.HasField("distance_m") else None,
                "std_m": rounded(each.distance_std_m),
            }
            for each in stopping.stops
        ],
    }


def _truth(truth: Any | None) -> dict[str, Any] | None:
    """Of a simulated ride."""
    if truth is None:
        return None
    return {
        "latitude_deg": round(truth.latitude_deg, 8),
        "longitude_deg": round(truth.longitude_deg, 8),
        "speed_mps": rounded(truth.speed_mps) if truth.HasField("speed_mps") else None,
    }


def _satellites(message: Any | None) -> list[dict[str, Any]] | None:
    if message is None:
        return None
    return [
        {
            "name": f"{_RINEX.get(each.gnss_id, '?')}{each.sv_id:02d}",
            "cno_dbhz": each.cno_dbhz,
            "elevation_deg": each.elevation_deg if each.HasField("elevation_deg") else None,
            "azimuth_deg": each.azimuth_deg if each.HasField("azimuth_deg") else None,
            "used": each.used,
        }
        for each in message.satellites
    ]


def _temperature(imu: Any | None) -> float | None:
    return None if imu is None else rounded(imu.temperature_scale_degc * imu.temperature)


def _row(frame: dict[str, Any], stamp_ns: int) -> list[float]:
    """The row of the history that a frame with a state or a fix makes."""
    state, gnss, wheels, grade = (frame[name] for name in ("state", "gnss", "wheels", "grade"))
    place = state or gnss
    values = {
        "t_s": stamp_ns / S,
        "latitude_deg": place["latitude_deg"],
        "longitude_deg": place["longitude_deg"],
        "gnss_speed_mps": gnss and gnss["valid"] and gnss["speed_mps"],
        "wheel_speed_mps": wheels and wheels["speed_mps"],
        "grade_percent": grade and grade["percent"],
        "grade_std_percent": grade and grade["std_percent"],
        "refused": float(sum(frame["refused"].values())),
    }
    if state is not None:
        names = ("speed_mps", "heading_deg", "along_std_m", "across_std_m")
        values |= {name: state[name] for name in names}
        values |= {name: state[name] for name in ("protection_along_m", "protection_across_m")}
    values |= {f"{name}_innovation": value for name, value in frame["innovations"].items()}
    row = [values.get(name) for name in COLUMNS]
    return [math.nan if each is None or each is False else float(each) for each in row]
