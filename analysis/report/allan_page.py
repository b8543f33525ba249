"""The page of `tramstream allan`: curves and figures of the six axes, of one and the same fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.models import DataRange1d, LegendItem

from tramstream.analysis.calibration.fit import value_of
from tramstream.analysis.calibration.noise import NAMES
from tramstream.analysis.calibration.standing_noise import AxisNoise, Found
from tramstream.analysis.report.charts import (
    FILTER,
    GNSS,
    OTHER,
    SMOOTHED,
    WHEELS,
    legend,
    plain_figure,
)
from tramstream.analysis.report.page import Page

HEAD = ("axis", "", "value", "95 %", "± %", "the work's tangent", "unit")
HELP = (
    "The dots are the overlapping Allan deviation of the readings with its own 95 % bars. The line "
    "is what the fitted model expects of it; thin lines are its parts: white noise N, bias "
    "instability B with its correlation time T_b, random walk K. All four come out of one maximum "
    "of the likelihood, not out of the dots.",
    "Where a coefficient is not seen, the largest value is given that the record does not exclude "
    "(95 %). Beside stand the values of the work's tangents, each read off the curve by itself.",
)


def units(unit: str) -> dict[str, str]:
    """Units of the coefficients of an axis in `unit`."""
    return {"N": f"{unit}/√Hz", "B": unit, "T_b": "s", "K": f"{unit}·√Hz"}


def rows(axis: AxisNoise) -> list[tuple[str, str, str, str, str, str, str]]:
    """Lines of a table about one axis; see `HEAD`."""
    if axis.fit is None:
        return [(axis.name, "", axis.trouble, "", "", "", "")]
    of = dict(zip(NAMES, axis.tangents, strict=True))
    made = []
    for name in NAMES:
        tangent = short(of[name])
        if name in axis.fit.std:
            low, high = axis.fit.interval(name)
            cells = (
                short(value_of(axis.fit.noise, name)),
                f"{short(low)} to {short(high)}",
                f"{100 * axis.fit.std[name]:.2g}",
            )
        elif name in axis.fit.limit:
            where = f", at T_b {axis.fit.limit_time_s:.3g} s" if name == "B" else ""
            cells = (f"not seen, at most {short(axis.fit.limit[name])}{where}", "", "")
        else:
            cells = ("not seen", "", "")
        made.append((axis.name, name, *cells, tangent, units(axis.unit)[name]))
    return made


def short(value: float) -> str:
    """Four digits that count."""
    return f"{value:.4g}" if math.isfinite(value) else "–"


def facts(found: Found) -> list[tuple[str, str]]:
    """What was read, and how it was."""
    low, high = found.temperature_degc
    parts = len(found.stretches_s)
    told = [
        ("records", ", ".join(found.records)),
        ("key", found.key or "–"),
        ("recorded", f"{found.recorded_s:.4g} s at {found.rate_hz:.5g} Hz"),
        ("at rest", f"{found.rest.standing_s:.4g} s in {parts} stretch{'es' * (parts != 1)}"),
        ("left out", f"{found.rest.moving_s:.4g} s that move or shake"),
        ("lost, bridged", f"{found.bridged} samples"),
        ("temperature", f"{low:.1f} to {high:.1f} °C" if math.isfinite(low) else "not recorded"),
    ]
    for axis in found.axes:
        if axis.fit is not None and axis.fit.temperature_matters:
            text = f"{short(axis.fit.per_degc)} ± {short(axis.fit.per_degc_std)} {axis.unit} a °C"
            told.append((f"{axis.name}, warmer", text))
        if axis.fit is not None and axis.fit.white_from_s > 1.5 / found.rate_hz:
            text = f"white from {axis.fit.white_from_s:.3g} s on; what is faster is left out"
            told.append((f"{axis.name}, fast", text))
        if axis.remark:
            told.append((axis.name, axis.remark))
    return told


def compose(found: Found, settings: Sequence[tuple[str, float, float]]) -> str:
    """Make the page; `settings` are fields of the filter with value and deviation."""
    page = Page("Noise of the inertial sensors", [", ".join(found.records)])
    page.fold("How to read this page", HELP)
    if found.verdict:
        page.absent(f"No figures: {found.verdict}.")
    else:
        page.section("Allan deviation")
        page.figures([_figure(axis) for axis in found.axes], "two")
        page.section("Coefficients")
        page.table(HEAD, [row for axis in found.axes for row in rows(axis)])
        page.section("Settings of the filter", "Of [imu]; the largest of the three axes.")
        page.table(
            ("field", "value", "σ"),
            [(name, short(value), short(std)) for name, value, std in settings],
        )
    page.section("Record")
    page.table(("", ""), facts(found))
    return page.render(Document())


def _figure(axis: AxisNoise) -> Any:
    """Curve, model and its parts, logarithmic both ways."""
    plot = plain_figure(
        f"{axis.name}, {axis.unit}",
        320,
        x_axis_type="log",
        y_axis_type="log",
        x_range=DataRange1d(range_padding=0.05),
        y_range=DataRange1d(range_padding=0.1),
    )
    plot.xaxis.axis_label = "τ, s"
    curve = axis.curve
    dots = plot.scatter(curve.tau_s, curve.deviation, size=5, color=FILTER)
    bars = plot.segment(curve.tau_s, curve.low, curve.tau_s, curve.high, color=FILTER)
    items = [LegendItem(label="readings", renderers=[dots, bars])]
    if axis.fit is not None and len(curve.tau_s):
        noise = axis.fit.noise
        tau_s = np.geomspace(curve.tau_s[0], curve.tau_s[-1], 120)
        whole = plot.line(tau_s, np.sqrt(noise.allan_variance(tau_s)), color=SMOOTHED, line_width=2)
        items.append(LegendItem(label="model", renderers=[whole]))
        parts = (
            ("N", noise._replace(instability=0.0, walk=0.0), GNSS),
            ("B", noise._replace(white=0.0, walk=0.0), WHEELS),
            ("K", noise._replace(white=0.0, instability=0.0), OTHER),
        )
        for name, part, colour in parts:
            if name in axis.fit.std:
                deviation = np.sqrt(part.allan_variance(tau_s))
                shown = deviation > float(curve.deviation.min()) / 5
                if shown.any():
                    line = plot.line(tau_s[shown], deviation[shown], color=colour)
                    items.append(LegendItem(label=name, renderers=[line]))
        plot.y_range.renderers = [dots, bars, whole]
    legend(plot, items)
    return plot
