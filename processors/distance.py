"""Travelled distance and speed from wheels and GNSS speed (konecny2004 on real measurements).

Pulses are measured as accumulated distance, so that quantisation never adds up; wheels that give a
speed, and the receiver's speed over ground, as speed. Each step predicts over the true interval
between the stamps. A measurement outside the gate is reported and not used; when the wheels' count
jumps (a restarted bridge, a reset controller) the distance goes on from the estimate.
"""

from __future__ import annotations

import numpy as np

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.processor import Ledger, Processor, Sample, State
from tramstream.processors import kalman1d
from tramstream.proto.estimate_pb2 import DistanceState, Innovation
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry

START_SPEED_STD_MPS = 20.0
"""Nothing is known at first: a tram does at most 80 km/h."""
MAX_SPEED_MPS = 30.0
"""Wheels that claim more have been reset."""
GNSS_SPEED_FLOOR_MPS = 0.1
"""The receiver's own accuracy leaves out what is correlated in time."""
QUANTISATION = 1.0 / 3.0
"""Variance of a pulse count in pulses²: 1/12 in theory, 1/3 works better at low speed (theory.md
section 2)."""
MAX_STEP_S = 60.0
"""After a longer pause the speed is unknown again."""
MAX_REFUSALS = 50
"""So many refused wheel readings in a row (one second) mean that the estimate is wrong."""


