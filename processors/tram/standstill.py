"""Does the vehicle stand? Wheels say so; the inertial sensor must agree, or says it alone.

Idling is not motion: an engine, a fan or a compressor shakes the case with degrees a second, yet
the vehicle stands. So nothing here asks for quiet in itself. Where wheels are read, it stands when
they have not turned for a while, unless the filter or GNSS knows of a speed that a sliding wheel
or a stuck counter would hide. Without wheels, the shaking is compared with what it was while the
vehicle surely stood and surely ran, by GNSS speed; until both are known, or when they do not
differ, only a speed estimate near zero with a steady heading counts.

Equations: docs/theory.md, section 7.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Protocol

from tramstream.clock import S
from tramstream.estimation.kalman import Array, compiled
from tramstream.estimation.records import Records, dtype_of, numbers, one
from tramstream.processors.tram_model.records import READING, X, Y, Z

WHEELS_STILL_S = 0.6
"""Wheels that have not turned for so long stand; 30 readings at 50 Hz."""
LOCKED_MPS = 0.5
LOCKED_SIGMA = 4.0
"""Beyond an estimated speed of this and so many deviations, wheels that do not turn slide, or their
counter is stuck."""
FAST_S = 3.0
"""Fixes that have moved fast for so long have not jumped."""
PAUSE_S = 0.5
"""Of the inertial readings: after a longer one they begin anew."""
STILL_S = 0.8
"""The inertial sensor alone must agree for so long."""
CREEP_MPS = 0.3
"""Estimated speed that may be standing, without wheels."""
STEADY_RADPS = 0.01
"""Mean yaw rate of a vehicle that stands."""
SMOOTHING_S = 0.5
LEARNING_S = 20.0
SEPARATION = 2.0
"""The shaking must differ by this factor between running and standing to be of use."""
RUNNING_MPS = 2.0
_SEPARATION = math.log(SEPARATION)
PUSH_MPS2 = 0.12
"""Change of the mean specific force along the track that sets a vehicle going: without wheels the
first thing to be seen."""
SETTLING_S = 5.0
RUN_S = 3.0
"""Without wheels, a vehicle that has left does not stand again before this: at walking pace its
shaking is still that of standing."""
GNSS_AGE_S = 2.5
PLACES_S, LEAST_PLACES_S = 3.0, 2.5
"""Where nothing but places of fixes tells, so much time is looked at; chosen by hand."""
SAME_PLACE_M, LEFT_M = 0.8, 1.5
"""A vehicle whose fixes are no further apart stands, until one is further from where it was when
that was seen. An error of 0.5 m on an axis that lasts 20 s moves by the first of these in 3 s once
in eighty times; chosen by hand, guarded by `tests/processors/tram/test_fixes_alone.py`."""
STEP_S, STEP_M = 0.75, 0.6
"""It has left, too, when fixes that are so far apart in time are so far apart; chosen by hand."""
UNSEEN_M = 2.0
"""Way on which a vehicle reaches `RUNNING_MPS`, at 1 m/s²; chosen by hand."""


class Shaking(Protocol):
    """What the readings are like in the last moments, and what they were like before."""

    mean_rate: Annotated[Array, (3,)]
    """Of the angular rates, smoothed, rad/s."""
    mean_force: Annotated[Array, (3,)]
    """Of the specific forces, smoothed, m/s²."""
    rate_variance: Annotated[Array, (3,)]
    """(rad/s)²."""
    force_variance: Annotated[Array, (3,)]
    """(m/s²)²."""
    stop_force: float
    """Specific force along the track while standing, m/s²."""
    standing_level: float
    """Logarithm of the shaking while standing; 0: not known."""
    running_level: float
    """Logarithm of the shaking while running; 0: not known."""


SHAKING = dtype_of(Shaking)


@compiled
def may_stand(
    shaking: Array,
    u: Array,
    dt_s: float,
    standing: bool,
    known: bool,
    ground_mps: float,
    speed_mps: float,
    bias_z: float,
) -> bool:
    """Take a reading: whether it could be that of a vehicle that stands.

    Parameters
    ----------
    shaking : record
        One `Shaking`; changed in place.
    u : record
        One `Reading`.
    standing : bool
        What the vehicle did until now.
    known : bool
        Whether the speed over ground is.
    """
    f, read = shaking.view(SHAKING)[0], u.view(READING)[0]
    weight = min(1.0, dt_s / SMOOTHING_S)
    _smooth(f.mean_rate, f.rate_variance, read.angular_rate, weight)
    _smooth(f.mean_force, f.force_variance, read.specific_force, weight)
    variance = f.force_variance[X] + f.force_variance[Y] + f.force_variance[Z]
    level = 0.5 * math.log(variance + 1e-12)
    force = f.mean_force[X]
    slow = ground_mps if known else abs(speed_mps)
    if known and ground_mps > RUNNING_MPS:
        f.running_level = _blend(f.running_level, level, dt_s / LEARNING_S)
    if standing and slow < CREEP_MPS:
        f.standing_level = _blend(f.standing_level, level, dt_s / LEARNING_S)
    pushed = standing and abs(force - f.stop_force) > PUSH_MPS2
    f.stop_force += dt_s / SETTLING_S * (force - f.stop_force)
    if pushed or slow > (2.0 * CREEP_MPS if known else RUNNING_MPS):
        return False
    if abs(f.mean_rate[Z] - bias_z) > STEADY_RADPS:
        return False
    still, running = f.standing_level, f.running_level
    if still != 0.0 and running != 0.0 and running - still > _SEPARATION:
        return bool(level < 0.5 * (still + running))
    return bool(slow < CREEP_MPS)


@compiled
def _smooth(mean: Array, variance: Array, read: Array, weight: float) -> None:
    for k in range(3):
        before = read[k] - mean[k]
        mean[k] += weight * before
        variance[k] += weight * (before * (read[k] - mean[k]) - variance[k])


@compiled
def _blend(before: float, value: float, weight: float) -> float:
    return value + (before - value) * (1.0 - weight) if before != 0.0 else value


@dataclass(eq=False)
class Standstill:
    """Decides frame by frame; `noise` gives what the readings scatter by while standing.

    It is its own memory.
    """

    standing: bool = False
    since_ns: int = 0
    """Start of the present state."""
    _shaking: Records = field(default_factory=lambda: one(SHAKING))
    _started: bool = False
    _last_ns: int = 0
    """Inertial reading."""
    _wheel_ns: int = 0
    """Last reading of the wheels."""
    _turned_ns: int = 0
    """Last reading with a turn."""
    _quiet_ns: int = 0
    """Since when the inertial sensor agrees."""
    _gnss_mps: float = math.inf
    _gnss_ns: int = 0
    _fast_ns: int = 0
    """Since when that has been fast."""
    _places: list[tuple[int, float, float]] = field(default_factory=list)
    """Of fixes that nothing else tells of the motion beside: stamp, east, north."""
    _place: tuple[float, float] = (0.0, 0.0)
    """Where the vehicle was seen to stand by them."""
    noise: Array = field(init=False)
    """Variance of rates and specific forces in the last moments, shape (6,)."""

    def __post_init__(self) -> None:
        self._numbers = numbers(self._shaking)
        self.noise = self._numbers[6:12]

    @property
    def speed_over_ground_mps(self) -> float:
        """Last speed that GNSS measured; 0 if it never has."""
        return self._gnss_mps if math.isfinite(self._gnss_mps) else 0.0

    def fast_s(self, stamp_ns: int) -> float:
        """For how long GNSS has seen a fast vehicle; 0 if it does not."""
        heard = self._gnss_ns and stamp_ns - self._gnss_ns < GNSS_AGE_S * S
        return (self._gnss_ns - self._fast_ns) / S if heard else 0.0

    def unseen(self, stamp_ns: int) -> tuple[float, float]:
        """Way and speed that GNSS says of a vehicle that stands by its wheels, m, m/s."""
        fast_s = self.fast_s(stamp_ns)
        return (UNSEEN_M + self._gnss_mps * fast_s, self._gnss_mps) if fast_s > 0.0 else (0.0, 0.0)

    def leave_wheels(self, stamp_ns: int) -> None:
        """Do without wheels, which were found dead: the vehicle does not stand as they say."""
        self._wheel_ns, self._quiet_ns = 0, stamp_ns

    def wheels(self, stamp_ns: int, turned: bool) -> None:
        """Take a reading of the wheels."""
        if turned or stamp_ns - self._wheel_ns > WHEELS_STILL_S * S:
            self._turned_ns = stamp_ns
        self._wheel_ns = stamp_ns

    def speed_over_ground(self, stamp_ns: int, speed_mps: float) -> None:
        """Take a speed that GNSS measured."""
        if speed_mps < RUNNING_MPS or stamp_ns - self._gnss_ns > GNSS_AGE_S * S:
            self._fast_ns = stamp_ns
        self._gnss_mps, self._gnss_ns = speed_mps, stamp_ns

    def place(self, stamp_ns: int, east_m: float, north_m: float) -> None:
        """Take the place of a fix, where nothing else tells of the motion."""
        places = self._places
        places.append((stamp_ns, east_m, north_m))
        while stamp_ns - places[0][0] > PLACES_S * S:
            del places[0]

    def gone(self) -> tuple[complex, complex]:
        """Way of the places since it was surely standing, and velocity of their last step."""
        if not self._places:
            return 0j, 0j
        stamp_ns, east, north = self._places[-1]
        before_ns, before_east, before_north = self._before(stamp_ns)
        step = complex(east - before_east, north - before_north)
        velocity = step * S / (stamp_ns - before_ns) if stamp_ns > before_ns else 0j
        return complex(east - self._places[0][1], north - self._places[0][2]), velocity

    def _before(self, stamp_ns: int) -> tuple[int, float, float]:
        """The last place that is a step older."""
        older = (each for each in reversed(self._places) if stamp_ns - each[0] >= STEP_S * S)
        return next(older, self._places[0])

    def _by_places(self, stamp_ns: int) -> bool:
        """Whether fixes have stayed where they are."""
        places = self._places
        if not places or stamp_ns - places[-1][0] > GNSS_AGE_S * S:
            return False
        newest_ns, east, north = places[-1]
        if self.standing:
            _, before_east, before_north = self._before(newest_ns)
            stepped_m = math.hypot(east - before_east, north - before_north)
            off_m = math.hypot(east - self._place[0], north - self._place[1])
            return stepped_m < STEP_M and off_m < LEFT_M
        stays = all(math.hypot(e - east, n - north) < SAME_PLACE_M for _, e, n in places)
        self._place = east, north
        return stays and newest_ns - places[0][0] >= LEAST_PLACES_S * S

    def step(
        self,
        stamp_ns: int,
        u: Array | None,
        dt_s: float,
        speed_mps: float,
        speed_variance: float,
        bias_z: float,
    ) -> bool:
        """Decide for the instant `stamp_ns`.

        Parameters
        ----------
        u : record or None
            Numbers of one `Reading`; None without an inertial sensor.
        speed_mps : float
            As the filter knows it; NaN if it does not.
        bias_z : float
            Of the vertical gyroscope.
        """
        if stamp_ns - self._last_ns > PAUSE_S * S:  # nobody has seen that it stood all the time
            self._quiet_ns, self._started = stamp_ns, False
        if u is not None:
            self._last_ns = stamp_ns
            self._read(stamp_ns, u, dt_s, speed_mps, bias_z)
        if stamp_ns - self._wheel_ns < WHEELS_STILL_S * S and self._wheel_ns:
            standing = self._by_wheels(stamp_ns, speed_mps, speed_variance)
        elif u is None and self._places:
            standing = self._by_places(stamp_ns)
        else:
            standing = u is not None and stamp_ns - self._quiet_ns > STILL_S * S
            if standing and not self.standing and self.since_ns:
                standing = stamp_ns - self.since_ns > RUN_S * S
        if standing != self.standing:
            self.standing, self.since_ns = standing, stamp_ns
            self._shaking["stop_force"] = self._shaking["mean_force"][0, X]
        return standing

    def _by_wheels(self, stamp_ns: int, speed_mps: float, speed_variance: float) -> bool:
        if stamp_ns - self._turned_ns < WHEELS_STILL_S * S:
            return False
        fast = self._gnss_ns - self._fast_ns > FAST_S * S
        if fast and stamp_ns - self._gnss_ns < GNSS_AGE_S * S:
            return False
        std_mps = math.sqrt(max(speed_variance, 0.0))
        # NaN: not known, so it stands.
        return not abs(speed_mps) > LOCKED_MPS + LOCKED_SIGMA * std_mps

    def _read(self, stamp_ns: int, u: Array, dt_s: float, speed_mps: float, bias_z: float) -> None:
        if not self._started:
            self._numbers[:6] = u[:6]  # the means; nothing is known of variances
            self._started, self._quiet_ns = True, stamp_ns
            self._shaking["stop_force"] = self._shaking["mean_force"][0, X]
        known = stamp_ns - self._gnss_ns < GNSS_AGE_S * S
        if not may_stand(
            self._numbers,
            u,
            dt_s,
            self.standing,
            known,
            self._gnss_mps,
            speed_mps,
            bias_z,
        ):
            self._quiet_ns = stamp_ns
