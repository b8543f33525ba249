"""Stops and turns out of epochs: what has begun, what has ended, how far apart they are."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tramstream.clock import S
from tramstream.processors.segments.kernels import Ix
from tramstream.processors.segments.motion import Epoch, Motion
from tramstream.processors.segments.standing import St
from tramstream.processors.segments.turns import Turn
from tramstream.proto.estimate_pb2 import SegmentEvent

LEFT_M = 1.5
"""A vehicle that has gone so far since a stand has left; less is a jolt."""
JOLT_STD_S = 0.3
"""How well the begin and the end of a stand are known by quiet, and"""
WHEEL_STD_S = 0.1
"""by wheels."""
ANGLE_STD_RAD = 0.005
"""Of a turn's angle: the body's sway at its two ends;"""
ANGLE_PART = 0.003
"""and the gyroscope's scale, and that its axis is not quite vertical."""


@dataclass
class LedgerMemory:
    """What is remembered of stops and turns."""

    halted: bool = False
    """A stop has been told that has not ended."""
    halt_ns: int = 0
    halt_m: float = 0.0
    doors: bool = False
    left_ns: int = 0
    """When it seems to have left; 0: it stands."""
    end_m: float = 0.0
    """Way at the end of what was told last."""
    held_variance: float = 0.0
    """Of the way, at the last stand."""


class Ledger:
    """Makes `SegmentEvent`s of what epochs show."""

    def __init__(self, motion: Motion, least_turn_rad: float, memory: LedgerMemory) -> None:
        self.memory = memory
        self._motion = motion
        self._least_turn_rad = least_turn_rad

    def take(self, epoch: Epoch) -> list[SegmentEvent]:
        """Take an epoch."""
        made = self._turns(epoch)
        memory, motion = self.memory, self._motion
        if epoch.standing:
            if memory.halted:
                memory.left_ns = 0
            else:
                made.append(self._halt(epoch))
            doors_ns = motion.memory.wheels.doors_ns
            memory.doors = memory.doors or doors_ns > memory.halt_ns
            memory.held_variance = motion.std(Ix.WAY) ** 2
        elif memory.halted:
            if not memory.left_ns:
                memory.left_ns = motion.stamp_of(float(motion.memory.standing[St.SINCE_S]))
            if abs(motion.gone_m - memory.halt_m) > LEFT_M:
                made.append(self._stop())
        return made

    def _halt(self, epoch: Epoch) -> SegmentEvent:
        memory, motion = self.memory, self._motion
        since_ns = motion.stamp_of(float(motion.memory.standing[St.SINCE_S]))
        memory.halted, memory.doors, memory.left_ns = True, False, 0
        memory.halt_ns, memory.halt_m = min(since_ns, epoch.stamp_ns), motion.gone_m
        return self._event(SegmentEvent.HALT, memory.halt_ns, memory.halt_ns, motion.gone_m)

    def _stop(self) -> SegmentEvent:
        memory = self.memory
        memory.halted = False
        event = self._event(SegmentEvent.STOP, memory.halt_ns, memory.left_ns, memory.halt_m)
        event.doors_opened = memory.doors
        if memory.doors:
            event.inputs.append("doors")
        memory.end_m = memory.halt_m
        return event

    def _event(
        self, kind: SegmentEvent.Kind, start_ns: int, end_ns: int, at_m: float
    ) -> SegmentEvent:
        wheeled = self._motion.wheeled
        return SegmentEvent(
            kind=kind,
            start_ns=start_ns,
            end_ns=end_ns,
            start_m=at_m,
            end_m=at_m,
            distance_m=at_m - self.memory.end_m,
            distance_std_m=self._distance_std_m(),
            probability=0.999 if wheeled else 0.99,
            stop_std_s=WHEEL_STD_S if wheeled else JOLT_STD_S,
            inputs=self._inputs(),
        )

    def _turns(self, epoch: Epoch) -> list[SegmentEvent]:
        if not epoch.turned:
            return []
        motion, turn, memory = self._motion, self._motion.turn, self.memory
        angle = float(turn[Turn.ANGLE])
        way = float(turn[Turn.END_M] - turn[Turn.BEGIN_M])
        lasted_s = float(turn[Turn.END_S] - turn[Turn.BEGIN_S])
        if abs(angle) < self._least_turn_rad or way <= 0.0:
            return []
        gyro, bias = motion.gyro_noise, motion.std(Ix.GYRO_Z)
        std = math.sqrt(
            ANGLE_STD_RAD**2
            + (ANGLE_PART * angle) ** 2
            + gyro * gyro * lasted_s
            + (bias * lasted_s) ** 2
        )
        radius = way / abs(angle)
        speed = max(way / max(lasted_s, 0.1), 0.5)
        scale = motion.scale_std if motion.wheeled else motion.std(Ix.SPEED) / speed
        start_m = float(turn[Turn.BEGIN_M])
        event = SegmentEvent(
            kind=SegmentEvent.TURN,
            start_ns=motion.stamp_of(float(turn[Turn.BEGIN_S])),
            end_ns=motion.stamp_of(float(turn[Turn.END_S])),
            start_m=start_m,
            end_m=float(turn[Turn.END_M]),
            distance_m=start_m - memory.end_m,
            distance_std_m=self._distance_std_m(),
            angle_rad=angle,
            angle_std_rad=std,
            radius_m=radius,
            radius_std_m=radius * math.hypot(std / angle, scale),
            probability=math.erf(abs(angle) / (math.sqrt(2.0) * 2.0 * std)),
            backwards=motion.backwards,
            inputs=self._inputs(),
        )
        memory.end_m = event.end_m
        return [event]

    def _distance_std_m(self) -> float:
        grown = self._motion.std(Ix.WAY) ** 2 - self.memory.held_variance
        return math.sqrt(max(grown, 1e-4))

    def _inputs(self) -> list[str]:
        return ["inertial", "wheels"] if self._motion.wheeled else ["inertial"]

    @property
    def halted_s(self) -> float:
        """For how long it has stood; 0 where it does not."""
        memory = self.memory
        if not memory.halted or memory.left_ns:
            return 0.0
        return (self._motion.memory.stamp_ns - memory.halt_ns) / S
