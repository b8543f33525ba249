"""Many simulated rides through the processor `segments`, judged: what docs/segments.md states."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from tramstream import keys
from tramstream.analysis.segments import judging
from tramstream.analysis.segments.judging import Found, Stops, Turns
from tramstream.analysis.segments.rides import Ridden, World, frames, lines_of, ridden
from tramstream.processor import Sample
from tramstream.processors.segments.processor import SegmentFinder
from tramstream.tracks.network import Network
from tramstream.tracks.signature import Signature

SCALE = 0.03
"""Wheels are larger or smaller than configured by up to so much, as a part."""
KASPAR_WALK = 7.563e-5
WORLDS = {
    "wheels": World(),
    "no wheels": World(wheels=False),
    "pusman2017": World(base="pusman2017", wheels=False),
    "kaspar gyro": World(wheels=False, gyro_walk_radps2_rthz=KASPAR_WALK),
    "kaspar gyro, wheels": World(gyro_walk_radps2_rthz=KASPAR_WALK),
}


class Judged(NamedTuple):
    """What came of a ride."""

    world: str
    line: str
    seed: int
    stops: Stops
    turns: Turns
    found: Found | None
    """None where no place was looked for."""
    events: tuple[str, ...]
    """Kinds of what the processor had to say."""


def scaled(world: World, seed: int) -> World:
    """The world with wheels of a size that nobody knows."""
    if not world.wheels:
        return world
    return world._replace(scale=float(np.random.default_rng(seed + 77).uniform(-SCALE, SCALE)))


def judge(
    world: str, ride: Ridden, lines: Sequence[Signature], stream: Iterable[Sample] | None = None
) -> tuple[Stops, Turns, Found | None, tuple[str, ...]]:
    """Let a ride go through the processor, and judge what it says."""
    finder = SegmentFinder(ride.simulation.vehicle, lines)
    events, places, kinds = [], [], []
    for frame in stream if stream is not None else frames(ride.simulation):
        for said in finder.step(frame):
            if said.key is keys.EST_SEGMENT:
                events.append(said.message)
            elif said.key is keys.MAP_PLACE:
                places.append(said.message)
            elif said.key.quantity == "event":
                kinds.append(said.message.kind)
    found = judging.places(ride, places, lines) if places else None
    return judging.stops(ride, events), judging.turns(ride, events), found, tuple(kinds)


def study(
    worlds: Sequence[str],
    names: Sequence[str],
    seeds: Sequence[int],
    network: Network | None = None,
    duration_s: float | None = None,
    place: bool = True,
    say: Callable[[str], None] = lambda _: None,
) -> Iterator[Judged]:
    """Rides of each world on each line, one after another.

    Parameters
    ----------
    names : sequence of str
        "7/0" of the network, or "built-in".
    place : bool
        Whether a place is looked for, among all lines of the network and the built-in one.
    """
    lines = lines_of(network) if place else []
    for world in worlds:
        for name in names:
            for seed in seeds:
                ride = ridden(scaled(WORLDS[world], seed), seed, network, name, duration_s)
                judged = Judged(world, name, seed, *judge(world, ride, lines))
                say(line_of(judged))
                yield judged


def line_of(judged: Judged) -> str:
    """One line of text."""
    stops, turns, found = judged.stops, judged.turns, judged.found
    parts = [f"{judged.world:12} {judged.line:9} {judged.seed:2}"]
    late = max(
        (float(np.abs(each).max()) for each in (stops.begin_s, stops.end_s) if len(each)),
        default=0.0,
    )
    parts.append(f"stops F1 {stops.f1:.3f} (-{stops.missed} +{stops.false}) {late:.2f} s")
    angle = np.degrees(turns.angle_rad)
    rms = float(np.sqrt(np.mean(angle**2))) if len(angle) else 0.0
    worst = float(np.abs(turns.radius).max()) if len(turns.radius) else 0.0
    missed = turns.missed
    parts.append(f"turns {turns.hits} -{missed} +{turns.false} {rms:.2f}° R {100 * worst:.1f} %")
    if found is not None:
        parts.append(
            f"place 3 m {found.share_3_m:.3f} 10 m {found.share_10_m:.3f} 30 m "
            f"{found.share_30_m:.3f} first {found.first_m:.0f} m off {found.first_error_m:.1f} "
            f"half {found.half_right} near {found.near:.2f} off-line {found.off_m:.0f}"
        )
    return "  ".join([*parts, *sorted(set(judged.events))])
