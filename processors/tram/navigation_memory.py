"""What a navigation remembers: one tree, with what its parts remember inside."""

from __future__ import annotations

from dataclasses import dataclass, field

from tramstream.estimation.localiser import Verdict
from tramstream.estimation.track import TrailMemory
from tramstream.processors.tram_filter.filter import FilterMemory
from tramstream.processors.tram_sources.course import CourseMemory
from tramstream.processors.tram_sources.divergence import DivergenceMemory
from tramstream.processors.tram_sources.gnss import FixesMemory
from tramstream.processors.tram_sources.readings import ReadingsMemory
from tramstream.processors.tram_sources.wheel import PairMemory


@dataclass
class NavigationMemory:
    """What a `Navigation` remembers."""

    filter: FilterMemory
    readings: ReadingsMemory
    wheels: PairMemory = field(default_factory=PairMemory)
    fixes: FixesMemory = field(default_factory=FixesMemory)
    course: CourseMemory = field(default_factory=CourseMemory)
    divergence: DivergenceMemory = field(default_factory=DivergenceMemory)
    contradicted: bool = False
    """Whether several sources have contradicted the filter in this frame."""
    stood: bool = False
    """Whether the vehicle stood in the last frame."""
    trail: TrailMemory = field(default_factory=TrailMemory)
    given: list[Verdict] = field(default_factory=list)
    """Verdicts on what was taken since the last frame."""
    watched: int = 0
    """By which number a watcher finds the place again, where there is one."""
