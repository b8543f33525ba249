"""States and constants of the model `tram`, each with its one name.

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
    GNSS_EAST = 15  # error of the fixes, m
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
    Ix.SCALE_A: "1",
    Ix.SCALE_B: "1",
    Ix.GNSS_DELAY: "s",
    Ix.WHEEL_DELAY: "s",
    Ix.PIVOT: "m",
}
"""The slowly changing states, and their units."""


class Pm(IntEnum):
    """Slots of the model's parameters; SI."""

    GRAVITY = 0
    CURVATURE = 1  # of the Earth, 1/m
    IMU_X = 2  # the case from the vehicle's origin
    IMU_Y = 3
    IMU_Z = 4
    ANTENNA_X = 5
    ANTENNA_Y = 6
    ANTENNA_Z = 7
    OFFSET_A = 8  # wheel A to the left of the vehicle's axis
    OFFSET_B = 9
    SIGN_A = 10  # −1 when the wheel counts up while the vehicle runs backwards
    SIGN_B = 11
    ACCEL_DENSITY = 12  # N² of the accelerometer along x, (m/s²)²/Hz
    ROLL_DENSITY = 13  # N² of the gyroscopes, (rad/s)²/Hz
    PITCH_DENSITY = 14
    YAW_DENSITY = 15
    GYRO_WALK = 16  # K² of their biases
    ACCEL_WALK = 17
    SLIP_DENSITY = 18  # creep of a wheel: variance of its path a metre, m
    SCALE_WALK = 19  # variance of a wheel's scale a metre, 1/m
    GNSS_DECAY = 20  # 1/τ of the fixes' error; 0 while standing
    GNSS_DENSITY = 21  # driving noise of that error, horizontal, m²/s
    GNSS_UP_DENSITY = 22
    LATERAL_VARIANCE = 23  # of a lateral specific force, (m/s²)²
    STANDING_VARIANCE = 24  # of the speed of a vehicle that stands, (m/s)²
    STILL_ROLL_VARIANCE = 25  # of a rate reading of a vehicle that stands, (rad/s)²
    STILL_PITCH_VARIANCE = 26
    STILL_YAW_VARIANCE = 27
    READING_VARIANCE = 29  # of one rate reading, (rad/s)²
    SIDE_DENSITY = 30  # of the pivot's slip to the side, m²/s
    HEAVE_DENSITY = 31  # of its heaving, m²/s
    CLOCK_SHARE = 32  # part of the fixes' delay by which the inertial stamps are too early
    HEAVE_VARIANCE = 34  # of w = 0 at one reading, (m/s)²
    VERTICAL_DENSITY = 33  # noise of the vertical force, (m/s²)²/Hz; 0: it is not used
    STILL_FORCE_VARIANCE = 28  # of a specific force of a vehicle that stands, (m/s²)²


PARAMETERS = len(Pm)

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
    (Ix.UP, Ix.HEAVE),
    (Ix.HEAVE, Ix.ROLL),
    (Ix.HEAVE, Ix.PITCH),
    (Ix.HEAVE, Ix.GYRO_Y),
    (Ix.HEAVE, Ix.ACCEL_Z),
)
"""Where A of the transition F = I + A has entries, in the order in which `predict` fills them."""

ROWS = np.array([int(row) for row, _ in ENTRIES])
COLUMNS = np.array([int(column) for _, column in ENTRIES])
