"""docs/events.md: every kind of event of ours, with cause and cure.

`python -m tramstream.analysis.report.events_page docs/events.md` writes it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

from tramstream.bridges.gnss import events as receiver
from tramstream.bridges.odometer import events as odometer
from tramstream.bridges.simulators import events as simulators
from tramstream.estimation import events as fixes
from tramstream.events import Kind
from tramstream.events.sentences import unit_of
from tramstream.live import events as live
from tramstream.processors.consistency import events as configuration
from tramstream.processors.distance import events as distance
from tramstream.processors.grade import events as grade
from tramstream.processors.kaspar2023 import events as kaspar2023
from tramstream.processors.localisation import events as ekf
from tramstream.processors.matching import events as matching
from tramstream.processors.segments import events as segments
from tramstream.processors.tram_filter import events as tram
from tramstream.recorder import events as recorder
from tramstream.recorder.file import events as record
from tramstream.supervision import events as supervision

TABLES: dict[ModuleType, str] = {
    live: "Nodes, their inputs and devices",
    receiver: "Receivers and their lines",
    odometer: "Frames of the vehicle bus",
    ekf: "Localisation",
    fixes: "Fixes that no localiser uses",
    tram: "The filter `tram`",
    kaspar2023: "The filter `kaspar2023`",
    matching: "Map matcher",
    distance: "Distance and speed",
    grade: "Slope of the track",
    segments: "Stops, turns and the place on a line",
    configuration: "Configuration against the data",
    supervision: "Processes",
    recorder: "Recorder",
    record: "Files of records",
    simulators: "Simulated devices",
}
"""Where kinds are declared, and what stands above them in the page."""

HEAD = """\
# Events

What the system has to say is an event: a kind and its facts, on `health/<node>/event`
(`tramstream.Event`). No program needs to read English: it takes the kind, and the facts by name,
as in `tramstream echo health/ekf/event` and `tramstream top --json`. People read the sentence: on
`health/<node>/log` (`foxglove.Log`, for the log panel of any viewer), from `tramstream run`, in
`top` and in `report`. A fact's name ends in its unit. Texts say which of many it was, numbers how
much: the same event (kind and texts) is said at once, and again after ten seconds, with how often
it happened between.

What lasts (a device that is away) stands in each heartbeat as a trouble, kind and facts likewise.

A processor of your own declares its kinds in a line each: [processor.md](processor.md).

This page is written by `python -m tramstream.analysis.report.events_page docs/events.md`.
"""


def kinds(table: ModuleType) -> dict[str, Kind]:
    """Kinds that a module declares, by the name that they have there."""
    return {name: value for name, value in vars(table).items() if isinstance(value, Kind)}


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for table, title in TABLES.items():
        parts.append(f"## {title}\n")
        parts += _entries(kinds(table).values())
    return "\n".join(parts)


def _entries(declared: Iterable[Kind]) -> list[str]:
    return [
        "\n".join(
            [
                f"### `{kind.name}`",
                "",
                f"> {kind.sentence}",
                "",
                f"{kind.severity.name.capitalize()}. {kind.cause}",
                *([f"Cure: {kind.cure}."] if kind.cure else []),
                *([f"Facts: {', '.join(_facts(kind))}."] if kind.facts else []),
                "",
            ]
        )
        for kind in declared
    ]


def _facts(kind: Kind) -> list[str]:
    units = {name: unit_of(name) for name in kind.facts}
    return [f"`{name}`" + (f" ({unit})" if unit else "") for name, unit in units.items()]


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page())
