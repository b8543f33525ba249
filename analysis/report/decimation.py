"""Choose rows of a long series so that a drawing of them shows what a drawing of all would.

A spike of one sample is what a drawing is looked at for; taking every n-th sample loses it, a mean
flattens it. So the series is cut into equal runs and of each run the extremes stay.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def extremes(columns: ArrayLike, limit: int) -> NDArray[np.intp]:
    """Choose rows in which a column is smallest or largest among its neighbours.

    Of each run of neighbours the rows stay in which some column is smallest, largest, or not known
    (NaN, where a line is broken); the first and the last row stay too. Rows that stay are what was
    measured: nothing is averaged or interpolated.

    Parameters
    ----------
    columns : array_like, shape (n,) or (n, k)
        Series that are drawn together, e.g. a value and the two edges of its band; any unit.
    limit : int
        Most rows to choose; at least 3 k + 2.

    Returns
    -------
    rows : ndarray of int
        Ascending, without repetition; all rows if there are no more than `limit`.
    """
    values = np.asarray(columns, dtype=float)
    values = values[:, None] if values.ndim == 1 else values
    count, width = values.shape
    if count <= limit:
        return np.arange(count)
    unknown = np.isnan(values)
    a_run = width * (3 if unknown.any() else 2)
    runs = (limit - 2) // a_run
    if runs < 1:
        raise ValueError(f"limit {limit}: {width} columns need {a_run + 2}")
    length = -(-count // runs)
    runs = -(-count // length)
    rows = np.minimum(np.arange(runs * length), count - 1).reshape(runs, length)
    start = rows[:, :1]
    chosen = [np.array([0, count - 1])]
    lowest = np.where(unknown, np.inf, values)[rows].argmin(axis=1)
    highest = np.where(unknown, -np.inf, values)[rows].argmax(axis=1)
    chosen += [(start + lowest).ravel(), (start + highest).ravel()]
    if unknown.any():
        inside = unknown[rows]
        first = start + inside.argmax(axis=1)
        chosen.append(first[inside.any(axis=1)])
    return np.unique(np.concatenate(chosen))
