"""Figures of the system's health: states of filter, nodes and devices, and how keys came."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, FactorRange, HoverTool, LegendItem

from tramstream import keys
from tramstream.analysis.report.charts import (
    BAD,
    CALM,
    FILTER,
    GNSS,
    OTHER,
    SOFT,
    WHEELS,
    Timeline,
    clock_axis,
    legend,
    plain_figure,
)
from tramstream.analysis.report.material import Material
from tramstream.analysis.report.page import Page
from tramstream.boundary import name_of
from tramstream.clock import S
from tramstream.estimation.series import Array, Instants, StateSeries
from tramstream.proto.estimate_pb2 import MotionState
from tramstream.proto.health_pb2 import DeviceHealth, Loss, NodeHealth
from tramstream.recorder.health import Health, Run

ROW_PX = 24
MOST_ROWS = 200
"""Of a table of losses or sentences."""
COLOURS = {
    "OK": OTHER,
    "OPEN": OTHER,
    "TRACKING": OTHER,
    "STARTING": CALM,
    "HEADING_UNKNOWN": WHEELS,
    "DEGRADED": GNSS,
    "SILENT": GNSS,
    "DEAD_RECKONING": GNSS,
    "FAILED": BAD,
    "LOST": BAD,
}
FEWEST = 4
"""Usual messages a bin, for a key to have a rate."""
TOLERANCE, EDGES = 0.1, 1.5
"""A bin whose count is off by no more than a tenth, or by a message at either edge, is steady."""


def states_figure(timeline: Timeline, health: Health, states: StateSeries | None) -> Any:
    """One row a node or device, coloured by its state; nothing where it was silent."""
    rows = {"filter": mode_runs(states)} if states is not None else {}
    rows |= {f"{name} node": runs for name, runs in sorted(health.nodes.items())}
    rows |= {f"{name} device": runs for name, runs in sorted(health.devices.items())}
    plot = _rows_figure("", timeline, list(rows))
    by_state: dict[str, list[tuple[str, Run]]] = {}
    for name, runs in rows.items():
        for run in runs:
            by_state.setdefault(run.state, []).append((name, run))
    items, drawn = [], []
    for state in sorted(by_state, key=_rank):
        bars = by_state[state]
        source = ColumnDataSource(
            {
                "row": [name for name, _ in bars],
                "start": timeline.ms(np.array([run.start_ns for _, run in bars])),
                "end": timeline.ms(np.array([run.end_ns for _, run in bars])),
                "state": [_said(state)] * len(bars),
                "text": [run.text for _, run in bars],
            }
        )
        style = {"height": 0.6, "fill_color": COLOURS.get(state, SOFT), "line_color": None}
        drawn.append(plot.hbar("row", left="start", right="end", source=source, **style))
        items.append(LegendItem(label=_said(state), renderers=[drawn[-1]]))
    legend(plot, items)
    _add_hover(timeline, plot, drawn, "<b>@row</b> @state @text", "@start")
    return plot


def _rank(state: str) -> int:
    """Place among the colours; states of a newer version come last."""
    return list(COLOURS).index(state) if state in COLOURS else len(COLOURS)


def mode_runs(states: StateSeries) -> list[Run]:
    """How the filter went on: starting, tracking, dead reckoning."""
    mode, stamp_ns = states.mode, states.stamp_ns
    starts = np.flatnonzero(np.append(True, mode[1:] != mode[:-1]))
    ends = np.append(starts[1:], len(mode) - 1)
    return [
        Run(name_of(MotionState.Mode, int(mode[a])), "", int(stamp_ns[a]), int(stamp_ns[b]))
        for a, b in zip(starts, ends, strict=True)
    ]


def _said(state: str) -> str:
    return state.lower().replace("_", " ")


def rates_figure(timeline: Timeline, edges_ns: Instants, rates_hz: Mapping[str, Array]) -> Any:
    """One row a key, coloured by its rate against what is usual for it."""
    plot = _rows_figure("Rate of every key against its usual rate", timeline, list(rates_hz))
    start, end = timeline.ms(edges_ns[:-1]), timeline.ms(edges_ns[1:])
    width_s = np.diff(edges_ns) / S
    kinds: dict[str, dict[str, list[Any]]] = {}
    for path, rate in rates_hz.items():
        for kind, which in _kinds(path, rate * width_s).items():
            if not which.any():
                continue
            table = kinds.setdefault(kind, {"row": [], "start": [], "end": [], "rate": []})
            for first, last in _joined(which):
                table["row"].append(path)
                table["start"].append(start[first])
                table["end"].append(end[last])
                table["rate"].append(float(rate[first : last + 1].mean()))
    colours = {"steady": OTHER, "slower": GNSS, "faster": FILTER, "none": BAD, "now and then": SOFT}
    items, drawn = [], []
    for kind, colour in colours.items():
        if kind in kinds:
            style = {"height": 0.7, "fill_color": colour, "line_color": None}
            source = ColumnDataSource(kinds[kind])
            drawn.append(plot.hbar("row", left="start", right="end", source=source, **style))
            items.append(LegendItem(label=kind, renderers=[drawn[-1]]))
    legend(plot, items)
    _add_hover(timeline, plot, drawn, "<b>@row</b> @rate{0.[00]} Hz", "@start")
    return plot


def _kinds(path: str, counts: Array) -> dict[str, Any]:
    """Bins by how their count compares with the median of this ride."""
    key = keys.find(path)
    usual = float(np.median(counts))
    if (key is not None and key.rate_hz == 0) or usual < FEWEST:
        return {"now and then": counts > 0}  # too few a bin to speak of a rate
    off = counts - usual
    tolerance = max(TOLERANCE * usual, EDGES)
    return {
        "none": counts == 0,
        "slower": (counts > 0) & (off < -tolerance),
        "steady": np.abs(off) <= tolerance,
        "faster": off > tolerance,
    }


def _joined(mask: Any) -> list[tuple[int, int]]:
    """First and last index of each run in which the mask holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [(int(first), int(last) - 1) for first, last in edges.reshape(-1, 2)]


