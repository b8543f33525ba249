"""Springs under a body: how it nods and leans under forces, in closed form.

Pitch and roll of the body against its bogies are those of oscillators ẍ + 2ζω ẋ + ω² x = ω² u,
driven by the angle u that a force holds in the end. The force is taken at `NODES_HZ` and runs
straight between; for that input the response is a closed form, and so value, rate and acceleration
agree exactly at every instant.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

NODES_HZ = 100.0
"""Of the force that springs feel: a hundred times their own frequency."""


class Oscillator:
    """Response to a force that runs straight between nodes, in the steady state at the first.

    With s = ω(−ζ + i√(1 − ζ²)) the one complex ż = s z + u has x = ω/√(1 − ζ²) Im z.
    """

    def __init__(self, force: Array, frequency_hz: float, damping: float) -> None:
        omega = math.tau * frequency_hz
        root = math.sqrt(1 - damping**2)
        self._s = s = omega * complex(-damping, root)
        self._scale = omega / root
        self._force = force
        step_s = 1 / NODES_HZ
        fade = np.exp(s * step_s)
        late = (fade - 1 - s * step_s) / (s**2 * step_s)  # of the node's force that comes
        early = (fade - 1) / s - late
        start = -force[0] / s
        driven = early * force[:-1] + late * force[1:]
        followed, _ = lfilter([1.0], [1.0, -fade], driven, zi=np.array([fade * start]))
        self._z = np.concatenate([[start], followed])

    def at(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Value and two derivatives."""
        node = np.clip((time_s * NODES_HZ).astype(np.int64), 0, len(self._z) - 2)
        past = time_s - node / NODES_HZ
        u, rise = self._force[node], (self._force[node + 1] - self._force[node]) * NODES_HZ
        s = self._s
        fade = np.exp(s * past)
        z = fade * self._z[node] + u * (fade - 1) / s + rise * (fade - 1 - s * past) / s**2
        first = s * z + u + rise * past
        second = s * first + rise
        return (self._scale * z.imag, self._scale * first.imag, self._scale * second.imag)


class Springs(NamedTuple):
    """Of one part."""

    nod: Oscillator
    """Pitch."""
    lean: Oscillator
    """Roll."""
