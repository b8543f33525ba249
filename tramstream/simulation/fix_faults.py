"""Faults of the receiver, as stages over its fixes (`simulation.faults`)."""

from __future__ import annotations

import math

import numpy as np

from tramstream import keys
from tramstream.clock import S
from tramstream.geodesy import SEMI_MAJOR_M
from tramstream.processor import Sample
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.simulation.event_kinds import (
    GnssFrozen,
    GnssHold,
    GnssJammed,
    GnssRateLost,
    GnssStated,
)
from tramstream.simulation.fault_stage import Stage, Timed, copied

JAMMED_S = 3.0
"""How long a jammed receiver's error lasts."""
LEAST_SATELLITES = 4
"""Of a fix in three dimensions."""
_PLACE = ("latitude_deg", "longitude_deg", "height_ellipsoid_m", "height_msl_m")
_VELOCITY = ("vel_n_mps", "vel_e_mps", "vel_d_mps", "speed_mps", "course_deg")


def _stop(fix: GnssFix) -> None:
    """Say in a fix that the antenna does not move."""
    for name in _VELOCITY[:3]:
        if fix.HasField(name):
            setattr(fix, name, 0.0)
    fix.speed_mps = 0.0


class Repeated(Stage):
    """Fixes that repeat a place: frozen, or held while the receiver thinks that it stands."""

    key = keys.GNSS_FIX

    def __init__(self, timed: Timed) -> None:
        super().__init__(timed)
        self._held: GnssFix | None = None

    def _take(self, sample: Sample) -> list[Sample]:
        fix: GnssFix = sample.message
        if not self.timed.lasts(sample.stamp_ns) or not self._repeats(fix):
            self._held = fix if fix.valid else self._held
            return [sample]
        if self._held is None:
            self._held = fix
        changed = copied(fix)
        for name in _PLACE:
            setattr(changed, name, getattr(self._held, name))
        self._change(changed, self._held)
        return [sample._replace(message=changed)]

    def _repeats(self, fix: GnssFix) -> bool:
        fault = self.timed.fault
        return isinstance(fault, GnssFrozen) or (
            isinstance(fault, GnssHold) and fix.valid and fix.speed_mps < fault.below_mps
        )

    def _change(self, fix: GnssFix, held: GnssFix) -> None:
        fault = self.timed.fault
        if not isinstance(fault, GnssFrozen):
            _stop(fix)
            return
        fix.valid, fix.fix_type, fix.invalid_llh = True, held.fix_type, False
        fix.horizontal_std_m, fix.vertical_std_m = held.horizontal_std_m, held.vertical_std_m
        if fault.velocity == "zero":
            _stop(fix)
            return
        for name in _VELOCITY:
            if fault.velocity == "kept":
                setattr(fix, name, getattr(held, name))
            else:
                fix.ClearField(name)


class Stated(Stage):
    """Deviations that the receiver states wrongly."""

    key = keys.GNSS_FIX

    def _take(self, sample: Sample) -> list[Sample]:
        fault = self.timed.fault
        assert isinstance(fault, GnssStated)
        if not (self.timed.lasts(sample.stamp_ns) and sample.message.valid):
            return [sample]
        changed = copied(sample.message)
        changed.horizontal_std_m *= fault.factor
        changed.vertical_std_m *= fault.factor
        return [sample._replace(message=changed)]


class Kept(Stage):
    """Fixes that get lost, but for one in so many."""

    key = keys.GNSS_FIX

    def __init__(self, timed: Timed) -> None:
        super().__init__(timed)
        self._count = 0

    def _take(self, sample: Sample) -> list[Sample]:
        fault = self.timed.fault
        assert isinstance(fault, GnssRateLost)
        if not self.timed.lasts(sample.stamp_ns):
            return [sample]
        self._count += 1
        return [sample] if fault.keeps and self._count % fault.keeps == 1 % fault.keeps else []


class Jammed(Stage):
    """Errors that nobody states, and fewer satellites."""

    key = keys.GNSS_FIX

    def __init__(self, timed: Timed) -> None:
        super().__init__(timed)
        assert isinstance(timed.fault, GnssJammed)
        self._rng = np.random.default_rng(timed.fault.seed)
        self._error = np.zeros(3)
        self._last_ns = 0

    def _take(self, sample: Sample) -> list[Sample]:
        fault, fix = self.timed.fault, sample.message
        assert isinstance(fault, GnssJammed)
        if not (self.timed.lasts(sample.stamp_ns) and fix.valid):
            return [sample]
        keep = math.exp(-(sample.stamp_ns - self._last_ns) / S / JAMMED_S)
        self._last_ns = sample.stamp_ns
        drawn = fault.std_m * math.sqrt(1.0 - keep**2) * self._rng.standard_normal(3)
        self._error = keep * self._error + drawn
        east, north, up = self._error.tolist()
        changed = copied(fix)
        changed.satellites_used = min(fix.satellites_used, fault.satellites)
        if fault.satellites < LEAST_SATELLITES:
            changed.valid, changed.fix_type = False, GnssFix.NO_FIX
            return [sample._replace(message=changed)]
        changed.latitude_deg += math.degrees(north / SEMI_MAJOR_M)
        parallel_m = SEMI_MAJOR_M * math.cos(math.radians(fix.latitude_deg))
        changed.longitude_deg += math.degrees(east / parallel_m)
        changed.height_ellipsoid_m += up
        changed.height_msl_m += up
        changed.horizontal_std_m *= fault.stated_factor
        changed.vertical_std_m *= fault.stated_factor
        return [sample._replace(message=changed)]
