"""The page of `tramstream map info`: the network to look at, its figures, its lines."""

from __future__ import annotations

from typing import Any

from bokeh.document import Document

from tramstream.analysis.report.network_page import HELP, NetworkFigure
from tramstream.analysis.report.network_tables import LINE_HEAD, line_rows, network_facts
from tramstream.analysis.report.page import Page
from tramstream.tracks.network import Network


def compose(network: Network, name: str, figures: dict[str, Any]) -> str:
    """Make the page of a network; `figures` are those of `map_info.describe`."""
    page = Page(f"Track network {name}", [network.source])
    page.fold("How to read this page", HELP)
    page.tiles(
        [
            (f"{figures['track_m'] / 1000:.1f} km", "of track"),
            (str(figures["switches"]), "switches"),
            (str(figures["stops"]), "stops"),
            (str(len({line.line for line in network.lines})), "lines"),
        ]
    )
    page.section("Map")
    drawing = NetworkFigure(network)
    drawing.lines()
    drawing.tracks()
    drawing.switches()
    drawing.stops()
    page.figures([drawing.finish()])
    page.section("Figures")
    page.table(("", ""), network_facts(figures))
    page.section("Lines")
    if not network.lines:
        page.absent("No lines: `tramstream map build --lines FILE` lays them.")
    page.table(LINE_HEAD, line_rows(figures))
    for line in network.lines:
        rows = [(f"{stop.chainage_m:.1f}", stop.name) for stop in line.stops]
        page.table(("m", "stop"), rows, f"line {line.line}, {line.origin} – {line.destination}")
    return page.render(Document())
