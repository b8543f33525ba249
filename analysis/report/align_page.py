"""The page of `tramstream align`: how a ride's forces and rates look in vehicle axes, pass by pass.

The figures are those of melenovsky2023, 7.2 to 7.8, by their subject: the angles as they settle,
forces and rates of the case and of the vehicle, and what braking and curves press.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.models import LegendItem

from tramstream.analysis.mounting.align import AXES, Answer, Ride
from tramstream.analysis.mounting.combine import turn_between
from tramstream.analysis.mounting.drive import Array
from tramstream.analysis.report.charts import (
    FILTER,
    GNSS,
    OTHER,
    SMOOTHED,
    legend,
    plain_figure,
)
from tramstream.analysis.report.page import Page

MOST_POINTS = 1500
COLOURS = (FILTER, SMOOTHED, GNSS)
HELP = (
    "Forces and rates are means over two seconds. In the vehicle's axes x presses when it speeds "
    "up, y in curves, z always: if a line does so that should not, the mounting is wrong.",
    "Deviations are about the vehicle's axes. What the cross-level of the track makes of them "
    "stands beside: only 'upright on straight track' tells roll.",
)


def compose(found: Answer, angles: Sequence[Sequence[str]]) -> str:
    """Make the page; `angles` are the rows of the table of angles."""
    page = Page("Mounting of the IMU", [", ".join(each.name for each in found.rides)])
    page.fold("How to read this page", HELP)
    if found.verdict:
        page.absent(f"No figures: {found.verdict}.")
    else:
        page.section("Mounting")
        page.table(("", "mounting °", "about", "σ °", "of it cross-level °"), angles)
    for note in found.notes:
        page.note(note)
    for ride in found.rides:
        page.section(ride.name, ride.trouble)
        motion = ride.motion._asdict()
        page.table(("", ""), [(name, f"{value:.4g}") for name, value in motion.items()])
        if ride.solution is None or ride.trouble or found.verdict:
            continue
        page.table(
            ("thesis", "value", "holds"),
            [
                (each.text, f"{each.value:.3g}{each.unit}", "yes" if each.holds else "NO")
                for each in ride.theses
                if each.asked
            ],
        )
        page.figures(figures(ride), "two")
    return page.render(Document())


def figures(ride: Ride) -> list[Any]:
    """Seven figures of a ride."""
    solution = ride.solution
    assert solution is not None
    kin, dt = ride.coarse.kinematics, ride.drive.dt_s
    rows = np.arange(0, ride.drive.length, max(ride.drive.length // MOST_POINTS, 1))
    time_s: Array = rows.astype(float) * dt
    C_vb = solution.C_vb
    f_v = (kin.f_b - solution.point.accel_bias) @ C_vb.T
    omega_v = (kin.omega_b - solution.point.gyro_bias) @ C_vb.T
    off = np.degrees([turn_between(C_vb, each) for each in solution.history])
    passes: Array = np.arange(1, len(off) + 1, dtype=float)
    sign = np.where(ride.coarse.reverse, -1.0, 1.0)
    moving = rows[kin.moving[rows]]
    braking = sign * kin.acceleration_mps2
    curve = sign * kin.speed_mps * omega_v[:, 2]
    return [
        _lines("From the last pass' mounting, °, by pass", passes, off, AXES),
        _lines("Force in the case, m/s²", time_s, kin.f_b[rows], "xyz"),
        _lines("Force in the vehicle, m/s²", time_s, f_v[rows], "xyz"),
        _lines("Rate in the case, rad/s", time_s, kin.omega_b[rows], "xyz"),
        _lines("Rate in the vehicle, rad/s", time_s, omega_v[rows], "xyz"),
        _dots("Force along x and across y over v̇, m/s²", braking[moving], f_v[moving]),
        _dots("Force along x and across y over v·ω_z, m/s²", curve[moving], f_v[moving]),
    ]


def _lines(title: str, across: Array, values: Array, names: Sequence[str]) -> Any:
    plot = plain_figure(title, 260)
    items = []
    for name, column, colour in zip(names, values.T, COLOURS, strict=True):
        line = plot.line(across, column, color=colour)
        items.append(LegendItem(label=name, renderers=[line]))
    legend(plot, items)
    return plot


def _dots(title: str, cause: Array, force: Array) -> Any:
    plot = plain_figure(title, 260)
    items = []
    for name, column in (("x", 0), ("y", 1)):
        dots = plot.scatter(cause, force[:, column], size=3, color=COLOURS[column])
        items.append(LegendItem(label=name, renderers=[dots]))
    reach = float(np.abs(cause).max(initial=1.0))
    line = plot.line([-reach, reach], [-reach, reach], color=OTHER)
    items.append(LegendItem(label="once", renderers=[line]))
    legend(plot, items)
    return plot
