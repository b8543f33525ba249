"""How the IMU lies in the vehicle, found on the run: the vertical at a stand, x in a departure.

A vehicle that stands feels gravity's answer alone: its mean over a quiet second is the vertical,
and the mean rate the gyroscopes' bias. What pushes it out of that stand, while it does not turn,
points forwards. So nothing need be known of the case, not even which side is up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tramstream.processors.segments.kernels import EPOCH_S

Array = NDArray[np.float64]

QUIET_EPOCHS = 12
QUIET_MPS2, QUIET_RADPS = 0.05, 0.006
"""Deviations of force and rate, on each axis, over these epochs."""
PUSH_MPS2 = 0.15
"""Horizontal force beside that of the stand that is a departure."""
PUSHED_MPS = 1.5
"""So much speed tells the direction."""
STRAIGHT_RADPS = 0.02
LOST_S = 8.0
"""A push that has not come to that after so long was none."""


@dataclass
class AlignmentMemory:
    """What an alignment on the run remembers."""

    ring: Array = field(default_factory=lambda: np.zeros((QUIET_EPOCHS, 6)))
    epochs: int = 0
    up: Array = field(default_factory=lambda: np.zeros(3))
    """Vertical in the case, a unit; zero while it is not known."""
    level: Array = field(default_factory=lambda: np.zeros(3))
    """Mean force of the last stand,"""
    bias: Array = field(default_factory=lambda: np.zeros(3))
    """and mean rate."""
    pushed: Array = field(default_factory=lambda: np.zeros(3))
    """Speed that the departure has given, in the case, m/s."""
    pushed_s: float = 0.0


class Found:
    """Mounting, biases and speed at the end of an alignment."""

    def __init__(self, C_vb: Array, bias_v: Array, speed_mps: float) -> None:
        self.C_vb, self.bias_v, self.speed_mps = C_vb, bias_v, speed_mps


class Alignment:
    """Takes mean rates and forces of epochs, in the case, until it knows how the case lies."""

    def __init__(self, memory: AlignmentMemory) -> None:
        self.memory = memory

    @property
    def level(self) -> bool:
        """Whether the vertical is known."""
        return bool(self.memory.up.any())

    def take(self, rate_b: Array, force_b: Array) -> Found | None:
        """Take an epoch; what was found, once it is."""
        memory = self.memory
        memory.ring[memory.epochs % QUIET_EPOCHS] = (*rate_b, *force_b)
        memory.epochs += 1
        if self._quiet():
            mean = memory.ring.mean(axis=0)
            memory.bias[:], memory.level[:] = mean[:3], mean[3:]
            memory.up[:] = mean[3:] / np.linalg.norm(mean[3:])
            memory.pushed[:] = 0.0
            memory.pushed_s = 0.0
            return None
        if not self.level:
            return None
        return self._push(rate_b - memory.bias, force_b - memory.level)

    def _quiet(self) -> bool:
        if self.memory.epochs < QUIET_EPOCHS:
            return False
        stds = self.memory.ring.std(axis=0)
        return bool(np.all(stds[:3] < QUIET_RADPS) and np.all(stds[3:] < QUIET_MPS2))

    def _push(self, rate_b: Array, force_b: Array) -> Found | None:
        memory = self.memory
        up = memory.up
        level = force_b - (force_b @ up) * up
        memory.pushed_s += EPOCH_S
        if abs(float(rate_b @ up)) > STRAIGHT_RADPS or memory.pushed_s > LOST_S:
            memory.pushed[:] = 0.0  # a curve, or no departure: wait for the next stand
            memory.pushed_s = LOST_S + 1.0
            return None
        if float(np.linalg.norm(level)) > PUSH_MPS2:
            memory.pushed += EPOCH_S * level
        speed = float(np.linalg.norm(memory.pushed))
        if speed < PUSHED_MPS:
            return None
        forward = memory.pushed / speed
        C_vb = np.stack([forward, np.cross(up, forward), up])
        return Found(C_vb, C_vb @ memory.bias, speed)


def tilt_rad(C_vb: Array, force_b: Array) -> float:
    """Angle between z of the vehicle, as mounted, and the force that is felt."""
    z = float((C_vb @ force_b)[2]) / max(float(np.linalg.norm(force_b)), 1e-9)
    return math.acos(min(max(z, -1.0), 1.0))
