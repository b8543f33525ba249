"""A bounded queue between a bus' or port's thread and a node's worker: the oldest goes first."""

from __future__ import annotations

import queue
import threading
from collections import Counter
from typing import Generic, TypeVar

from tramstream.processor import Ledger

T = TypeVar("T")


class Ring(Generic[T]):
    """Bounded queue that drops its oldest item when full, and counts what it dropped by name.

    `put` is what bus callbacks call, from any number of threads: it takes microseconds and never
    waits for the worker. One thread takes items out.
    """

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.received = 0
        self.taken = 0
        self.dropped_total = 0
        self.dropped: Counter[str] = Counter()
        """Drops by name since the beginning; readers keep their own account of them."""
        self._lock = threading.Lock()  # of the counters: they agree with the queue at any instant
        self._queue: queue.SimpleQueue[tuple[str, T]] = queue.SimpleQueue()

    def __len__(self) -> int:
        return self._queue.qsize()

    def put(self, name: str, item: T) -> None:
        """Append `item`; `name` is what a drop is counted under."""
        with self._lock:
            self.received += 1
            if self._queue.qsize() >= self.capacity:
                try:
                    oldest, _ = self._queue.get_nowait()
                    self.dropped[oldest] += 1
                    self.dropped_total += 1
                except queue.Empty:
                    pass  # the worker was faster
            self._queue.put((name, item))

    def get(self, timeout_s: float) -> T | None:
        """Next item, or None after `timeout_s`."""
        try:
            item = self._queue.get(timeout=max(0.0, timeout_s))[1]
        except queue.Empty:
            return None
        self.taken += 1
        return item

    def ledger(self) -> Ledger:
        """What became of all items; for the thread that takes them out."""
        with self._lock:
            return Ledger(
                "queue", "items", self.received, self.taken, self.dropped_total, len(self)
            )
