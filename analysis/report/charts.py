"""Figures of a report: drawn by bokeh on a canvas, all over one range of time.

Each trace is thinned to what a screen can show, extremes kept. Where a series is silent for a
while its line is broken.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    CrosshairTool,
    DataRange1d,
    DatetimeTickFormatter,
    HoverTool,
    Legend,
    LegendItem,
    Range1d,
    RangeTool,
    Span,
    WheelZoomTool,
)
from bokeh.plotting import figure

from tramstream.analysis.report.decimation import extremes
from tramstream.clock import S
from tramstream.estimation.series import Array, Instants

FILTER, SMOOTHED, GNSS, WHEELS = "#0072b2", "#009e73", "#e69f00", "#cc79a7"
TRUTH, BAD, CALM, OTHER = "#222222", "#d55e00", "#8c959f", "#56b4e9"
"""Colours of Okabe and Ito, told apart by every eye: what is the same has one colour everywhere."""

POINTS = 4000
"""Most points of a trace: two a pixel of a wide screen."""
SMALL_POINTS, SMALL_HEIGHT = 1500, 190
"""Of figures that stand side by side; the height in px."""
MARGIN, SMALL_MARGIN = 76, 64
"""Left of the axis, px: figures below each other then share their time axis by eye."""
CUT = 0.1
"""Share of a band's edge that may be cut where it is far wider than elsewhere."""
SILENCE_S = 5.0
"""A longer one breaks the line."""
FONT = "system-ui, sans-serif"
INK, SOFT, GRID = "#24292f", "#57606a", "#eaeef2"


@dataclass(frozen=True, slots=True)
class Trace:
    """One series to draw: a line, dots, a band, or a line in a band."""

    name: str
    stamp_ns: Instants
    value: Array | None
    colour: str
    band: tuple[Array, Array] | None = None
    """Low and high edge: filled, or two lines if `edges`."""
    width: float = 1.4
    dash: str = "solid"
    dots: bool = False
    edges: bool = False

    @property
    def known(self) -> bool:
        """Whether there is anything to draw."""
        drawn = self.value if self.value is not None else self.band[0] if self.band else None
        return drawn is not None and bool(np.isfinite(drawn).any())

    @classmethod
    def within(
        cls, name: str, stamp_ns: Instants, value: Array, spread: Array, colour: str
    ) -> Trace:
        """A value in the band of half width `spread` around it."""
        return cls(name, stamp_ns, value, colour, (value - spread, value + spread))


class Spans(NamedTuple):
    """Parts of the ride that are shaded behind the traces."""

    name: str
    start_ns: Instants
    end_ns: Instants
    colour: str
    alpha: float


