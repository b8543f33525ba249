"""The noise of six inertial axes out of records of standstill, or why there are no figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.calibration.allan import (
    Counts,
    Curve,
    Run,
    Tangents,
    octaves,
    overlapping,
    tangents,
)
from tramstream.analysis.calibration.blocks import FEWEST_BLOCKS, blocks_of
from tramstream.analysis.calibration.fit import TEMPERATURE_SEEN_DEGC, Fit, fit
from tramstream.analysis.calibration.samples import AXES, Spool, fill
from tramstream.analysis.calibration.standstill import Rest, find
from tramstream.recorder.reader import Record

Array = NDArray[np.float64]

LEAST_S = 300.0
"""Standstill without which there are no figures: in less a walk of the bias is hardly seen."""
COARSE = 0.7
"""Deviation of a reading, counts, below which rounding is no white noise any more: at 0.5 the
figure of N is off by 3 % (docs/calibration.md)."""
CLIPPED = 1e-4
"""Share of readings at the end of sixteen bits."""


@dataclass(frozen=True)
class AxisNoise:
    """One axis, SI."""

    name: str
    unit: str
    curve: Curve
    tangents: Tangents
    fit: Fit | None
    """None where `trouble` says why."""
    trouble: str = ""
    remark: str = ""
    """What is to be known beside figures that hold."""
    mean: float = math.nan
    """Reading at rest."""


@dataclass(frozen=True)
class Found:
    """What records tell of the noise of their inertial sensors."""

    records: list[str]
    key: str
    rate_hz: float
    recorded_s: float
    rest: Rest
    stretches_s: list[tuple[float, float]]
    """Begin and end of each stretch at rest, seconds since the first sample, gaps left out."""
    bridged: int
    temperature_degc: tuple[float, float]
    """Least and largest while at rest; NaN where there is none."""
    verdict: str
    """Why there are no figures; empty where there are."""
    axes: list[AxisNoise] = field(default_factory=list)


def analyse(
    records: Sequence[Record],
    least_s: float = LEAST_S,
    say: Callable[[str], None] = lambda _: None,
) -> Found:
    """Read records of one sensor and estimate its noise, axis by axis.

    Parameters
    ----------
    records : sequence of Record
    least_s : float
        Standstill without which there are no figures, s.
    say : callable
        Is told what is being done.
    """
    with Spool() as spool:
        key = fill(spool, records)
        rest = find(spool, records) if spool.count else Rest([], 0.0, 0.0)
        recorded_s = spool.count / spool.rate_hz if spool.count else 0.0
        verdict = _verdict(spool.count, recorded_s, rest, least_s)
        axes = []
        for number in range(len(AXES)) if not verdict else ():
            say(f"{AXES[number]}: {rest.standing_s:.0f} s at rest")
            axes.append(_axis(spool, rest.stretches, number))
        return Found(
            records=[str(path) for record in records for path in record.paths],
            key=key,
            rate_hz=spool.rate_hz,
            recorded_s=recorded_s,
            rest=rest,
            stretches_s=[
                (run.start / spool.rate_hz, run.end / spool.rate_hz) for run in rest.stretches
            ],
            bridged=spool.bridged,
            temperature_degc=_range(spool, rest.stretches),
            verdict=verdict,
            axes=axes,
        )


def _verdict(count: int, recorded_s: float, rest: Rest, least_s: float) -> str:
    if count == 0:
        return "there are no inertial samples"
    if count == 1:
        return "there is one inertial sample, which has no noise"
    needs = f"figures need {least_s:g} s of standstill"
    if recorded_s < least_s:
        return f"{recorded_s:.4g} s of inertial samples are too short: {needs}"
    if not rest.stretches:
        return f"the vehicle moves or shakes all the time, in {recorded_s:.0f} s: {needs}"
    if rest.standing_s < least_s:
        return (
            f"the vehicle stands for {rest.standing_s:.4g} s of {recorded_s:.0f} s, the rest moves "
            f"or shakes: {needs}"
        )
    return ""


def _range(spool: Spool, runs: Sequence[Run]) -> tuple[float, float]:
    """Temperature while at rest; a sensor that always says 0 has none."""
    number, value = spool.temperature
    inside = np.zeros(len(number), bool)
    for run in runs:
        inside |= (number >= run.start) & (number < run.end)
    if not inside.any() or not np.any(value):
        return math.nan, math.nan
    return float(value[inside].min()), float(value[inside].max())


def _axis(spool: Spool, runs: Sequence[Run], number: int) -> AxisNoise:
    counts = spool.axis(number)
    return axis_noise(counts, runs, spool, number)


def axis_noise(counts: Counts, runs: Sequence[Run], spool: Spool, number: int) -> AxisNoise:
    """One axis: its curve, the tangents of the work, the joint fit."""
    unit = spool.scales.of(number)
    trouble, remark = _troubles(counts, runs)
    curve = overlapping(counts, runs, spool.rate_hz, octaves(runs))
    blocks = blocks_of(counts, runs, spool.rate_hz, spool.temperature)
    if not trouble and len(blocks.mean) - np.count_nonzero(blocks.restarts) < FEWEST_BLOCKS:
        trouble = "too few samples at rest"
    found = None if trouble else fit(blocks)
    scaled = Curve(
        curve.tau_s, curve.deviation * unit, curve.low * unit, curve.high * unit, curve.terms
    )
    return AxisNoise(
        name=AXES[number],
        unit="rad/s" if number < 3 else "m/s²",
        curve=scaled,
        tangents=tangents(scaled),
        fit=found.scaled(unit) if found else None,
        trouble=trouble,
        remark=remark,
        mean=float(blocks.mean.mean()) * unit if len(blocks.mean) else math.nan,
    )


def _troubles(counts: Counts, runs: Sequence[Run]) -> tuple[str, str]:
    """Why an axis has no figures, and what is to be said beside those that it has."""
    low = min(int(counts[run.start : run.end].min()) for run in runs)
    high = max(int(counts[run.start : run.end].max()) for run in runs)
    if low == high:
        return f"reads {low} counts throughout: dead or stuck", ""
    size = sum(run.end - run.start for run in runs)
    if low <= -32768 or high >= 32767:
        ends = sum(
            int(np.count_nonzero((part <= -32768) | (part >= 32767)))
            for part in (counts[run.start : run.end] for run in runs)
        )
        if ends > CLIPPED * size:
            return f"is at the end of its range in {100 * ends / size:.3g} % of all readings", ""
    differences = overlapping(counts, runs, 1.0, [1])
    if float(differences.deviation[0]) < COARSE:
        return "", "changes by less than a count from reading to reading: rounding hides its noise"
    return "", ""


# Settings of the filter ---------------------------------------------------------------------------
_FIELDS = {
    "gyro": ("gyro_noise_radps_rthz", "gyro_walk_radps2_rthz"),
    "accel": ("accel_noise_mps2_rthz", "accel_walk_mps3_rthz"),
}


@dataclass(frozen=True)
class Settings:
    """Fields of `[imu]` that a filter takes, each with its relative deviation."""

    values: dict[str, float]
    std: dict[str, float]
    """Of the values, in their units."""
    notes: list[str]
    """What is not among them, and why."""


def settings_of(found: Found) -> Settings:
    """Noise as the filter has it: one number for three axes, the largest of them.

    Its bias walks: by K, and by what drives an unstable bias, √S_b, for times well below T_b
    (docs/theory.md, section 3.1).
    """
    values: dict[str, float] = {}
    std: dict[str, float] = {}
    notes = []
    for sensor, (noise, walk) in _FIELDS.items():
        fits = [each.fit for each in found.axes if each.name.startswith(sensor)]
        known = [each for each in fits if each is not None]
        if not known:
            continue
        most = max(known, key=lambda each: each.noise.white)
        values[noise] = most.noise.white
        std[noise] = most.noise.white * most.std["N"]
        of = max(known, key=_walk)
        largest = _walk(of)
        if largest > 0:
            values[walk] = largest
            std[walk] = largest * _walk_std(of)
        else:
            at_most = max(each.limit.get("K", math.nan) for each in known)
            notes.append(f"{walk}: not seen in this record, at most {at_most:.3g}; left out")
    low, high = found.temperature_degc
    if not high - low >= TEMPERATURE_SEEN_DEGC:
        notes.append("the temperature did not change: what it does to the bias is not known")
    return Settings(values, std, notes)


def _walk(each: Fit) -> float:
    drive = each.noise.drive if each.noise.instability > 0 else 0.0
    return math.hypot(each.noise.walk, drive)


def _walk_std(each: Fit) -> float:
    """Relative deviation of `_walk`; B and T_b are taken to be independent."""
    whole = _walk(each) ** 2
    of_walk = each.noise.walk**2 / whole * each.std.get("K", 0.0)
    of_drive = 0.0
    if each.noise.instability > 0:
        relative = math.hypot(each.std["B"], each.std["T_b"] / 2)
        of_drive = each.noise.drive**2 / whole * relative
    return math.hypot(of_walk, of_drive)
