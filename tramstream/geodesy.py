"""WGS84: geodetic, Earth-fixed and local level coordinates, and normal gravity.

Rows of geodetic coordinates are (latitude, longitude, ellipsoidal height) in rad, rad, m. Rows may
be one, shape (3,), or many, shape (n, 3), time first; the answer has the shape of the question.

References
----------
NIMA TR8350.2, Department of Defense World Geodetic System 1984, third edition, chapters 3 and 4.
IOGP Publication 373-7-2 (EPSG Guidance Note 7-2), methods 9602, 9836 and 9837.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SEMI_MAJOR_M = 6378137.0
FLATTENING = 1 / 298.257223563
SEMI_MINOR_M = SEMI_MAJOR_M * (1 - FLATTENING)
E2 = FLATTENING * (2 - FLATTENING)
"""First eccentricity, squared."""
SECOND_E2 = E2 / (1 - E2)

GRAVITY_EQUATOR_MPS2 = 9.7803253359
SOMIGLIANA_K = 0.00193185265241
GRAVITY_M = 0.00344978650684
"""ω²a²b / GM: centrifugal to gravitational acceleration at the equator."""

PRAGUE_GEOID_M = 44.5
"""Height of the geoid (EGM96) above the ellipsoid in Prague, rounded."""
_BOWRING_STEPS = 3
"""Below 1e-12 rad from 10 km under the ellipsoid to far beyond any tram."""


def ecef_from_geodetic(geodetic: ArrayLike) -> Array:
    """Turn geodetic rows into Earth-fixed ones (EPSG method 9602).

    Parameters
    ----------
    geodetic : array_like, shape (3,) or (n, 3)
        Latitude, longitude, ellipsoidal height; rad, rad, m.

    Returns
    -------
    p_e : ndarray, same shape
        Earth-fixed position, m.
    """
    latitude, longitude, height = np.moveaxis(np.asarray(geodetic, dtype=float), -1, 0)
    normal = _prime_vertical_m(latitude)
    radius = (normal + height) * np.cos(latitude)
    return np.stack(
        [
            radius * np.cos(longitude),
            radius * np.sin(longitude),
            (normal * (1 - E2) + height) * np.sin(latitude),
        ],
        axis=-1,
    )


def geodetic_from_ecef(p_e: ArrayLike) -> Array:
    """Turn Earth-fixed rows into geodetic ones; the poles included, the Earth's centre not.

    Bowring's iteration on the parametric latitude.

    Parameters
    ----------
    p_e : array_like, shape (3,) or (n, 3)
        Earth-fixed position, m.

    Returns
    -------
    geodetic : ndarray, same shape
        Latitude, longitude, ellipsoidal height; rad, rad, m.

    References
    ----------
    B. R. Bowring, "Transformation from spatial to geographical coordinates", Survey Review 23
    (1976) 323-327; the height as in "The accuracy of geodetic latitude and height equations",
    Survey Review 28 (1985) 202-206, eq. 7.
    """
    x, y, z = np.moveaxis(np.asarray(p_e, dtype=float), -1, 0)
    radius = np.hypot(x, y)
    parametric = np.arctan2(z, radius * (1 - FLATTENING))
    latitude = parametric
    for _ in range(_BOWRING_STEPS):
        latitude = np.arctan2(
            z + SECOND_E2 * SEMI_MINOR_M * np.sin(parametric) ** 3,
            radius - E2 * SEMI_MAJOR_M * np.cos(parametric) ** 3,
        )
        parametric = np.arctan2((1 - FLATTENING) * np.sin(latitude), np.cos(latitude))
    height = (
        radius * np.cos(latitude)
        + z * np.sin(latitude)
        - SEMI_MAJOR_M * np.sqrt(1 - E2 * np.sin(latitude) ** 2)
    )
    return np.stack([latitude, np.arctan2(y, x), height], axis=-1)


def normal_gravity_mps2(latitude_rad: ArrayLike, height_m: ArrayLike) -> Array:
    """Give normal gravity at latitude and ellipsoidal height (Somigliana, second order in height).

    References
    ----------
    NIMA TR8350.2, third edition, eqs. 4-1 and 4-3.
    """
    sin2 = np.sin(np.asarray(latitude_rad, dtype=float)) ** 2
    ratio = np.asarray(height_m, dtype=float) / SEMI_MAJOR_M
    surface = GRAVITY_EQUATOR_MPS2 * (1 + SOMIGLIANA_K * sin2) / np.sqrt(1 - E2 * sin2)
    linear = 1 + FLATTENING + GRAVITY_M - 2 * FLATTENING * sin2
    gravity: Array = surface * (1 - 2 * linear * ratio + 3 * ratio**2)
    return gravity


def _prime_vertical_m(latitude_rad: Array) -> Array:
    """Radius of curvature in the prime vertical."""
    radius: Array = SEMI_MAJOR_M / np.sqrt(1 - E2 * np.sin(latitude_rad) ** 2)
    return radius


@dataclass(frozen=True)
class LocalLevel:
    """The local level frame `l` at an origin: east, north, up of the tangent plane.

    Parameters
    ----------
    latitude_rad, longitude_rad, height_m : float
        The origin.
    """

    latitude_rad: float
    longitude_rad: float
    height_m: float
    C_le: Array = field(init=False, repr=False, compare=False)
    """Turn of Earth-fixed components into east, north, up of the origin, shape (3, 3)."""
    origin_e: Array = field(init=False, repr=False, compare=False)
    """The origin, Earth-fixed, m."""
    _numbers: tuple[list[list[float]], list[float]] = field(init=False, repr=False, compare=False)
    """The two once more, as `place` needs them."""

    def __post_init__(self) -> None:
        sin_lat, cos_lat = np.sin(self.latitude_rad), np.cos(self.latitude_rad)
        sin_lon, cos_lon = np.sin(self.longitude_rad), np.cos(self.longitude_rad)
        C_le = np.array(
            [
                [-sin_lon, cos_lon, 0.0],
                [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
                [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
            ]
        )
        origin_e = ecef_from_geodetic([self.latitude_rad, self.longitude_rad, self.height_m])
        for array in (C_le, origin_e):
            array.flags.writeable = False
        object.__setattr__(self, "C_le", C_le)
        object.__setattr__(self, "origin_e", origin_e)
        object.__setattr__(self, "_numbers", (C_le.tolist(), origin_e.tolist()))

    @classmethod
    def at_deg(cls, latitude_deg: float, longitude_deg: float, height_m: float) -> LocalLevel:
        """Lay the origin where people write it, in degrees."""
        return cls(float(np.radians(latitude_deg)), float(np.radians(longitude_deg)), height_m)

    def from_geodetic(self, geodetic: ArrayLike) -> Array:
        """Local level position of geodetic rows, m (EPSG method 9837)."""
        p_l: Array = (ecef_from_geodetic(geodetic) - self.origin_e) @ self.C_le.T
        return p_l

    def place(
        self, latitude_rad: float, longitude_rad: float, height_m: float
    ) -> tuple[float, float, float]:
        """Local level position of one place, m: `from_geodetic` without an array for each step."""
        sin, cos = math.sin(latitude_rad), math.cos(latitude_rad)
        normal = SEMI_MAJOR_M / math.sqrt(1.0 - E2 * sin * sin)
        radius = (normal + height_m) * cos
        ((ex, ey, ez), (nx, ny, nz), (ux, uy, uz)), origin = self._numbers
        x = radius * math.cos(longitude_rad) - origin[0]
        y = radius * math.sin(longitude_rad) - origin[1]
        z = (normal * (1.0 - E2) + height_m) * sin - origin[2]
        return (
            ex * x + ey * y + ez * z,
            nx * x + ny * y + nz * z,
            ux * x + uy * y + uz * z,
        )

    def to_geodetic(self, p_l: ArrayLike) -> Array:
        """Geodetic rows of local level positions; rad, rad, m."""
        return geodetic_from_ecef(np.asarray(p_l, dtype=float) @ self.C_le + self.origin_e)

    def up_l(self, p_l: ArrayLike) -> Array:
        """Direction of the place's up at local level positions, in `l`.

        It is that of the ellipsoid with the shape of WGS84 through the place, 1e-7 rad off for each
        200 m of height.
        """
        p_e = np.asarray(p_l, dtype=float) @ self.C_le + self.origin_e
        up_e = p_e / (SEMI_MAJOR_M**2, SEMI_MAJOR_M**2, SEMI_MINOR_M**2)
        up: Array = up_e / np.linalg.norm(up_e, axis=-1, keepdims=True) @ self.C_le.T
        return up


def convergence_rad(level: LocalLevel, longitude_rad: ArrayLike) -> Array:
    """Angle by which yaw in `level` is more than yaw against east of a place at a longitude.

    The direction of the place's east in `level`; it depends on the longitude alone.
    """
    off = np.asarray(longitude_rad, dtype=float) - level.longitude_rad
    angle: Array = np.arctan2(np.sin(level.latitude_rad) * np.sin(off), np.cos(off))
    return angle


def C_nl(level: LocalLevel, geodetic: ArrayLike) -> Array:
    """Turn of components in `level` into east, north and up of places; shape (3, 3) or (n, 3, 3).

    Its last row is the direction of each place's up in `level`.
    """
    latitude, longitude, _ = np.moveaxis(np.asarray(geodetic, dtype=float), -1, 0)
    turn: Array = _C_ne(latitude, longitude) @ level.C_le.T
    return turn


def _C_ne(latitude_rad: Array, longitude_rad: Array) -> Array:
    """Turn of Earth-fixed components into east, north and up of places."""
    sin_lat, cos_lat = np.sin(latitude_rad), np.cos(latitude_rad)
    sin_lon, cos_lon = np.sin(longitude_rad), np.cos(longitude_rad)
    rows = [
        [-sin_lon, cos_lon, np.zeros_like(sin_lon)],
        [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
        [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
