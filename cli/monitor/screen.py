"""`top`'s screen: a board as lines of segments, laid out by hand for any width.

A rich table measures and wraps every cell, four times a second; this costs a tenth of it. Colour
marks only what deserves attention.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

from rich.console import Console, ConsoleOptions, RenderResult
from rich.segment import Segment
from rich.style import Style

from tramstream.clock import S
from tramstream.events.wording import clipped, lasting, number, scaled
from tramstream.monitor.board import Board, DeviceRow, EventRow, KeyRow, Level, NodeRow

PLAIN = Style()
DIM = Style(dim=True)
TITLE = Style(bold=True)
GOOD = Style(color="green")
LEVELS = {
    Level.FINE: PLAIN,
    Level.WARNING: Style(color="yellow"),
    Level.BAD: Style(color="red", bold=True),
}
WIDE = 110
"""From this width on there is room for sizes and ports."""
KEY_WIDTH = 28


@dataclass(frozen=True, slots=True)
class Cell:
    """A piece of a line: `width` 0 takes what is left; `right` is flush right."""

    text: str
    width: int
    style: Style = PLAIN
    right: bool = False


Line = list[Cell]


@dataclass(frozen=True, slots=True)
class Screen:
    """A board that rich can print. With a `height` what does not fit is counted, not shown."""

    board: Board
    title: str = ""
    height: int = 0

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = options.max_width
        lines = list(self._lines(width))
        if self.height and len(lines) > self.height:
            hidden = len(lines) - self.height + 1
            more = f"… {hidden} more lines; a taller window shows them"
            lines[self.height - 1 :] = [[Cell(more, 0, DIM)]]
        for line in lines:
            yield from _segments(line, width)
            yield Segment.line()

    def _lines(self, width: int) -> Iterator[Line]:
        board = self.board
        yield _header(board, width)
        if self.title:
            yield [Cell(self.title, 0, DIM)]
        if board.nodes:
            yield []
            yield from _nodes(board.nodes, width)
        if board.devices:
            yield []
            yield from _devices(board.devices, width)
        if board.events:
            yield []
            yield from _events(board.events, width)
        yield []
        if board.keys:
            yield from _keys(board.keys, width)
        else:
            yield [Cell("nothing on the bus yet", 0, DIM)]


def _header(board: Board, width: int) -> Line:
    clock = time.strftime("%H:%M:%S", time.gmtime(board.now_ns / S)) + " UTC"
    lost = f"{board.lost} lost" if board.lost else "none lost"
    sums = f"{board.rate_hz:.0f} msg/s  {scaled(board.bytes_per_s, 'B/s')}  "
    name_width = max(0, width - len(sums) - len(lost) - len(clock) - 3)
    return [
        Cell(board.vehicle, name_width, TITLE),
        Cell(sums, len(sums)),
        Cell(lost, len(lost), LEVELS[Level.WARNING] if board.lost else PLAIN),
        Cell(f"   {clock}", 0, DIM),
    ]


def _head(*cells: tuple[str, int, bool]) -> Line:
    return [Cell(text, width, DIM, right) for text, width, right in cells]


def _nodes(rows: list[NodeRow], width: int) -> Iterator[Line]:
    name = max(10, *(len(row.node) for row in rows)) + 2
    yield _head(
        ("NODE", name, False), ("STATE", 10, False), ("CPU", 7, True), ("MEMORY", 9, True),
        ("UP", 9, True), ("LOST", 6, True), ("   SAYS", 0, False),
    )  # fmt: skip
    for row in rows:
        uptime = f"{row.uptime_s:.0f} s" if row.uptime_s < 100 else lasting(row.uptime_s)
        cpu = "–" if row.cpu_percent is None else f"{row.cpu_percent:.1f} %"
        says = row.text or (f"last heard {lasting(row.age_s)} ago" if row.state == "SILENT" else "")
        yield [
            Cell(row.node, name),
            Cell(row.state, 10, GOOD if row.level == Level.FINE else LEVELS[row.level]),
            Cell(cpu, 7, right=True),
            Cell(scaled(row.rss_bytes, "B"), 9, right=True),
            Cell(uptime, 9, right=True),
            Cell(str(row.messages_lost), 6, LEVELS[Level(row.messages_lost > 0)], right=True),
            Cell(f"   {says}", 0, LEVELS[row.level]),
        ]


def _devices(rows: list[DeviceRow], width: int) -> Iterator[Line]:
    name = max(10, *(len(row.device) for row in rows)) + 2
    yield _head(
        ("DEVICE", name, False), ("STATE", 10, False), ("RECEIVED", 10, True), ("BAD", 6, True),
        ("LOST", 6, True), ("   PORT", 0, False),
    )  # fmt: skip
    for row in rows:
        # The sentence of a sick device names its port.
        says = row.text or row.port
        yield [
            Cell(row.device, name),
            Cell(row.state, 10, GOOD if row.level == Level.FINE else LEVELS[row.level]),
            Cell(scaled(row.bytes_per_s, "B/s"), 10, right=True),
            Cell(str(row.frames_rejected), 6, LEVELS[Level(row.frames_rejected > 0)], right=True),
            Cell(str(row.samples_lost), 6, LEVELS[Level(row.samples_lost > 0)], right=True),
            Cell(f"   {says}", 0, LEVELS[row.level] if row.text else DIM),
        ]


def _events(rows: list[EventRow], width: int) -> Iterator[Line]:
    source = max(10, *(len(row.source) for row in rows)) + 2
    yield _head(("EVENT", source, False), ("AGO", 8, True), ("   WHAT HAPPENED LAST", 0, False))
    for row in rows:
        yield [
            Cell(row.source, source),
            Cell(lasting(row.age_s), 8, right=True),
            Cell(f"   {row.text}", 0, LEVELS[row.level]),
        ]


def _keys(rows: list[KeyRow], width: int) -> Iterator[Line]:
    wide = width >= WIDE
    name = min(KEY_WIDTH, max(len(row.key) for row in rows)) + 1
    head = [("KEY", name, False), ("RATE Hz", 8, True)]
    head += [("of", 5, True)] if wide else []
    head += [("AGE", 8, True), ("LOST", 6, True)]
    head += [("SIZE", 8, True)] if wide else []
    yield _head(*head, ("  LAST", 0, False))
    layer = ""
    for row in rows:
        first, _, rest = row.key.partition("/")
        text = row.key if first != layer else " " * (len(first) + 1) + rest
        layer = first
        line = [
            Cell(clipped(text, name - 1), name),
            Cell(number(row.rate_hz, 1), 8, LEVELS[row.rate_level], right=True),
        ]
        if wide:
            line.append(Cell(f"{row.nominal_hz:g}" if row.nominal_hz else "", 5, DIM, right=True))
        line += [
            Cell(lasting(row.age_s), 8, LEVELS[row.age_level], right=True),
            Cell(str(row.lost), 6, LEVELS[Level(row.lost > 0)], right=True),
        ]
        if wide:
            line.append(Cell(scaled(row.size_bytes, "B"), 8, right=True))
        yield [*line, Cell(f"  {row.last}", 0)]


def _segments(line: Line, width: int) -> Iterator[Segment]:
    """The cells as few segments: rich handles each several times."""
    left, run, style = width, "", PLAIN
    for cell in line:
        size = min(cell.width or left, left)
        text = clipped(_printable(cell.text), size)
        if cell.right:
            text = text.rjust(size)
        elif cell.width:
            text = text.ljust(size)
        left -= size
        if cell.style is not style:
            if run:
                yield Segment(run, style)
            run, style = "", cell.style
        run += text
    if run:
        yield Segment(run, style)


def _printable(text: str) -> str:
    """Without what would move the cursor: devices send anything."""
    return text if text.isprintable() else "".join(c if c.isprintable() else "·" for c in text)
