"""GNSS fixes for the model `tram`: what they are worth, and what to do when they do not fit.

What their error is taken for says `fix_noise.py`. A fix that jumps is refused; if the jump stays,
the error has jumped, not the vehicle; and if the error stays absurd over a good way, the vehicle
was thought to be elsewhere and is taken where the fixes are.

Equations: docs/theory.md, sections 6.3 and 7.6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.fixes import (
    FASTEST_MPS,
    UNSTATED_STD_M,
    antenna_l,
    deviations,
    measures_height,
    velocity_l,
)
from tramstream.estimation.localiser import Verdict
from tramstream.events.kinds import Event
from tramstream.geodesy import LocalLevel
from tramstream.processors.tram_filter.events import (
    ACCURACY_UNSTATED,
    ERROR_TAKEN,
    FIRST_FIXES_WRONG,
    FIX_REFUSED,
    FIXES_BACK,
    FIXES_JUMPED,
    IMPOSSIBLE_VELOCITY,
    NO_HOPE,
    POSITION_TAKEN,
    VELOCITY_REFUSED,
)
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_model.gnss_position import DOUBT_STD_M, GnssHeight, GnssPosition
from tramstream.processors.tram_model.gnss_velocity import GnssVelocity
from tramstream.processors.tram_model.measurement import PAIR_GATE
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_sources.divergence import Heard, Offset
from tramstream.processors.tram_sources.first_place import FirstPlace, FirstPlaceMemory, Level
from tramstream.processors.tram_sources.fix_noise import (
    HEAVY_SIGMA,
    WHITE_FLOOR_M,
    WHITE_SHARE,
    FixNoise,
    FixNoiseMemory,
    crowded,
    error_of_fixes,
)
from tramstream.proto.gnss_pb2 import GnssFix

_KEY = keys.GNSS_FIX.path
JUMP_M = 30.0
"""Fixes that jump by more, from one to the next, are not of multipath; chosen by hand."""
JUMP_PAUSE_S = 5.0
"""After a longer pause it may be the filter that was elsewhere; chosen by hand."""
JUMP_TRUST_S, JUMP_HELD_S = 60.0, 600.0
"""Who has followed fixes for the first of these does not follow a jump of theirs, for as long as it
has followed them, and no longer than the second; chosen by hand."""
JUMP_SAID_S = 1.0
"""A jump that lasts so long is said; chosen by hand."""
UNEXPLAINED_SIGMA = 2.0
"""Fixes that are further from a vehicle that stands cast doubt on that; chosen by hand."""
ABSORB_S = 8.0
"""Fixes refused for so long have a new error, not an outlier; or, if they were refused before the
first fix was as old, it was the first ones that were wrong."""
ABSURD_SIGMA = 8.0
ABSURD_S = 60.0
ABSURD_M = 200.0
"""An error beyond so many deviations for so long and so far is the position's."""
HUGE_M = 100.0
HUGE_S = 20.0
"""One of this size is none of multipath; the vehicle need not move until it is the position's."""
TURNED_STD_RAD = 0.2
"""Whoever was elsewhere than thought may face elsewhere than thought."""
DIVERGED_COUNT = 3
DIVERGED_S = 600.0
"""Taken from the fixes so often within so long, the filter does not know what it does."""
VELOCITY_FLOOR_MPS = 0.03
VELOCITY_STD_MPS = 0.5
"""Of one whose receiver says nothing of its accuracy."""
NEIGHBOURS_S = 3.0
"""Fixes that are less apart share most of their error; chosen by hand."""
UNSHARED = 0.2
"""Of a fix's deviation that shows in the way between neighbours; chosen by hand."""


