"""States of the model `tram`, each with its one name, and which of them move which.

Angles are those of docs/theory.md, section 1.2 and their errors add: x_true = x + δx, the attitude
error too, for a tram never stands on its nose. All axes are the vehicle's (frame v) unless said
otherwise; inertial readings are turned into v by the configured mounting before they come here, and
three small angles remain to be found.

Left out because nothing observes them, or another state does the same: constant bias and random
walk of one axis side by side (one state for their sum); the Earth's rotation, an eighth of the
walk of the gyroscopes' bias within a minute. HEAVE and ACCEL_Z rest at 0 unless the vertical force
is used.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from tramstream.estimation.kalman import Pattern


class Ix(IntEnum):
    """Slots of the state vector."""

    EAST = 0  # of the pivot in l, m
    NORTH = 1
    UP = 2
    SPEED = 3  # along x, negative backwards, m/s
    ROLL = 4  # rad
    PITCH = 5
    YAW = 6
    GYRO_X = 7  # biases, rad/s
    GYRO_Y = 8
    GYRO_Z = 9
    ACCEL_X = 10  # biases, m/s²
    ACCEL_Y = 11
    MOUNT_ROLL = 12  # what the configured mounting leaves, rad
    MOUNT_YAW = 13
    GYRO_SCALE = 14  # of the vertical gyroscope
    GNSS_EAST = 15  # error of the fixes that lasts `gnss.error_tau_s`, m
    GNSS_NORTH = 16
    GNSS_UP = 17
    SCALE_A = 18  # of the wheels: they count 1 + scale too much
    SCALE_B = 19
    PATH_A = 20  # of the wheels since the last reading, as they count, m
    PATH_B = 21
    GNSS_DELAY = 22  # by which stamps are too late, s
    WHEEL_DELAY = 23
    PIVOT = 24  # the vehicle's origin before the point that does not slip sideways, m
    MOUNT_PITCH = 25
    HEAVE = 26  # speed along z, where the vertical force is used, m/s
    ACCEL_Z = 27  # bias, m/s²
    GNSS_SLOW_EAST = 28  # error of the fixes that lasts for many minutes, m
    GNSS_SLOW_NORTH = 29
    MAP_EAST = 30  # of the rails from the map, for kilometres, where there is a map, m
    MAP_NORTH = 31


SIZE = len(Ix)
MOTION = slice(int(Ix.EAST), int(Ix.YAW) + 1)
"""What is published with its covariance."""

UNITS = {
    Ix.GYRO_X: "rad/s",
    Ix.GYRO_Y: "rad/s",
    Ix.GYRO_Z: "rad/s",
    Ix.ACCEL_X: "m/s²",
    Ix.ACCEL_Y: "m/s²",
    Ix.MOUNT_ROLL: "rad",
    Ix.MOUNT_PITCH: "rad",
    Ix.MOUNT_YAW: "rad",
    Ix.GYRO_SCALE: "1",
    Ix.GNSS_EAST: "m",
    Ix.GNSS_NORTH: "m",
    Ix.GNSS_UP: "m",
    Ix.GNSS_SLOW_EAST: "m",
    Ix.GNSS_SLOW_NORTH: "m",
    Ix.MAP_EAST: "m",
    Ix.MAP_NORTH: "m",
    Ix.SCALE_A: "1",
    Ix.SCALE_B: "1",
    Ix.GNSS_DELAY: "s",
    Ix.WHEEL_DELAY: "s",
    Ix.PIVOT: "m",
}
"""The slowly changing states, and their units."""


_ANGLES = (Ix.ROLL, Ix.PITCH, Ix.YAW)
_PATHS = ((Ix.PATH_A, Ix.SCALE_A), (Ix.PATH_B, Ix.SCALE_B))
ENTRIES: tuple[tuple[Ix, Ix], ...] = (
    (Ix.EAST, Ix.SPEED),
    (Ix.EAST, Ix.PITCH),
    (Ix.EAST, Ix.YAW),
    (Ix.NORTH, Ix.SPEED),
    (Ix.NORTH, Ix.PITCH),
    (Ix.NORTH, Ix.YAW),
    (Ix.UP, Ix.SPEED),
    (Ix.UP, Ix.PITCH),
    (Ix.SPEED, Ix.PITCH),
    (Ix.SPEED, Ix.ACCEL_X),
    (Ix.SPEED, Ix.MOUNT_YAW),
    (Ix.SPEED, Ix.MOUNT_PITCH),
    (Ix.SPEED, Ix.PIVOT),
    (Ix.ROLL, Ix.ROLL),
    (Ix.ROLL, Ix.PITCH),
    (Ix.PITCH, Ix.ROLL),
    (Ix.YAW, Ix.ROLL),
    (Ix.YAW, Ix.PITCH),
    *(
        (angle, column)
        for angle in _ANGLES
        for column in (
            Ix.GYRO_X,
            Ix.GYRO_Y,
            Ix.GYRO_Z,
            Ix.MOUNT_ROLL,
            Ix.MOUNT_YAW,
            Ix.MOUNT_PITCH,
            Ix.GYRO_SCALE,
        )
        if (angle, column) not in ((Ix.PITCH, Ix.GYRO_X), (Ix.YAW, Ix.GYRO_X))
    ),
    *(
        (path, column)
        for path, scale in _PATHS
        for column in (
            Ix.SPEED,
            scale,
            Ix.GYRO_Z,
            Ix.GYRO_SCALE,
            Ix.MOUNT_ROLL,
            Ix.MOUNT_PITCH,
        )
    ),
    (Ix.GNSS_EAST, Ix.GNSS_EAST),
    (Ix.GNSS_NORTH, Ix.GNSS_NORTH),
    (Ix.GNSS_UP, Ix.GNSS_UP),
    (Ix.GNSS_SLOW_EAST, Ix.GNSS_SLOW_EAST),
    (Ix.GNSS_SLOW_NORTH, Ix.GNSS_SLOW_NORTH),
    (Ix.UP, Ix.HEAVE),
    (Ix.HEAVE, Ix.ROLL),
    (Ix.HEAVE, Ix.PITCH),
    (Ix.HEAVE, Ix.GYRO_Y),
    (Ix.HEAVE, Ix.ACCEL_Z),
)
"""Where A of the transition F = I + A has entries; those of HEAVE come last."""

ROWS = np.array([int(row) for row, _ in ENTRIES])
COLUMNS = np.array([int(column) for _, column in ENTRIES])
PATTERN = Pattern.of(ROWS, COLUMNS)
ENTRY_COUNT = len(ENTRIES)
WITHOUT_HEAVE = sum(Ix.HEAVE not in (row, column) for row, column in ENTRIES)
"""Entries of A that are not always 0 where the vertical force is not used."""
