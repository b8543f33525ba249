"""Figures of keys as a reader sees them: rate, period, size, losses; live or out of a record.

Times are arrivals on the vehicle clock: of this process on the bus, of the recorder in a file.
Sizes are those of payloads. Two views of the same arrivals: `total` over everything seen, `recent`
over a sliding window, which tells what is going on now.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

from tramstream import keys
from tramstream.clock import S
from tramstream.keys import Key
from tramstream.transport.bus import Envelope

WINDOW_S = 10.0
"""Long enough for a steady figure at 1 Hz, short enough to see a change while one looks."""


SESSIONS = 16
"""Publishers of one topic that are told apart."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Of some messages of one key; None where there are too few to tell."""

    count: int = 0
    rate_hz: float | None = None
    period_min_s: float | None = None
    period_max_s: float | None = None
    period_std_s: float | None = None
    bytes_per_s: float | None = None
    size_min_bytes: int | None = None
    size_mean_bytes: float | None = None
    size_max_bytes: int | None = None


class Sequence:
    """Watches the sequence numbers of one topic, of each publisher by itself.

    A publisher that starts anew is told by its session, or, in a record, which names none, by a
    lower number that was published later. What its predecessor sent last cannot be known.
    """

    def __init__(self) -> None:
        self.lost = 0
        self.disordered = 0
        self._last: dict[int, Envelope] = {}

    def missing(self, envelope: Envelope) -> int:
        """Take note of a message; how many are missing right before it."""
        if envelope.sequence == 0:  # a stranger without our header
            return 0
        last = self._last.get(envelope.session)
        if last is None:
            if len(self._last) >= SESSIONS:
                del self._last[next(iter(self._last))]
            self._last[envelope.session] = envelope
            return 0
        if envelope.sequence <= last.sequence:
            if envelope.publish_ns > last.publish_ns:
                self._last[envelope.session] = envelope
            else:
                self.disordered += 1
            return 0
        self._last[envelope.session] = envelope
        missing = envelope.sequence - last.sequence - 1
        self.lost += missing
        return missing