def speed_over_ground(
    fix: GnssFix, last: GnssFix | None, level: LocalLevel, std_m: float
) -> float | None:
    """Speed that the receiver measured, or else how far apart two neighbouring fixes are, m/s.

    Parameters
    ----------
    last : GnssFix or None
        The usable one before.
    std_m : float
        Deviation of `fix` on each horizontal axis.
    """
    measured = velocity_l(fix, level)
    if measured is not None:
        return math.hypot(*measured)
    if last is None or not 0 < fix.stamp_ns - last.stamp_ns < NEIGHBOURS_S * S:
        return None
    a, b = antenna_l(last, level), antenna_l(fix, level)
    dt_s = (fix.stamp_ns - last.stamp_ns) / S
    # Neighbours share most of their error; what they do not share is no motion.
    noise_m = UNSHARED * std_m
    return max(0.0, math.hypot(b[0] - a[0], b[1] - a[1]) - noise_m) / dt_s


def doubts(fix: GnssFix, level: LocalLevel) -> list[Event]:
    """What is taken of a usable fix for less than it claims to be."""
    found = []
    if not (math.isfinite(fix.horizontal_std_m) and fix.horizontal_std_m > 0.0):
        found.append(ACCURACY_UNSTATED(key=_KEY, taken_m=UNSTATED_STD_M))
    if fix.HasField("vel_e_mps") and velocity_l(fix, level) is None:
        speed_mps = math.hypot(fix.vel_e_mps, fix.vel_n_mps)
        found.append(IMPOSSIBLE_VELOCITY(key=_KEY, speed_mps=speed_mps, limit_mps=FASTEST_MPS))
    return found


@dataclass
class FixesMemory:
    """What `Fixes` remember."""

    noise: FixNoiseMemory = field(default_factory=FixNoiseMemory)
    first: FirstPlaceMemory = field(default_factory=FirstPlaceMemory)
    refused_ns: int = 0
    """Since when; 0 if the last was taken."""
    jumped_ns: int = 0
    """Since when fixes are elsewhere at once; 0 if they are not."""
    absurd_ns: int = 0
    absurd_m: float = 0.0
    begun_ns: int = 0
    """First fix."""
    last_ns: int = 0
    accepted_ns: int = 0
    """Stamp of the last fix that was accepted."""
    taken_ns: list[int] = field(default_factory=list)
    """When the position was taken from the fixes."""


def _refused(ekf: TramFilter, doubt: float) -> tuple[float, float]:
    """How far off what the filter has just refused was, and how far it may be that way."""
    (a, b), ((first, cross), (_, second)) = ekf.y[:, 0].tolist(), ekf.S.tolist()
    first, second = first + doubt, second + doubt
    off, determinant = math.hypot(a, b), first * second - cross * cross
    distance = a * a * second - 2.0 * a * b * cross + b * b * first
    known = determinant > 0.0 and distance > 0.0
    return off, off * math.sqrt(PAIR_GATE * determinant / distance) if known else math.nan


