"""When the messages of a cycle were sent, where nobody but a late reader stamped them.

A sender's cycle is a clock: message n was sent n periods after the first. A reader on a busy
computer notes arrivals that are right, or late by tenths of a second, and never early; so the
number of a message takes the place of a device's stamp, and `tramstream.clock.ClockFit` finds the
line under which no arrival lies, as it does for the IMU.

1. *Learning*: of the arrivals of `LEARNED_NS` the supporting line (number, arrival) gives the
   period. Where less than a fifth of them lie within `SCATTER` of a period above it the messages
   are no cycle, and their stamps stay what they are.
2. *Numbers*: a message that comes late is the next one until it is seen that those behind it do not
   catch up: a reader that was away finds all that waited at once, and what does not catch up was
   lost. Then the count goes on by as many.
3. *Phase*: what comes a little early lowers the line. What comes half a period before it was sent
   refutes the phase, as does a message after a silence: it begins anew with that arrival. So does
   one that no arrival of `WATCHED` has come near. A cycle that is refuted time and again is none.

4. *Pattern*: a gateway whose task runs every 10 ms sends 25 ms as 20, 30, 20, 30. So of each of
   `CLASSES` numbers in turn the least lateness of `TALLIED` messages is noted; what none of them
   ever falls short of is the sender's, and no lateness.

A sender that is late at random cannot be told from a late reader. No stamp lies after its own
arrival, so that a wrong fit can do no more than believe a message to be later than it is.
Everything depends on the arrivals alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

from tramstream.clock import ClockFit, FitMemory, S, supporting_line
from tramstream.memory.stage import assign

LEARNED = 32
LEARNED_NS = 2 * S
"""So many arrivals at least, over so long: a reader that jitters by a millisecond then tells the
period to a few parts in ten thousand, and so long it is until the fit tells better."""
MOST = 1000
"""Arrivals that are kept for it."""
DROPPED = 8
"""A part of them gives way to newer ones when no period was found."""
WHOLE_NS, WHOLE = 1_000_000, 0.002
"""People set cycles in milliseconds: a period that is so close to one is it."""
SCATTER = 0.25
NEAR = 0.2
"""On a computer at load 15 a fifth of the arrivals was within 0.15 periods of the line; of messages
that come at random a fifth is more than a period away, for 100 of them."""
SHORTEST_NS, LONGEST_NS = S // 1000, S
"""Periods of cyclic messages; what is faster or slower is no wheel's."""
AWAY_NS = 2 * S
"""No reader is away for longer without losing what its adapter holds: the sender was silent."""
EARLY = 0.5
"""So much of a period before it was due a message refutes the phase."""
NOT_CAUGHT_UP = 0.9
APART = 0.5
STUCK = 5
"""So many in a row, `NOT_CAUGHT_UP` periods late and `APART` from the one before: messages were
lost. One that is read with all that waited behind it comes close to the one before."""
WATCHED = 50
OFF = 0.3
"""Periods by which all of `WATCHED` messages are late, where the phase has moved; but for those
that were read with others."""
REFUTED, TOO_OFTEN = 8, 40
"""A refuted phase counts so much, less one for each message that fits; from `TOO_OFTEN` on it is no
cycle."""
CLASSES, TALLIED = 12, 64
"""Patterns of 2, 3, 4, 6 and 12 messages; of so many late ones of a class one is in time, to
2 ms on a computer at load 15."""
PATTERN_NS, PATTERN = 2_000_000, 0.05
"""A pattern is at least so much, and so much of a period."""
MAX_SKEW = 0.01
"""How well the first arrivals tell the period; the fit finds the rest."""
BUCKET_S, BUCKET_PERIODS = 0.25, 8
LATE_NS = 5_000_000
"""What is read later than this counts as late; twice what `wheels.stamp_std_s` expects."""


@dataclass
class CycleMemory:
    """What a `Cycle` remembers."""

    recent: list[int] = field(default_factory=list)
    """Arrivals, while it learns."""
    period_ns: float = 0.0
    """0 while it is not known."""
    fit: FitMemory = field(default_factory=FitMemory)
    number: int = 0
    last_ns: int = 0
    """Arrival of the last message."""
    stuck: int = 0
    least_ns: float = inf
    """The least lateness of those that are stuck."""
    watched: int = 0
    nearest_ns: float = inf
    """The least lateness of those that are watched."""
    refuted: int = 0
    tallied: int = 0
    least: list[float] = field(default_factory=list)
    """Of each class the least lateness since it was tallied last."""
    pattern: list[float] = field(default_factory=list)
    """Of each class how much after its time it is sent; empty while that is not known."""
    late: int = 0
    """Messages that were read late."""
    skipped: int = 0
    """Messages that were found to be lost."""


