"""Sections of a report, each from what the record has; each says what it lacks."""

from __future__ import annotations

from typing import Any

import numpy as np

from tramstream import keys
from tramstream.analysis.evaluate.consistency import chi_square_interval
from tramstream.analysis.evaluate.errors import COURSE_SPEED_MPS
from tramstream.analysis.evaluate.grade import PITCH_IS_THE_BODYS, slope_pct
from tramstream.analysis.report.charts import (
    BAD,
    CALM,
    FILTER,
    GNSS,
    OTHER,
    SMOOTHED,
    TRUTH,
    WHEELS,
    Spans,
    Timeline,
    Trace,
)
from tramstream.analysis.report.map import Path, RideMap, Stops
from tramstream.analysis.report.material import Material, inside, std_of
from tramstream.analysis.report.page import Page
from tramstream.clock import S
from tramstream.estimation.series import (
    Array,
    Innovations,
    Instants,
    Slot,
    StateSeries,
    TruthSeries,
    wrapped_rad,
)

NIS_WINDOW_S, NIS_LEAST = 20.0, 20
"""The rolling mean of NIS spans about so long, and never fewer measurements."""

UNKNOWN_MPS = 3.0
"""A speed that is known no better is not drawn."""


def timeline_of(material: Material) -> Timeline:
    """The time axis, with standstills and GNSS outages shaded."""
    return Timeline(
        material.start_ns,
        material.end_ns,
        material.utc_offset_ns or 0,
        [
            Spans("stands", *material.standing, CALM, 0.13),
            Spans("no GNSS fix", *material.outages, GNSS, 0.22),
        ],
    )


def add_map(page: Page, material: Material, timeline: Timeline) -> RideMap | None:
    """Tracks of truth, GNSS, smoother and filter, with what happened on the way."""
    page.section("Map")
    states, smoothed, truth, fixes = (
        material.states,
        material.smoothed,
        material.ride.truth,
        material.fixes,
    )
    if states is None and smoothed is None and truth is None and (fixes is None or not len(fixes)):
        page.absent("The record has no position: no fix, no filter, no truth.")
        return None
    chart = RideMap(timeline)
    if truth is not None:
        chart.track(Path("truth", truth.stamp_ns, truth.p_l, TRUTH, truth.speed_mps, width=3.5))
    if states is not None and len(material.outages.start_ns):
        chart.track(_without_gnss(states, material))
    if fixes is not None:
        points = Path("GNSS", fixes.stamp_ns, fixes.p_l, GNSS, fixes.speed_mps, alpha=0.8)
        chart.points(points)
    for name, series, colour in (("smoothed", smoothed, SMOOTHED), ("filter", states, FILTER)):
        if series is not None:
            std = np.hypot(std_of(series, Slot.EAST), std_of(series, Slot.NORTH))
            path = Path(name, series.stamp_ns, series.p_l, colour, series.speed_mps, std)
            chart.track(path)
    if states is not None:
        chart.points(_refused(states), marker="x", size=9)
    chart.stops(_stops(material))
    page.figures([chart.finish()])
    page.note(
        "Metres east and north of the first position. The part of the ride chosen above is marked "
        "in yellow; the dot is where the pointer is in any figure over time."
    )
    if fixes is None:
        page.absent("No raw/gnss/fix in the record: the receiver's own track is not drawn.")
    return chart


def add_speed(page: Page, material: Material, timeline: Timeline) -> None:
    """Every speed there is in one figure, and the acceleration."""
    page.section("Speed")
    traces = []
    truth, fixes, states, smoothed = (
        material.ride.truth,
        material.fixes,
        material.states,
        material.smoothed,
    )
    if truth is not None and np.isfinite(truth.speed_mps).any():
        traces.append(Trace("truth", truth.stamp_ns, truth.speed_mps, TRUTH, width=3.5))
    if fixes is not None:
        traces.append(Trace("GNSS", fixes.stamp_ns, fixes.speed_mps, GNSS, dots=True))
    if material.wheels is not None:
        wheels = material.wheels
        traces.append(Trace("wheels", wheels.stamp_ns, wheels.speed_mps, WHEELS))
    if material.distance is not None:
        stamp_ns, speed, std = material.distance
        told = speed if std is None else np.where(std < UNKNOWN_MPS, speed, np.nan)
        traces.append(Trace("distance filter", stamp_ns, told, OTHER, _band(told, std)))
    if smoothed is not None:
        traces.append(Trace("smoothed", smoothed.stamp_ns, smoothed.speed_mps, SMOOTHED))
    if states is not None:
        spread = 2 * std_of(states, Slot.SPEED)
        name, speed = "filter ± 2σ", states.speed_mps
        traces.append(Trace.within(name, states.stamp_ns, speed, spread, FILTER))
    if not traces:
        page.absent("The record has no speed: no fix, no wheels, no filter.")
        return
    page.figures([timeline.figure("", "speed, m/s", traces, height=320)])


