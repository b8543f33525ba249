"""Travelled distance and speed from wheels and GNSS speed (konecny2004 on real measurements).

Pulses are measured as accumulated distance, so that quantisation never adds up; wheels that give a
speed, and the receiver's speed over ground, as speed. Each step predicts over the true interval
between the stamps; that the stamps jitter counts as noise of the path, in proportion to the speed.
A measurement outside the gate is reported and not used.

The wheels' path is *tied* to the estimate with its first reading, and anew when it jumps (a
restarted bridge, a reset controller) or does not fit after a pause, when other wheels make it up,
and after many refusals. What the estimate was wrong by at a tie stays in the distance for good: its
variance is *settled*, kept beside the filter, whose P speaks of the path since the tie.

Equations: docs/theory.md, section 9.2.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import sqrt
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Distance, Vehicle
from tramstream.estimation.fixes import measures_speed
from tramstream.events import Event, declared
from tramstream.processor import Ledger, Processor, Sample
from tramstream.processors.distance import events as own_events
from tramstream.processors.distance import kalman1d
from tramstream.proto.estimate_pb2 import DistanceState
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry

START_SPEED_STD_MPS = 20.0
"""Nothing is known at first: a tram does at most 80 km/h."""
MAX_SPEED_MPS = 30.0
"""Wheels that claim more have been reset."""
MIN_JUMP_S = 0.1
"""Readings that come closer together (stamps jitter) are not reset for it."""
GNSS_SPEED_FLOOR_MPS = 0.1
"""The receiver's own accuracy leaves out what is correlated in time."""
QUANTISATION = 1.0 / 3.0
"""Variance of a pulse count in pulses²: 1/12 in theory, 1/3 works better at low speed
(docs/theory.md, section 3.5)."""
MAX_PAUSE_S = 0.5
"""After a longer pause of the wheels, a path that does not fit has been counted without us."""
MAX_STEP_S = 60.0
"""After a longer pause the speed is unknown again."""
MAX_REFUSALS = 50
"""So many refused wheel readings in a row (one second) mean that the estimate is wrong, or that a
slip has taken the wheels' path away from it for good."""


WHEEL_PATH, GNSS_SPEED = "wheel_path", "gnss_speed"


class _Taken(NamedTuple):
    """One scalar measurement as the filter saw it; becomes an Innovation."""

    measurement: str
    innovation: float
    variance: float
    accepted: bool


@dataclass
class DistanceMemory:
    """What a `DistanceFilter` remembers."""

    belief: kalman1d.Belief = field(default_factory=kalman1d.Belief)
    stamp_ns: int = 0
    refusals: int = 0
    wheels: list[str] = field(default_factory=list)
    """Whose pulses make up the path."""
    offset_m: float | None = None
    """Distance − wheels' path; None while not tied."""
    path_m: float = 0.0
    """Wheels' path at the last reading."""
    path_ns: int = 0
    settled_m2: float = 0.0
    ledger: Ledger = field(default_factory=lambda: Ledger("distance", "measurements"))


