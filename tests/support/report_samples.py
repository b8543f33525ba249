"""A ride with everything that a report shows, made by hand from the built-in line.

The errors of the made-up filter are those it claims: first-order Gauss-Markov along and across
the track, so NEES and protection come out as they should, and every figure can be reckoned again
from the arrays.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log

from tramstream import keys
from tramstream.clock import S
from tramstream.keys import Key
from tramstream.lines.line import built_in_line
from tramstream.proto.estimate_pb2 import (
    FilterParameters,
    GradeState,
    Innovation,
    MotionState,
    Parameter,
)
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.health_pb2 import ClockReference, DeviceHealth, Loss, NodeHealth
from tramstream.proto.raw_pb2 import Odometry, WheelReading
from tramstream.recorder.file.writer import RecordFile
from tramstream.simulation.ride import Limits, Ride

VEHICLE = "4711"
START_NS = 1_790_000_000 * S
OUTAGE_S = (20.0, 28.0)
"""The receiver has no fix in this part of the ride."""
WRONG_EVERY = 37
"""One of so many fixes is 30 m off; the filter refuses it."""

ALONG_STD_M, ACROSS_STD_M, UP_STD_M = 0.6, 0.3, 1.0
SPEED_STD_MPS, YAW_STD_RAD, ATTITUDE_STD_RAD, GRADE_STD_RAD = 0.05, 0.01, 0.005, 0.002
PROTECTION = 5.33
"""Two-sided normal quantile of a risk of 1e-7."""


class Sample(NamedTuple):
    """One message on its way into the record."""

    key: Key
    stamp_ns: int
    message: object


def gauss_markov(
    rng: np.random.Generator, size: int, std: float, decay: float = 0.98
) -> np.ndarray:
    """Stationary errors of standard deviation `std`, correlated from one step to the next."""
    noise = rng.normal(0.0, std, size)
    for k in range(1, size):
        noise[k] = decay * noise[k - 1] + math.sqrt(1 - decay**2) * noise[k]
    return noise


class MadeUpRide:
    """Messages of one ride; `rate_hz` is that of the filter."""

    def __init__(self, duration_s: float, rate_hz: float = 10.0, seed: int = 1) -> None:
        self.ride = Ride(built_in_line(), Limits(dwell_s=58.0))
        self.duration_s, self.rng = duration_s, np.random.default_rng(seed)
        self.time_s = np.arange(0.0, duration_s, 1 / rate_hz)

    def geodetic_deg(self, p_l: np.ndarray) -> np.ndarray:
        geodetic = self.ride.line.level.to_geodetic(p_l)
        geodetic[:, :2] = np.degrees(geodetic[:, :2])
        return geodetic

    def truth(self) -> Iterator[Sample]:
        for t in np.arange(0.0, self.duration_s, 0.1):
            stamp_ns = START_NS + round(t * S)
            yield Sample(keys.TRUTH_STATE, stamp_ns, self.ride.truth(t, stamp_ns))

    def fixes(self) -> Iterator[Sample]:
        time_s = np.arange(0.0, self.duration_s, 0.2)
        motion = self.ride.motion(time_s)
        p_l = self.ride.line.position_l(motion.arc_length_m)
        p_l += np.stack([gauss_markov(self.rng, len(time_s), 0.8, 0.95) for _ in range(3)], axis=1)
        p_l[WRONG_EVERY - 1 :: WRONG_EVERY, 1] += 30.0
        for k, (latitude, longitude, height) in enumerate(self.geodetic_deg(p_l)):
            valid = not OUTAGE_S[0] <= time_s[k] < OUTAGE_S[1]
            stamp_ns = START_NS + round(time_s[k] * S)
            speed, yaw = motion.speed_mps[k], motion.yaw_rad[k]
            fix = GnssFix(
                stamp_ns=stamp_ns,
                source="NAV-PVT",
                fix_type=GnssFix.FIX_3D if valid else GnssFix.NO_FIX,
                valid=valid,
                satellites_used=14 if valid else 2,
                latitude_deg=latitude,
                longitude_deg=longitude,
                height_ellipsoid_m=height,
                horizontal_std_m=1.1,
                vertical_std_m=1.5,
                speed_mps=abs(speed + self.rng.normal(0, 0.08)),
                speed_std_mps=0.1,
                course_deg=(90 - math.degrees(yaw)) % 360,
                course_std_deg=2.0,
            )
            yield Sample(keys.GNSS_FIX, stamp_ns, fix)

    def wheels(self) -> Iterator[Sample]:
        time_s = np.arange(0.0, self.duration_s, 0.1)
        speed = self.ride.motion(time_s).speed_mps
        doors = self.ride.doors_open(time_s)
        for k, t in enumerate(time_s):
            stamp_ns = START_NS + round(t * S)
            wheels = [
                WheelReading(wheel=name, speed_mps=speed[k] * scale)
                for name, scale in (("left", 1.01), ("right", 0.99))
            ]
            message = Odometry(stamp_ns=stamp_ns, wheels=wheels, doors_open=bool(doors[k]))
            yield Sample(keys.ODO_WHEELS, stamp_ns, message)

    def estimate(self, key: Key, share: float = 1.0) -> Iterator[Sample]:
        """States whose errors have `share` of the standard deviations above."""
        rng, time_s = self.rng, self.time_s
        motion = self.ride.motion(time_s)
        size, yaw = len(time_s), motion.yaw_rad
        along = gauss_markov(rng, size, ALONG_STD_M * share)
        across = gauss_markov(rng, size, ACROSS_STD_M * share)
        p_l = self.ride.line.position_l(motion.arc_length_m)
        p_l[:, 0] += along * np.cos(yaw) - across * np.sin(yaw)
        p_l[:, 1] += along * np.sin(yaw) + across * np.cos(yaw)
        p_l[:, 2] += gauss_markov(rng, size, UP_STD_M * share)
        speed = motion.speed_mps + gauss_markov(rng, size, SPEED_STD_MPS * share)
        yaw = yaw + gauss_markov(rng, size, YAW_STD_RAD * share)
        geodetic = self.geodetic_deg(p_l)
        outage = (time_s >= OUTAGE_S[0] + 5) & (time_s < OUTAGE_S[1])
        step = max(1, round(len(time_s) / self.duration_s / 5))
        for k, (latitude, longitude, height) in enumerate(geodetic):
            stamp_ns = START_NS + round(time_s[k] * S)
            state = MotionState(
                stamp_ns=stamp_ns,
                mode=MotionState.DEAD_RECKONING if outage[k] else MotionState.TRACKING,
                latitude_deg=latitude,
                longitude_deg=longitude,
                height_ellipsoid_m=height,
                speed_mps=speed[k],
                acceleration_mps2=motion.acceleration_mps2[k],
                pitch_rad=0.01 * math.sin(time_s[k] / 60),
                yaw_rad=math.remainder(yaw[k], math.tau),
                yaw_rate_radps=motion.yaw_rate_radps[k],
                standing=bool(motion.standing[k]),
                along_std_m=ALONG_STD_M * share,
                across_std_m=ACROSS_STD_M * share,
                up_std_m=UP_STD_M * share,
                speed_std_mps=SPEED_STD_MPS * share,
                yaw_std_rad=YAW_STD_RAD * share,
                protection_along_m=PROTECTION * ALONG_STD_M * share,
                protection_across_m=PROTECTION * ACROSS_STD_M * share,
                covariance=covariance(yaw[k], share),
            )
            if key is keys.EST_STATE and k % step == 0 and not outage[k]:
                state.innovations.extend(self._innovations(k // step))
            yield Sample(key, stamp_ns, state)

    def slopes(self) -> Iterator[Sample]:
        """What a grade estimator says, off by its deviation."""
        motion = self.ride.motion(self.time_s)
        grade = self.ride.grade_rad(motion) + gauss_markov(
            self.rng, len(self.time_s), GRADE_STD_RAD
        )
        nod = gauss_markov(self.rng, len(self.time_s), GRADE_STD_RAD)
        for t, slope, pitch in zip(self.time_s, grade, nod, strict=True):
            stamp_ns = START_NS + round(t * S)
            message = GradeState(
                stamp_ns=stamp_ns,
                grade_rad=slope,
                grade_std_rad=GRADE_STD_RAD,
                body_pitch_rad=pitch,
                body_pitch_std_rad=GRADE_STD_RAD,
            )
            yield Sample(keys.EST_GRADE, stamp_ns, message)

    def _innovations(self, fix: int) -> Iterator[Innovation]:
        wrong = fix % WRONG_EVERY == WRONG_EVERY - 1
        for name, std in (("gnss_east", 1.0), ("gnss_north", 1.0), ("odometry", 0.05)):
            value = 30.0 if wrong and name == "gnss_north" else self.rng.normal(0.0, std)
            accepted = abs(value) < 5 * std
            yield Innovation(measurement=name, value=value, variance=std**2, accepted=accepted)

    def parameters(self) -> Iterator[Sample]:
        for t in np.arange(0.0, self.duration_s, 1.0):
            fade = math.exp(-t / 60)
            known = [
                Parameter(name=name, value=value * (1 - fade), std=std * fade + std / 20, unit=unit)
                for name, value, std, unit in (
                    ("gyro_bias_z", 0.002, 0.005, "rad/s"),
                    ("accel_bias_x", -0.08, 0.1, "m/s²"),
                    ("wheel_scale_left", 0.012, 0.02, "1"),
                    ("wheel_scale_right", -0.008, 0.02, "1"),
                )
            ]
            stamp_ns = START_NS + round(t * S)
            message = FilterParameters(stamp_ns=stamp_ns, model="made up", parameters=known)
            yield Sample(keys.EST_PARAMETERS, stamp_ns, message)

    def health(self) -> Iterator[Sample]:
        for t in np.arange(0.0, self.duration_s, 1.0):
            stamp_ns = START_NS + round(t * S)
            lost = OUTAGE_S[0] <= t < OUTAGE_S[1]
            for node in ("gnss", "processors"):
                beat = NodeHealth(
                    stamp_ns=stamp_ns,
                    node=node,
                    state=NodeHealth.DEGRADED if lost and node == "gnss" else NodeHealth.OK,
                    text="no fix" if lost and node == "gnss" else "",
                    uptime_s=t,
                    cpu_s=0.04 * t,
                    rss_bytes=44_000_000,
                )
                yield Sample(keys.HEARTBEAT.at(node), stamp_ns, beat)
            device = DeviceHealth(
                stamp_ns=stamp_ns,
                device="gnss",
                port="/dev/gnss",
                state=DeviceHealth.SILENT if lost else DeviceHealth.OPEN,
                opened=1,
                bytes_received=int(500 * t),
                frames_rejected=int(t // 100),
            )
            yield Sample(keys.DEVICE.at("gnss"), stamp_ns, device)
        loss = Loss(stamp_ns=START_NS + 3 * S, consumer="recorder", key="imu/batch", count=2)
        yield Sample(keys.LOSS.at("recorder"), START_NS + 3 * S, loss)
        log = Log(level=Log.WARNING, name="gnss", message="<b>no fix</b> & no hope")
        log.timestamp.FromNanoseconds(START_NS + round(OUTAGE_S[0] * S))
        yield Sample(keys.LOG.at("gnss"), START_NS + round(OUTAGE_S[0] * S), log)
        clock = ClockReference(stamp_ns=START_NS, host_utc_ns=START_NS + 7 * S, boot_id="boot")
        yield Sample(keys.CLOCK, START_NS, clock)


def covariance(yaw_rad: float, share: float) -> list[float]:
    """East, north, up, speed, roll, pitch, yaw: upper triangle, row by row."""
    along2, across2 = ALONG_STD_M**2, ACROSS_STD_M**2
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    P = np.diag(
        [
            along2 * c * c + across2 * s * s,
            along2 * s * s + across2 * c * c,
            UP_STD_M**2,
            SPEED_STD_MPS**2,
            ATTITUDE_STD_RAD**2,
            ATTITUDE_STD_RAD**2,
            YAW_STD_RAD**2,
        ]
    )
    P[0, 1] = (along2 - across2) * c * s
    return [float(value) for value in (P * share**2)[np.triu_indices(7)]]


def write(path: Path, *streams: Iterator[Sample], metadata: dict[str, str] | None = None) -> Path:
    """A finished record of the streams, in the order of their stamps."""
    samples = sorted((s for stream in streams for s in stream), key=lambda sample: sample.stamp_ns)
    numbers: dict[str, count[int]] = {}
    with RecordFile(path, VEHICLE, metadata or {}) as record:
        for key, stamp_ns, message in samples:
            number = next(numbers.setdefault(key.path, count(1)))
            if "sequence" in message.DESCRIPTOR.fields_by_name:
                message.sequence = number
            payload = message.SerializeToString()
            record.append(key.on(VEHICLE), key, payload, stamp_ns + S // 100, stamp_ns, number)
    return path


def whole_ride(path: Path, duration_s: float = 60.0, rate_hz: float = 10.0) -> Path:
    """A record with all that a report can show."""
    made = MadeUpRide(duration_s, rate_hz)
    return write(
        path,
        made.truth(),
        made.fixes(),
        made.wheels(),
        made.estimate(keys.EST_STATE),
        made.estimate(keys.EST_SMOOTHED, 0.5),
        made.slopes(),
        made.parameters(),
        made.health(),
    )