def add_attitude(page: Page, material: Material, timeline: Timeline) -> None:
    """Heading, the track's grade, and how the body is turned."""
    page.section("Heading and grade")
    drawn = {
        "Heading": ("clockwise from north, °", _headings(material)),
        "Grade of the track": ("uphill positive, %", _grades(material)),
        "Pitch of the body": ("nose down positive, °", _turns(material, Slot.PITCH)),
        "Roll of the body": ("right side down positive, °", _turns(material, Slot.ROLL)),
    }
    known = {
        title: (unit, [each for each in traces if each.known])
        for title, (unit, traces) in drawn.items()
    }
    figures = [
        timeline.figure(title, unit, traces) for title, (unit, traces) in known.items() if traces
    ]
    page.figures(figures)
    if material.grade is None:
        page.note(f"No {keys.EST_GRADE.path} in the record: {PITCH_IS_THE_BODYS}.")
    if not known["Heading"][1] or not known["Pitch of the body"][1]:
        page.absent(f"Not all of it is known without {material.estimate} in the record.")


def _headings(material: Material) -> list[Trace]:
    traces = []
    truth, states = material.ride.truth, material.states
    if truth is not None:
        traces.append(Trace("truth", truth.stamp_ns, _compass(truth.yaw_rad), TRUTH, width=3.5))
    if material.fixes is not None:
        fixes = material.fixes.take(material.fixes.speed_mps > COURSE_SPEED_MPS)
        course = _compass(fixes.course_yaw_rad)
        traces.append(Trace("GNSS course", fixes.stamp_ns, course, GNSS, dots=True))
    if states is not None:
        spread = 2 * np.degrees(std_of(states, Slot.YAW))
        compass = _compass(np.where(states.heading_known, states.yaw_rad, np.nan))
        traces.append(Trace.within("filter ± 2σ", states.stamp_ns, compass, spread, FILTER))
    return traces


def _grades(material: Material) -> list[Trace]:
    """The track's: never a localiser's pitch, which is the body's."""
    traces = []
    truth, said = material.ride.truth, material.grade
    if truth is not None:
        traces.append(Trace("truth", truth.stamp_ns, slope_pct(truth.grade_rad), TRUTH, width=3.5))
    if said is not None:
        spread = slope_pct(2 * said.grade_std_rad)
        grade = slope_pct(said.grade_rad)
        traces.append(Trace.within("grade ± 2σ", said.stamp_ns, grade, spread, FILTER))
    return traces


def _turns(material: Material, slot: Slot) -> list[Trace]:
    """Roll or pitch."""
    column = slot - Slot.ROLL
    traces = []
    known: list[tuple[str, TruthSeries | StateSeries | None, str, float]] = [
        ("truth", material.ride.truth, TRUTH, 3.5),
        ("smoothed", material.smoothed, SMOOTHED, 1.5),
    ]
    for name, series, colour, width in known:
        if series is not None:
            angle = np.degrees(series.attitude_rad[:, column])
            traces.append(Trace(name, series.stamp_ns, angle, colour, width=width))
    states = material.states
    if states is not None:
        angle, spread = (
            np.degrees(states.attitude_rad[:, column]),
            2 * np.degrees(std_of(states, slot)),
        )
        traces.append(Trace.within("filter ± 2σ", states.stamp_ns, angle, spread, FILTER))
    return traces


def add_parameters(page: Page, material: Material, timeline: Timeline) -> None:
    """What the filter has learned, one small figure each."""
    page.section("Learned parameters")
    if not material.parameters:
        page.absent(f"No {keys.EST_PARAMETERS.path} in the record.")
        return
    figures = []
    for name, parameter in sorted(material.parameters.items()):
        unit = "ratio" if parameter.unit == "1" else parameter.unit
        spread = 2 * parameter.std
        trace = Trace.within(name, parameter.stamp_ns, parameter.value, spread, FILTER)
        title = name.replace("_", " ")
        figures.append(timeline.figure(title, unit, [trace], small=True))
    page.figures(figures, beside="many")


