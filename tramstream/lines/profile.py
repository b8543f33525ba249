"""Smooth functions of arc length: grade and cant of a line.

A chain of cubics that share value and slope where they meet (Hermite's form); beyond the ends the
end value stays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class Shape(NamedTuple):
    """A profile at some arc lengths: the value, and its first and second derivative."""

    value: Array
    slope_per_m: Array
    bend_per_m2: Array


class Profile:
    """A function of arc length with a continuous first derivative.

    Parameters
    ----------
    knots_m : array_like, shape (n,)
        Ascending.
    values : array_like, shape (n,)
    slopes_per_m : array_like, shape (n,), optional
        None: level at every knot, so that nothing between two knots lies beyond their values.
    """

    def __init__(
        self, knots_m: ArrayLike, values: ArrayLike, slopes_per_m: ArrayLike | None = None
    ) -> None:
        self.knots_m = np.asarray(knots_m, dtype=float)
        self.values = np.asarray(values, dtype=float)
        slopes = np.zeros_like(self.values) if slopes_per_m is None else np.asarray(slopes_per_m)
        self.flat = not np.any(self.values) and not np.any(slopes)
        """Whether it is zero everywhere."""
        length = np.diff(self.knots_m)
        mean = np.diff(self.values) / length
        square = (3 * mean - 2 * slopes[:-1] - slopes[1:]) / length
        cube = (slopes[:-1] + slopes[1:] - 2 * mean) / length**2
        # The value of a piece is c0 + c1 t + c2 t² + c3 t³; before and after lie constant pieces.
        still = np.zeros(1)
        self._starts = np.concatenate([self.knots_m[:1], self.knots_m])
        self._c0 = np.concatenate([self.values[:1], self.values])
        self._c1 = np.concatenate([still, slopes[:-1], still])
        self._c2 = np.concatenate([still, square, still])
        self._c3 = np.concatenate([still, cube, still])

    @classmethod
    def through(cls, knots_m: ArrayLike, values: ArrayLike) -> Profile:
        """Lay a profile through points that rises and falls only where they do.

        References
        ----------
        F. N. Fritsch and J. Butland, "A method for constructing local monotone piecewise cubic
        interpolants", SIAM J. Sci. Stat. Comput. 5 (1984) 300-304, eq. 4.
        """
        knots, points = np.asarray(knots_m, dtype=float), np.asarray(values, dtype=float)
        length = np.diff(knots)
        before, after = length[:-1], length[1:]
        mean = np.diff(points) / length
        one, other = mean[:-1], mean[1:]
        slopes = np.zeros_like(points)
        alike = one * other > 0
        weighted = (after + 2 * before) * one + (2 * after + before) * other
        weighted = np.where(alike, weighted, 1.0)
        slopes[1:-1] = np.where(alike, 3 * (before + after) * one * other / weighted, 0.0)
        return cls(knots, points, slopes)

    @classmethod
    def level(cls) -> Profile:
        """Give the profile that is zero everywhere."""
        return cls([0.0, 1.0], [0.0, 0.0])

    def __call__(self, arc_length_m: ArrayLike) -> Array:
        """Value at each arc length."""
        index, t = self._locate(arc_length_m)
        value: Array = self._c0[index] + t * (
            self._c1[index] + t * (self._c2[index] + t * self._c3[index])
        )
        return value

    def shape(self, arc_length_m: ArrayLike) -> Shape:
        """Value and derivatives at each arc length."""
        index, t = self._locate(arc_length_m)
        c1, c2, c3 = self._c1[index], self._c2[index], self._c3[index]
        return Shape(
            self._c0[index] + t * (c1 + t * (c2 + t * c3)),
            c1 + t * (2 * c2 + 3 * t * c3),
            2 * c2 + 6 * t * c3,
        )

    def _locate(self, arc_length_m: ArrayLike) -> tuple[NDArray[np.intp], Array]:
        """Piece of each arc length and the way into it; piece 0 lies before the first knot."""
        s = np.asarray(arc_length_m, dtype=float)
        index = np.searchsorted(self.knots_m, s, side="right")
        return index, s - self._starts[index]
