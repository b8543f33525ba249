"""What a measurement is to the filter `tram`, and the limits of its innovation gate.

A measurement is a value: z, R and the gate. Its module holds h(x) (`expected`), H by the names of
the states (`jacobian`), and the compiled call that takes it (`take`). It knows no filter; the
filter knows none of them (`TramFilter.apply`).
"""

from __future__ import annotations

from typing import Protocol

from tramstream.estimation.kalman import Array

PAIR_GATE = 30.0
"""Squared Mahalanobis distance beyond which a fix or a velocity is refused: 3e-7 of honest ones."""
PAIR_KNEE = 9.0
"""Squared Mahalanobis distance from which on a fix is weighted down: 1 % of honest ones."""
SCALAR_GATE = 25.0
"""Squared normalised innovation beyond which a scalar is refused: 5 σ."""
EVERY, REFUSED, NONE = range(3)
"""Of which innovations a verdict is published: every one, those that the gate refused, none."""


class Measurement(Protocol):
    """A value that the filter can apply."""

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each scalar, as it is published."""

    @property
    def verdicts(self) -> int:
        """One of `EVERY`, `REFUSED`, `NONE`."""

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        """Update state and covariance; leaves y, S, R, H and K in the memory."""
