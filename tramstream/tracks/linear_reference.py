"""Places as operators call them: line, direction and chainage from the line's first stop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tramstream.tracks.network import Array, Integers, Network


class Reference(NamedTuple):
    """A place as an operator calls it."""

    line: int
    """Index of `Network.lines`."""
    chainage_m: float
    """Along the line."""


@dataclass(frozen=True)
class References:
    """Which lines go on which run, and how far along them that is; rows lie run after run."""

    starts: Integers
    """First row of each run, and the number of all: shape (2 tracks + 1,)."""
    line: Integers
    from_m: Array
    to_m: Array
    """Part of the run on which the line goes, along the run."""
    offset_m: Array
    """Chainage along the line minus chainage along the run."""

    def at(self, run: int, chainage_m: float) -> list[Reference]:
        """Every line that passes a place of a run, in their order; one that passes twice comes
        twice."""
        return [
            Reference(int(self.line[row]), chainage_m + float(self.offset_m[row]))
            for row in range(int(self.starts[run]), int(self.starts[run + 1]))
            if self.from_m[row] <= chainage_m <= self.to_m[row]
        ]


def references(network: Network) -> References:
    """Tabulate the operator's references of every run."""
    rows: list[tuple[int, int, float, float, float]] = []
    for index, line in enumerate(network.lines):
        offset_m = -line.begin_m
        for run in line.runs:
            length_m = float(network.length_m[run >> 1])
            begin_m, end_m = max(0.0, -offset_m), min(length_m, line.length_m - offset_m)
            rows.append((run, index, begin_m, end_m, offset_m))
            offset_m += length_m
    table = np.array(sorted(rows), dtype=float).reshape(len(rows), 5)
    count = np.bincount(table[:, 0].astype(int), minlength=2 * network.track_count)
    return References(
        np.concatenate([[0], np.cumsum(count)]).astype(np.int32),
        table[:, 1].astype(np.int32),
        table[:, 2],
        table[:, 3],
        table[:, 4],
    )
