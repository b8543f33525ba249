"""The map of a report: tracks on a metric plane, east and north of the local level frame.

There are no tiles, for there is no network; the track itself is the map.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    HoverTool,
    LegendItem,
    PanTool,
    ResetTool,
    WheelZoomTool,
)

from tramstream.analysis.report.charts import (
    BAD,
    POINTS,
    TRUTH,
    Timeline,
    broken,
    legend,
    map_figure,
)
from tramstream.analysis.report.decimation import extremes
from tramstream.estimation.series import Array, Instants

HEIGHT = 560


class Path(NamedTuple):
    """One track: where the vehicle was, and when."""

    name: str
    stamp_ns: Instants
    p_l: Array
    """(n, 2) or (n, 3): east, north, m."""
    colour: str
    speed_mps: Array | None = None
    std_m: Array | None = None
    """Horizontal deviation, as stated."""
    width: float = 1.6
    alpha: float = 1.0


class Stops(NamedTuple):
    """Where the vehicle stood."""

    p_l: Array
    start_ns: Instants
    duration_s: Array


class RideMap:
    """The figure of the map, and the sources that follow the timeline.

    Parameters
    ----------
    timeline : Timeline
        Shared with all other figures.
    """

    def __init__(self, timeline: Timeline) -> None:
        self._timeline = timeline
        self._items: list[LegendItem] = []
        self.path: ColumnDataSource | None = None
        """The track that the timeline's chosen part is marked on; the last one added."""
        self.figure = map_figure(HEIGHT, 0.05)
        self.shown = ColumnDataSource({"east": [], "north": []})
        self.here = ColumnDataSource({"east": [], "north": []})
        self.figure.line(
            "east", "north", source=self.shown, color="#f0e442", line_width=16, line_alpha=0.9
        )

    def track(self, path: Path) -> None:
        """Draw a track as a line, broken where it is silent."""
        source = self._source(path, gaps=True)
        line = self.figure.line(
            "east",
            "north",
            source=source,
            name=path.name,
            color=path.colour,
            line_width=path.width,
            line_alpha=path.alpha,
        )
        self._items.append(LegendItem(label=path.name, renderers=[line]))
        self._hover(line, path)
        self.path = source

    def points(self, path: Path, marker: str = "circle", size: int = 4) -> None:
        """Draw a track as points."""
        if not len(path.stamp_ns):
            return
        style = {"fill_color": path.colour, "line_color": path.colour if marker == "x" else None}
        drawn = self.figure.scatter(
            "east",
            "north",
            source=self._source(path, gaps=False),
            name=path.name,
            marker=marker,
            size=size,
            fill_alpha=path.alpha,
            line_width=2,
            **style,
        )
        self._items.append(LegendItem(label=path.name, renderers=[drawn]))
        self._hover(drawn, path)

    def stops(self, stops: Stops) -> None:
        """Mark where the vehicle stood."""
        if not len(stops.start_ns):
            return
        source = ColumnDataSource(
            {
                "east": stops.p_l[:, 0],
                "north": stops.p_l[:, 1],
                "time": self._timeline.ms(stops.start_ns),
                "duration": stops.duration_s,
            }
        )
        style = {"fill_color": "white", "line_color": TRUTH, "line_width": 1.5, "size": 9}
        drawn = self.figure.scatter("east", "north", source=source, name="stands", **style)
        self._items.append(LegendItem(label="stands", renderers=[drawn]))
        text = "<b>stands</b> @duration{0} s <span style='color:#57606a'>@time{%H:%M:%S}</span>"
        self._add_hover(drawn, text)

    def finish(self) -> Any:
        """Add the marker, legend and tools; give the figure."""
        plot = self.figure
        style = {"fill_color": BAD, "line_color": "white", "line_width": 2, "size": 12}
        plot.scatter("east", "north", source=self.here, **style)
        legend(plot, self._items)
        pan = PanTool()
        plot.add_tools(
            pan, WheelZoomTool(modifiers="ctrl"), BoxZoomTool(match_aspect=True), ResetTool()
        )
        plot.toolbar.active_drag = pan
        plot.toolbar.logo = None
        plot.toolbar_location = "right"
        return plot

    def _source(self, path: Path, gaps: bool) -> ColumnDataSource:
        columns = [path.p_l[:, 0], path.p_l[:, 1]]
        names = ["east", "north"]
        for name, values in (("speed", path.speed_mps), ("std", path.std_m)):
            if values is not None:
                columns.append(values)
                names.append(name)
        stamp_ns, table = path.stamp_ns, np.stack(columns, axis=1)
        if gaps:
            stamp_ns, table = broken(stamp_ns, table)
        rows = extremes(table[:, :2], POINTS)
        data = {name: table[rows, k].astype(np.float32) for k, name in enumerate(names)}
        return ColumnDataSource({"time": self._timeline.ms(stamp_ns[rows]), **data})

    def _hover(self, drawn: Any, path: Path) -> None:
        text = f"<b>{_plain(path.name)}</b> "
        if path.speed_mps is not None:
            text += "@speed{0.0} m/s "
        if path.std_m is not None:
            text += "σ @std{0.00} m "
        self._add_hover(drawn, text + "<span style='color:#57606a'>@time{%H:%M:%S.%3N}</span>")

    def _add_hover(self, drawn: Any, text: str) -> None:
        hover = HoverTool(renderers=[drawn], tooltips=f"<div>{text}</div>", visible=False)
        hover.formatters = {"@time": "datetime"}
        self.figure.add_tools(hover)


def _plain(name: str) -> str:
    """A name without what bokeh or a browser would read as more than text."""
    return "".join(letter for letter in name if letter not in "@$<>&{}")