class Timeline:
    """The time axis that all figures of one report share.

    Parameters
    ----------
    start_ns, end_ns : int
        First and last stamp, vehicle clock.
    utc_offset_ns : int
        UTC minus vehicle clock.
    spans : sequence of Spans
        Shaded in every figure.
    """

    def __init__(
        self, start_ns: int, end_ns: int, utc_offset_ns: int = 0, spans: Sequence[Spans] = ()
    ) -> None:
        self._utc_offset_ns, self._spans = utc_offset_ns, spans
        first, last = self.ms(np.array([start_ns, max(end_ns, start_ns + S)]))
        self.whole = (float(first), float(last))
        self.range = Range1d(*self.whole, bounds=self.whole)
        self.cursor = Span(dimension="height", line_color=SOFT, line_dash="dotted", line_width=1)
        """Follows the pointer through all figures."""

    def ms(self, stamp_ns: Instants) -> Array:
        """UTC in milliseconds since 1970, which is what a browser reckons in."""
        time_ms: Array = (stamp_ns + self._utc_offset_ns) / 1e6
        return time_ms

    def figure(
        self, title: str, unit: str, traces: Iterable[Trace], height: int = 260, small: bool = False
    ) -> Any:
        """Draw `traces` over time; `unit` labels the other axis."""
        plot = plain_figure(
            title,
            SMALL_HEIGHT if small else height,
            x_range=self.range,
            y_range=DataRange1d(range_padding=0.08, only_visible=True),
            x_axis_type="datetime",
        )
        plot.window_axis = "x"
        plot.yaxis.formatter.power_limit_low = -5
        plot.yaxis.axis_label = unit
        clock_axis(plot)
        plot.min_border_left = SMALL_MARGIN if small else MARGIN
        for spans in self._spans:
            _shade(plot, self, spans)
        items, lines, solid = [], [], []
        for trace in traces:
            if trace.known:
                drawn = _draw(plot, self, trace, SMALL_POINTS if small else POINTS)
                lines += drawn[-1:] if trace.value is not None else []
                solid += drawn if not trace.dots else []
                items.append(LegendItem(label=trace.name, renderers=drawn))
        if small:
            plot.xaxis.ticker.desired_num_ticks = 4
        if solid and not small:  # one wild fix shall not squeeze a filter to a line
            plot.y_range.renderers = solid
        if not small:
            legend(plot, items)
        hover = HoverTool(renderers=lines, mode="vline", tooltips=_tooltip(unit))
        hover.formatters = {"@time": "datetime"}
        self.add_tools(plot, hover)
        return plot

    def add_tools(self, plot: Any, hover: Any) -> None:
        """Let a drag choose a part of the ride, in all figures at once."""
        zoom = BoxZoomTool(dimensions="width")
        wheel = WheelZoomTool(dimensions="width", modifiers="ctrl")
        plot.add_tools(zoom, wheel, hover, CrosshairTool(overlay=self.cursor))
        plot.toolbar.active_drag = zoom

    def overview(self, trace: Trace) -> Any:
        """Draw a low figure of the whole ride with a window to move."""
        plot = plain_figure(
            "",
            56,
            x_range=Range1d(*self.whole),
            y_range=DataRange1d(range_padding=0.1),
            x_axis_type="datetime",
        )
        clock_axis(plot)
        plot.yaxis.visible = plot.ygrid.visible = False
        plot.min_border_left = 16
        _draw(plot, self, trace, SMALL_POINTS)
        tool = RangeTool(x_range=self.range, start_gesture="pan")
        tool.overlay.fill_color, tool.overlay.fill_alpha = FILTER, 0.12
        plot.add_tools(tool)
        return plot


def broken(stamp_ns: Instants, table: Array, silence_s: float = SILENCE_S) -> tuple[Any, Array]:
    """Put a row of NaN into every silence, so that no line is drawn across it."""
    steps = np.diff(stamp_ns)
    gaps = np.flatnonzero(steps > silence_s * S) + 1
    if not len(gaps):
        return stamp_ns, table
    return (
        np.insert(stamp_ns, gaps, stamp_ns[gaps - 1] + 1),
        np.insert(table, gaps, np.nan, axis=0),
    )


def map_figure(height: int, padding: float) -> Any:
    """A figure of a plan, as long north as east; `padding` is the share left free at its rims."""
    plot = plain_figure(
        "",
        height,
        x_range=DataRange1d(range_padding=padding),
        y_range=DataRange1d(range_padding=padding),
        match_aspect=True,
        min_border_left=MARGIN,
    )
    plot.xaxis.axis_label, plot.yaxis.axis_label = "east, m", "north, m"
    return plot


def plain_figure(title: str, height: int, **options: Any) -> Any:
    """A figure in the report's style, without tools."""
    plot = figure(
        title=title or None,
        height=height,
        sizing_mode="stretch_width",
        tools="",
        toolbar_location=None,
        outline_line_color=None,
        background_fill_color="white",
        border_fill_color="white",
        min_border_right=12,
        **options,
    )
    if title:
        plot.title.text_font, plot.title.text_font_size = FONT, "13px"
        plot.title.text_color, plot.title.text_font_style = INK, "bold"
    plot.axis.axis_line_color = plot.axis.major_tick_line_color = "#d0d7de"
    plot.axis.minor_tick_line_color = None
    plot.axis.axis_label_text_font = plot.axis.major_label_text_font = FONT
    plot.axis.axis_label_text_font_style = "normal"
    plot.axis.axis_label_text_font_size = plot.axis.major_label_text_font_size = "12px"
    plot.axis.axis_label_text_color = plot.axis.major_label_text_color = SOFT
    plot.grid.grid_line_color = GRID
    return plot