def add_measurements(page: Page, material: Material, timeline: Timeline) -> None:
    """Innovations and their normalised squares, measurement by measurement."""
    page.section(
        "Measurements",
        "What the filter was told minus what it expected, within ± 2√S if all is well. NIS is its "
        "square over S, here of accepted measurements in a rolling mean: 1 on average, within the "
        "band 95 % of the time if innovations are white. What the gate refused is red-orange, and "
        "at the edge of the picture where it lies beyond.",
    )
    states = material.states
    if states is None or not len(states.innovations.stamp_ns):
        page.absent(f"No innovations in the record ({keys.EST_STATE.path} carries them).")
        return
    figures = []
    for index, name in enumerate(states.innovations.names):
        figures += _measurement(states.innovations, index, name, timeline)
    page.figures(figures, beside="two")


def _measurement(all_: Innovations, index: int, name: str, timeline: Timeline) -> list[Any]:
    which = all_.which == index
    stamp_ns, value = all_.stamp_ns[which], all_.value[which]
    variance, accepted = all_.variance[which], all_.accepted[which]
    spread = 2 * np.sqrt(variance)
    title = name.replace("_", " ")
    edge = 1.5 * float(np.abs(np.concatenate([value[accepted], spread])).max())
    refused = value[~accepted]
    count = f"{len(value):,}{f', {len(refused):,} refused' if len(refused) else ''}"
    traces = [
        Trace("± 2√S", stamp_ns, None, SMOOTHED, (-spread, spread)),
        Trace(title, stamp_ns[accepted], value[accepted], FILTER, dots=True),
        Trace("refused", stamp_ns[~accepted], refused.clip(-edge, edge), BAD, dots=True),
    ]
    figure = timeline.figure(f"{title}: {count}", "innovation", traces, small=True)
    nis = value[accepted] ** 2 / variance[accepted]
    return [figure, _nis(title, stamp_ns[accepted], nis, timeline)]


def _nis(title: str, stamp_ns: Instants, nis: Array, timeline: Timeline) -> Any:
    """Rolling mean of NIS with its bounds; None for too few."""
    if len(nis) < 2 * NIS_LEAST:
        return None
    span_s = max((stamp_ns[-1] - stamp_ns[0]) / S, 1.0)
    window = min(max(round(len(nis) / span_s * NIS_WINDOW_S), NIS_LEAST), len(nis) // 2)
    sums = np.cumsum(np.concatenate([[0.0], nis]))
    mean = (sums[window:] - sums[:-window]) / window
    low, high = (bound / window for bound in chi_square_interval(window))
    middle = stamp_ns[window // 2 : window // 2 + len(mean)]
    traces = [
        Trace("95 %", middle, None, SMOOTHED, (np.full(len(mean), low), np.full(len(mean), high))),
        Trace("NIS", middle, mean, FILTER),
    ]
    return timeline.figure(f"{title}: NIS, mean of {window}", "NIS", traces, small=True)


def _band(value: Array, std: Array | None) -> tuple[Array, Array] | None:
    return None if std is None else (value - 2 * std, value + 2 * std)


def _compass(yaw_rad: Array) -> Array:
    """Degrees clockwise from north, [0, 360); NaN at a step through north, to lift the pen."""
    heading: Array = np.degrees(wrapped_rad(np.pi / 2 - yaw_rad)) % 360
    heading[1:][np.abs(np.diff(heading)) > 180] = np.nan
    return heading


def _without_gnss(states: StateSeries, material: Material) -> Path:
    """The parts of the filter's track that no fix supported, wide below it."""
    lost = inside(states.stamp_ns, material.outages)
    p_l = np.where(lost[:, None], states.p_l, np.nan)
    return Path("no GNSS fix", states.stamp_ns, p_l, BAD, width=8, alpha=0.3)


def _refused(states: StateSeries) -> Path:
    """Where the filter was when its gate refused a position."""
    told = states.innovations
    positions = [k for k, name in enumerate(told.names) if "gnss" in name or "position" in name]
    which = ~told.accepted & np.isin(told.which, positions)
    stamp_ns = np.unique(told.stamp_ns[which])
    rows = np.searchsorted(states.stamp_ns, stamp_ns).clip(max=len(states.stamp_ns) - 1)
    return Path("fix refused", stamp_ns, states.p_l[rows], BAD)


def _stops(material: Material) -> Stops:
    """Where the vehicle stood, by the best track there is."""
    start_ns, end_ns = material.standing
    track: Any = material.states or material.ride.truth or material.fixes
    if track is None or not len(track):
        return Stops(np.empty((0, 3)), start_ns[:0], np.empty(0))
    rows = np.searchsorted(track.stamp_ns, (start_ns + end_ns) // 2).clip(max=len(track) - 1)
    return Stops(track.p_l[rows], start_ns, (end_ns - start_ns) / S)