class DistanceFilter(Processor):
    """(s, ṡ) from `sync/fusion/frame`, published with every frame that holds a measurement."""

    name = "distance"
    Settings = Distance
    Memory = DistanceMemory
    memory: DistanceMemory
    inputs = (keys.SYNC_FRAME,)
    outputs = (keys.EST_DISTANCE,)
    events = declared(own_events)
    pacing = (keys.SYNC_FRAME,)

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        config = vehicle.distance
        wheels = vehicle.wheels
        self._m_per_pulse = wheels.m_per_pulse
        self._acceleration_std = config.acceleration_std_mps2
        self._stamp_variance = wheels.stamp_std_s**2
        self._wheel_variance = wheels.speed_std_mps**2
        self._gate = config.gate_sigma
        belief = self.memory.belief
        self._kalman = kalman1d.distance_filter(np.zeros(2), np.zeros((2, 2)), belief)
        self._restart_speed()

    def step(self, sample: Sample) -> list[Sample]:
        memory = self.memory
        frame = sample.message
        # Copies: to go through what protobuf holds takes three times as long.
        measurements: list[GnssFix | Odometry] = [*frame.gnss[:], *frame.odometry[:]]
        if not measurements:
            return []
        if len(measurements) > 1:
            measurements.sort(key=attrgetter("stamp_ns"))
        innovations: list[_Taken] = []
        for measurement in measurements:
            memory.ledger.received += 1
            if isinstance(measurement, Odometry):
                found = self._take_wheels(measurement)
            else:
                found = self._take_fix(measurement)
            if any(innovation.accepted for innovation in found):
                memory.ledger.delivered += 1
            else:
                memory.ledger.dropped += 1
            innovations += found
        made = [self._publish(innovations)] if innovations else []
        for taken in innovations:
            if not taken.accepted:
                made += self.raise_event(self._refusal(taken), frame.stamp_ns)
        return made + self.overdue_events(frame.stamp_ns)

    def _refusal(self, taken: _Taken) -> Event:
        off, limit = abs(taken.innovation), self._gate * sqrt(max(taken.variance, 0.0))
        if taken.measurement == WHEEL_PATH:
            path = keys.ODO_WHEELS.path
            return own_events.PATH_REFUSED(key=path, innovation_m=off, limit_m=limit)
        key = keys.GNSS_FIX if taken.measurement == GNSS_SPEED else keys.ODO_WHEELS
        return own_events.SPEED_REFUSED(key=key.path, innovation_mps=off, limit_mps=limit)

    # Measurements --------------------------------------------------------------------------------
    def _predict(self, stamp_ns: int) -> None:
        memory = self.memory
        dt_s = (stamp_ns - memory.stamp_ns) / S
        if memory.stamp_ns == 0:
            memory.stamp_ns = stamp_ns
        elif dt_s > MAX_STEP_S:
            memory.stamp_ns = stamp_ns
            self._restart_speed(travelled_std_m=START_SPEED_STD_MPS * dt_s)
        elif dt_s > 0:
            self._kalman.move(dt_s, self._acceleration_std)
            memory.stamp_ns = stamp_ns

    def _restart_speed(self, travelled_std_m: float = 0.0) -> None:
        """Keep the distance, forget the speed and what the wheels' path was tied to."""
        memory = self.memory
        variance = self._kalman.covariance[0] + travelled_std_m**2
        self._kalman.x = np.array([[self._kalman.state[0]], [0.0]])
        self._kalman.P = np.diag([variance, START_SPEED_STD_MPS**2])
        memory.offset_m = None
        memory.refusals = 0

    def _take_wheels(self, odometry: Odometry) -> list[_Taken]:
        memory = self.memory
        names: list[str] = []
        speeds: list[float] = []
        pulses = 0
        for wheel in odometry.wheels[:]:
            if wheel.HasField("pulses"):
                names.append(wheel.wheel)
                pulses += wheel.pulses
            if wheel.HasField("speed_mps"):
                speeds.append(wheel.speed_mps)
        if not names and not speeds:
            return []
        self._predict(odometry.stamp_ns)
        found = []
        if names:
            path_m = pulses / len(names) * self._m_per_pulse
            found.append(self._take_path(names, path_m, odometry.stamp_ns))
        if speeds:
            speed_mps = sum(speeds) / len(speeds)
            variance = self._wheel_variance / len(speeds)
            found.append(self._update("wheel_speed", speed_mps, kalman1d.SPEED, variance))
        # The path speaks for the wheels: after a slip their speed is right again, the path is not.
        memory.refusals = 0 if found[0].accepted else memory.refusals + 1
        if memory.refusals >= MAX_REFUSALS:
            if any(innovation.accepted for innovation in found):
                memory.offset_m = None  # the speed is right, so the path is wrong
                memory.refusals = 0
            else:
                self._restart_speed()
        return found

    def _take_path(self, wheels: list[str], path_m: float, stamp_ns: int) -> _Taken:
        """Take the mean path of `wheels`."""
        memory = self.memory
        speed_mps = self._kalman.state[1]
        variance = (
            self._m_per_pulse**2 * QUANTISATION / len(wheels) + speed_mps**2 * self._stamp_variance
        )
        pause_s = (stamp_ns - memory.path_ns) / S
        jumped = abs(path_m - memory.path_m) > MAX_SPEED_MPS * max(pause_s, MIN_JUMP_S)
        if wheels != memory.wheels or jumped:
            memory.offset_m = None
        memory.wheels, memory.path_m, memory.path_ns = wheels, path_m, stamp_ns
        if memory.offset_m is None:
            return self._tie(path_m, variance)
        z = path_m + memory.offset_m
        innovation = self._update(WHEEL_PATH, z, kalman1d.POSITION, variance)
        if not innovation.accepted and pause_s > MAX_PAUSE_S:
            return self._tie(path_m, variance)
        return innovation

    def _tie(self, path_m: float, variance: float) -> _Taken:
        """Count the wheels' path from the estimate on."""
        memory = self.memory
        p00, _, _, p11 = self._kalman.covariance
        memory.settled_m2 += p00 + variance
        self._kalman.P = np.diag([variance, p11])
        memory.offset_m = self._kalman.state[0] - path_m
        return _Taken(WHEEL_PATH, 0.0, variance, accepted=True)

    def _take_fix(self, fix: GnssFix) -> list[_Taken]:
        if not (fix.valid and measures_speed(fix)):
            return []
        self._predict(fix.stamp_ns)
        # Speed over ground has no sign; the tram's direction is the filter's own.
        speed_mps = fix.speed_mps if self._kalman.state[1] >= 0.0 else -fix.speed_mps
        std_mps = max(fix.speed_std_mps, GNSS_SPEED_FLOOR_MPS)
        return [self._update(GNSS_SPEED, speed_mps, kalman1d.SPEED, std_mps**2)]

    def _update(self, name: str, z: float, H: kalman1d.Array, R: float) -> _Taken:
        verdict = self._kalman.update(z, R, H, self._gate)
        assert verdict is not None  # there was a measurement
        return _Taken(name, *verdict)

    def _publish(self, innovations: list[_Taken]) -> Sample:
        memory = self.memory
        distance_m, speed_mps = self._kalman.state
        p00, p01, _, p11 = self._kalman.covariance
        p00 += memory.settled_m2
        state = DistanceState()
        state.distance_m = distance_m
        state.speed_mps = speed_mps
        state.distance_std_m = sqrt(p00)
        state.speed_std_mps = sqrt(p11)
        state.covariance.extend((p00, p01, p01, p11))
        for taken in innovations:
            state.innovations.add(
                measurement=taken.measurement,
                value=taken.innovation,
                variance=taken.variance,
                accepted=taken.accepted,
            )
        return self.emit(keys.EST_DISTANCE, state, memory.stamp_ns)

    # Memory --------------------------------------------------------------------------------------
    def ledgers(self) -> list[Ledger]:
        return [self.memory.ledger]
