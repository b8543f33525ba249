"""What studies of simulated rides share: frames of a ride, for filters in the same process."""

from __future__ import annotations

from collections.abc import Iterator

from tramstream import keys
from tramstream.graph import Graph
from tramstream.processor import Sample
from tramstream.processors.resampling.resampler import Resampler
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.simulation.simulation import Simulation


def frames(simulation: Simulation, fixes: list[GnssFix]) -> Iterator[Sample]:
    """Frames of the ride; its fixes are appended on the way."""
    graph = Graph([Resampler(simulation.vehicle)])
    for sample in simulation.samples():
        if sample.key is keys.GNSS_FIX:
            fixes.append(sample.message)
        for released in graph.step(sample):
            if released.key is keys.SYNC_FRAME:
                yield released
