"""Which tracks run beside which."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.estimation.kalman import compiled
from tramstream.tracks.network import BACKWARDS, FORWARDS, PARTNER_LEFT, PARTNER_RIGHT

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Bytes = NDArray[np.int8]

PARTNER_M = 8.0
"""Twice the usual distance of two tracks' axes and a metre for the map's noise."""
NEAREST_M = 1.0
"""What is nearer are the same rails: a switch that has not parted yet, or interlaced track."""
PARALLEL_RAD = math.radians(20.0)
_ABREAST_M = 0.75
"""How far ahead or behind another track's sample may lie: samples are up to 1 m apart."""
_APART_M = 40.0
"""A track is its own partner from there on along itself: both legs of a loop."""
_OPPOSITE_FORWARDS, _OPPOSITE_BACKWARDS = 4, 8


class Partners(NamedTuple):
    """What is beside each sample."""

    sides: Bytes
    """Bits PARTNER_LEFT and PARTNER_RIGHT."""
    opposite: Bytes
    """Bits FORWARDS and BACKWARDS: trams that go this way along the track have a parallel track
    beside them where trams go the other way."""


def beside(starts: Integers, rules: Bytes, position: Array, yaw_rad: Array) -> Partners:
    """Find the parallel tracks within `PARTNER_M` of every sample.

    Parameters
    ----------
    starts : ndarray, shape (tracks + 1,)
    rules : ndarray, shape (tracks,)
    position : ndarray, shape (n, 2)
    yaw_rad : ndarray, shape (n,)
    """
    cell = np.floor((position - position.min(axis=0)) / PARTNER_M).astype(np.int64) + 1
    width = int(cell[:, 0].max()) + 2
    key = cell[:, 1] * width + cell[:, 0]
    order = np.argsort(key, kind="stable")
    track = np.repeat(np.arange(len(rules)), np.diff(starts))
    direction = np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
    bits = np.zeros(len(key), dtype=np.int8)
    first = np.searchsorted(key[order], np.arange(width * (int(cell[:, 1].max()) + 3)))
    _look(key, width, first, order, track, rules, position, direction, bits)
    opposite = (bits // _OPPOSITE_FORWARDS) & (FORWARDS | BACKWARDS)
    return Partners(bits & (PARTNER_LEFT | PARTNER_RIGHT), opposite.astype(np.int8))


@compiled
def _look(
    key: Integers,
    width: int,
    first: Integers,
    order: Integers,
    track: Integers,
    rules: Bytes,
    position: Array,
    direction: Array,
    bits: Bytes,
) -> None:
    """Compare each sample with those in its cell of a grid and the eight around it.

    Parameters
    ----------
    key : ndarray, shape (n,)
        Cell of each sample, row by row of `width`.
    first : ndarray
        Where in `order`, samples by cell, those of each cell begin.
    bits : ndarray, shape (n,)
        Changed in place.
    """
    parallel = math.cos(PARALLEL_RAD)
    for i in range(len(key)):
        for row in range(-1, 2):
            begin = first[key[i] + row * width - 1]
            end = first[key[i] + row * width + 2]
            for at in range(begin, end):
                j = order[at]
                east, north = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
                left = direction[i, 0] * north - direction[i, 1] * east
                if abs(left) < NEAREST_M or abs(left) > PARTNER_M:
                    continue
                along = direction[i, 0] * east + direction[i, 1] * north
                if abs(along) > _ABREAST_M:
                    continue
                same = direction[i, 0] * direction[j, 0] + direction[i, 1] * direction[j, 1]
                if abs(same) < parallel or (track[i] == track[j] and abs(i - j) < _APART_M):
                    continue
                bits[i] |= PARTNER_LEFT if left > 0 else PARTNER_RIGHT
                there = rules[track[j]]
                with_us = FORWARDS if same > 0 else BACKWARDS  # bit of going as i is drawn
                if there & (FORWARDS + BACKWARDS - with_us):
                    bits[i] |= _OPPOSITE_FORWARDS
                if there & with_us:
                    bits[i] |= _OPPOSITE_BACKWARDS