class KeyStats:
    """What came on one topic."""

    def __init__(self, topic: str, window_s: float = WINDOW_S) -> None:
        self.topic = topic
        self.vehicle, path = keys.split(topic)
        self.path = path or topic
        self.key: Key | None = keys.find(path)
        self.count = 0
        self.bytes = 0
        self.sequence = Sequence()
        self.last: Envelope | None = None
        self.before: Envelope | None = None
        """The message before `last`: what grows steadily is told by the difference."""
        self._window_ns = int(window_s * S)
        self._recent: deque[tuple[int, int]] = deque()  # (arrival, size)
        self._first_ns = 0
        self._period_min_ns = self._period_max_ns = 0
        self._period_mean_ns = self._period_square_ns2 = 0.0  # Welford's running sums
        self._size_min = self._size_max = 0

    def add(self, envelope: Envelope) -> None:
        """Take note of a message."""
        size, now_ns = len(envelope.payload), envelope.arrival_ns
        self.sequence.missing(envelope)
        if self.last is None:
            self._first_ns = now_ns
            self._size_min = self._size_max = size
        else:
            self._add_period(now_ns - self.last.arrival_ns)
            self._size_min = min(self._size_min, size)
            self._size_max = max(self._size_max, size)
        self.count += 1
        self.bytes += size
        self.before, self.last = self.last, envelope
        recent = self._recent
        recent.append((now_ns, size))
        while len(recent) > 2 and now_ns - recent[0][0] > self._window_ns:
            recent.popleft()

    def _add_period(self, period_ns: int) -> None:
        if self.count == 1:
            self._period_min_ns = self._period_max_ns = period_ns
        self._period_min_ns = min(self._period_min_ns, period_ns)
        self._period_max_ns = max(self._period_max_ns, period_ns)
        deviation_ns = period_ns - self._period_mean_ns
        self._period_mean_ns += deviation_ns / self.count
        self._period_square_ns2 += deviation_ns * (period_ns - self._period_mean_ns)

    @property
    def lost(self) -> int:
        """Messages missing by sequence number."""
        return self.sequence.lost

    @property
    def disordered(self) -> int:
        """Messages that came after a later one."""
        return self.sequence.disordered

    @property
    def type_name(self) -> str:
        """Full name of the message type, as declared with the last message."""
        if self.last is not None:
            return self.last.encoding.rpartition(";")[2]
        return self.key.type.DESCRIPTOR.full_name if self.key is not None else ""

    def age_s(self, now_ns: int) -> float | None:
        """How long ago the last message came; None if none did."""
        return None if self.last is None else max(0, now_ns - self.last.arrival_ns) / S

    def total(self) -> Figures:
        """Figures over everything seen."""
        if self.last is None:
            return Figures()
        span_ns = self.last.arrival_ns - self._first_ns
        rate_hz = (self.count - 1) * S / span_ns if span_ns > 0 else None
        periods = self.count - 1
        mean_bytes = self.bytes / self.count
        return Figures(
            count=self.count,
            rate_hz=rate_hz,
            period_min_s=self._period_min_ns / S if periods else None,
            period_max_s=self._period_max_ns / S if periods else None,
            period_std_s=math.sqrt(self._period_square_ns2 / periods) / S if periods else None,
            bytes_per_s=None if rate_hz is None else rate_hz * mean_bytes,
            size_min_bytes=self._size_min,
            size_mean_bytes=mean_bytes,
            size_max_bytes=self._size_max,
        )

    def rate_hz(self, now_ns: int) -> float | None:
        """Rate now; silence of more than a period lowers it."""
        fresh = self._fresh(now_ns)
        if not fresh:
            return 0.0 if self.count else None
        return _rate_hz([arrival_ns for arrival_ns, _ in fresh], now_ns)

    def recent(self, now_ns: int) -> Figures:
        """Figures of the window that ends now."""
        fresh = self._fresh(now_ns)
        if not fresh:
            return Figures(rate_hz=self.rate_hz(now_ns))
        arrivals = [arrival_ns for arrival_ns, _ in fresh]
        sizes = [size for _, size in fresh]
        rate_hz = _rate_hz(arrivals, now_ns)
        periods = [after - before for before, after in pairwise(arrivals)]
        mean_ns = sum(periods) / len(periods) if periods else 0.0
        mean_bytes = sum(sizes) / len(sizes)
        variance_ns2 = sum((period - mean_ns) ** 2 for period in periods) / max(1, len(periods))
        return Figures(
            count=len(fresh),
            rate_hz=rate_hz,
            period_min_s=min(periods) / S if periods else None,
            period_max_s=max(periods) / S if periods else None,
            period_std_s=math.sqrt(variance_ns2) / S if periods else None,
            bytes_per_s=None if rate_hz is None else rate_hz * mean_bytes,
            size_min_bytes=min(sizes),
            size_mean_bytes=mean_bytes,
            size_max_bytes=max(sizes),
        )

    def _fresh(self, now_ns: int) -> list[tuple[int, int]]:
        """Arrivals within the window; of a slow key the last two, unless they are long past."""
        begin_ns = now_ns - self._window_ns
        fresh = [entry for entry in self._recent if entry[0] >= begin_ns]
        if len(fresh) >= 2 or len(self._recent) < 2:
            return fresh
        first_ns, last_ns = self._recent[-2][0], self._recent[-1][0]
        patience_ns = max(self._window_ns, 2 * (last_ns - first_ns))
        return list(self._recent)[-2:] if now_ns - last_ns <= patience_ns else fresh


def _rate_hz(arrivals: list[int], now_ns: int) -> float | None:
    intervals = len(arrivals) - 1
    if intervals < 1:
        return None
    span_ns = arrivals[-1] - arrivals[0]
    period_ns = span_ns / intervals
    span_ns = max(span_ns, int(now_ns - arrivals[0] - period_ns))
    return intervals * S / span_ns if span_ns > 0 else None


class Stats:
    """`KeyStats` of all topics that come, with losses by sequence number."""

    def __init__(self, window_s: float = WINDOW_S) -> None:
        self.by_topic: dict[str, KeyStats] = {}
        self._window_s = window_s

    def expect(self, topic: str) -> KeyStats:
        """The figures of `topic`, from now on among the results even if nothing comes."""
        found = self.by_topic.get(topic)
        if found is None:
            found = self.by_topic[topic] = KeyStats(topic, self._window_s)
        return found

    def add(self, envelope: Envelope) -> None:
        """Take note of a message."""
        found = self.by_topic.get(envelope.topic) or self.expect(envelope.topic)
        found.add(envelope)

    def in_order(self) -> list[KeyStats]:
        """All keys, layer by layer as in `tramstream.keys`, then by name."""
        return sorted(self.by_topic.values(), key=order)


_LAYERS = {layer: place for place, layer in enumerate(("raw", "sync", "est", "map", "health"))}


def order(stats: KeyStats) -> tuple[int, str, str]:
    """Where a key stands in a list."""
    layer = stats.path.split("/", 1)[0] if stats.vehicle else ""
    return _LAYERS.get(layer, len(_LAYERS)), stats.path, stats.topic
