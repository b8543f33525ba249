"""Turns and vectors of three, compiled: what the smoother's kernels are written in."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tramstream.machine.kernels import compiled

Array = NDArray[np.float64]


@compiled
def rotation(vector: Array) -> Array:
    """Exp of a rotation vector."""
    angle = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if angle > 1e-8:
        a, b = math.sin(angle) / angle, (1 - math.cos(angle)) / angle**2
    else:
        a, b = 1.0, 0.5
    x, y, z = vector[0], vector[1], vector[2]
    C = np.empty((3, 3))
    C[0, 0], C[0, 1], C[0, 2] = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    C[1, 0], C[1, 1], C[1, 2] = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    C[2, 0], C[2, 1], C[2, 2] = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)
    return C


@compiled
def times(C: Array, v: Array) -> Array:
    out = np.empty(3)
    for i in range(3):
        out[i] = C[i, 0] * v[0] + C[i, 1] * v[1] + C[i, 2] * v[2]
    return out


@compiled
def product(A: Array, B: Array) -> Array:
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
    return out


@compiled
def against(A: Array, B: Array) -> Array:
    """A Bᵀ."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[j, 0] + A[i, 1] * B[j, 1] + A[i, 2] * B[j, 2]
    return out


@compiled
def cross_row(row: Array, v: Array, out: Array) -> None:
    """row · [v]×, into `out`: what a turn by θ does to row · v is −row·[v]×·θ."""
    out[0] = row[1] * v[2] - row[2] * v[1]
    out[1] = row[2] * v[0] - row[0] * v[2]
    out[2] = row[0] * v[1] - row[1] * v[0]