class DistanceFilter(Processor):
    """(s, ṡ) from `sync/fusion/frame`, published with every frame that holds a measurement."""

    name = "distance"
    inputs = (keys.SYNC_FRAME,)
    outputs = (keys.EST_DISTANCE,)
    pacing = (keys.SYNC_FRAME,)

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        config = vehicle.distance
        self._m_per_pulse = config.m_per_pulse
        self._acceleration_std = config.acceleration_std_mps2
        self._wheel_variance = config.wheel_speed_std_mps**2
        self._gate = config.gate_sigma
        self._stamp_ns = 0
        self._refusals = 0
        self._offset_m: float | None = None  # distance − wheels' path
        self._path_m = 0.0  # wheels' path at the last reading
        self._path_ns = 0
        self._ledger = Ledger("distance", "measurements")
        self._kalman = kalman1d.distance_filter(np.zeros(2), np.zeros((2, 2)))
        self._restart_speed()

    def step(self, sample: Sample) -> list[Sample]:
        frame = sample.message
        measurements = sorted((*frame.gnss, *frame.odometry), key=lambda m: m.stamp_ns)
        innovations: list[Innovation] = []
        for measurement in measurements:
            self._ledger.received += 1
            if isinstance(measurement, Odometry):
                found = self._take_wheels(measurement)
            else:
                found = self._take_fix(measurement)
            if any(innovation.accepted for innovation in found):
                self._ledger.delivered += 1
            else:
                self._ledger.dropped += 1
            innovations += found
        return [self._publish(innovations)] if innovations else []

    # Measurements --------------------------------------------------------------------------------
    def _predict(self, stamp_ns: int) -> None:
        dt_s = (stamp_ns - self._stamp_ns) / S
        if self._stamp_ns == 0:
            self._stamp_ns = stamp_ns
        elif dt_s > MAX_STEP_S:
            self._stamp_ns = stamp_ns
            self._restart_speed()
        elif dt_s > 0:
            noise = kalman1d.acceleration_noise(dt_s, self._acceleration_std)
            self._kalman.predict(F=kalman1d.transition(dt_s), Q=noise)
            self._stamp_ns = stamp_ns

    def _restart_speed(self) -> None:
        """Keep the distance, forget the speed and what the wheels' path was tied to."""
        distance_m = float(self._kalman.x[0, 0])
        variance = float(self._kalman.P[0, 0])
        self._kalman.x = np.array([[distance_m], [0.0]])
        self._kalman.P = np.diag([variance, START_SPEED_STD_MPS**2])
        self._offset_m = None
        self._refusals = 0

    def _take_wheels(self, odometry: Odometry) -> list[Innovation]:
        pulses = [wheel.pulses for wheel in odometry.wheels if wheel.HasField("pulses")]
        speeds = [wheel.speed_mps for wheel in odometry.wheels if wheel.HasField("speed_mps")]
        found = []
        self._predict(odometry.stamp_ns)
        if pulses:
            path_m = sum(pulses) / len(pulses) * self._m_per_pulse
            if self._jumped(path_m, odometry.stamp_ns):
                self._offset_m = None
            if self._offset_m is None:
                self._offset_m = float(self._kalman.x[0, 0]) - path_m
            self._path_m, self._path_ns = path_m, odometry.stamp_ns
            variance = self._m_per_pulse**2 * QUANTISATION / len(pulses)
            found.append(
                self._update("wheel_path", path_m + self._offset_m, kalman1d.POSITION, variance)
            )
        if speeds:
            speed_mps = sum(speeds) / len(speeds)
            variance = self._wheel_variance / len(speeds)
            found.append(self._update("wheel_speed", speed_mps, kalman1d.SPEED, variance))
        if found:
            accepted = any(innovation.accepted for innovation in found)
            self._refusals = 0 if accepted else self._refusals + 1
            if self._refusals >= MAX_REFUSALS:
                self._restart_speed()
        return found

    def _jumped(self, path_m: float, stamp_ns: int) -> bool:
        dt_s = (stamp_ns - self._path_ns) / S
        return abs(path_m - self._path_m) > MAX_SPEED_MPS * max(dt_s, 0.1)

    def _take_fix(self, fix: GnssFix) -> list[Innovation]:
        if not fix.valid:
            return []
        self._predict(fix.stamp_ns)
        # Speed over ground has no sign; the tram's direction is the filter's own.
        speed_mps = fix.speed_mps if self._kalman.x[1, 0] >= 0.0 else -fix.speed_mps
        std_mps = max(fix.speed_std_mps, GNSS_SPEED_FLOOR_MPS)
        return [self._update("gnss_speed", speed_mps, kalman1d.SPEED, std_mps**2)]

    def _update(self, name: str, z: float, H: kalman1d.Array, R: float) -> Innovation:
        verdict = kalman1d.update(self._kalman, z, H, R, self._gate)
        return Innovation(
            measurement=name,
            value=verdict.innovation,
            variance=verdict.variance,
            accepted=verdict.accepted,
        )

    def _publish(self, innovations: list[Innovation]) -> Sample:
        x, P = self._kalman.x, self._kalman.P
        state = DistanceState(
            distance_m=x[0, 0],
            speed_mps=x[1, 0],
            distance_std_m=P[0, 0] ** 0.5,
            speed_std_mps=P[1, 1] ** 0.5,
            covariance=P.ravel().tolist(),
            innovations=innovations,
        )
        return self.emit(keys.EST_DISTANCE, state, self._stamp_ns)

    # Memory --------------------------------------------------------------------------------------
    def ledgers(self) -> list[Ledger]:
        return [self._ledger]

    def snapshot(self) -> State:
        return {
            "sequences": self.sequences(),
            "x": self._kalman.x.copy(),
            "P": self._kalman.P.copy(),
            "stamp_ns": self._stamp_ns,
            "refusals": self._refusals,
            "offset_m": self._offset_m,
            "path_m": self._path_m,
            "path_ns": self._path_ns,
            "counts": [self._ledger.received, self._ledger.delivered, self._ledger.dropped],
        }

    def restore(self, state: State) -> None:
        self.restore_sequences(state["sequences"])
        self._kalman.x, self._kalman.P = state["x"].copy(), state["P"].copy()
        self._stamp_ns, self._refusals = state["stamp_ns"], state["refusals"]
        self._offset_m = state["offset_m"]
        self._path_m, self._path_ns = state["path_m"], state["path_ns"]
        self._ledger = Ledger("distance", "measurements", *state["counts"])