class Cycle:
    """Stamps for the messages of one identifier.

    Parameters
    ----------
    memory : CycleMemory
        Part of its owner's.
    """

    def __init__(self, memory: CycleMemory) -> None:
        self.memory = memory
        self.late_ns = 0
        """How late the last message was read; 0 while the period is not known."""
        self._made: ClockFit | None = None

    @property
    def period_ns(self) -> float:
        """Of the cycle; 0 while it is not known."""
        return self.memory.period_ns

    def stamp(self, arrival_ns: int) -> int:
        """When a message was sent that arrived then; never after its arrival."""
        memory = self.memory
        self.late_ns = 0
        if not memory.period_ns:
            self._learn(arrival_ns)
            return arrival_ns
        gap_ns, memory.last_ns = arrival_ns - memory.last_ns, arrival_ns
        memory.number += 1
        late_ns = arrival_ns - self._due_ns()
        if late_ns < -EARLY * memory.period_ns:
            self._refute(arrival_ns)
            return arrival_ns
        memory.refuted = max(0, memory.refuted - 1)
        if late_ns > AWAY_NS:
            self._begin(arrival_ns)
            return arrival_ns
        late_ns = self._skip_lost(late_ns, gap_ns)
        if gap_ns >= APART * memory.period_ns and self._has_moved(late_ns):
            self._begin(arrival_ns - round(late_ns - memory.nearest_ns))
        else:
            self._fit.add(self._device_ns(), arrival_ns)
            late_ns -= self._tally(late_ns)
        memory.late += late_ns > LATE_NS
        self.late_ns = max(0, late_ns)
        return arrival_ns - self.late_ns

    @property
    def _fit(self) -> ClockFit:
        """The fit with settings of the period that is known: it is learned while running."""
        if self._made is None:
            bucket_s = max(BUCKET_S, BUCKET_PERIODS * self.memory.period_ns / S)
            step_s = 2 * AWAY_NS / S  # jumps are found here
            self._made = ClockFit(bucket_s, 64, MAX_SKEW, step_s, self.memory.fit)
        return self._made

    def restored(self) -> None:
        """Memory was put back: the fit's settings are of another period."""
        self._made = None

    def _device_ns(self) -> int:
        return round(self.memory.number * self.memory.period_ns)

    def _due_ns(self) -> int:
        return self._fit.host_ns(self._device_ns())

    def _learn(self, arrival_ns: int) -> None:
        memory = self.memory
        recent = memory.recent
        if recent and not 0 <= arrival_ns - recent[-1] <= AWAY_NS:
            recent.clear()
        recent.append(arrival_ns)
        if len(recent) < LEARNED or (recent[-1] - recent[0] < LEARNED_NS and len(recent) < MOST):
            return
        points = [(number, each - recent[0]) for number, each in enumerate(recent)]
        period_ns, offset_ns = supporting_line(points, inf)
        above = sorted(y - offset_ns - period_ns * x for x, y in points)
        above_ns = above[int(NEAR * len(above))]
        if SHORTEST_NS <= period_ns <= LONGEST_NS and above_ns <= SCATTER * period_ns:
            assign(memory, CycleMemory(late=memory.late, skipped=memory.skipped))
            memory.period_ns = _whole(period_ns)
            self._made = None
            for number, each in enumerate([arrival for _, arrival in points]):
                memory.number = number
                self._fit.add(self._device_ns(), each + arrival_ns - points[-1][1])
            memory.last_ns = arrival_ns
        else:
            del recent[: len(recent) // DROPPED]

    def _begin(self, arrival_ns: int) -> None:
        """Let the phase begin anew at a message that was sent then; the period is what it was."""
        memory = self.memory
        memory.period_ns *= 1.0 + self._fit.skew
        self._fit.restart()
        memory.number, memory.stuck, memory.watched, memory.tallied = 0, 0, 0, 0
        memory.least, memory.pattern = [], []
        memory.least_ns = memory.nearest_ns = inf
        self._made = None
        self._fit.add(0, arrival_ns)

    def _refute(self, arrival_ns: int) -> None:
        memory = self.memory
        memory.refuted += REFUTED
        if memory.refuted < TOO_OFTEN:
            self._begin(arrival_ns)
            return
        kept = CycleMemory(late=memory.late, skipped=memory.skipped)
        assign(memory, kept)
        memory.recent.append(arrival_ns)
        self._made = None

    def _skip_lost(self, late_ns: int, gap_ns: int) -> int:
        """Count messages that were lost; how late this one is then."""
        memory = self.memory
        period_ns = memory.period_ns
        if late_ns < NOT_CAUGHT_UP * period_ns or gap_ns < APART * period_ns:
            memory.stuck, memory.least_ns = 0, inf
            return late_ns
        memory.stuck += 1
        memory.least_ns = min(memory.least_ns, late_ns)
        if memory.stuck < STUCK:
            return late_ns
        lost = round(memory.least_ns / period_ns)
        memory.stuck, memory.least_ns = 0, inf
        memory.number += lost
        memory.skipped += lost
        return late_ns - round(lost * period_ns)

    def _tally(self, late_ns: int) -> int:
        """Note how late a message of its class is; how much of that is the sender's."""
        memory = self.memory
        if not memory.tallied:
            memory.least = [inf] * CLASSES
        place = memory.number % CLASSES
        memory.least[place] = min(memory.least[place], late_ns)
        memory.tallied += 1
        own_ns = round(memory.pattern[place]) if memory.pattern else 0
        if memory.tallied >= CLASSES * TALLIED:
            least_ns = max(PATTERN_NS, PATTERN * memory.period_ns)
            known = [each if least_ns <= each < inf else 0.0 for each in memory.least]
            memory.pattern, memory.tallied = known, 0
        return min(own_ns, max(0, late_ns))

    def _has_moved(self, late_ns: int) -> bool:
        """Whether no message has come near its time for long."""
        memory = self.memory
        if memory.watched >= WATCHED:
            memory.watched, memory.nearest_ns = 0, inf
        memory.watched += 1
        memory.nearest_ns = min(memory.nearest_ns, late_ns)
        return memory.watched == WATCHED and memory.nearest_ns > OFF * memory.period_ns


def _whole(period_ns: float) -> float:
    """The period that was set, where it is one of whole milliseconds."""
    whole_ns = round(period_ns / WHOLE_NS) * WHOLE_NS
    return whole_ns if abs(period_ns - whole_ns) < WHOLE * period_ns else period_ns
