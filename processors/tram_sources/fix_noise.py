"""What the filter `tram` takes the error of the fixes for, as it has been learned.

The error has states of its own: a part that lasts `gnss.error_tau_s` and, horizontally, one that
lasts for many minutes. What neighbouring fixes do not share counts by time, not by fix: more fixes
tell no more. Standing, the surroundings stand still too: the error then only walks, and a drift of
the fixes does not move the vehicle.

Equations: docs/theory.md, section 6.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tramstream import keys
from tramstream.clock import S
from tramstream.estimation.fix_error import FixError, FixErrorMemory
from tramstream.estimation.fixes import deviations
from tramstream.estimation.localiser import Verdict
from tramstream.events.kinds import Event
from tramstream.processors.tram_filter.events import RECEIVER_BOASTS
from tramstream.processors.tram_filter.filter import TramFilter
from tramstream.processors.tram_model.slow_error import SlowError
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_sources.slow_fix_error import (
    SLOW_TAU_S,
    SlowFixError,
    SlowFixErrorMemory,
)
from tramstream.proto.gnss_pb2 import GnssFix

_KEY = keys.GNSS_FIX.path
_EAST, _NORTH, _SLOW_EAST, _SLOW_NORTH = (
    int(each) for each in (Ix.GNSS_EAST, Ix.GNSS_NORTH, Ix.GNSS_SLOW_EAST, Ix.GNSS_SLOW_NORTH)
)
WHITE_SHARE = 0.1
"""Part of the deviation that neighbouring fixes do not share."""
WHITE_FLOOR_M = 0.01
"""Noise of a carrier-phase fix, which neighbours do not share."""
INDEPENDENT_S = 0.2
"""Noise of fixes that are less apart is not new noise: a receiver filters its own; chosen by hand,
guarded by `test_more_fixes_of_the_same_error_make_the_filter_no_surer`."""
NEW_REGIME = 2.0
"""Accuracy that changes by this factor is a new situation with an error of its own."""
HEAVY_SIGMA = 2.5
"""Beyond this the error is taken for larger than stated: its noise grows with it."""
HEAVIEST, HEAVIEST_M = 100.0, 5.0
"""... but no more than by this, ten deviations, or to a deviation of so many metres if that is
more. Beyond, every fix would be accepted and none would tell anything; chosen by hand."""
BOASTED = 9.0
"""Drifts of more than so many times the stated variance are believed; chosen by hand."""
BOAST = 3.0
"""A receiver that errs by so many times what it states is said to boast; until it is half of that.
Chosen by hand, guarded by `test_receiver_that_boasts_tenfold_is_said_and_weighed`."""
WAY_S = 10.0
"""For so long the way errs by the same speed, across by that of the heading; chosen by hand."""
STEP = 1.1
"""What is learned of the error is told to the filter when it is off by this factor; by hand."""


@dataclass
class FixNoiseMemory:
    """What `FixNoise` remembers."""

    std_m: float = 0.0
    """As the receiver states it in the present regime; 0 before the first fix."""
    std_up_m: float = 0.0
    """Of the last height."""
    fast: float = 1.0
    """The largest variance over the stated one that the place has been doubted for."""
    up: float = 1.0
    """The largest variance of heights over the stated one that the height has been doubted for."""
    slow_m: float = 0.0
    """Deviation that the slow error's state began with; 0 before the first fix."""
    boasts: bool = False
    """Whether the receiver has been said to."""
    learned: FixErrorMemory = field(default_factory=FixErrorMemory)
    learned_up: FixErrorMemory = field(default_factory=FixErrorMemory)
    """Of heights."""
    slow: SlowFixErrorMemory = field(default_factory=SlowFixErrorMemory)
    fix_ns: int = 0
    """Of the last fix."""
    moved_east_m: float = 0.0
    """How far fixes have moved the place, all together."""
    moved_north_m: float = 0.0
    way_m2: float = 0.0
    """Variance of the way since the slow error was looked at."""


