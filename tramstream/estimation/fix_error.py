"""How large the error of the fixes really is, and how long it lasts: learned from the fixes.

A receiver states a deviation and says nothing of how long an error lasts. What the filter makes of
the fixes, fix minus place, shows it: how much that changes within the correlation time, and within
a quarter of it, against what an error of the stated size would. Where it changes by more, the
receiver boasts; where it changes by less, the rest of what is stated is taken to last for minutes,
for no fix can tell that it is not there. On rails the whole error across is seen.

The learned size is never below the stated one, follows slowly, and each instant counts for no more
than a few of its like. A difference that goes one way all the time is a filter that goes astray,
not noise: nothing is learned from it.

Equations: docs/theory.md, section 6.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tramstream.clock import S

SAMPLE_S = 1.0
"""Errors are kept so far apart in time, whatever the rate of the fixes; chosen by hand."""
PART = 4.0
"""The shorter of the two spans is the correlation time over this; chosen by hand."""
SLACK = 1.5
"""A pair of errors that is further apart than so many spans is none; chosen by hand."""
LIMIT = 4.0
"""One change counts for no more than so many of what is expected, as Huber has it; by hand."""
EVEN = (
    0.0,
    math.erf(math.sqrt(LIMIT / 2.0)) * (1.0 - LIMIT)
    - math.sqrt(2.0 * LIMIT / math.pi) * math.exp(-LIMIT / 2.0)
    + LIMIT,
    1.0 - math.exp(-LIMIT),
)
"""Mean of min(u, LIMIT) where u, a χ² of so many degrees over their number, has the mean 1."""
FIRST_S, MOST_S = 10.0, 200.0
"""Time constant of what is learned: it begins with the first and grows to the second; by hand."""
TRUSTED = 1.7
"""Up to this times the stated variance the receiver is believed; chosen by hand."""
STEADY = 1.5
"""A variance that is seen counts for so much, if it is less than what is stated: it is seen for a
few minutes only; chosen by hand."""
UNSEEN, SEEN = 2.0, 0.9
"""What is seen to be less than the second of these times the stated variance lasts for minutes, and
is so many times what is missing: in streets receivers are too sure of themselves; by hand."""
LEAST_SHARE = 0.1
"""Of the stated variance that is always taken to change within the correlation time; by hand."""
SLOW_SHARE = 0.03
"""Of the variance that is always taken to last for minutes; chosen by hand."""
LARGEST = 1000.0
"""No receiver is believed to boast by more than this in variance; chosen by hand."""
ASTRAY = 0.5
"""Share of the mean square that the squared mean has, of changes that go one way; by hand."""


@dataclass
class FixErrorMemory:
    """What `FixError` remembers."""

    seen: list[tuple[int, float, float, float]] = field(default_factory=list)
    """Stamp, error to the east and the north, m, and what the receiver stated, m."""
    learned_s: float = 0.0
    """For how long something has been learned."""
    whole: float = 1.0
    """Variance over the stated one, by changes within the correlation time."""
    part: float = 1.0
    """The same by changes within a part of it."""
    across: float = 0.0
    """The same by the error across a track; 0 while there is none."""
    across_ns: int = 0
    """When that was last seen."""


class FixError:
    """Learns size and duration of the error of the fixes.

    Parameters
    ----------
    tau_s : float
        Correlation time that the configuration gives.
    axes : int
        How many are learned of together: 2, or 1 for heights, whose north is 0.
    """

    def __init__(self, tau_s: float, memory: FixErrorMemory | None = None, axes: int = 2) -> None:
        self._tau_s, self._axes = max(tau_s, SAMPLE_S), axes
        self.memory = FixErrorMemory() if memory is None else memory

    @property
    def fast(self) -> float:
        """Variance of what lasts for the correlation time, over the stated one."""
        memory = self.memory
        found = min(memory.whole, memory.part)
        if found > TRUSTED:
            return found
        return min(max(STEADY * memory.whole, LEAST_SHARE), 1.0)

    @property
    def size(self) -> float:
        """Variance over the stated one where all of it is taken to last no longer: heights'."""
        return max(min(self.memory.whole, self.memory.part), 1.0)

    @property
    def slow(self) -> float:
        """Variance of what lasts for minutes, over the stated one."""
        fast, memory = self.fast, self.memory
        unseen = UNSEEN * (SEEN - memory.whole)
        return max(unseen, memory.across - fast, SLOW_SHARE * max(fast, 1.0))

    @property
    def scale(self) -> float:
        """Deviation over the stated one."""
        return math.sqrt(max(self.fast, self.memory.across, 1.0))

    def see(self, stamp_ns: int, east_m: float, north_m: float, stated_m: float) -> bool:
        """Take the error of a fix, by the filter's place; whether something was learned.

        Parameters
        ----------
        stated_m : float
            Deviation of an axis, as the receiver states it.
        """
        memory = self.memory
        seen = memory.seen
        if seen and not stamp_ns - seen[-1][0] >= (SAMPLE_S - 0.01) * S:
            return False
        seen.append((stamp_ns, east_m, north_m, stated_m))
        oldest_ns = stamp_ns - round(SLACK * self._tau_s * S)
        while seen[0][0] < oldest_ns:
            del seen[0]
        whole, part = self._change(self._tau_s), self._change(self._tau_s / PART)
        if part is None:
            return False
        memory.learned_s += SAMPLE_S
        gain = SAMPLE_S / min(FIRST_S + memory.learned_s, MOST_S)
        if whole is not None:
            memory.whole = _follow(memory.whole, whole, gain, EVEN[self._axes])
        if part < memory.part or not self._goes_one_way():
            memory.part = _follow(memory.part, part, gain, EVEN[self._axes])
        if whole is None:  # until then the shorter span tells alone
            memory.whole = max(memory.part, 1.0)
        return True

    def see_across(
        self, stamp_ns: int, error_m: float, variance_m2: float, stated_m: float
    ) -> None:
        """Take the error of the fixes across a track that the filter is held to.

        Parameters
        ----------
        variance_m2 : float
            Of the way to the track; what may be the track's error is not the fixes'.
        """
        memory = self.memory
        if not stamp_ns - memory.across_ns >= (SAMPLE_S - 0.01) * S:
            return
        memory.across_ns = stamp_ns
        found = max(error_m * error_m - 2.0 * variance_m2, 0.0) / (stated_m * stated_m)
        limit = LIMIT * max(memory.across, 1.0)
        memory.across += (min(found, limit) - memory.across) / (MOST_S / SAMPLE_S)

    def forget(self) -> None:
        """Begin anew with the differences; what has been learned of their size stays."""
        self.memory.seen.clear()

    def _change(self, span_s: float) -> float | None:
        """Squared change over so long, over what an error of the stated size would have."""
        now_ns, east, north, stated = self.memory.seen[-1]
        for stamp_ns, before_east, before_north, before in reversed(self.memory.seen[:-1]):
            age_s = (now_ns - stamp_ns) / S
            if age_s < span_s - 0.5 * SAMPLE_S:
                continue
            if age_s > SLACK * span_s:
                return None
            changed = (east - before_east) ** 2 + (north - before_north) ** 2
            forgotten = 1.0 - math.exp(-age_s / self._tau_s)
            return changed / (self._axes * forgotten * (stated * stated + before * before))
        return None

    def _goes_one_way(self) -> bool:
        """Whether the changes of the last correlation time are mostly one and the same."""
        seen = self.memory.seen
        apart = max(round(self._tau_s / PART / SAMPLE_S), 1)
        changes = [(b[1] - a[1], b[2] - a[2]) for a, b in zip(seen, seen[apart:], strict=False)]
        count = len(changes)
        if count <= 2 * apart:
            return False
        east, north = (sum(each[k] for each in changes) / count for k in (0, 1))
        square = sum(each[0] ** 2 + each[1] ** 2 for each in changes) / count
        return east * east + north * north > ASTRAY * square


def _follow(value: float, found: float, gain: float, even: float) -> float:
    """Follow a squared change by its logarithm; one that is far off counts for `LIMIT`."""
    followed = value * math.exp(gain * (min(found / value, LIMIT) - even))
    return min(max(followed, 0.5 * LEAST_SHARE), LARGEST)
