"""What a wheel message says to the model kaspar2023: pulses since the message before.

As in the work, the count of one message is the speed at the message's instant, with nothing but
quantisation for noise. Pulses are counted over the mean interval, for stamps jitter and encoders do
not, and scaled to the nominal one. Left and right are told by the configuration or by their names;
otherwise, and where there is only one, the first wheel is taken without the turning term.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.kalman import Array
from tramstream.events.kinds import Event
from tramstream.processors.kaspar2023 import model
from tramstream.processors.kaspar2023.events import WHEELS_JUMPED
from tramstream.proto.raw_pb2 import Odometry, WheelReading

MESSAGE_S = 0.02
"""T_o: between two messages of the work's wheels, 50 Hz."""
QUANTISATION = 1.0 / 3.0
"""Variance of a count in pulses²: 1/12 of rounding; 1/3 works better (docs/theory.md, section
3.5)."""
INTERVAL_MEMORY = 0.005
"""Weight of a new interval in the mean."""
MAX_PAUSE_S = 0.5
"""The count of a longer interval says nothing about the speed at its end."""
MAX_SPEED_MPS = 30.0
"""Wheels that claim more have been reset."""
PAIR = ("left", "right")


class Reading(NamedTuple):
    """A measurement for `Kaspar2023Filter.update`."""

    names: tuple[str, ...]
    z: Array
    R: Array
    function: Callable[..., Array]
    jacobian: Callable[..., Array]
    arguments: tuple[Any, ...]


class Refused(NamedTuple):
    """Why a message was not used."""

    why: Event


@dataclass
class PairMemory:
    """The last message of a `WheelPair`."""

    pulses: dict[str, int] = field(default_factory=dict)
    """By side."""
    stamp_ns: int = 0
    interval_s: float = 0.0
    """Mean; 0 while there was none."""


class WheelPair:
    """Remembers the last message, so that the next one can be counted from it.

    Parameters
    ----------
    vehicle : tramstream.config.Vehicle
    memory : PairMemory or None
        Part of its owner's memory; one of its own by default.
    """

    def __init__(self, vehicle: Vehicle, memory: PairMemory | None = None) -> None:
        configured = vehicle.odometer.wheels if vehicle.odometer is not None else {}
        self._sides = {name: wheel.side or name for name, wheel in configured.items()}
        self._m_per_pulse = vehicle.wheels.m_per_pulse
        self._half_track_m = vehicle.wheels.track_m / 2.0
        self._speed_std_mps = vehicle.wheels.speed_std_mps
        self.memory = PairMemory() if memory is None else memory

    @property
    def pulses_per_mps(self) -> float:
        """k: pulses a message for 1 m/s."""
        return MESSAGE_S / self._m_per_pulse

    def read(self, odometry: Odometry) -> Reading | Refused | None:
        """Turn a message into a measurement; None for the first one and after a pause."""
        memory = self.memory
        chosen = self._chosen(odometry)
        if not chosen:
            return None
        if not all(wheel.HasField("pulses") for wheel in chosen.values()):
            k = self.pulses_per_mps
            counted = [wheel.speed_mps * k for wheel in chosen.values()]
            return self._reading(counted, (self._speed_std_mps * k) ** 2)
        before, interval_s = memory.pulses, (odometry.stamp_ns - memory.stamp_ns) / S
        memory.pulses = {side: wheel.pulses for side, wheel in chosen.items()}
        memory.stamp_ns = odometry.stamp_ns
        if before.keys() != memory.pulses.keys() or not 0.0 < interval_s <= MAX_PAUSE_S:
            return None
        counts = [memory.pulses[side] - before[side] for side in memory.pulses]
        longest_s = max(interval_s, MESSAGE_S)  # stamps that jitter together are no reset
        most = max(counts, key=abs)
        if abs(most) * self._m_per_pulse > MAX_SPEED_MPS * longest_s:
            facts = {"interval_s": interval_s, "limit_mps": MAX_SPEED_MPS}
            return Refused(WHEELS_JUMPED(key=keys.ODO_WHEELS.path, pulses=most, **facts))
        scale = MESSAGE_S / self._regular_s(interval_s)
        return self._reading([count * scale for count in counts], QUANTISATION * scale**2)

    def _regular_s(self, interval_s: float) -> float:
        """The interval without jitter: whole mean ones."""
        memory = self.memory
        if memory.interval_s == 0.0:
            memory.interval_s = interval_s
        messages = max(round(interval_s / memory.interval_s), 1)
        memory.interval_s += INTERVAL_MEMORY * (interval_s / messages - memory.interval_s)
        return messages * memory.interval_s

    def _chosen(self, odometry: Odometry) -> dict[str, WheelReading]:
        """Left and right, in this order, or the first wheel as the only one."""
        sides = {self._sides.get(wheel.wheel, wheel.wheel): wheel for wheel in odometry.wheels}
        if all(side in sides for side in PAIR):
            return {side: sides[side] for side in PAIR}
        return dict(list(sides.items())[:1])

    def _reading(self, counts: list[float], variance: float) -> Reading:
        z, R = np.array(counts).reshape(-1, 1), np.diag([variance] * len(counts))
        k = self.pulses_per_mps
        if len(counts) == len(PAIR):
            names = ("wheel_left", "wheel_right")
            arguments = (k, self._half_track_m)
            return Reading(names, z, R, model.wheels, model.wheels_jacobian, arguments)
        return Reading(("wheel",), z, R, model.one_wheel, model.one_wheel_jacobian, (k,))

    def forget(self) -> None:
        """Count anew from the next message."""
        self.memory.pulses = {}
