"""What is said of a vehicle whose heading is not known."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tramstream.estimation.fixes import antenna_l
from tramstream.estimation.localiser import Estimate
from tramstream.processors.tram.heading import Search
from tramstream.processors.tram.localiser_memory import LocaliserMemory
from tramstream.processors.tram.navigation import Navigation
from tramstream.processors.tram_filter import estimate as estimates
from tramstream.processors.tram_filter.estimate import STEEPEST


def unplaced(
    estimate: Estimate,
    memory: LocaliserMemory,
    navigation: Navigation,
    search: Search | None,
    standing: bool,
    lever_arm_m: Sequence[float],
) -> Estimate:
    """Say where it is: where it stood and how far it has gone since, or else where its fixes are.

    Parameters
    ----------
    estimate : Estimate
        What the filter has.
    search : Search or None
        That for the heading, if it goes on.
    """
    fix = memory.last_fix
    if fix is None or (standing and search is None):
        return estimates.without_heading(estimate, lever_arm_m)
    if search is not None and search.trying:
        return estimates.without_heading(estimate, lever_arm_m, of_antenna=False)
    gone = search.way(memory.stamp_ns) if search is not None else None
    if gone is not None:
        return estimates.on_way(estimate, *gone, lever_arm_m)
    east, north, up = antenna_l(fix, navigation.level)
    std_m, std_up_m = navigation.accuracies_m(fix)
    way_m2, speed_mps = memory.way_m**2, memory.standstill.speed_over_ground_mps
    if search is not None and search.has_heard(fix.stamp_ns):
        way, way_m2 = search.way_since_fix(memory.stamp_ns)
        east, north = east + way.real, north + way.imag
    stds_m = math.hypot(std_m, math.sqrt(way_m2)), math.hypot(std_up_m, STEEPEST * memory.way_m)
    return estimates.at_fix(estimate, (east, north, up), stds_m, speed_mps, lever_arm_m)