class FixNoise:
    """Tells the filter how large the error of the fixes is and how it goes on.

    Parameters
    ----------
    tau_s : float
        Correlation time that the configuration gives.
    floor_m : float
        Least deviation of a fix on each axis.
    """

    def __init__(self, tau_s: float, floor_m: float, memory: FixNoiseMemory) -> None:
        self._tau_s, self._floor_m = tau_s, floor_m
        self.memory = memory
        self._learned = FixError(tau_s, memory.learned)
        self._learned_up = FixError(tau_s, memory.learned_up, axes=1)
        self._slow = SlowFixError(tau_s, memory.slow)

    def deviations(self, fix: GnssFix) -> tuple[float, float]:
        """Deviation of each horizontal axis and of the height, as far as it is known."""
        std, std_up = deviations(fix, self._floor_m)
        return self._scale * std, math.sqrt(self._up_share) * std_up

    @property
    def std_m(self) -> float:
        """Deviation of a horizontal axis, as far as it is known."""
        return self._scale * self.memory.std_m

    def renew(self, ekf: TramFilter) -> None:
        """Take the error for another one from here on."""
        ekf.set_states(Ix.GNSS_EAST, (0.0, 0.0, 0.0))
        self.memory.std_m = 0.0
        self.restart()

    def restart(self) -> None:
        """Compare errors of the fixes anew: the place was taken for another one until here."""
        self._learned.forget()
        self._learned_up.forget()
        self._slow.forget()

    @property
    def _fast_share(self) -> float:
        """Variance of what lasts for the correlation time, over the stated one.

        A filter that believes a boast follows its fixes, and their error by its place is too small.
        """
        drifts = self._slow.fast
        return max(self._learned.fast, drifts if drifts > BOASTED else 0.0)

    @property
    def _up_share(self) -> float:
        """Variance of a height's error over the stated one; nothing of it counts as slow."""
        return self._learned_up.size

    @property
    def _scale(self) -> float:
        """Deviation over the stated one."""
        return max(self._learned.scale, math.sqrt(self._fast_share))

    @property
    def _slow_share(self) -> float:
        """Variance of what lasts for minutes, over the stated one."""
        return max(self._learned.slow, self._slow.slow)

    def set(self, ekf: TramFilter, std: float, std_up: float) -> None:
        """Let the error be what it is taken for at a fix of the stated deviations."""
        memory = self.memory
        memory.std_up_m = std_up
        up_share = self._up_share
        fast_up = std_up * math.sqrt(up_share)
        fast = std * math.sqrt(self._fast_share)
        if memory.std_m == 0.0 or not 1 / NEW_REGIME < std / memory.std_m < NEW_REGIME:
            if memory.std_m != 0.0:
                ekf.set_states(Ix.GNSS_EAST, (0.0, 0.0, 0.0))
            ekf.forget((Ix.GNSS_EAST, Ix.GNSS_NORTH, Ix.GNSS_UP), (fast, fast, fast_up))
            self._renew_slow_error(ekf, std)
            memory.std_m = std
        self._set_fast_error(ekf)
        if up_share > STEP * memory.up:
            _doubt(ekf, Ix.UP, Ix.GNSS_UP, math.sqrt(up_share / memory.up - 1.0))
            memory.up = up_share
        self._set_slow_error(ekf, memory.std_m * math.sqrt(self._slow_share))
        east, north, up = ekf.state[Ix.GNSS_EAST : Ix.GNSS_UP + 1]
        usual = HEAVY_SIGMA * max(fast, std)
        heavy = _bounded((east * east + north * north) / (usual * usual), max(fast, std))
        heavy_up = _bounded((up / (HEAVY_SIGMA * fast_up)) ** 2, fast_up)
        white = 1.0 - WHITE_SHARE**2
        density = 2.0 * white * fast * fast * heavy / self._tau_s
        up_density = 2.0 * white * fast_up * fast_up * heavy_up / self._tau_s
        ekf.set_fix_error(1.0 / self._tau_s, density, up_density)

    def _renew_slow_error(self, ekf: TramFilter, std: float) -> None:
        """Let the slow error be that of another accuracy: a better one has its own."""
        memory, before_m = self.memory, self.memory.slow_m
        memory.slow_m = std * math.sqrt(max(self._slow_share, 1.0))
        for state in (Ix.GNSS_SLOW_EAST, Ix.GNSS_SLOW_NORTH):
            if memory.slow_m > before_m > 0.0:
                ekf.widen(state, math.sqrt(memory.slow_m**2 - before_m**2))
            else:
                ekf.reset(state, 0.0, memory.slow_m)

    def _set_fast_error(self, ekf: TramFilter) -> None:
        """Let a place that fixes have given be as doubtful as they turn out to be."""
        memory, fast = self.memory, self._fast_share
        if fast > STEP * memory.fast:
            wider = math.sqrt(fast / memory.fast - 1.0)
            for state, error in ((Ix.EAST, Ix.GNSS_EAST), (Ix.NORTH, Ix.GNSS_NORTH)):
                _doubt(ekf, state, error, wider)
            memory.fast = fast

    def _set_slow_error(self, ekf: TramFilter, slow_m: float) -> None:
        """Let the slow error be as large as it is taken to be now, as if it always had been.

        Of the fixes so far only the sum of place and error is known.
        """
        memory = self.memory
        if slow_m > STEP * memory.slow_m:
            wider = math.sqrt(slow_m * slow_m - memory.slow_m * memory.slow_m)
            ekf.exchange(Ix.EAST, Ix.GNSS_SLOW_EAST, wider)
            ekf.exchange(Ix.NORTH, Ix.GNSS_SLOW_NORTH, wider)
            memory.slow_m = slow_m
        elif slow_m * STEP < memory.slow_m:
            ekf.apply(SlowError(1.0 / (1.0 / slow_m**2 - 1.0 / memory.slow_m**2)))
            memory.slow_m = slow_m
        ekf.set_slow_fix_error(1.0 / SLOW_TAU_S, 2.0 * memory.slow_m * memory.slow_m / SLOW_TAU_S)

    def on_track(self, ekf: TramFilter, normal: tuple[float, float], variance_m2: float) -> None:
        """Learn of the error that the fixes have across a track that the filter is held to."""
        if self.memory.std_m > 0.0:
            east, north = error_of_fixes(ekf)
            across_m = normal[0] * east + normal[1] * north
            self._learned.see_across(ekf.stamp_ns, across_m, variance_m2, self.memory.std_m)

    def learn(
        self,
        stamp_ns: int,
        ekf: TramFilter,
        verdicts: list[Verdict],
        std: float,
        moved_m: tuple[float, float],
    ) -> list[Event]:
        """Learn of the error that the fix has by the filter's place; gives what there is to say.

        Parameters
        ----------
        moved_m : tuple of 2 float
            How far the fix has moved the place, to the east and to the north.
        """
        east, north = error_of_fixes(ekf)
        if not verdicts[0].accepted:  # else the error's state has it
            east, north = east + verdicts[0].innovation, north + verdicts[1].innovation
        self._learned.see(stamp_ns, east, north, std)
        self._learn_drift(stamp_ns, ekf, (east, north), std, moved_m)
        memory, times = self.memory, self._scale
        boasts = times > (BOAST / 2.0 if memory.boasts else BOAST)
        said, memory.boasts = memory.boasts or not boasts, boasts
        return [] if said else [RECEIVER_BOASTS(key=_KEY, times=times, stated_m=std)]

    def learn_height(self, stamp_ns: int, ekf: TramFilter, verdict: Verdict, std_up: float) -> None:
        """Learn of the error that the height of the fix has by the filter's."""
        up = ekf.state[Ix.GNSS_UP] + (0.0 if verdict.accepted else verdict.innovation)
        self._learned_up.see(stamp_ns, up, 0.0, std_up)

    def _learn_drift(
        self,
        stamp_ns: int,
        ekf: TramFilter,
        error_m: tuple[float, float],
        std: float,
        moved_m: tuple[float, float],
    ) -> None:
        """Learn of how the fixes drift against the way that no fix has moved."""
        memory, x, variances = self.memory, ekf.state, ekf.variances
        dt_s = (stamp_ns - memory.fix_ns) / S if memory.fix_ns else 0.0
        memory.fix_ns = stamp_ns
        memory.moved_east_m += moved_m[0]
        memory.moved_north_m += moved_m[1]
        across = x[Ix.SPEED] * x[Ix.SPEED] * variances[Ix.YAW]
        memory.way_m2 += WAY_S * dt_s * (across + variances[Ix.SPEED])
        drift_m = error_m[0] + memory.moved_east_m, error_m[1] + memory.moved_north_m
        if self._slow.see(stamp_ns, *drift_m, std, memory.way_m2):
            memory.way_m2 = 0.0


def _doubt(ekf: TramFilter, state: Ix, error: Ix, wider: float) -> None:
    """Take that what fixes have told of a place is their error, to a part more than thought."""
    ekf.exchange(state, error, wider * math.sqrt(ekf.variances[error]))


def _bounded(heavy: float, std: float) -> float:
    """By how much the noise of an error grows, which has a bound."""
    return min(max(1.0, heavy), max(HEAVIEST, (HEAVIEST_M / std) ** 2))


def error_of_fixes(ekf: TramFilter) -> tuple[float, float]:
    """Error of the fixes as the filter has it, to the east and to the north."""
    x = ekf.state
    return x[_EAST] + x[_SLOW_EAST], x[_NORTH] + x[_SLOW_NORTH]


def crowded(since_ns: int) -> float:
    """By how much less a fix tells than one that comes `INDEPENDENT_S` after the last one."""
    return max(INDEPENDENT_S * S / since_ns, 1.0) if since_ns > 0 else 1.0
