"""GNSS fixes for the model `tram`: what they are worth, and what to do when they do not fit.

Neighbouring fixes share their error (multipath, atmosphere), so it has states of its own, and the
receiver's accuracy is its least size. Standing, the surroundings stand still too: the error then
only walks, and a drift of the fixes does not move the vehicle. A fix that jumps is refused; if the
jump stays, the error has jumped, not the vehicle; and if the error stays absurd over a good way,
the vehicle was thought to be elsewhere and is taken where the fixes are.
"""

from __future__ import annotations

import math
from typing import Any

from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.geodesy import LocalLevel
from tramstream.localisation import Verdict
from tramstream.processors.tram_filter import TramFilter
from tramstream.processors.tram_states import Ix, Pm
from tramstream.proto.gnss_pb2 import GnssFix

UNSTATED_STD_M = 5.0
"""Of a fix whose receiver says nothing of its accuracy."""
WHITE_SHARE = 0.1
"""Part of the deviation that neighbouring fixes do not share."""
WHITE_FLOOR_M = 0.01
"""Noise of a carrier-phase fix, which neighbours do not share."""
NEW_REGIME = 2.0
"""Accuracy that changes by this factor is a new situation with an error of its own."""
HEAVY_SIGMA = 2.5
"""Beyond this the error is taken for larger than stated: its noise grows with it."""
ABSORB_S = 8.0
"""Fixes refused for so long have a new error, not an outlier."""
ABSURD_SIGMA = 8.0
ABSURD_S = 60.0
ABSURD_M = 200.0
"""An error beyond so many deviations for so long and so far is the position's."""
VELOCITY_FLOOR_MPS = 0.03
FAR_M = 200_000.0
"""A fix further from the origin is not of this ride."""


def deviations(fix: GnssFix, floor_m: float) -> tuple[float, float]:
    """Deviation of each horizontal axis and of the height; the receiver's, within reason.

    u-blox states the horizontal accuracy as the deviation of the distance: √2 of an axis'.
    """
    horizontal, vertical = fix.horizontal_std_m, fix.vertical_std_m
    if not (math.isfinite(horizontal) and horizontal > 0.0):
        horizontal = math.sqrt(2.0) * UNSTATED_STD_M
    if not (math.isfinite(vertical) and vertical > 0.0):
        vertical = 1.5 * horizontal
    return max(horizontal / math.sqrt(2.0), floor_m), max(vertical, floor_m)


def unusable(fix: GnssFix, level: LocalLevel | None) -> str:
    """Why a fix that the receiver calls valid cannot be used; empty if it can."""
    values = (fix.latitude_deg, fix.longitude_deg, fix.height_ellipsoid_m)
    if not all(math.isfinite(value) for value in values):
        return "a fix with a position that is no number"
    if abs(fix.latitude_deg) > 90.0 or abs(fix.longitude_deg) > 360.0:
        return f"a fix at latitude {fix.latitude_deg}°, longitude {fix.longitude_deg}°"
    if level is not None:
        radius = 6_371_000.0
        north = (math.radians(fix.latitude_deg) - level.latitude_rad) * radius
        east = math.remainder(math.radians(fix.longitude_deg) - level.longitude_rad, math.tau)
        east *= radius * math.cos(level.latitude_rad)
        if not math.hypot(north, east) < FAR_M:
            away_km = math.hypot(north, east) / 1000
            return f"a fix {away_km:.0f} km away from where the ride began"
    return ""


def antenna_l(fix: GnssFix, level: LocalLevel) -> tuple[float, float, float]:
    """Position of the antenna in l, m."""
    row = (
        math.radians(fix.latitude_deg),
        math.radians(fix.longitude_deg),
        fix.height_ellipsoid_m,
    )
    east, north, up = level.from_geodetic(row).tolist()
    return east, north, up


