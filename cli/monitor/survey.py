"""What `hz` and `bw` share: count what comes, report once a second, or once for a record."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tramstream.cli.monitor.source import Source, Waiting, line
from tramstream.cli.terminal.columns import aligned
from tramstream.monitor.stats import Figures, KeyStats, Stats

PERIOD_S = 1.0


@dataclass(frozen=True, slots=True)
class Sheet:
    """What one verb reports of a key, for people and as plain data."""

    head: tuple[str, ...]
    cells: Callable[[KeyStats, Figures], list[str]]
    data: Callable[[KeyStats, Figures], dict[str, Any]]


class Reporter:
    """Prints reports; the head again whenever other keys are in it."""

    def __init__(self, source: Source, sheet: Sheet, as_json: bool) -> None:
        self._source = source
        self._sheet = sheet
        self._json = as_json
        self._shown: list[str] = []

    def report(self, stats: Stats) -> None:
        """Print the figures: of the window live, of all of a record."""
        now_ns = self._source.now_ns()
        found = stats.in_order()
        figures = [key.recent(now_ns) if self._source.live else key.total() for key in found]
        if self._json:
            for key, of_key in zip(found, figures, strict=True):
                row = {"key": self._source.shown(key.topic), **self._sheet.data(key, of_key)}
                print(line(row), flush=True)
            return
        names = [self._source.shown(key.topic) for key in found]
        rows = [["key", *self._sheet.head]]
        for name, key, of_key in zip(names, found, figures, strict=True):
            rows.append([name, *self._sheet.cells(key, of_key)])
        lines = aligned(rows, left=frozenset([0]))
        several = len(found) > 1
        if names and (several or names != self._shown):
            print(("\n" if self._shown else "") + lines[0])
        self._shown = names or self._shown
        if names:
            print("\n".join(lines[1:]), flush=True)


def survey(
    source: Source,
    stop: threading.Event,
    sheet: Sheet,
    as_json: bool,
    count: int,
    window_s: float,
) -> None:
    """Count and report until `stop`, or the end of the record.

    `count` is the number of reports on the bus, of messages in a record; 0 is no limit.
    """
    stats = Stats(window_s)
    reporter = Reporter(source, sheet, as_json)
    if source.topic:
        stats.expect(source.topic)
    waiting = Waiting(source)
    due_s = time.monotonic() + PERIOD_S
    reports = messages = 0
    for envelope in source.messages(stop):
        waiting.see(envelope)
        if envelope is not None:
            stats.add(envelope)
            messages += 1
            if not source.live and messages == count:
                break
        if source.live and time.monotonic() >= due_s:
            reporter.report(stats)
            due_s += PERIOD_S
            reports += 1
            if reports == count:
                break
    if not source.live:
        reporter.report(stats)
