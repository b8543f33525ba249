"""What every localisation filter gives and takes, whatever its states.

The processor (`processors/ekf.py`) owns keys, messages and numbering; a model owns its states. Both
models of this house, `tram` and `kaspar2023`, keep this contract, and so can another.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tramstream.geodesy import LocalLevel
from tramstream.processor import State
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame

Array = NDArray[np.float64]
Mode = MotionState.Mode


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


@dataclass(frozen=True, slots=True)
class Estimate:
    """The vehicle's motion at one instant.

    Position is that of the vehicle's origin in `level`; roll, pitch and yaw are those of theory.md
    section 1 against that same frame.
    """

    stamp_ns: int
    mode: Mode
    p_l: tuple[float, float, float]
    speed_mps: float
    acceleration_mps2: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    yaw_rate_radps: float
    standing: bool
    covariance: Array
    """Of east, north, up, speed, roll, pitch, yaw; shape (7, 7)."""
    verdicts: list[Verdict] = field(default_factory=list)


class Localiser(Protocol):
    """A localisation filter behind the processor."""

    name: str
    """As in the configuration, `ekf.model`."""

    @property
    def level(self) -> LocalLevel | None:
        """Frame `l` of its estimates; None before the first usable fix."""

    def take(self, frame: SyncFrame) -> Estimate | None:
        """Go to the frame's stamp with all that is in it; None while nothing is known."""

    def ahead(self, mean: ImuMean) -> Estimate | None:
        """Predict from the last frame to a newer inertial mean; they come in order, all of them."""

    def learned(self) -> list[Learned]:
        """Biases, scales, offsets as they stand."""

    def complaints(self) -> list[str]:
        """Sentences about bad input since the last call, for health."""

    def snapshot(self) -> State:
        """Memory as plain data that shares nothing with the filter."""

    def restore(self, state: State) -> None:
        """Go on from `state`."""
