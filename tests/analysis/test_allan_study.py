"""The study of noise figures: its sensors, its sums, its table."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tramstream.analysis.calibration.fit import value_of
from tramstream.analysis.calibration.noise import NAMES, whittle_bound
from tramstream.analysis.studies import allan as study
from tramstream.analysis.studies.allan import Case, Figures
from tramstream.cli.figures.reproduce_allan import table_of

CASE = Case(seed=3, duration_s=900.0, rate_hz=8.0)


def test_readings_follow_each_other_and_do_not_hang_on_the_block(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = list(study.readings(CASE))
    counts = np.concatenate([each.counts for each in whole], axis=1)
    assert counts.shape == (6, 7200)
    for each in whole:
        np.testing.assert_array_equal(each.first[1:], (each.first + each.length)[:-1])
        assert int(each.length.sum()) == each.counts.shape[1]
    monkeypatch.setattr(study, "_BLOCK", 1000)
    parts = list(study.readings(CASE))
    assert len(parts) == 8
    np.testing.assert_array_equal(np.concatenate([each.counts for each in parts], axis=1), counts)


def test_truth_has_the_scenarios_figures_and_the_rounding() -> None:
    known = study.truth("still")
    section = study.section_of("still")
    for sensor, unit, density in (
        ("gyro", section.scales.gyro_radps, section.errors.gyro_noise_radps_rthz),
        ("accel", section.scales.accel_mps2, section.errors.accel_noise_mps2_rthz),
    ):
        expected = math.sqrt(density**2 + unit**2 / 12 / 2000.0)
        assert known[sensor].white == pytest.approx(expected)
    assert known["gyro"].walk == 0.000075630
    assert known["accel"].instability == 0.000035316


def test_axes_of_a_record_are_estimated_near_the_truth() -> None:
    (axis,) = study.axes_of(CASE, [2])
    true = study.truth("still", CASE.rate_hz)["gyro"]
    assert axis.fit is not None
    assert axis.fit.noise.white == pytest.approx(true.white, rel=5 * axis.fit.std["N"])
    assert axis.fit.noise.walk == pytest.approx(true.walk, rel=5 * axis.fit.std["K"])


def made(axis: str, error: float, seen: tuple[str, ...]) -> Figures:
    """Figures that are off by a share of the truth."""
    true = study.truth("still", CASE.rate_hz)[axis.split()[0]]
    values = {name: value_of(true, name) * (1 + error) for name in NAMES}
    inside = {name: abs(error) < 0.15 for name in seen}
    tangents = {name: values[name] if name != "B" else math.nan for name in NAMES}
    return Figures(axis, 1, values, seen, inside, tangents, {})


def test_sums_are_over_axes_and_seeds_and_what_is_beyond_is_named() -> None:
    errors = (0.1, -0.2, 0.1)
    found = [
        made(f"accel {axis}", error, ("N", "K")) for axis, error in zip("xyz", errors, strict=True)
    ]
    rows = {each.name: each for each in study.overall(found, CASE)}
    assert set(rows) == set(NAMES)
    bound = whittle_bound(study.truth("still", 8.0)["accel"], 900.0, 8.0)
    for name, row in rows.items():
        assert row.bound == pytest.approx(bound[name])
        assert row.rms == pytest.approx(math.sqrt(0.02))
        assert row.bias == pytest.approx(0.0, abs=1e-12)
        assert row.seen == (1.0 if name in ("N", "K") else 0.0)
        assert row.tangents == (0.0 if name == "B" else 1.0)
    assert rows["K"].inside == pytest.approx(2 / 3)
    assert math.isnan(rows["B"].inside)
    assert [each.name for each in study.beyond(list(rows.values()))] == ["N"]
    assert table_of(list(rows.values())).row_count == 4
