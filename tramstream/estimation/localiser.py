"""What every localisation filter gives and takes, whatever its states.

The processor (`processors/localisation/processor.py`) owns keys, messages and numbering; a model
owns its states. Both models of this house, `tram` and `kaspar2023`, keep this contract, and so can
another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tramstream.estimation.track import LocalTrack
from tramstream.events.kinds import Event
from tramstream.geodesy import LocalLevel
from tramstream.processor import State
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame

Array = NDArray[np.float64]
STARTING, HEADING_UNKNOWN, TRACKING, DEAD_RECKONING = range(4)
"""`MotionState.Mode` as plain numbers: looking one up by name there costs as much as a kernel."""


class Verdict(NamedTuple):
    """One scalar measurement as the filter saw it: conditional on those of the frame before it."""

    measurement: str
    innovation: float
    variance: float
    accepted: bool


class Learned(NamedTuple):
    """One slowly changing quantity and how well it is known."""

    name: str
    value: float
    std: float
    unit: str


ACCELERATION, YAW_RATE, LEVEL_ERROR, LEVEL_STD, COVARIANCE = 7, 8, 9, 10, 11
"""Where they begin in the values of an estimate, behind the motion."""
VALUES = COVARIANCE + 49


@dataclass(slots=True)
class Estimate:
    """The vehicle's motion at one instant; nobody changes it.

    Position is that of the vehicle's origin in `level`; roll, pitch and yaw are those of
    docs/theory.md, section 1.2 against that same frame.
    """

    stamp_ns: int
    mode: int
    """One of `MotionState.Mode`."""
    values: Array
    """All that follows in one array, shape (VALUES,): compiled code takes it as a whole."""
    standing: bool
    verdicts: list[Verdict] = field(default_factory=list)

    @property
    def motion(self) -> Array:
        """East, north, up, speed along x, roll, pitch, yaw; m, m/s, rad; shape (7,)."""
        return self.values[:ACCELERATION]

    @property
    def covariance(self) -> Array:
        """Of `motion`, shape (7, 7)."""
        return self.values[COVARIANCE:].reshape(7, 7)

    @property
    def acceleration_mps2(self) -> float:
        return float(self.values[ACCELERATION])

    @property
    def yaw_rate_radps(self) -> float:
        return float(self.values[YAW_RATE])

    @property
    def level_error_rad(self) -> float:
        """By which the pitch lies under what the accelerometer shows; NaN: there is none."""
        return float(self.values[LEVEL_ERROR])

    @property
    def p_l(self) -> tuple[float, float, float]:
        east, north, up = self.motion[:3].tolist()
        return east, north, up

    @property
    def speed_mps(self) -> float:
        return float(self.motion[3])

    @property
    def roll_rad(self) -> float:
        return float(self.motion[4])

    @property
    def pitch_rad(self) -> float:
        return float(self.motion[5])

    @property
    def yaw_rad(self) -> float:
        return math.remainder(float(self.motion[6]), math.tau)


def values_of(
    motion: ArrayLike, covariance: Array, acceleration_mps2: float, yaw_rate_radps: float
) -> Array:
    """Values of an estimate out of what they consist of, of a localiser without a level."""
    values = np.empty(VALUES)
    values[:ACCELERATION] = motion
    values[ACCELERATION], values[YAW_RATE] = acceleration_mps2, yaw_rate_radps
    values[LEVEL_ERROR:COVARIANCE] = math.nan
    values[COVARIANCE:] = covariance.ravel()
    return values


class Localiser(Protocol):
    """A localisation filter behind the processor."""

    name: str
    """As in the configuration, `ekf.model`."""

    @property
    def level(self) -> LocalLevel | None:
        """Frame `l` of its estimates; None before the first usable fix."""

    def take(self, frame: SyncFrame) -> Estimate | None:
        """Go to the frame's stamp with all that is in it; None while nothing is known."""

    def see(self, mean: ImuMean) -> None:
        """Take an inertial mean that is newer than the last frame; they come in order."""

    def follow(self, track: LocalTrack) -> bool:
        """Take that the vehicle was on a track a moment ago; False if that cannot be used."""

    def ahead(self) -> Estimate | None:
        """Predict from the last frame to the newest mean that was seen."""

    def learned(self) -> list[Learned]:
        """Biases, scales, offsets as they stand."""

    def complaints(self) -> list[Event]:
        """What was wrong with its input since the last call, for health."""

    def snapshot(self) -> State:
        """Memory as plain data that shares nothing with the filter."""

    def restore(self, state: State) -> None:
        """Go on from `state`."""
