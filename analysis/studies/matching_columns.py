"""What a localisation filter and its map matcher said on a ride, as columns."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tramstream import keys
from tramstream.clock import S
from tramstream.processor import Sample
from tramstream.proto.estimate_pb2 import MapMatch, MotionState
from tramstream.simulation.simulation import EPOCH_NS
from tramstream.simulation.track_rides import Flags, Integers, Spots
from tramstream.tracks.network import Array

NO_RUN = -1
"""Where there is no answer."""
_NUMBERS, _OTHERS = 7, 4
"""Columns of a point, and of an alternative."""


class Said:
    """What the filter and its matcher said, in flat columns."""

    def __init__(self) -> None:
        self.stamp_ns = array("q")
        self._numbers = array("d")
        self._others = array("d")

    def keep(self, outputs: Sequence[Sample]) -> None:
        """Remember what came out of one step, if there was a position."""
        state: MotionState | None = None
        match: MapMatch | None = None
        for output in outputs:
            if output.key is keys.EST_STATE:
                state = output.message
            elif output.key is keys.MAP_MATCH:
                match = output.message
        if state is None:
            return
        row = len(self.stamp_ns)
        self.stamp_ns.append(state.stamp_ns)
        self._numbers.extend((state.latitude_deg, state.longitude_deg))
        if match is None:
            self._numbers.extend((NO_RUN, 0.0, 0.0, 0.0, 0.0))
            return
        run = match.run if match.state == MapMatch.ON_TRACK else NO_RUN
        self._numbers.extend((run, match.chainage_m, match.chainage_std_m))
        self._numbers.extend((match.probability, match.direction_known))
        for each in match.alternatives:
            self._others.extend((row, each.run, each.chainage_m, each.probability))

    def columns(self) -> Columns:
        """The same as arrays."""
        numbers = np.frombuffer(self._numbers).reshape(-1, _NUMBERS)
        others = np.frombuffer(self._others).reshape(-1, _OTHERS)
        return Columns(
            time_s=(np.frombuffer(self.stamp_ns, dtype=np.int64) - EPOCH_NS) / S,
            geodetic=np.radians(numbers[:, :2]),
            spots=Spots(numbers[:, 2].astype(np.int64), numbers[:, 3]),
            std_m=numbers[:, 4],
            probability=numbers[:, 5],
            headed=numbers[:, 6] != 0.0,
            other_row=others[:, 0].astype(np.int64),
            others=Spots(others[:, 1].astype(np.int64), others[:, 2]),
            other_probability=others[:, 3],
        )


class Columns(NamedTuple):
    """Judged points, one row each, and their alternatives."""

    time_s: Array
    """Of the ride."""
    geodetic: Array
    """Of the filter, rad, (n, 2)."""
    spots: Spots
    """Where there is an answer; run `NO_RUN` where there is none."""
    std_m: Array
    probability: Array
    headed: Flags
    other_row: Integers
    """To which point an alternative belongs."""
    others: Spots
    other_probability: Array

    @property
    def answered(self) -> Flags:
        answered: Flags = self.spots.run != NO_RUN
        return answered

    def since(self, first: int) -> Columns:
        """From a row on."""
        kept = self.other_row >= first
        return Columns(
            time_s=self.time_s[first:],
            geodetic=self.geodetic[first:],
            spots=Spots(self.spots.run[first:], self.spots.chainage_m[first:]),
            std_m=self.std_m[first:],
            probability=self.probability[first:],
            headed=self.headed[first:],
            other_row=self.other_row[kept] - first,
            others=Spots(self.others.run[kept], self.others.chainage_m[kept]),
            other_probability=self.other_probability[kept],
        )
