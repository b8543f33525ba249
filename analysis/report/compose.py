"""A report put together: sections in order, the timeline they share, the file."""

from __future__ import annotations

from datetime import UTC, datetime
from importlib.resources import files
from typing import Any

from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.models import CustomJS

from tramstream.analysis.report.charts import POINTS, SOFT, Timeline, Trace
from tramstream.analysis.report.errors import add_errors, add_summary, judge_ride
from tramstream.analysis.report.health import add_health, add_keys
from tramstream.analysis.report.map import RideMap
from tramstream.analysis.report.material import Material
from tramstream.analysis.report.page import Page
from tramstream.analysis.report.sections import (
    add_attitude,
    add_map,
    add_measurements,
    add_parameters,
    add_speed,
    timeline_of,
)
from tramstream.clock import S
from tramstream.events.wording import lasting

HELP = (
    "Drag over a figure, or over the strip on top, to choose a part of the ride in all figures at "
    "once; Ctrl and the wheel zoom; “whole ride” goes back. On a touch screen use the strip. A "
    "click on a name hides what it names.",
    "Behind the traces grey is where the vehicle stands, orange where no GNSS fix came. Bands are "
    "± 2σ as stated; they are cut where they are far wider than elsewhere.",
    f"Series are thinned to {POINTS} points: of each short run the smallest and the largest value "
    "stay, so no spike is missing. A line is broken where its series is silent for long.",
)


def compose(material: Material) -> str:
    """Make the page of a ride."""
    judged = judge_ride(material)
    timeline = timeline_of(material)
    page = Page(_title(material), _facts(material))
    page.fold("How to read this page", HELP)
    add_summary(page, material, judged)
    chart = add_map(page, material, timeline)
    add_speed(page, material, timeline)
    add_errors(page, material, judged, timeline)
    add_attitude(page, material, timeline)
    add_parameters(page, material, timeline)
    add_measurements(page, material, timeline)
    add_health(page, material, timeline)
    add_keys(page, material, timeline)
    if material.speed is not None:
        name, stamp_ns, speed = material.speed
        page.overview(timeline.overview(Trace(name, stamp_ns, speed, SOFT)))
    return page.render(_document(page, timeline, chart))


def _document(page: Page, timeline: Timeline, chart: RideMap | None) -> Document:
    """The figures' document; when it stands in the browser, `report.js` runs."""
    document = Document()
    source = files("tramstream.analysis.report").joinpath("report.js").read_text(encoding="utf-8")
    arguments: dict[str, Any] = {
        "timeline": timeline.range,
        "whole": list(timeline.whole),
        "cursor": timeline.cursor,
        "figures": page.placed,
        "path": chart.path if chart is not None else None,
        "shown": chart.shown if chart is not None else None,
        "here": chart.here if chart is not None else None,
    }
    document.js_on_event(DocumentReady, CustomJS(args=arguments, code=source))
    return document


def _title(material: Material) -> str:
    vehicle = material.description.vehicle
    start = _utc(material.start_ns, material)
    return f"{f'Vehicle {vehicle}' if vehicle else 'Ride'}, {start:%Y-%m-%d %H:%M} UTC"


def _facts(material: Material) -> list[str]:
    start, end = (_utc(stamp, material) for stamp in (material.start_ns, material.end_ns))
    told = material.utc_offset_ns is not None
    of_clock = "" if told else " The record does not relate the vehicle clock to UTC."
    duration = lasting((material.end_ns - material.start_ns) / S)
    facts = [f"{start:%H:%M:%S} to {end:%H:%M:%S} UTC, {duration}.{of_clock}"]
    for description in (material.description, material.source):
        if description is not None:
            names = ", ".join(description.files)
            size = description.size_bytes / 1e6
            facts.append(
                f"{names}: {size:.1f} MB, {description.message_count:,} messages, "
                f"{description.software or 'not written by tramstream'}"
            )
            if description.damaged:
                facts.append(f"{description.damaged}; `tramstream recover` saves the rest.")
            if description.left_out:
                facts.append(f"{description.left_out}.")
            if description.missing_parts:
                missing = ", ".join(map(str, description.missing_parts))
                facts.append(f"Parts are missing: {missing}.")
    return facts


def _utc(stamp_ns: int, material: Material) -> datetime:
    return datetime.fromtimestamp((stamp_ns + (material.utc_offset_ns or 0)) / S, UTC)
