"""A ride as the aligner takes it: means of inertial samples between nodes; fixes, wheels at nodes.

Nodes are `dt_s` apart (a tenth of a second). What was measured between two nodes is one mean of
specific force and angular rate; that is all that the smoother knows of 2000 samples a second.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

NODE_S = 0.1
"""Between nodes. A tram's attitude turns by less than 0.05 rad in it, and its force changes by less
than 0.1 m/s²: the mean in the middle is good to 1e-5 m/s a step."""


class Inertial(NamedTuple):
    """Means from each node to the next one; the last row is of no use."""

    f_b: Array
    """(n, 3), m/s²."""
    omega_b: Array
    """(n, 3), rad/s."""


class Fixes(NamedTuple):
    """What the receiver said, one row a fix, in the order of time."""

    node: NDArray[np.int64]
    """The nearest node."""
    late_s: Array
    """How much later than that node the fix describes the antenna."""
    p_l: Array
    """(m, 3), m; NaN where it is not told."""
    p_std_m: Array
    """(m, 3)."""
    vel_l: Array
    """(m, 3), m/s; NaN where it is not told."""
    vel_std_mps: Array
    """(m, 3)."""


class Drive(NamedTuple):
    """One ride."""

    dt_s: float
    start_ns: int
    """Vehicle clock at the first node."""
    inertial: Inertial
    fixes: Fixes
    wheel_mps: Array
    """(n,): speed of the wheels at each node, mean of all; NaN where there is none."""
    wheel_std_mps: float
    standing: Flags
    """(n,)."""
    up_l: Array
    """(n, 3): direction of the place's up."""
    gravity_mps2: float

    @property
    def length(self) -> int:
        return len(self.standing)

    @property
    def duration_s(self) -> float:
        return (self.length - 1) * self.dt_s

    def cut(self, first: int, end: int) -> Drive:
        """The nodes first ≤ k < end, and what was measured between them."""
        inside = (self.fixes.node >= first) & (self.fixes.node < end)
        fixes = Fixes(
            self.fixes.node[inside] - first,
            self.fixes.late_s[inside],
            self.fixes.p_l[inside],
            self.fixes.p_std_m[inside],
            self.fixes.vel_l[inside],
            self.fixes.vel_std_mps[inside],
        )
        return self._replace(
            start_ns=self.start_ns + round(first * self.dt_s * 1e9),
            inertial=Inertial(*(each[first:end] for each in self.inertial)),
            fixes=fixes,
            wheel_mps=self.wheel_mps[first:end],
            standing=self.standing[first:end],
            up_l=self.up_l[first:end],
        )


def no_fixes() -> Fixes:
    """Of a ride without a receiver."""
    three = np.zeros((0, 3))
    return Fixes(np.zeros(0, np.int64), np.zeros(0), three, three, three, three)
