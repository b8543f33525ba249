"""The page of `tramstream map match`: the path over the tracks, and its table."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.document import Document

from tramstream.analysis.report.charts import POINTS
from tramstream.analysis.report.decimation import extremes
from tramstream.analysis.report.network_page import HELP, SURE, NetworkFigure, Piece
from tramstream.analysis.report.network_tables import LEG_HEAD, leg_rows, match_facts
from tramstream.analysis.report.page import Page
from tramstream.analysis.studies.match_source import Source
from tramstream.tracks.network import Network


def compose(network: Network, source: Source, figures: dict[str, Any]) -> str:
    """Make the page of a path; `figures` are those of `map_match.describe`."""
    page = Page(f"Path of {figures['file']}", [f"Network: {network.source}", *figures["notes"]])
    page.fold("How to read this page", HELP)
    legs = [leg for leg in figures["path"] if leg["edge"] is not None]
    sure_m = sum(leg["to_m"] - leg["from_m"] for leg in legs if leg["probability"] >= SURE[0][0])
    length_m = figures["length_m"]
    page.tiles(
        [
            (f"{length_m / 1000:.2f} km", "on tracks"),
            (f"{figures['on_track_share']:.1%}", "of the time on a track"),
            (f"{sure_m / length_m:.1%}" if length_m else "–", "of the path is sure"),
            (str(len(legs)), "runs"),
        ]
    )
    page.section("Map")
    drawing = NetworkFigure(network, source.plan)
    drawing.lines(shown=False)
    drawing.tracks()
    rows = extremes(source.plan, POINTS)
    rows = np.union1d(rows, np.linspace(0, len(source.plan) - 1, POINTS // 2).astype(int))
    times = [source.time(int(stamp_ns)) for stamp_ns in source.stamp_ns[rows]]
    drawing.trace(source.plan[rows], times, "as seen")
    drawing.matched(
        Piece(leg["run"], leg["from_m"], leg["to_m"], leg["probability"], leg["entered"])
        for leg in legs
    )
    drawing.switches()
    drawing.stops()
    page.figures([drawing.finish()])
    page.section("Path")
    page.table(("", ""), match_facts(figures))
    page.table(LEG_HEAD, leg_rows(figures))
    return page.render(Document())
