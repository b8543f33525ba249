"""How an IMU is turned in its vehicle: angles and quaternion of one and the same turn.

`C_bv` takes components of the vehicle into those of the case (docs/theory.md, section 1.2). Angles
Ψ = roll, pitch, yaw name every turn, at a pitch of ±90° in many ways; the quaternion q_bv, order
w x y z, names each in two, q and −q, and loses nothing anywhere.
"""

from __future__ import annotations

import math

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Stated = tuple[float, ...]
"""A quaternion, or nothing."""
Matrix = tuple[Triple, Triple, Triple]

UNIT_TOLERANCE = 1e-3
"""A quaternion whose size is further from 1 is a slip of the pen, not of rounding."""
SAME_RAD = math.radians(1e-3)
"""Turns that differ by less are the same, written with other digits."""


def quaternion_of(mounting_deg: Triple) -> Quaternion:
    """q_bv of roll, pitch and yaw: C_bv = R_x(−φ) R_y(−θ) R_z(−ψ)."""
    roll, pitch, yaw = (math.radians(each) / 2 for each in mounting_deg)
    x = (math.cos(roll), -math.sin(roll), 0.0, 0.0)
    y = (math.cos(pitch), 0.0, -math.sin(pitch), 0.0)
    z = (math.cos(yaw), 0.0, 0.0, -math.sin(yaw))
    return product(product(x, y), z)


def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """The turn q, then p."""
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def unit(q: Stated) -> Quaternion:
    """The same turn, of size 1.

    Raises
    ------
    ValueError
        If it is none, or its size is not nearly 1 already.
    """
    if len(q) != 4:
        raise ValueError(f"`mounting_q_bv` has {len(q)} numbers; a quaternion has 4: w x y z")
    size = math.sqrt(sum(each * each for each in q))
    if abs(size - 1.0) > UNIT_TOLERANCE:
        raise ValueError(f"`mounting_q_bv` has the size {size:.6g}; that of a turn is 1")
    w, x, y, z = (each / size for each in q)
    return (w, x, y, z)


def matrix_of(q: Quaternion) -> Matrix:
    """C_bv of a quaternion of size 1, row by row."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def angles_of(q: Quaternion) -> Triple:
    """Roll, pitch and yaw of a quaternion of size 1, °; also where pitch is ±90°."""
    C = matrix_of(q)
    pitch = math.atan2(-C[0][2], math.hypot(C[0][0], C[0][1]))
    roll = math.atan2(C[1][2], C[2][2])
    s, c = math.sin(roll), math.cos(roll)
    yaw = math.atan2(s * C[2][0] - c * C[1][0], c * C[1][1] - s * C[2][1])
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)


def between_rad(p: Quaternion, q: Quaternion) -> float:
    """Angle of the turn from one mounting to another."""
    w, x, y, z = product((p[0], -p[1], -p[2], -p[3]), q)
    return 2 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))


def check(mounting_deg: Triple, q: Stated) -> None:
    """Refuse angles and a quaternion that are different turns.

    Raises
    ------
    ValueError
        Also for a quaternion that is no turn.
    """
    if q and between_rad(quaternion_of(mounting_deg), unit(q)) > SAME_RAD:
        raise ValueError("`mounting_deg` and `mounting_q_bv` are different turns: state one")


def about_axes(std: float | tuple[float, ...]) -> Triple:
    """A deviation about each of three axes, where one number may stand for all."""
    x, y, z = std if isinstance(std, tuple) else (std, std, std)
    return x, y, z