def clock_axis(plot: Any) -> None:
    """Label the time axis as people read clocks."""
    plot.xaxis.formatter = DatetimeTickFormatter(
        milliseconds="%H:%M:%S.%3N",
        seconds="%H:%M:%S",
        minsec="%H:%M:%S",
        minutes="%H:%M",
        hourmin="%H:%M",
        hours="%H:%M",
    )


def legend(plot: Any, items: list[LegendItem]) -> None:
    """Put names above the figure; a click hides what is named."""
    plot.add_layout(
        Legend(
            items=items,
            orientation="horizontal",
            click_policy="hide",
            border_line_color=None,
            background_fill_color=None,
            label_text_font=FONT,
            label_text_font_size="12px",
            label_text_color=SOFT,
            padding=0,
            margin=0,
            spacing=12,
        ),
        "above",
    )


def _draw(plot: Any, timeline: Timeline, trace: Trace, points: int) -> list[Any]:
    """What a trace consists of; the line or the dots come last."""
    series = {"value": trace.value} if trace.value is not None else {}
    if trace.band is not None:
        low, high = _cut(trace.band, trace.value)
        series |= {"low": low, "high": high}
    stamp_ns, table = trace.stamp_ns, np.stack(list(series.values()), axis=1)
    if not trace.dots:
        stamp_ns, table = broken(stamp_ns, table)
    rows = extremes(table, points // 2 if trace.dots else points)
    if trace.dots and len(rows) < len(table):  # extremes alone would leave the middle empty
        rows = np.union1d(rows, np.linspace(0, len(table) - 1, points // 2).astype(int))
    data = {name: table[rows, k].astype(np.float32) for k, name in enumerate(series)}
    source = ColumnDataSource({"time": timeline.ms(stamp_ns[rows]), **data})
    line = {"color": trace.colour, "line_width": trace.width, "line_dash": trace.dash}
    if trace.edges:
        return [plot.line("time", edge, source=source, name=trace.name, **line) for edge in series]
    drawn = []
    if trace.band is not None:
        style = {"fill_color": trace.colour, "fill_alpha": 0.18}
        drawn.append(plot.varea("time", "low", "high", source=source, **style))
    if trace.value is None:
        return drawn
    if trace.dots:
        style = {"size": 3, "color": trace.colour, "line_color": None, "alpha": 0.7}
        drawn.append(plot.scatter("time", "value", source=source, name=trace.name, **style))
    else:
        drawn.append(plot.line("time", "value", source=source, name=trace.name, **line))
    return drawn


def _cut(band: tuple[Array, Array], value: Array | None) -> tuple[Array, Array]:
    """A band without its rare great widths, which would squeeze everything else to a line."""
    low, high = band
    if not np.isfinite(low).any() or not np.isfinite(high).any():
        return band
    bottom, top = np.nanquantile(low, CUT), np.nanquantile(high, 1 - CUT)
    if value is not None:
        bottom, top = min(bottom, np.nanmin(value)), max(top, np.nanmax(value))
    room = (top - bottom) / 4
    return np.maximum(low, bottom - room), np.minimum(high, top + room)


def _shade(plot: Any, timeline: Timeline, spans: Spans) -> None:
    if len(spans.start_ns):
        source = ColumnDataSource(
            {"start": timeline.ms(spans.start_ns), "end": timeline.ms(spans.end_ns)}
        )
        style = {"fill_color": spans.colour, "fill_alpha": spans.alpha, "line_color": None}
        plot.vstrip("start", "end", source=source, level="underlay", **style)


def _tooltip(unit: str) -> str:
    measure = unit.rpartition(", ")[2] if ", " in unit else ""
    return (
        f"<div><b>$name</b> @value{{0.[000]}} {measure} "
        f"<span style='color:{SOFT}'>@time{{%H:%M:%S.%3N}}</span></div>"
    )
