"""What happens on one simulated ride: the scenario's events at their times, and those of chance.

All happenings are intervals of the ride's time. Those of chance (multipath jumps, wheels that slide
or slip at stops) follow from a generator of their own, so that they change no sensor's noise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tramstream.errors import ConfigError
from tramstream.simulation.event_kinds import (
    SIDES,
    Event,
    Fault,
    GnssDrift,
    GnssJump,
    Side,
    Slip,
    Tunnel,
)
from tramstream.simulation.ride import Ride
from tramstream.simulation.scenario import Gnss, Scenario, Wheels

Array = NDArray[np.float64]

MOST_JUMPS = 100_000
"""Of the fixes in a ride: one a second for a day. They are all drawn before the ride begins."""
_SLIDE_S = (0.4, 2.0)
"""Shortest and longest slide or slip of chance."""
_SLIDE_FACTORS = (0.0, 0.95)
_SLIP_FACTORS = (1.05, 1.6)


class Offset(NamedTuple):
    """Fixes are off by `offset_l`; over `rise_s` and `fall_s` the offset comes and goes."""

    start_s: float
    end_s: float
    offset_l: tuple[float, float, float]
    rise_s: float = 0.0
    fall_s: float = 0.0
    velocity: bool = False
    """Whether velocities go with it."""


class Blackout(NamedTuple):
    """No fix."""

    start_s: float
    end_s: float


class Skid(NamedTuple):
    """Wheels turn by `factor` times the vehicle's way, and `speed_error_mps` more."""

    start_s: float
    end_s: float
    wheels: tuple[Side, ...]
    factor: float
    speed_error_mps: float


class Broken(NamedTuple):
    """A sensor's fault from one time of the ride until before another."""

    fault: Fault
    start_s: float
    end_s: float


class Happenings:
    """All that happens on a ride.

    Parameters
    ----------
    scenario : Scenario
    ride : Ride
    rng : Generator
        For what chance brings.

    Raises
    ------
    ConfigError
        For an event at a stop that the line does not have, or that ends before it begins. A place
        beyond the line's last stop is no error: a scenario goes with any line.
    """

    def __init__(self, scenario: Scenario, ride: Ride, rng: Generator) -> None:
        self.ride = ride
        self.offsets: list[Offset] = []
        """Jumps and drifts of the fixes."""
        self.blackouts: list[Blackout] = []
        """Tunnels, until the receiver has found its satellites again."""
        self.skids: list[Skid] = []
        """Slips and slides."""
        self.faults: list[Broken] = []
        """Of sensors, for `simulation.faults`."""
        regain_s = scenario.gnss.reacquisition_s if scenario.gnss else 0.0
        for index, event in enumerate(scenario.events):
            interval = self._interval(event, f"$.events[{index}]")
            if interval is None:
                continue
            start_s, end_s = interval
            if isinstance(event, GnssJump):
                shift = (event.east_m, event.north_m, event.up_m)
                self.offsets.append(Offset(start_s, end_s, shift))
            elif isinstance(event, GnssDrift):
                shift = (event.east_m, event.north_m, event.up_m)
                lasts_s = end_s - start_s
                self.offsets.append(
                    Offset(start_s, end_s, shift, lasts_s, event.recovery_s, event.velocity)
                )
            elif isinstance(event, Tunnel):
                self.blackouts.append(Blackout(start_s, end_s + regain_s))
            elif isinstance(event, Slip):
                factor = 1.0 if event.factor is None else event.factor
                error_mps = event.speed_error_mps or 0.0
                self.skids.append(Skid(start_s, end_s, event.wheels, factor, error_mps))
            elif isinstance(event, Fault):
                self.faults.append(Broken(event, start_s, end_s))
        jumps_rng, skids_rng = rng.spawn(2)
        if scenario.gnss is not None:
            self.offsets += _multipath(scenario.gnss, ride.duration_s, jumps_rng)
        if scenario.wheels is not None:
            self.skids += _skids(scenario.wheels, ride, skids_rng)

    def gnss_offset_l(self, time_s: Array) -> Array:
        """How far fixes are off at each instant, (n, 3)."""
        total = np.zeros((len(time_s), 3))
        for offset in self.offsets:
            rising = (time_s - offset.start_s) / offset.rise_s if offset.rise_s else np.inf
            since = time_s - offset.end_s
            falling = 1 - since / offset.fall_s if offset.fall_s else np.where(since < 0, 1.0, 0.0)
            share = np.where(
                time_s >= offset.start_s, np.clip(np.minimum(rising, falling), 0, 1), 0
            )
            total += share[:, None] * np.array(offset.offset_l)
        return total

    def gnss_drift_l(self, time_s: Array) -> Array:
        """How fast fixes wander off at each instant where their velocities do so too, (n, 3)."""
        total = np.zeros((len(time_s), 3))
        for offset in self.offsets:
            if not (offset.velocity and offset.rise_s and offset.fall_s):
                continue
            rises = (time_s >= offset.start_s) & (time_s < offset.end_s)
            falls = (time_s >= offset.end_s) & (time_s < offset.end_s + offset.fall_s)
            rate = rises / offset.rise_s - falls / offset.fall_s
            total += rate[:, None] * np.array(offset.offset_l)
        return total

    def gnss_lost(self, time_s: Array) -> NDArray[np.bool_]:
        """Whether there is no fix at each instant."""
        lost = np.zeros(len(time_s), dtype=bool)
        for blackout in self.blackouts:
            lost |= (time_s >= blackout.start_s) & (time_s < blackout.end_s)
        return lost

    def slipped_m(self, time_s: Array) -> Array:
        """What left and right wheel have turned beyond their way until each instant, (n, 2).

        In the direction of travel, whichever that was.
        """
        slipped = np.zeros((len(time_s), len(SIDES)))
        gone_m = self.ride.gone_m(time_s)
        for skid in self.skids:
            if skid.start_s > time_s[-1]:
                continue
            ends = self.ride.gone_m([skid.start_s, skid.end_s])
            way = np.clip(gone_m, *ends) - ends[0]
            lasted = np.clip(time_s, skid.start_s, skid.end_s) - skid.start_s
            extra = (skid.factor - 1) * way + skid.speed_error_mps * lasted
            for side in skid.wheels:
                slipped[:, SIDES.index(side)] += extra
        return slipped

    def _interval(self, event: Event, path: str) -> tuple[float, float] | None:
        """Start and end of an event in seconds of the ride; None if the line ends before it."""
        dwells = self.ride.dwells_s
        if event.stop is not None:
            if event.stop > len(dwells):
                raise ConfigError(f"{path}.stop: the line has {len(dwells)} stops")
            start_s, departure_s = dwells[event.stop - 1].tolist()
            end_s = departure_s
        elif event.start_m is not None:
            if event.start_m >= self.ride.farthest_m:
                return None
            start_s = self.ride.time_at_s(event.start_m)
            end_s = start_s
        else:
            start_s = end_s = event.start_s or 0.0
        start_s += event.after_s
        if event.duration_s is not None:
            end_s = start_s + event.duration_s
        elif event.end_m is not None:
            end_s = self.ride.time_at_s(event.end_m)
        if end_s <= start_s:
            raise ConfigError(f"{path}: ends before it begins")
        return start_s, end_s


