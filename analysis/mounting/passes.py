"""What a pass of the smoother works on, and what it leaves behind."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.mounting.drive import Drive
from tramstream.analysis.mounting.states import (
    Arms,
    Noise,
)

Array = NDArray[np.float64]


class Log(NamedTuple):
    """All scalar measurements in the order of their use, and the prediction at each node."""

    kind: NDArray[np.int64]
    node: NDArray[np.int64]
    innovation: Array
    variance: Array
    """Of the innovation."""
    H: Array
    K: Array
    x: Array
    """(n, SIZE), before the measurements of the node."""
    P: Array
    """(n, SIZE, SIZE)."""


class State(NamedTuple):
    """What a pass carries along; its arrays are written to."""

    x: Array
    P: Array
    H: Array
    """One row, used again and again."""
    used: NDArray[np.int64]
    """(1,): measurements so far."""


class Model(NamedTuple):
    """What is measured, and what is known of it."""

    drive: Drive
    noise: Noise
    arms: Arms
    force_l: Array
    """(n, 3): specific force in `l` from each node to the next, as the trajectory has it. What an
    error of attitude does to velocity is told by this and not by the reading: noise of a reading
    would count as motion, and motion is what tells yaw."""
    limit: float
    """Deviations beyond which fixes and wheels count as Huber says; 0: all count alike."""
