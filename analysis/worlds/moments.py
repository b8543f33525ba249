"""What happens in worlds, at times made from a ride: at speed, in corners, at a departure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tramstream.simulation.event_kinds import AnyEvent, GnssDrift, GnssJump, ImuLost
from tramstream.simulation.ride import Ride

Events = Callable[[Ride, float], tuple[AnyEvent, ...]]
"""Of a ride that ends at a time."""
AT_SPEED_MPS = 6.0
FAULT_SHARE = 0.4
"""Of the ride, before a fault: the filter knows by then what it can learn."""
CORNER_PER_M = 1.0 / 60.0
"""Curves that are tighter are corners of streets."""
APART_S = 20.0
"""Between two gaps in corners, at least."""


# Times --------------------------------------------------------------------------------------------
def at_speed_s(ride: Ride, end_s: float, share: float = FAULT_SHARE) -> float:
    """First time after a share of the ride from which on the vehicle goes fast for ten seconds."""
    time_s = np.arange(share * end_s, end_s, 0.5)
    fast = np.abs(ride.motion(time_s).speed_mps) > AT_SPEED_MPS
    for_long = np.convolve(fast, np.ones(20), "full")[19:] == 20
    return float(time_s[int(np.argmax(for_long))])


def corners_s(ride: Ride, end_s: float) -> list[float]:
    """When the vehicle is in the middle of entering tight curves, from the second minute on."""
    time_s = np.arange(60.0, end_s, 0.2)
    motion = ride.motion(time_s)
    bent = np.abs(ride.line.curvature_per_m(motion.arc_length_m)) > CORNER_PER_M
    moving = np.abs(motion.speed_mps) > 2.0
    begins = time_s[1:][(bent & moving)[1:] & ~(bent & moving)[:-1]]
    found: list[float] = []
    for begin in begins.tolist():
        if not found or begin > found[-1] + APART_S:
            found.append(begin)
    return found


# Events -------------------------------------------------------------------------------------------
def lasting(kind: Callable[..., AnyEvent], duration_s: float, **fields: Any) -> Events:
    """A fault that begins at speed."""
    return lambda ride, end_s: (
        kind(start_s=at_speed_s(ride, end_s), duration_s=duration_s, **fields),
    )


def from_start(kind: Callable[..., AnyEvent], **fields: Any) -> Events:
    """A fault all the way."""
    return lambda _, end_s: (kind(start_s=0.0, duration_s=end_s + 60.0, **fields),)


def drift(speed_mps: float) -> Events:
    """Fixes, and velocities in them, wander off until the ride ends."""

    def events(ride: Ride, end_s: float) -> tuple[AnyEvent, ...]:
        start_s = at_speed_s(ride, end_s)
        east_m = speed_mps * (end_s - start_s)
        return (
            GnssDrift(start_s=start_s, duration_s=end_s - start_s, east_m=east_m, velocity=True),
        )

    return events


def corner_gaps(ride: Ride, end_s: float) -> tuple[AnyEvent, ...]:
    """Inertial samples that a logger has drawn straight, in each corner."""
    return tuple(
        ImuLost(start_s=start_s, duration_s=1.5, straight=True)
        for start_s in corners_s(ride, end_s)
    )


def departure_jump(ride: Ride, _: float) -> tuple[AnyEvent, ...]:
    """Fixes that jump around the first departure."""
    departure_s = float(ride.dwells_s[0, 1])
    return (
        GnssJump(start_s=max(departure_s - 3.0, 0.0), duration_s=10.0, east_m=9.0, north_m=-12.0),
    )