class Fixes:
    """Feeds fixes to the filter."""

    def __init__(self, vehicle: Vehicle, memory: FixesMemory | None = None) -> None:
        gnss = vehicle.gnss
        self.floor_m = gnss.error_floor_m if gnss else 0.005
        self.tau_s = gnss.error_tau_s if gnss else 20.0
        self.memory = FixesMemory() if memory is None else memory
        self.noise = FixNoise(self.tau_s, self.floor_m, self.memory.noise)
        self._first = FirstPlace(self.tau_s, self.memory.first)
        self.heard: Heard | None = None
        """What became of the last fix, for whoever judges the filter at once."""

    @property
    def diverged(self) -> Event | None:
        """That the position has been taken from the fixes again and again, if it has."""
        if len(self.memory.taken_ns) < DIVERGED_COUNT:
            return None
        return NO_HOPE(times=DIVERGED_COUNT, within_s=DIVERGED_S)

    def renew(self, ekf: TramFilter) -> None:
        """The error of the fixes is another one: after a long pause."""
        memory = self.memory
        self.noise.renew(ekf)
        memory.refused_ns, memory.absurd_ns, memory.absurd_m = 0, 0, 0.0
        memory.jumped_ns = 0

    def apply(
        self, fix: GnssFix, ekf: TramFilter, level: LocalLevel, standing: bool
    ) -> tuple[list[Verdict], list[Event]]:
        """Apply a usable fix; the filter is at its stamp. Gives the verdicts, and what happened."""
        memory = self.memory
        std, std_up = deviations(fix, self.floor_m)
        memory.begun_ns = memory.begun_ns or fix.stamp_ns
        self.noise.set(ekf, std, std_up)
        z = antenna_l(fix, level)
        closeness = crowded(fix.stamp_ns - memory.last_ns)
        white = closeness * max(WHITE_SHARE * std, WHITE_FLOOR_M) ** 2
        white_up = closeness * max(WHITE_SHARE * std_up, WHITE_FLOOR_M) ** 2
        east, north = ekf.state[Ix.EAST], ekf.state[Ix.NORTH]
        verdicts = ekf.apply(GnssPosition(z[0], z[1], white))
        moved_m = ekf.state[Ix.EAST] - east, ekf.state[Ix.NORTH] - north
        found: list[Event] = []
        refused = not verdicts[0].accepted
        if refused:
            off_m, limit_m = _refused(ekf, DOUBT_STD_M**2)
            facts = {"gate_sigma": math.sqrt(PAIR_GATE), "accuracy_m": fix.horizontal_std_m}
            found.append(FIX_REFUSED(key=_KEY, innovation_m=off_m, limit_m=limit_m, **facts))
        found += self.noise.learn(fix.stamp_ns, ekf, verdicts, std, moved_m)
        if measures_height(fix):
            verdicts += ekf.apply(GnssHeight(z[2], white_up))
            self.noise.learn_height(fix.stamp_ns, ekf, verdicts[2], std_up)
            if not verdicts[2].accepted:
                self._absorb_height(ekf, verdicts[2].innovation, std_up)
        resting = standing and not ekf.heading_known
        if resting:
            found += self._rest(fix.stamp_ns, z, ekf, refused)
        elif self.memory.first.levels:
            self._first.forget()
        if refused:
            found += self._refuse(fix.stamp_ns, off_m, verdicts, ekf, resting)
        else:
            if memory.jumped_ns:
                lasted_s = (fix.stamp_ns - memory.jumped_ns) / S
                found.append(FIXES_BACK(key=_KEY, lasted_s=lasted_s))
            memory.refused_ns = memory.jumped_ns = 0
        measured = None if standing else velocity_l(fix, level)
        if measured == (0.0, 0.0):  # no moving antenna measures that: the receiver holds its place
            measured = None
        velocity, accepted = None, False
        if measured is not None:
            std_mps = velocity_std(fix)
            taken = ekf.apply(GnssVelocity(*measured, closeness * std_mps * std_mps))
            verdicts += taken
            accepted = taken[0].accepted
            if not accepted:
                velocity = Offset(taken[0].innovation, taken[1].innovation, std_mps)
                off_mps, limit_mps = _refused(ekf, 0.0)
                facts = {"gate_sigma": math.sqrt(PAIR_GATE), "accuracy_mps": fix.speed_std_mps}
                facts |= {"innovation_mps": off_mps, "limit_mps": limit_mps}
                found.append(VELOCITY_REFUSED(key=_KEY, **facts))
        found += self._detect_divergence(fix.stamp_ns, ekf, self.noise.std_m, standing)
        if not refused and memory.absurd_ns == 0:
            memory.accepted_ns = fix.stamp_ns
        memory.last_ns = fix.stamp_ns
        innovation_m = verdicts[0].innovation, verdicts[1].innovation
        std_m = self.noise.std_m
        self.heard = Heard(fix.stamp_ns, std_m, refused, innovation_m, velocity, accepted)
        return verdicts, found

    def _rest(
        self, stamp_ns: int, z: tuple[float, float, float], ekf: TramFilter, refused: bool
    ) -> list[Event]:
        """Let a vehicle that has not moved yet be where its fixes have been for longest."""
        std, last_ns = self.noise.std_m, self.memory.last_ns
        if not self.memory.first.levels:  # the vehicle is believed to be somewhere already
            east, north = ekf.state[Ix.EAST], ekf.state[Ix.NORTH]
            last = (east, north) if refused else (z[0], z[1])
            lasted_s = (last_ns - self.memory.begun_ns) / S if last_ns else 0.0
            self._first.begin(Level(east, north, last[0], last[1], last_ns or stamp_ns, lasted_s))
        place = self._first.take(stamp_ns, z[0], z[1], std)
        if place is None:
            return []
        east, north = place[0] - ekf.state[Ix.EAST], place[1] - ekf.state[Ix.NORTH]
        away_m = math.hypot(east, north)
        self._move(ekf, east, north, std)
        ekf.set_states(Ix.GNSS_EAST, (z[0] - place[0], z[1] - place[1]))
        self.memory.refused_ns = 0
        return [FIRST_FIXES_WRONG(key=_KEY, away_m=away_m)]

    def _refuse(
        self, stamp_ns: int, off_m: float, verdicts: list[Verdict], ekf: TramFilter, resting: bool
    ) -> list[Event]:
        """Find out whose fault a refused fix is: of one that has jumped, its own."""
        memory, std = self.memory, self.noise.std_m
        followed_s = (stamp_ns - memory.begun_ns) / S
        if memory.refused_ns == 0 and off_m > JUMP_M and followed_s > JUMP_TRUST_S:
            pause_s = (stamp_ns - memory.accepted_ns) / S
            memory.jumped_ns = stamp_ns if pause_s < JUMP_PAUSE_S else 0
        if memory.jumped_ns == 0:
            return self._absorb(stamp_ns, verdicts, ekf, std, resting)
        lasted_s = (stamp_ns - memory.jumped_ns) / S
        if lasted_s > min(followed_s - lasted_s, JUMP_HELD_S):
            memory.jumped_ns = 0
            return self._absorb(stamp_ns, verdicts, ekf, std, resting)
        memory.refused_ns = stamp_ns
        if lasted_s < JUMP_SAID_S:
            return []
        return [FIXES_JUMPED(key=_KEY, off_m=off_m, limit_m=JUMP_M, lasted_s=lasted_s)]

    def _absorb(
        self, stamp_ns: int, verdicts: list[Verdict], ekf: TramFilter, std: float, resting: bool
    ) -> list[Event]:
        memory = self.memory
        memory.refused_ns = memory.refused_ns or stamp_ns
        if stamp_ns - memory.refused_ns < ABSORB_S * S:
            return []
        young = memory.refused_ns - memory.begun_ns < ABSORB_S * S
        refused_s, memory.refused_ns = (stamp_ns - memory.refused_ns) / S, 0
        east, north = (verdict.innovation for verdict in verdicts[:2])
        if young and not resting:
            error = error_of_fixes(ekf)
            self._move(ekf, error[0] + east, error[1] + north, std)
            away_m = math.hypot(error[0] + east, error[1] + north)
            return [FIRST_FIXES_WRONG(key=_KEY, away_m=away_m)]
        for slot, innovation in ((Ix.GNSS_EAST, east), (Ix.GNSS_NORTH, north)):
            error_m = ekf.state[slot] + innovation
            ekf.reset(slot, error_m, max(std, abs(error_m)))
        error_m = math.hypot(*error_of_fixes(ekf))
        return [ERROR_TAKEN(key=_KEY, refused_s=refused_s, error_m=error_m)]

    def move_to(self, verdicts: list[Verdict], ekf: TramFilter) -> None:
        """Let the place be where a fix is that was refused, by its verdicts."""
        east, north = error_of_fixes(ekf)
        east, north = east + verdicts[0].innovation, north + verdicts[1].innovation
        self._move(ekf, east, north, self.noise.std_m)
        self.memory.refused_ns = self.memory.absurd_ns = self.memory.jumped_ns = 0

    def _move(self, ekf: TramFilter, east: float, north: float, std: float) -> None:
        """Let the position be elsewhere, where fixes without an error would have it.

        So is the height, if it is far from theirs: it was that of another place.
        """
        ekf.shift(Ix.EAST, east)
        ekf.shift(Ix.NORTH, north)
        ekf.set_states(Ix.GNSS_EAST, (0.0, 0.0))
        ekf.set_states(Ix.GNSS_SLOW_EAST, (0.0, 0.0))
        ekf.forget((Ix.EAST, Ix.NORTH, Ix.GNSS_EAST, Ix.GNSS_NORTH), (2 * std, 2 * std, std, std))
        slow_m = self.memory.noise.slow_m
        ekf.forget((Ix.GNSS_SLOW_EAST, Ix.GNSS_SLOW_NORTH), (slow_m, slow_m))
        up, std_up = ekf.state[Ix.GNSS_UP], self.memory.noise.std_up_m
        if abs(up) > HEAVY_SIGMA * std_up:
            ekf.shift(Ix.UP, up)
            ekf.reset(Ix.GNSS_UP, 0.0, std_up)
            ekf.forget((Ix.UP,), (2 * std_up,))
        self.noise.restart()

    def unexplained_m(self, ekf: TramFilter) -> float:
        """How far fixes are from a vehicle that is taken to stand, beyond what they err."""
        off_m = math.hypot(*error_of_fixes(ekf))
        return max(0.0, off_m - UNEXPLAINED_SIGMA * self.noise.std_m)

    def take_place(self, ekf: TramFilter, heard: Heard) -> None:
        """Let the place of a filter that was wrong be where the last fix is."""
        east, north = heard.off_m if heard.refused else (0.0, 0.0)
        error = error_of_fixes(ekf)
        self._move(ekf, error[0] + east, error[1] + north, heard.std_m)
        self.memory.refused_ns = self.memory.absurd_ns = self.memory.jumped_ns = 0

    def _absorb_height(self, ekf: TramFilter, innovation: float, std_up: float) -> None:
        """A height that jumps has a new error: nobody waits for heights."""
        error_m = ekf.state[Ix.GNSS_UP] + innovation
        ekf.reset(Ix.GNSS_UP, error_m, max(std_up, abs(error_m)))

    def _detect_divergence(
        self, stamp_ns: int, ekf: TramFilter, std: float, standing: bool
    ) -> list[Event]:
        """Take the position where the fixes are when their error has been absurd for long."""
        memory = self.memory
        east, north = error_of_fixes(ekf)
        error = math.hypot(east, north)
        if error < ABSURD_SIGMA * std:
            memory.absurd_ns, memory.absurd_m = 0, 0.0
            return []
        if standing and error < HUGE_M:
            return []
        if memory.absurd_ns == 0:
            memory.absurd_ns = stamp_ns
        dt_s = min((stamp_ns - memory.last_ns) / S, 2.0)
        memory.absurd_m += 0.0 if standing else abs(ekf.state[Ix.SPEED]) * dt_s
        lasted_s = (stamp_ns - memory.absurd_ns) / S
        for_long = lasted_s > ABSURD_S and memory.absurd_m > ABSURD_M
        if not for_long and not (lasted_s > HUGE_S and error > HUGE_M):
            return []
        memory.absurd_ns, memory.absurd_m = 0, 0.0
        recent = [each for each in memory.taken_ns if stamp_ns - each < DIVERGED_S * S]
        memory.taken_ns = [*recent, stamp_ns]
        self._move(ekf, east, north, std)
        ekf.widen(Ix.YAW, TURNED_STD_RAD)
        return [POSITION_TAKEN(key=_KEY, away_m=error, lasted_s=lasted_s)]


def velocity_std(fix: GnssFix) -> float:
    """Deviation of the receiver's velocity on each axis, m/s."""
    std = fix.speed_std_mps
    return max(std, VELOCITY_FLOOR_MPS) if 0.0 < std < FASTEST_MPS else VELOCITY_STD_MPS
