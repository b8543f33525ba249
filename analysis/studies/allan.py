"""Noise of simulated inertial sensors at rest, estimated again: errors beside the Whittle bound.

The sensors are those of a scenario (`still`: six hours at 2 kHz; `kaspar2023` at its 100 Hz),
whose coefficients are known; a sensor is rounded to whole counts, and that is white noise too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream.analysis.calibration.allan import Run
from tramstream.analysis.calibration.fit import value_of
from tramstream.analysis.calibration.inertial import Samples
from tramstream.analysis.calibration.noise import NAMES, Noise, whittle_bound
from tramstream.analysis.calibration.samples import AXES, Spool
from tramstream.analysis.calibration.standing_noise import AxisNoise, axis_noise
from tramstream.clock import S
from tramstream.simulation import scenario
from tramstream.simulation.imu import STANDARD_GRAVITY_MPS2, Imu
from tramstream.simulation.scenario import Imu as ImuSection

Array = NDArray[np.float64]

SCENARIO = "still"
HOURS = 6.0
SEEDS = 20
WORTH = 0.5
"""A coefficient whose bound is larger cannot be told from a record of this length."""
LIMIT = 1.5
"""RMS of the errors over the bound that is aimed at."""
_BLOCK = 1 << 18
_LENGTH = 64
"""Samples of a message."""


class Case(NamedTuple):
    """One record."""

    scenario: str = SCENARIO
    seed: int = 1
    duration_s: float = HOURS * 3600
    rate_hz: float = 0.0
    """0: that of the scenario."""


class Figures(NamedTuple):
    """One axis of one record."""

    axis: str
    seed: int
    estimate: dict[str, float]
    """By the joint fit, seen or not."""
    seen: tuple[str, ...]
    inside: dict[str, bool]
    """Whether the truth lies in the interval of 95 %, of those that are seen."""
    tangents: dict[str, float]
    limits: dict[str, float]


class Row(NamedTuple):
    """One coefficient of one kind of sensor, all axes and seeds together; parts of the truth."""

    sensor: str
    name: str
    truth: float
    bound: float
    rms: float
    bias: float
    """Mean of the errors."""
    seen: float
    """Share of axes where it is seen."""
    inside: float
    """Share of those whose interval of 95 % holds the truth; NaN where none is seen."""
    tangent_rms: float
    """Of the work's tangents, where there is one."""
    tangents: float
    """Share of axes where there is one."""


def section_of(name: str) -> ImuSection:
    """The inertial sensor of a scenario."""
    section = scenario.load(name).imu
    assert section is not None
    return section


def truth(name: str, rate_hz: float = 0.0) -> dict[str, Noise]:
    """What the sensors of a scenario have, rounding included; SI, by kind."""
    section = section_of(name)
    errors, scales = section.errors, section.scales
    period_s = 1 / (rate_hz or section.rate_hz)

    def white(density: float, unit: float) -> float:
        return math.hypot(density, unit * math.sqrt(period_s / 12))

    return {
        "gyro": Noise(
            white(errors.gyro_noise_radps_rthz, scales.gyro_radps),
            errors.gyro_instability_radps,
            errors.gyro_instability_time_s,
            errors.gyro_walk_radps2_rthz,
        ),
        "accel": Noise(
            white(errors.accel_noise_mps2_rthz, scales.accel_mps2),
            errors.accel_instability_mps2,
            errors.accel_instability_time_s,
            errors.accel_walk_mps3_rthz,
        ),
    }


def readings(case: Case) -> Iterator[Samples]:
    """What the sensors of a vehicle at rest say."""
    section = section_of(case.scenario)
    rate_hz = case.rate_hz or section.rate_hz
    sensor = Imu(np.random.default_rng(case.seed), rate_hz, section.errors, section.scales)
    period_ns = S / rate_hz
    done, count = 0, int(case.duration_s * rate_hz)
    while done < count:
        size = min(_BLOCK, count - done)
        force = np.zeros((size, 3))
        force[:, 2] = STANDARD_GRAVITY_MPS2
        counts = sensor.measure(force, np.zeros((size, 3)))
        first = done + np.arange(0, size, _LENGTH)
        length = np.minimum(_LENGTH, done + size - first)
        ones = np.ones(len(first))
        yield Samples(
            stamp_ns=np.rint(first * period_ns).astype(np.int64),
            first=first,
            length=length,
            period_ns=ones * period_ns,
            gyro_scale_radps=ones * section.scales.gyro_radps,
            accel_scale_mps2=ones * section.scales.accel_mps2,
            temperature_degc=np.float64(section.scales.temperature_degc)
            * counts.temperature[::_LENGTH].astype(np.float64),
            counts=np.concatenate([counts.gyro, counts.accel], axis=1).T,
        )
        done += size


def axes_of(case: Case, which: Sequence[int] = range(len(AXES))) -> Iterator[AxisNoise]:
    """Estimate the noise of axes of a simulated record."""
    with Spool() as spool:
        for samples in readings(case):
            spool.put(samples)
        for number in which:
            yield axis_noise(spool.axis(number), [Run(0, spool.count)], spool, number)


def study(case: Case) -> list[Figures]:
    """All axes of one record."""
    known = truth(case.scenario, case.rate_hz)
    return [_figures(axis, case.seed, known[axis.name.split()[0]]) for axis in axes_of(case)]


def _figures(axis: AxisNoise, seed: int, true: Noise) -> Figures:
    fit = axis.fit
    assert fit is not None, axis.trouble
    seen = tuple(name for name in NAMES if name in fit.std)
    inside = {}
    for name in seen:
        low, high = fit.interval(name)
        inside[name] = low <= value_of(true, name) <= high
    return Figures(
        axis=axis.name,
        seed=seed,
        estimate={name: value_of(fit.noise if name in seen else fit.full, name) for name in NAMES},
        seen=seen,
        inside=inside,
        tangents=dict(zip(NAMES, axis.tangents, strict=True)),
        limits=fit.limit,
    )


def overall(found: Sequence[Figures], case: Case) -> list[Row]:
    """Sum up axes and seeds, a coefficient a row; `case` is any of those."""
    rows = []
    rate_hz = case.rate_hz or section_of(case.scenario).rate_hz
    for sensor, true in truth(case.scenario, case.rate_hz).items():
        of_kind = [each for each in found if each.axis.startswith(sensor)]
        if not of_kind:
            continue
        bounds = whittle_bound(true, case.duration_s, rate_hz)
        for name in NAMES:
            value = value_of(true, name)
            error = np.array([each.estimate[name] / value - 1 for each in of_kind])
            tangent = np.array([each.tangents[name] / value - 1 for each in of_kind])
            some = np.isfinite(tangent)
            inside = [each.inside[name] for each in of_kind if name in each.inside]
            rows.append(
                Row(
                    sensor=sensor,
                    name=name,
                    truth=value,
                    bound=bounds[name],
                    rms=float(np.sqrt(np.mean(error**2))),
                    bias=float(error.mean()),
                    seen=float(np.mean([name in each.seen for each in of_kind])),
                    inside=float(np.mean(inside)) if inside else math.nan,
                    tangent_rms=_rms(tangent[some]),
                    tangents=float(some.mean()),
                )
            )
    return rows


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def beyond(rows: Sequence[Row]) -> list[Row]:
    """Coefficients that a record of this length can tell, and whose error is above the limit."""
    return [each for each in rows if each.bound < WORTH and each.rms > LIMIT * each.bound]
