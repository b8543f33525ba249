"""A `GradeState` out of its numbers and its words, as the bytes that it has on the wire.

Setting twenty fields one by one takes longer than the filter's step. The kernel writes the numbers
where they belong (`tramstream/estimation/encode.py`); the words hardly ever change.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from tramstream.estimation import encode
from tramstream.proto.estimate_pb2 import GradeState

FIELDS = (
    "grade_rad",
    "grade_std_rad",
    "body_pitch_rad",
    "body_pitch_std_rad",
    "speed_mps",
    "chainage_m",
    "probability",
    "mass_kg",
    "mass_std_kg",
    "rolling_resistance",
    "rolling_resistance_std",
)


class Of(IntEnum):
    """Where each number stands; the first of them are `FIELDS`."""

    SLOPE = 0
    SLOPE_STD = 1
    NOD = 2
    NOD_STD = 3
    SPEED = 4
    CHAINAGE = 5
    PROBABILITY = 6
    MASS = 7
    MASS_STD = 8
    ROLLING = 9
    ROLLING_STD = 10
    BEND = 11
    VARIANCE = 12


NUMBERS = len(Of)
EMPTY, PLACES = encode.doubles(GradeState, dict.fromkeys(FIELDS, 1))
UNFORCED_BYTES = int(PLACES[Of.MASS]) - 1
"""Before the tag of the first number that there is where the motor force is."""


class Said:
    """Makes the messages of one processor."""

    def __init__(self) -> None:
        self.numbers = np.zeros(NUMBERS)
        self.encoded = EMPTY.copy()
        """Of `numbers`, by a kernel."""
        self._unforced = self.encoded[:UNFORCED_BYTES]
        self._of: tuple[str, int, tuple[str, ...]] | None = None
        self._words = b""

    def message(self, forced: bool, edge: str, run: int, inputs: tuple[str, ...]) -> GradeState:
        """Give the message of the numbers; with mass and resistance where there is a force."""
        of = edge, run, inputs
        if of != self._of:
            words = GradeState(edge=edge, run=run, inputs=inputs)
            self._of, self._words = of, words.SerializeToString()
        numbers = self.encoded if forced else self._unforced
        return GradeState.FromString(numbers.tobytes() + self._words)
