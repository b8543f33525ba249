"""The search for the heading, from a departure until one direction of travel is believed.

    keeping ──displacements tell the line of motion──▶ trying ──one is much likelier──▶ found
       └──stands again, or too long──▶ failed

*Keeping*: the frames are kept while the displacements between fixes are summed (`alignment`).
*Trying*: the filter, set back to the departure, goes through the kept frames with a heading, once
for either direction of travel where the wheels do not tell it; from then on both go on side by
side, frame by frame, until curves or acceleration have told them apart.

Equations: docs/theory.md, section 7.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tramstream.clock import S
from tramstream.estimation.fixes import antenna_l, unusable, velocity_l
from tramstream.estimation.kalman import Array
from tramstream.estimation.localiser import Verdict
from tramstream.events.kinds import Event
from tramstream.memory.stage import assign, copied
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram.navigation_memory import NavigationMemory
from tramstream.processors.tram_filter.alignment import WHITE_SHARE, Alignment, AlignmentMemory
from tramstream.processors.tram_filter.events import REFUSALS
from tramstream.processors.tram_model.records import Z
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_sources.fix_noise import INDEPENDENT_S
from tramstream.processors.tram_sources.gnss import velocity_std
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.sync_pb2 import SyncFrame

KEEP_S = 120.0
"""Frames of so long are kept."""
YOUNG_S = 2.0
"""An older fix tells nothing of the place of the departure, and its velocity does not go on."""
HEADING_PRIOR_RAD = 0.35
"""The heading that displacements gave is only where the filter begins: it sees the same fixes."""
SPEED_PRIOR_MPS = 3.0
FORWARDS = 2.0
"""Trams run forwards far more often than not: in terms of log-likelihood."""
SURE = 20.0
"""Difference of log-likelihood at which a direction is taken. On a straight at constant speed it
stays within 5 either way; the first acceleration or curve makes it hundreds."""
LEAVING_MPS2 = 0.5
"""By so much a vehicle accelerates otherwise than between the two fixes before; by hand."""
BLIND_MPS2 = 1.5
"""How a vehicle accelerates of which nobody measures it; reckoned by hand from trams."""
UNSURE_WAY_M = 300.0
"""After so long a way the likelier direction is taken, however little."""


@dataclass
class Tried:
    """One direction of travel, as far as it has been gone."""

    sign: float
    likelihood: float
    navigation: NavigationMemory

    @classmethod
    def of(cls, sign: float, navigation: Navigation) -> Tried:
        """Keep where `navigation` is."""
        likelihood = navigation.ekf.log_likelihood_sum
        if likelihood is None or not math.isfinite(likelihood):
            likelihood = -math.inf
        return cls(sign, likelihood, navigation.kept())

    def go_on(self, navigation: Navigation) -> None:
        """Let `navigation` go on from here."""
        navigation.go_back(self.navigation)
        navigation.ekf.log_likelihood_sum = self.likelihood


@dataclass
class Gone:
    """The way since the departure by the velocities of the receiver, which no jump moves."""

    fix_ns: int
    """Of the last one; before the first, the departure."""
    way: complex = 0j
    """To the east and, imaginary, to the north, m."""
    velocity: complex = 0j
    acceleration: complex = 0j
    variance_m2: float = 0.0
    """Of either axis."""
    std_mps: float = 0.0
    blind: bool = False
    """Whether there has been a fix without."""
    place: complex | None = None
    """Of the last fix."""

    def note(self, stamp_ns: int, place: complex, std_m: float) -> None:
        """Take the place of a fix that has no velocity: neighbours show one."""
        dt_s = (stamp_ns - self.fix_ns) / S
        if self.place is not None and dt_s > 0.0:
            self.velocity, self.std_mps = (place - self.place) / dt_s, std_m / dt_s
        self.blind, self.place, self.fix_ns = True, place, stamp_ns

    def take(self, stamp_ns: int, velocity: complex, std_mps: float) -> None:
        """Take a velocity."""
        dt_s = (stamp_ns - self.fix_ns) / S
        if dt_s <= 0.0:
            return
        self.way += 0.5 * dt_s * (self.velocity + velocity)
        self.variance_m2 += std_mps * std_mps * max(dt_s, INDEPENDENT_S) * dt_s
        self.acceleration = (velocity - self.velocity) / dt_s
        self.fix_ns, self.velocity, self.std_mps = stamp_ns, velocity, std_mps

    def at(self, stamp_ns: int) -> tuple[complex, float]:
        """Way until an instant after the last fix, and its variance."""
        way, variance_m2 = self.since(stamp_ns, LEAVING_MPS2)
        return self.way + way, self.variance_m2 + variance_m2

    def since(self, stamp_ns: int, unseen_mps2: float) -> tuple[complex, float]:
        """Way since the last fix and its variance, where so much acceleration is not known."""
        age_s = (stamp_ns - self.fix_ns) / S
        led_s = min(age_s, YOUNG_S)
        sped_m = 0.5 * unseen_mps2 * age_s * age_s + (age_s - led_s) * abs(self.velocity)
        gone = led_s * (self.velocity + 0.5 * led_s * self.acceleration)
        return gone, (self.std_mps * age_s) ** 2 + sped_m * sped_m


@dataclass
class SearchMemory:
    """What a `Search` remembers."""

    anchor: NavigationMemory
    """As it was at the departure."""
    departed_ns: int
    rested: bool
    last_ns: int
    gone: Gone
    turned: float = 0.0
    found: bool = False
    failed: bool = False
    kept: list[SyncFrame] = field(default_factory=list)
    alignment: AlignmentMemory = field(default_factory=AlignmentMemory)
    tried: list[Tried] = field(default_factory=list)
    """Either direction; the likelier first."""


class Search:
    """One departure.

    Parameters
    ----------
    navigation : Navigation
        As it is at the departure, without a heading.
    fix : GnssFix or None
        The last one before.
    """

    def __init__(
        self, navigation: Navigation, fix: GnssFix | None, memory: SearchMemory | None = None
    ) -> None:
        departed_ns = navigation.ekf.stamp_ns
        # Fixes alone see a departure when it has begun.
        rested = navigation.memory.stood and not navigation.alone
        self.memory = memory or SearchMemory(
            navigation.kept(), departed_ns, rested, departed_ns, Gone(departed_ns)
        )
        self._alignment = Alignment(navigation.fixes.tau_s, self.memory.alignment)
        if memory is not None:
            return
        if fix is not None and navigation.ekf.stamp_ns - fix.stamp_ns < YOUNG_S * S:
            self._add_fix(navigation, fix, 0.0)

    @property
    def trying(self) -> bool:
        """Whether the navigation moves with the vehicle, though its heading may be opposite."""
        return bool(self.memory.tried)

    def step(
        self,
        navigation: Navigation,
        frame: SyncFrame,
        standing: bool,
        noise: Array | None,
        speed_mps: float,
    ) -> list[Verdict]:
        """Take a frame whose inertial reading `navigation` has; leaves it with what is likeliest.

        Parameters
        ----------
        noise : ndarray, shape (6,), or None
            See `Navigation.run`.
        speed_mps : float
            Over ground, as GNSS last measured it.
        """
        memory = self.memory
        self._integrate_turn(navigation, frame)
        if memory.tried:
            return self._continue_directions(navigation, frame, standing, noise)
        memory.kept.append(frame)
        for reading in frame.odometry:
            if not navigation.wheels.known:
                navigation.wheels.assign(reading, navigation.ekf)
            navigation.wheels.note_counters(reading)
        if standing or frame.stamp_ns - memory.departed_ns > KEEP_S * S:
            memory.failed = True
        elif self._alignment.ready:
            return self._try_directions(navigation, noise, speed_mps)
        return []

    def way(self, stamp_ns: int) -> tuple[complex, float, complex] | None:
        """Way of a vehicle that stood before, its variance and its velocity, if they are known."""
        gone = self.memory.gone
        if gone.blind or not self.memory.rested:
            return None
        return *gone.at(stamp_ns), gone.velocity

    def has_heard(self, fix_ns: int) -> bool:
        """Whether the velocity is known, and the last fix, of this instant, not too old for it."""
        gone = self.memory.gone
        known = self.memory.rested or gone.std_mps > 0.0
        return known and gone.fix_ns - fix_ns < YOUNG_S * S

    def way_since_fix(self, stamp_ns: int) -> tuple[complex, float]:
        """Way since the last fix, and its variance."""
        return self.memory.gone.since(stamp_ns, BLIND_MPS2)

    def abandon(self, navigation: Navigation) -> None:
        """Set the filter back to the departure: what it knows of the sensors stays."""
        wheels, stamp_ns = copied(navigation.wheels.memory), self.memory.last_ns
        began_without = not self.memory.anchor.wheels.wheels
        offsets_m = navigation.ekf.wheel_offsets_m()
        navigation.go_back(self.memory.anchor)
        assign(navigation.wheels.memory, wheels)
        for wheel, offset_m in enumerate(offsets_m):  # they may have been assigned since
            navigation.ekf.set_wheel(wheel, offset_m)
        if began_without:
            navigation.wheels.set_constants(navigation.ekf)
        navigation.ekf.set_time(stamp_ns)
        navigation.ekf.log_likelihood_sum = None

    # Displacements -------------------------------------------------------------------------------
    def _integrate_turn(self, navigation: Navigation, frame: SyncFrame) -> None:
        memory = self.memory
        dt_s = (frame.stamp_ns - memory.last_ns) / S
        rate = float(navigation.inertial["between"]["angular_rate"][0, Z])
        memory.turned += (rate - navigation.ekf.state[Ix.GYRO_Z]) * dt_s
        memory.last_ns = frame.stamp_ns
        for fix in frame.gnss:
            self._add_fix(navigation, fix, (fix.stamp_ns - memory.departed_ns) / S)

    def _add_fix(self, navigation: Navigation, fix: GnssFix, time_s: float) -> None:
        if fix.valid and not unusable(fix, navigation.level):
            east, north, _ = antenna_l(fix, navigation.level)
            std = navigation.accuracy_m(fix)
            self._alignment.take(time_s, east, north, self.memory.turned, std)
            velocity = velocity_l(fix, navigation.level)
            gone = self.memory.gone
            if velocity is None:
                apart = 1.0 - math.exp(-1.0 / navigation.fixes.tau_s) + WHITE_SHARE
                gone.note(fix.stamp_ns, complex(east, north), std * math.sqrt(2.0 * apart))
            else:
                gone.take(fix.stamp_ns, complex(*velocity), velocity_std(fix))

    # Directions ----------------------------------------------------------------------------------
    def _try_directions(
        self, navigation: Navigation, noise: Array | None, speed_mps: float
    ) -> list[Verdict]:
        memory = self.memory
        counted = navigation.wheels.counted(memory.kept)
        direction = navigation.wheels.direction(counted)
        verdicts: dict[float, list[Verdict]] = {}
        said: dict[float, list[Event]] = {}
        told = len(navigation.complaints)
        if direction == 0.0 and navigation.alone:
            direction = 1.0  # nothing will ever tell
        for sign in (1.0, -1.0) if direction == 0.0 else (direction,):
            navigation.go_back(memory.anchor)
            ekf, yaw_rad = navigation.ekf, self._alignment.yaw_rad
            navigation.set_heading(yaw_rad if sign > 0.0 else yaw_rad + math.pi, HEADING_PRIOR_RAD)
            navigation.wheels.count_as_running(sign, counted, ekf)
            if not memory.rested:
                ekf.reset(Ix.SPEED, sign * speed_mps, SPEED_PRIOR_MPS)
            ekf.log_likelihood_sum = FORWARDS if sign > 0.0 else 0.0
            for frame in memory.kept:
                inertial = navigation.read(frame)
                verdicts[sign] = navigation.run(frame, False, noise if inertial else None)
            memory.tried.append(Tried.of(sign, navigation))
            said[sign] = _taken(navigation.complaints, told)
        memory.kept = []
        return verdicts[self._decide(navigation, said)]

    def _continue_directions(
        self, navigation: Navigation, frame: SyncFrame, standing: bool, noise: Array | None
    ) -> list[Verdict]:
        verdicts: dict[float, list[Verdict]] = {}
        said: dict[float, list[Event]] = {}
        told = len(navigation.complaints)
        for number, tried in enumerate(self.memory.tried):
            tried.go_on(navigation)
            inertial = navigation.read(frame)
            verdicts[tried.sign] = navigation.run(frame, standing, noise if inertial else None)
            self.memory.tried[number] = Tried.of(tried.sign, navigation)
            said[tried.sign] = _taken(navigation.complaints, told)
        return verdicts[self._decide(navigation, said)]

    def _decide(self, navigation: Navigation, said: dict[float, list[Event]]) -> float:
        """Leave `navigation` with the likelier direction, which it returns.

        What the other one had to say of the sensors, `said`, is its own error. Refusals are of
        both: the fixes told the heading, and the gates are not for them.
        """
        memory = self.memory
        memory.tried.sort(key=lambda each: -each.likelihood)
        first, last = memory.tried[0], memory.tried[-1]
        first.go_on(navigation)
        told = [*navigation.complaints, *said[first.sign]]
        navigation.complaints[:] = [each for each in told if each.kind not in REFUSALS]
        sure = len(memory.tried) == 1 or not first.likelihood - last.likelihood < SURE
        memory.found = sure or self._alignment.way_m > UNSURE_WAY_M
        if memory.found:
            navigation.ekf.log_likelihood_sum = None
        return first.sign


def _taken(complaints: list[Event], begin: int) -> list[Event]:
    """Take the complaints from number `begin` on away."""
    taken = complaints[begin:]
    del complaints[begin:]
    return taken