def _multipath(gnss: Gnss, duration_s: float, rng: Generator) -> list[Offset]:
    """Jumps of the fixes: a Poisson process, durations exponential, offsets normal but bounded."""
    expected = gnss.jumps_per_min / 60 * duration_s
    if expected > MOST_JUMPS:
        raise ConfigError(
            f"$.gnss.jumps_per_min: {expected:.3g} jumps in a ride of {duration_s:.3g} s, there "
            f"may be {MOST_JUMPS}",
            cure="let fixes jump more rarely, or the ride be shorter (dwells, breaks)",
        )
    count = int(rng.poisson(expected))
    starts = np.sort(rng.uniform(0, duration_s, count)).tolist()
    lasts = rng.exponential(gnss.jump_duration_s, count).tolist()
    shifts = rng.standard_normal((count, 2)) * gnss.jump_std_m
    if gnss.jump_max_m is not None:
        too_far = np.maximum(np.hypot(*shifts.T) / gnss.jump_max_m, 1.0)
        shifts = shifts / too_far[:, None]
    return [
        Offset(start, start + last, (east, north, 0.0))
        for start, last, (east, north) in zip(starts, lasts, shifts.tolist(), strict=True)
    ]


def _skids(wheels: Wheels, ride: Ride, rng: Generator) -> list[Skid]:
    """Slides before stops and slips after departures, at some of them."""
    skids: list[Skid] = []
    for arrival_s, departure_s in ride.dwells_s.tolist():
        slides, slips, lasts, depth = rng.uniform(size=(4, 2)).tolist()
        begins = [arrival_s - 4.0, departure_s + 1.0]
        chances = [wheels.slides_per_stop, wheels.slips_per_stop]
        for index, (low, high) in enumerate((_SLIDE_FACTORS, _SLIP_FACTORS)):
            happens = (slides, slips)[index][0] < chances[index]
            if happens and 0 < begins[index] < ride.duration_s:
                last_s = _SLIDE_S[0] + (_SLIDE_S[1] - _SLIDE_S[0]) * lasts[index]
                factor = low + (high - low) * depth[index]
                start_s = begins[index]
                skids.append(Skid(start_s, start_s + last_s, SIDES, factor, 0.0))
    return skids