def _rows_figure(title: str, timeline: Timeline, rows: list[str]) -> Any:
    plot = plain_figure(
        title,
        ROW_PX * len(rows) + 90,
        x_range=timeline.range,
        y_range=FactorRange(*reversed(rows)),
        x_axis_type="datetime",
    )
    clock_axis(plot)
    plot.ygrid.visible = False
    return plot


def _add_hover(timeline: Timeline, plot: Any, drawn: list[Any], text: str, time: str) -> None:
    when = f"<span style='color:{SOFT}'>from {time}{{%H:%M:%S}}</span>"
    hover = HoverTool(renderers=drawn, tooltips=f"<div>{text} {when}</div>")
    hover.formatters = {time: "datetime"}
    timeline.add_tools(plot, hover)


def add_health(page: Page, material: Material, timeline: Timeline) -> None:
    """States, losses, what nodes had to say, and every key."""
    health = material.health
    page.section("Health")
    if health.nodes or health.devices or material.states is not None:
        page.figures([states_figure(timeline, health, material.states)])
    _add_tables(page, health)
    if not health.nodes:
        page.absent("No heartbeats in the record: states of nodes and devices are not known.")
    page.heading("Losses")
    if health.losses:
        head = ("until, UTC", "who missed it", "key", "messages", "cause")
        page.table(
            head,
            [
                (
                    clock(loss.stamp_ns, material),
                    loss.consumer,
                    loss.key,
                    loss.count,
                    name_of(Loss.Cause, loss.cause),
                )
                for loss in health.losses[:MOST_ROWS]
            ],
        )
        _cut(page, len(health.losses))
    else:
        page.note("No node reported a loss.")
    page.heading("What happened")
    if health.happened:
        columns = ("first, UTC", "last, UTC", "who", "event", "level", "times", "the last of them")
        happened = [
            (
                clock(each.first_ns, material),
                clock(each.last_ns, material),
                each.node,
                each.kind,
                each.level.lower(),
                each.count,
                each.last,
            )
            for each in health.happened.values()
        ]
        page.table(columns, happened[:MOST_ROWS])
        _cut(page, len(happened))
    else:
        page.note("No event is in the record.")
    page.heading("Log")
    if health.log:
        rows = [
            (clock(line.stamp_ns, material), line.level.lower(), line.node, line.text)
            for line in health.log[:MOST_ROWS]
        ]
        page.table(("UTC", "level", "node", "sentence"), rows)
        _cut(page, len(health.log))
    else:
        page.note("No node had anything to say.")


def add_keys(page: Page, material: Material, timeline: Timeline) -> None:
    """How steadily every key came, and what is missing by its sequence numbers."""
    page.section(
        "Keys",
        "Steady is within a tenth of the key's median rate. Gaps are of sequence numbers.",
    )
    page.figures([rates_figure(timeline, material.rate_edges_ns, material.rates_hz)])
    descriptions = [material.description, *([material.source] if material.source else [])]
    rows = [
        (
            channel.path,
            channel.type.removeprefix("tramstream."),
            channel.count,
            channel.rate_hz,
            channel.gaps,
            channel.missing,
            channel.restarts,
        )
        for description in descriptions
        for channel in description.channels
    ]
    head = ("key", "type", "messages", "Hz", "gaps", "missing", "restarts")
    page.table(head, rows, fold="All keys as a table")


def clock(stamp_ns: int, material: Material) -> str:
    """Time of day, UTC."""
    seconds, rest_ns = divmod(stamp_ns + (material.utc_offset_ns or 0), S)
    return f"{datetime.fromtimestamp(seconds, UTC):%H:%M:%S}.{rest_ns // 1_000_000:03d}"


def _add_tables(page: Page, health: Health) -> None:
    """The last word of every node and device."""
    nodes = [
        (
            name,
            name_of(NodeHealth.State, beat.state).lower(),
            beat.uptime_s,
            100 * beat.cpu_s / beat.uptime_s if beat.uptime_s else 0.0,
            beat.rss_bytes / 1e6,
            beat.messages_lost,
            beat.faults,
            beat.text,
        )
        for name, beat in sorted(health.last_of_node.items())
    ]
    if nodes:
        head = ("node", "state at the end", "up, s", "CPU, %", "memory, MB", "lost", "faults", "")
        page.table(head, nodes)
    devices = [
        (
            name,
            device.port,
            name_of(DeviceHealth.State, device.state).lower(),
            device.opened,
            device.bytes_received / 1e6,
            device.messages_decoded,
            device.frames_rejected,
            device.samples_lost,
            ", ".join(f"{n} {why}" for why, n in sorted(device.rejected_by_reason.items())),
        )
        for name, device in sorted(health.last_of_device.items())
    ]
    if devices:
        head = ("device", "port", "state at the end", "opened", "MB", "decoded", "rejected", "lost")
        page.table((*head, "reasons"), devices)


def _cut(page: Page, count: int) -> None:
    if count > MOST_ROWS:
        page.note(f"{count - MOST_ROWS} more; see `tramstream echo --file`.")
