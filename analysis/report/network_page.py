"""Pieces of a page that shows a track network: tracks, stops, lines, and what was matched to them.

The plan of the network is the map; there are no tiles, for there is no network to load them from.
Arrows, switches and names appear as one comes closer.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    CustomJS,
    CustomJSHover,
    HoverTool,
    LegendItem,
    PanTool,
    ResetTool,
    WheelZoomTool,
)

from tramstream.analysis.report.charts import (
    BAD,
    FILTER,
    FONT,
    GNSS,
    INK,
    OTHER,
    SMOOTHED,
    SOFT,
    WHEELS,
    legend,
    map_figure,
)
from tramstream.analysis.report.network_drawing import (
    View,
    arrow_rows,
    labels,
    plan_at,
    plan_of_nodes,
    rounded,
    thinned,
    track_rows,
)
from tramstream.mapping.lines import path_of
from tramstream.tracks.network import BACKWARDS, FORWARDS, Array, Network, RouteLine

HEIGHT = 720
AROUND = 0.15
AROUND_M = 120.0
"""What is shown around a trace: this share of its extent, and so much more."""
ARROW_NEAR_M, SWITCH_NEAR_M, NAME_NEAR_M = 2500.0, 8000.0, 6000.0
STOP_NEAR_M, POINT_NEAR_M = 10000.0, 3000.0
"""Widest view with these details; with stops and points of a trace at their full size."""
NAMES_A_ROW = 9
"""Of the legend, on a wide screen."""
LINES_SHOWN = 6
"""Most lines that are drawn from the start; more would hide each other."""
ONE_WAY, BOTH_WAYS, CLOSED = SOFT, "#8250df", "#d0d7de"
LINE_COLOURS = (FILTER, BAD, SMOOTHED, WHEELS, GNSS, OTHER, "#7a5195", "#8c6d31")
SURE = ((0.95, SMOOTHED, "sure, 0.95 and more"), (0.5, GNSS, "likely, 0.5 to 0.95"))
DOUBTFUL = (0.0, BAD, "doubtful, less than 0.5")


HELP = (
    "Drag to move, turn the wheel to come closer; arrows, switches and names appear on the way. A "
    "click on a name above the map hides what it names, or shows it.",
    "Under the pointer a track tells its run (the map's numbers of the nodes that it goes from and "
    "to), the chainage along it, what the map says of it, and where on an operator's lines it is.",
)


class Piece(NamedTuple):
    """A part of a run that a vehicle went over."""

    run: int
    from_m: float
    to_m: float
    """Along the run."""
    probability: float
    entered: str = ""
    """When, for people."""


class NetworkFigure:
    """The figure of a network.

    Parameters
    ----------
    network : Network
    surroundings : ndarray, shape (n, 2), optional
        East, north, m, of what shall be seen, a trace for example; tracks far from it are left out.
        Without it all of the network is shown.
    """

    def __init__(self, network: Network, surroundings: Array | None = None) -> None:
        self.network = network
        self._items: list[LegendItem] = []
        self._near: list[tuple[Any, float, float, float]] = []
        # What is drawn from near only: see network_page.js.
        plan = np.column_stack([network.east, network.north])
        self._view = View(plan.min(axis=0), plan.max(axis=0))
        if surroundings is not None and len(surroundings):
            low, high = np.nanmin(surroundings, axis=0), np.nanmax(surroundings, axis=0)
            margin = AROUND * float(np.max(high - low)) + AROUND_M
            self._view = View(low - margin, high + margin)
        self.figure = map_figure(HEIGHT, 0.03)
        corners = np.stack(self._view)
        frame = self.figure.scatter(corners[:, 0], corners[:, 1], size=0, alpha=0.0)
        self.figure.x_range.renderers = self.figure.y_range.renderers = [frame]

    # The network ----------------------------------------------------------------------------------
    def lines(self, shown: bool = True) -> None:
        """Draw each line as a band below the tracks; a click on its name shows or hides it."""
        by_name: dict[str, list[RouteLine]] = {}
        for line in self.network.lines:
            by_name.setdefault(line.line, []).append(line)
        for index, (name, lines) in enumerate(by_name.items()):
            colour = LINE_COLOURS[index % len(LINE_COLOURS)]
            paths = [
                thinned(path_of(self.network, each.runs, each.begin_m, each.length_m))
                for each in lines
            ]
            source = ColumnDataSource(
                {
                    "east": [rounded(path[:, 1]) for path in paths],
                    "north": [rounded(path[:, 2]) for path in paths],
                }
            )
            drawn = self.figure.multi_line(
                "east",
                "north",
                source=source,
                name=f"line {name}",
                color=colour,
                line_width=7,
                line_alpha=0.45,
                visible=shown and len(by_name) <= LINES_SHOWN,
            )
            self._items.append(LegendItem(label=f"line {name}", renderers=[drawn]))

    def tracks(self) -> None:
        """Draw the tracks that are in view, coloured by their rule, with arrows where one may go
        one way only."""
        rows = track_rows(self.network, self._view)
        for label, colour, width, rules in (
            ("one way", ONE_WAY, 1.4, (FORWARDS, BACKWARDS)),
            ("both ways", BOTH_WAYS, 1.8, (FORWARDS | BACKWARDS,)),
            ("closed", CLOSED, 1.4, (0,)),
        ):
            chosen = [row for row in rows if row["rule"] in rules]
            if not chosen:
                continue
            source = ColumnDataSource({name: [row[name] for row in chosen] for name in chosen[0]})
            drawn = self.figure.multi_line(
                "east", "north", source=source, name=label, color=colour, line_width=width
            )
            renderers = [drawn]
            if label == "one way":
                renderers.append(self._arrows())
            self._items.append(LegendItem(label=label, renderers=renderers))
            text = (
                "<b>@run</b> at @chainage{m} of @of m<br>"
                f"<span style='color:{SOFT}'>@told</span><br>@lines{{lines}}"
            )
            self._hover(drawn, text, source, "below")

    def switches(self) -> None:
        """Mark where a run has a choice."""
        nodes = np.flatnonzero(self.network.node_switch)
        plan = plan_of_nodes(self.network)[nodes]
        inside = self._view.holds(plan)
        source = ColumnDataSource(
            {
                "east": rounded(plan[inside, 0]),
                "north": rounded(plan[inside, 1]),
                "node": [str(node) for node in self.network.node_id[nodes[inside]]],
            }
        )
        drawn = self.figure.scatter(
            "east",
            "north",
            source=source,
            name="switches",
            marker="diamond",
            size=0,
            fill_color=BAD,
            line_color=None,
        )
        self._near.append((drawn, SWITCH_NEAR_M, 8, 0))
        self._items.append(LegendItem(label="switches", renderers=[drawn]))
        self._hover(drawn, "<b>switch</b> node @node")

    def stops(self) -> None:
        """Mark the stops, with their names."""
        stops = self.network.stops
        plan = np.array([plan_at(self.network, each.track, each.chainage_m) for each in stops])
        inside = np.flatnonzero(self._view.holds(plan.reshape(-1, 2)))
        if not len(inside):
            return
        plan = plan[inside]
        source = ColumnDataSource(
            {
                "east": rounded(plan[:, 0]),
                "north": rounded(plan[:, 1]),
                "stop": [stops[k].name for k in inside],
                "ref": [stops[k].ref for k in inside],
                "run": [
                    f"{self.network.name_of(2 * stops[k].track)} at {stops[k].chainage_m:.0f} m"
                    for k in inside
                ],
            }
        )
        style = {"fill_color": "white", "line_color": INK, "line_width": 1.4, "size": 4}
        drawn = self.figure.scatter("east", "north", source=source, name="stops", **style)
        self._near.append((drawn, STOP_NEAR_M, 7, 4))
        names = self._names([stops[k].name for k in inside], plan)
        self._items.append(LegendItem(label="stops", renderers=[drawn, names]))
        self._hover(drawn, f"<b>@stop</b> @ref <span style='color:{SOFT}'>@run</span>")

    # What was matched -----------------------------------------------------------------------------
    def trace(self, plan: Array, labels: Sequence[str], name: str = "trace") -> None:
        """Draw places as points; `labels` say when or what each is."""
        source = ColumnDataSource(
            {"east": rounded(plan[:, 0]), "north": rounded(plan[:, 1]), "label": list(labels)}
        )
        style = {"fill_color": FILTER, "line_color": None, "fill_alpha": 0.7, "size": 2}
        drawn = self.figure.scatter("east", "north", source=source, name=name, **style)
        self._near.append((drawn, POINT_NEAR_M, 5, 2))
        self._items.append(LegendItem(label=name, renderers=[drawn]))
        self._hover(drawn, f"<b>{_plain(name)}</b> @label")

    def matched(self, pieces: Iterable[Piece]) -> None:
        """Draw the path over the tracks, coloured by its probability."""
        groups: dict[tuple[float, str, str], list[Piece]] = {}
        for piece in pieces:
            kind = next((each for each in SURE if piece.probability >= each[0]), DOUBTFUL)
            groups.setdefault(kind, []).append(piece)
        for (_, colour, label), chosen in sorted(groups.items(), reverse=True):
            paths = [
                thinned(path_of(self.network, [piece.run], piece.from_m, length_m))
                for piece in chosen
                if (length_m := piece.to_m - piece.from_m) >= 0
            ]
            source = ColumnDataSource(
                {
                    "east": [rounded(path[:, 1]) for path in paths],
                    "north": [rounded(path[:, 2]) for path in paths],
                    "chainage": [
                        rounded(path[:, 0] + piece.from_m)
                        for path, piece in zip(paths, chosen, strict=True)
                    ],
                    "run": [self.network.name_of(piece.run) for piece in chosen],
                    "entered": [piece.entered for piece in chosen],
                    "probability": [f"{piece.probability:.3f}" for piece in chosen],
                }
            )
            drawn = self.figure.multi_line(
                "east", "north", source=source, color=colour, line_width=6, line_alpha=0.6
            )
            self._items.append(LegendItem(label=label, renderers=[drawn]))
            text = "<b>@run</b> at @chainage{m} m, probability @probability<br>@entered"
            self._hover(drawn, text, source)

    def finish(self) -> Any:
        """Add legend and tools; give the figure."""
        plot = self.figure
        legend(plot, self._items)
        (names,) = plot.legend
        names.ncols = NAMES_A_ROW
        pan, wheel = PanTool(), WheelZoomTool()
        plot.add_tools(pan, wheel, BoxZoomTool(match_aspect=True), ResetTool())
        plot.toolbar.active_drag, plot.toolbar.active_scroll = pan, wheel
        plot.toolbar.logo = None
        plot.toolbar_location = "right"
        code = (
            files("tramstream.analysis.report")
            .joinpath("network_page.js")
            .read_text(encoding="utf-8")
        )
        show = CustomJS(args={"near": [list(each) for each in self._near], "plot": plot}, code=code)
        plot.x_range.js_on_change("start", show)
        plot.x_range.js_on_change("end", show)
        return plot

    # Details --------------------------------------------------------------------------------------
    def _arrows(self) -> Any:
        table = arrow_rows(self.network, self._view).astype(np.float32)
        columns = {name: table[:, k] for k, name in enumerate(("east", "north", "angle"))}
        style = {"marker": "triangle", "size": 0, "fill_color": ONE_WAY, "line_color": None}
        drawn = self.figure.scatter(
            "east", "north", angle="angle", source=ColumnDataSource(columns), **style
        )
        self._near.append((drawn, ARROW_NEAR_M, 9, 0))
        return drawn

    def _names(self, names: Sequence[str], plan: Array) -> Any:
        told, places = labels(names, plan)
        columns = {"name": told, "east": rounded(places[:, 0]), "north": rounded(places[:, 1])}
        drawn = self.figure.text(
            "east",
            "north",
            "name",
            source=ColumnDataSource(columns),
            text_font={"value": FONT},
            text_font_size="12px",
            text_color=INK,
            text_alpha=0.0,
            background_fill_color="white",
            background_fill_alpha=0.0,
            padding=1,
            x_offset=8,
            y_offset=-4,
        )
        self._near.append((drawn, NAME_NEAR_M, 0, 0))
        return drawn

    def _hover(
        self, drawn: Any, text: str, corners: ColumnDataSource | None = None, side: str = "above"
    ) -> None:
        """Tell of what is under the pointer; `corners` are those of lines with chainages."""
        hover = HoverTool(
            renderers=[drawn], tooltips=f"<div>{text}</div>", visible=False, attachment=side
        )
        if corners is not None:
            hover.line_policy = "interp"
            code = (
                files("tramstream.analysis.report")
                .joinpath("network_hover.js")
                .read_text(encoding="utf-8")
            )
            found = CustomJSHover(args={"source": corners}, code=code)
            hover.formatters = {"@chainage": found, "@lines": found}
        self.figure.add_tools(hover)


def _plain(name: str) -> str:
    """A name without what bokeh or a browser would read as more than text."""
    return "".join(letter for letter in name if letter not in "@$<>&{}")
