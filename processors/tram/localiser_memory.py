"""What the localiser `tram` remembers: one tree, with what its parts remember inside."""

from __future__ import annotations

from dataclasses import dataclass, field

from tramstream.estimation.localiser import Estimate
from tramstream.geodesy import LocalLevel
from tramstream.processors.tram.heading import SearchMemory
from tramstream.processors.tram.liveness import LivenessMemory
from tramstream.processors.tram.mounting_witness import WitnessMemory
from tramstream.processors.tram.navigation_memory import NavigationMemory
from tramstream.processors.tram.outage import Parked, SilenceMemory
from tramstream.processors.tram.predictor import AheadMemory
from tramstream.processors.tram.standstill import Standstill
from tramstream.processors.tram_filter.modes import Phase
from tramstream.proto.gnss_pb2 import GnssFix


@dataclass
class LocaliserMemory:
    """What a `TramLocaliser` remembers."""

    level: LocalLevel | None = None
    navigation: NavigationMemory | None = None
    search: SearchMemory | None = None
    standstill: Standstill = field(default_factory=Standstill)
    silence: SilenceMemory = field(default_factory=SilenceMemory)
    ahead: AheadMemory = field(default_factory=AheadMemory)
    liveness: LivenessMemory = field(default_factory=LivenessMemory)
    witness: WitnessMemory = field(default_factory=WitnessMemory)
    parked: Parked | None = None
    phase: Phase = Phase.WAITING
    heard_ns: int = 0
    """Last inertial or wheel reading."""
    wheels_ns: int = 0
    way_m: float = 0.0
    """At most, since the last usable fix."""
    last_fix: GnssFix | None = None
    """Usable."""
    begun_ns: int = 0
    stamp_ns: int = 0
    back_ns: tuple[int, int] = (0, 0)
    """First and last stamp of frames that went on from an earlier time."""
    far_ns: tuple[int, int] = (0, 0)
    """First and last of those fixes in a row that are far away."""
    inertial: bool = False
    last: Estimate | None = None
