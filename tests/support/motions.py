"""Motions of a vehicle that the sensors' tests are fed."""

from __future__ import annotations

import numpy as np

from tramstream.simulation.ride import Motion


def motion_of(count: int = 1, **fields: object) -> Motion:
    """Motion of `count` instants, zero but for the fields that are named."""
    zero = {name: np.zeros(count) for name in Motion._fields}
    given = {name: np.broadcast_to(np.asarray(value), count) for name, value in fields.items()}
    motion = {**zero, "standing": np.zeros(count, dtype=bool), **given}
    return Motion(**motion)


def standing(count: int) -> Motion:
    """Stand level at the line's start."""
    return motion_of(count, standing=True)
