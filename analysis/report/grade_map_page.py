"""The page of `tramstream grade-map show`: the tracks coloured by slope beside their profiles."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.models import (
    BoxZoomTool,
    ColorBar,
    ColumnDataSource,
    CustomJS,
    DataRange1d,
    HoverTool,
    LinearColorMapper,
    PanTool,
    ResetTool,
    WheelZoomTool,
)
from bokeh.palettes import interp_palette

from tramstream.analysis.grade_map.assemble import GradeMap
from tramstream.analysis.grade_map.summary import (
    Profile,
    percent,
    profiles,
    sentences,
    std_percent,
)
from tramstream.analysis.grade_map.tables import PROFILE_HEAD, RIDE_HEAD, cells_of_table
from tramstream.analysis.report.charts import (
    BAD,
    FILTER,
    GNSS,
    MARGIN,
    OTHER,
    SOFT,
    map_figure,
    plain_figure,
)
from tramstream.analysis.report.page import Page
from tramstream.geodesy import LocalLevel

HEIGHT, PROFILE_HEIGHT = 480, 230
COLOURS = (FILTER, "#dddddd", BAD)
"""Down, level, up."""
GAP_M = 12.0
"""Cells farther apart along a profile are not joined by a line."""
DRAWN = 12
"""Profiles that are drawn from the start; a city has hundreds of short tracks."""
HELP = (
    "The map shows each cell of a track in the colour of its slope, uphill positive along the line "
    "that it is of (along the track as drawn where no line goes). The profile stands beside the "
    "map, with ±2σ around it; what is under the pointer there is marked on the map.",
    "σ is that of the mean of all rides, with what a ride and a vehicle have wrong all along. "
    "χ²/(n − 1) says whether the rides agree as well as they claim: about 1 is as it should be.",
)


def compose(made: GradeMap, name: str, figures: dict[str, Any]) -> str:
    """Make the page; `figures` are those of `grade-map show`."""
    page = Page(f"Grade map {name}", [*sentences(figures), made.source])
    page.fold("How to read this page", HELP)
    page.tiles(
        [
            (str(len(made.rides)), "rides"),
            (f"{figures['track_km']:.1f} km", "of track"),
            (_figure(figures["grade_std_median_percent"], "%"), "median σ"),
            (str(len(figures["rides_out"])), "rides rejected"),
        ]
    )
    found = sorted(profiles(made), key=lambda each: -len(each.rows))
    for profile in found[:DRAWN]:
        page.section(profile.name)
        page.figures(_beside(made, profile), "two")
    if len(found) > DRAWN:
        page.note(f"{len(found) - DRAWN} shorter profiles are in the table alone.")
    page.section("Profiles")
    _table(page, PROFILE_HEAD, figures["profiles"])
    page.section("Rides")
    _table(page, RIDE_HEAD, figures["by_ride"])
    return page.render(Document())


def _figure(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.3f} {unit}"


def _table(page: Page, head: Any, rows: list[dict[str, Any]]) -> None:
    page.table([name for name, _ in head], list(cells_of_table(head, rows)))


def _beside(made: GradeMap, profile: Profile) -> list[Any]:
    """Map, then profile of slope, χ² and heights below each other, one marker through all."""
    columns, rows = made.columns, profile.rows
    order = np.argsort(profile.at_m, kind="stable")
    rows, at, sign = rows[order], profile.at_m[order], profile.sign[order]
    grade = percent(sign * columns["grade_rad"][rows])
    spread = 2 * std_percent(columns["grade_rad"][rows], columns["grade_std_rad"][rows])
    begin, end = _plan(made, rows)
    low, high = _bounds(grade)
    mapper = LinearColorMapper(palette=interp_palette(COLOURS, 41), low=low, high=high)
    drawn = {
        "east": [[a, b] for a, b in zip(_cm(begin[:, 0]), _cm(end[:, 0]), strict=True)],
        "north": [[a, b] for a, b in zip(_cm(begin[:, 1]), _cm(end[:, 1]), strict=True)],
        "at": np.round(at, 1).tolist(),
        "grade": np.round(grade, 3).tolist(),
        "spread": np.round(spread, 3).tolist(),
        "rides": columns["rides"][rows].tolist(),
    }
    plot = map_figure(HEIGHT, 0.05)
    lines = plot.multi_line(
        "east",
        "north",
        source=ColumnDataSource(drawn),
        line_width=5,
        line_color={"field": "grade", "transform": mapper},
    )
    plot.add_layout(ColorBar(color_mapper=mapper, title="%", width=8), "right")
    marker = ColumnDataSource({"east": [], "north": [], "at": [], "grade": []})
    plot.scatter("east", "north", source=marker, size=12, fill_color=None, line_color="black")
    text = "<div><b>@grade %</b> ± @spread at @at m, @rides rides</div>"
    plot.add_tools(
        PanTool(),
        WheelZoomTool(),
        BoxZoomTool(match_aspect=True),
        ResetTool(),
        HoverTool(renderers=[lines], tooltips=text, attachment="above"),
    )
    plot.toolbar.active_scroll = plot.select_one(WheelZoomTool)
    plot.toolbar_location, plot.toolbar.logo = "right", None
    return [plot, _profile(made, (rows, at, grade, spread), (begin + end) / 2, marker)]


def _bounds(grade: Any) -> tuple[float, float]:
    """The same colour for as steep up and down."""
    most = float(np.nanquantile(np.abs(grade), 0.99)) if np.isfinite(grade).any() else 1.0
    most = max(most, 0.5)
    return -most, most


def _profile(made: GradeMap, drawn: Any, middle: Any, marker: ColumnDataSource) -> Any:
    from bokeh.layouts import column

    rows, at, grade, spread = drawn
    plot = plain_figure("", PROFILE_HEIGHT, y_range=DataRange1d(range_padding=0.08))
    plot.yaxis.axis_label = "uphill positive, %"
    plot.min_border_left = MARGIN
    breaks = np.flatnonzero(np.diff(at) > GAP_M) + 1
    table = np.column_stack([at, grade, grade - spread, grade + spread, middle])
    table = np.insert(table, breaks, np.nan, axis=0)
    names = ("at", "grade", "low", "high", "east", "north")
    source = ColumnDataSource(
        {name: table[:, k].astype(np.float32) for k, name in enumerate(names)}
    )
    plot.varea("at", "low", "high", source=source, fill_color=FILTER, fill_alpha=0.25)
    line = plot.line("at", "grade", source=source, color=FILTER, line_width=1.6)
    plot.scatter("at", "grade", source=marker, size=9, fill_color=None, line_color="black")
    mark = CustomJS(args={"marker": marker, "source": source}, code=_MARK)
    text = "<div><b>@grade{0.00} %</b> from @low{0.00} to @high{0.00} at @at{0} m</div>"
    hover = HoverTool(renderers=[line], tooltips=text, mode="vline", callback=mark)
    plot.add_tools(hover, BoxZoomTool(dimensions="width"), ResetTool())
    heights = plain_figure("", PROFILE_HEIGHT - 60, x_range=plot.x_range)
    heights.yaxis.axis_label = "above the ellipsoid, m"
    heights.xaxis.axis_label, heights.min_border_left = "way, m", MARGIN
    height = np.insert(made.columns["height_ellipsoid_m"][rows], breaks, np.nan)
    heights.line(table[:, 0], height.astype(np.float32), color=GNSS, line_width=1.6)
    agree = plain_figure("", PROFILE_HEIGHT - 90, x_range=plot.x_range)
    agree.yaxis.axis_label, agree.min_border_left = "χ²/(n − 1)", MARGIN
    passes = made.columns["passes"][rows]
    share = made.columns["chi2"][rows] / np.maximum(passes - 1, 1)
    share = np.insert(np.where(passes > 1, share, np.nan), breaks, np.nan)
    agree.line(table[:, 0], share.astype(np.float32), color=OTHER, line_width=1.2)
    agree.line([np.nanmin(at), np.nanmax(at)], [1.0, 1.0], color=SOFT, line_dash="dotted")
    return column(plot, agree, heights, sizing_mode="stretch_width")


_MARK = """
const index = cb_data.index;
const found = [...(index.line_indices || []), ...(index.indices || [])];
if (found.length) {
  const k = found[0], data = source.data;
  marker.data = {east: [data.east[k]], north: [data.north[k]], at: [data.at[k]],
                 grade: [data.grade[k]]};
} else {
  marker.data = {east: [], north: [], at: [], grade: []};
}
"""


def _plan(made: GradeMap, rows: Any) -> tuple[Any, Any]:
    """Ends of cells around the middle of the map, east and north, m."""
    columns = made.columns
    places = [
        np.column_stack(
            [
                np.radians(columns[f"{end}_latitude_deg"]),
                np.radians(columns[f"{end}_longitude_deg"]),
                np.zeros(len(made)),
            ]
        )
        for end in ("from", "to")
    ]
    latitude, longitude, _ = np.mean(places[0], axis=0)
    level = LocalLevel(float(latitude), float(longitude), 0.0)
    begin, end = (level.from_geodetic(each[rows])[:, :2] for each in places)
    return begin, end


def _cm(values: Any) -> list[float]:
    found: list[float] = np.round(values, 2).tolist()
    return found