class Fixes:
    """Feeds fixes to the filter."""

    def __init__(self, vehicle: Vehicle) -> None:
        gnss = vehicle.gnss
        self.floor_m = gnss.error_floor_m if gnss else 0.005
        self.tau_s = gnss.error_tau_s if gnss else 20.0
        self._std_m = 0.0  # of the present regime; 0 before the first fix
        self._refused_ns = 0  # since when; 0 if the last was taken
        self._absurd_ns = 0
        self._absurd_m = 0.0
        self._last_ns = 0
        self.accepted_ns = 0

    def take(
        self, fix: GnssFix, ekf: TramFilter, level: LocalLevel, standing: bool
    ) -> tuple[list[Verdict], str]:
        """Take a usable fix; the filter is at its stamp. Gives the verdicts, and a sentence."""
        std, std_up = deviations(fix, self.floor_m)
        self._set_noise(ekf, std, std_up)
        z = antenna_l(fix, level)
        verdicts = ekf.position(
            z, max(WHITE_SHARE * std, WHITE_FLOOR_M), max(WHITE_SHARE * std_up, WHITE_FLOOR_M)
        )
        sentence = ""
        if verdicts[0].accepted:
            self._refused_ns = 0
            self.accepted_ns = fix.stamp_ns
        else:
            self._refuse(fix.stamp_ns, verdicts, ekf, std)
        if not verdicts[2].accepted:
            self._absorb_height(ekf, verdicts[2].innovation, std_up)
        if not standing:
            if fix.HasField("vel_e_mps") and fix.HasField("vel_n_mps"):
                verdicts += self._velocity(fix, ekf)
            sentence = self._doubt(fix.stamp_ns, ekf, std, std_up)
        self._last_ns = fix.stamp_ns
        return verdicts, sentence

    def _velocity(self, fix: GnssFix, ekf: TramFilter) -> list[Verdict]:
        east, north, std = fix.vel_e_mps, fix.vel_n_mps, fix.speed_std_mps
        if not (math.isfinite(east) and math.isfinite(north)):
            return []
        std = std if math.isfinite(std) and std > 0.0 else 0.5
        return ekf.velocity((east, north), max(std, VELOCITY_FLOOR_MPS))

    def _set_noise(self, ekf: TramFilter, std: float, std_up: float) -> None:
        c = ekf.parameters
        if self._std_m == 0.0 or not 1 / NEW_REGIME < std / self._std_m < NEW_REGIME:
            if self._std_m != 0.0:
                ekf.memory[Ix.GNSS_EAST : Ix.GNSS_UP + 1] = 0.0
            slots = (Ix.GNSS_EAST, Ix.GNSS_NORTH, Ix.GNSS_UP)
            ekf.forget(slots, (std, std, std_up))
            self._std_m = std
        east, north, up = ekf.memory[Ix.GNSS_EAST : Ix.GNSS_UP + 1].tolist()
        heavy = max(1.0, (east * east + north * north) / (HEAVY_SIGMA * std) ** 2)
        heavy_up = max(1.0, (up / (HEAVY_SIGMA * std_up)) ** 2)
        white = 1.0 - WHITE_SHARE**2
        c[Pm.GNSS_DENSITY] = 2.0 * white * std * std * heavy / self.tau_s
        c[Pm.GNSS_UP_DENSITY] = 2.0 * white * std_up * std_up * heavy_up / self.tau_s
        c[Pm.GNSS_DECAY] = 1.0 / self.tau_s

    def _refuse(self, stamp_ns: int, verdicts: list[Verdict], ekf: TramFilter, std: float) -> None:
        if self._refused_ns == 0:
            self._refused_ns = stamp_ns
        elif stamp_ns - self._refused_ns > ABSORB_S * S:
            for slot, verdict in zip((Ix.GNSS_EAST, Ix.GNSS_NORTH), verdicts, strict=False):
                ekf.memory[slot] += verdict.innovation
                ekf.forget((slot,), (max(std, abs(float(ekf.memory[slot]))),))
            self._refused_ns = 0

    def _absorb_height(self, ekf: TramFilter, innovation: float, std_up: float) -> None:
        """A height that jumps has a new error: nobody waits for heights."""
        ekf.memory[Ix.GNSS_UP] += innovation
        ekf.forget((Ix.GNSS_UP,), (max(std_up, abs(float(ekf.memory[Ix.GNSS_UP]))),))

    def _doubt(self, stamp_ns: int, ekf: TramFilter, std: float, std_up: float) -> str:
        """Take the position where the fixes are when their error has been absurd for long."""
        east, north = ekf.memory[Ix.GNSS_EAST : Ix.GNSS_UP].tolist()
        error = math.hypot(east, north)
        if error < ABSURD_SIGMA * std:
            self._absurd_ns, self._absurd_m = 0, 0.0
            return ""
        if self._absurd_ns == 0:
            self._absurd_ns = stamp_ns
        dt_s = min((stamp_ns - self._last_ns) / S, 2.0)
        self._absurd_m += abs(float(ekf.memory[Ix.SPEED])) * dt_s
        if stamp_ns - self._absurd_ns < ABSURD_S * S or self._absurd_m < ABSURD_M:
            return ""
        self._absurd_ns, self._absurd_m = 0, 0.0
        x = ekf.memory
        x[Ix.EAST] += east
        x[Ix.NORTH] += north
        x[Ix.GNSS_EAST] = x[Ix.GNSS_NORTH] = 0.0
        ekf.forget((Ix.EAST, Ix.NORTH, Ix.GNSS_EAST, Ix.GNSS_NORTH), (2 * std, 2 * std, std, std))
        return f"the position was {error:.0f} m away from the fixes for long; taken from them again"

    # Memory --------------------------------------------------------------------------------------
    def snapshot(self) -> dict[str, Any]:
        return dict(vars(self))

    def restore(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            setattr(self, name, value)
