"""The study of kaspar2023: what a case is, the same figures twice, and how seeds are summed up."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tramstream.analysis.studies import kaspar2023 as study
from tramstream.analysis.studies.bound import Bound
from tramstream.analysis.studies.kaspar2023 import Case, Figures
from tramstream.processors.localisation.models import MODELS

SHORT_S = 60.0


def figures(**changes: object) -> Figures:
    fields: dict[str, object] = {
        "model": "tram",
        "line": study.BUILT_IN,
        "seed": 1,
        "kind": study.TWO,
        "steps": 100,
        "step_us": 10.0,
        "gnss_p90_m": 1.0,
        "position_p90_m": 0.5,
        "along_rms_m": 3.0,
        "across_rms_m": 0.3,
        "speed_std_mps": 0.01,
        "speed_mean_mps": 0.0,
        "yaw_rms_deg": 0.1,
        "nees": 2.0,
        "nees_series": np.random.default_rng(1).chisquare(2.0, 200),
        "exceeded_along_share": 0.0,
        "exceeded_across_share": 0.0,
    }
    return Figures(**{**fields, **changes})  # type: ignore[arg-type]


def test_case_chooses_wheels_and_errors_of_the_fixes() -> None:
    rides = [study.simulation_of(Case(kind=kind)) for kind in study.WITHOUT_MAP]
    two, one, slip, white = rides
    for simulation in rides:
        assert simulation.scenario.gnss is not None
        assert simulation.scenario.wheels is not None
    assert two.scenario.wheels.wheels == ("left", "right")
    assert one.scenario.wheels.wheels == ("left",)
    assert slip.scenario.wheels.wheels == ("left", "right")
    assert slip.happenings.skids
    assert not two.happenings.skids
    assert two.scenario.gnss.errors.decay == 0.95
    assert white.scenario.gnss.errors.decay == 0.0
    assert white.scenario.gnss.errors.horizontal_std_m == 0.5


def test_same_ride_gives_every_model_the_same_fixes_and_the_same_figures_again() -> None:
    case = Case(duration_s=SHORT_S)
    first, second = study.study(case, tuple(MODELS)), study.study(case, tuple(MODELS))
    assert [each.model for each in first] == ["tram", study.SMOOTHED, "kaspar2023"]
    assert len({each.gnss_p90_m for each in first}) == 1
    for one, other in zip(first, second, strict=True):
        blank = {"step_us": 0.0, "nees_series": np.empty(0)}
        assert str(one._replace(**blank)) == str(other._replace(**blank))
        np.testing.assert_array_equal(one.nees_series, other.nees_series)
        if one.model != study.SMOOTHED:
            assert one.steps == pytest.approx(100 * SHORT_S, abs=50)
        assert 0.1 < one.gnss_p90_m < 3.0
        assert 0.0 < one.position_p90_m < 3.0
        assert 0.0 < one.speed_std_mps < 0.1
        assert one.exceeded_along_share is not None


def test_seeds_are_summed_up_by_model_and_kind() -> None:
    rides = [
        figures(seed=1),
        figures(seed=1, model="kaspar2023", nees=9.0),
        figures(seed=2, position_p90_m=0.7, along_rms_m=4.0, nees=3.0),
        figures(seed=1, kind=study.ONE, exceeded_along_share=None, exceeded_across_share=None),
    ]
    tram, kaspar, one_wheel = study.overall(rides)
    assert (tram.model, tram.kind, tram.rides) == ("tram", study.TWO, 2)
    assert tram.position_p90_m == pytest.approx(0.6)
    assert tram.along_rms_m == pytest.approx(math.sqrt((9.0 + 16.0) / 2.0))
    assert tram.nees == pytest.approx(2.5)
    assert tram.nees_low < 2.0 < tram.nees_high
    assert tram.consistent == (True, False)
    assert (kaspar.model, kaspar.consistent) == ("kaspar2023", (False,))
    assert one_wheel.kind == study.ONE
    assert one_wheel.exceeded_along_share is None


def test_figures_are_multiples_of_the_bound_of_the_same_name() -> None:
    (total,) = study.overall([figures()])
    least = Bound(0.4, 2.0, 0.3, 0.005, math.nan)
    ratios = study.over_bound(total, least)
    assert ratios["position_p90_m"] == pytest.approx(1.25)
    assert ratios["along_rms_m"] == pytest.approx(1.5)
    assert ratios["speed_std_mps"] == pytest.approx(2.0)
    assert math.isnan(ratios["yaw_rms_deg"])


@pytest.mark.study
def test_filter_of_the_work_expects_white_errors() -> None:
    """On white errors it is near the published 0.55 m; on correlated ones hardly below raw GNSS."""
    (white,) = study.study(Case(kind=study.WHITE), ("kaspar2023",))
    (alike,) = study.study(Case(), ("kaspar2023",))
    assert 0.35 < white.position_p90_m < 0.6
    assert white.speed_std_mps < study.PUBLISHED["speed_std_mps"]
    assert alike.position_p90_m > 0.85 * alike.gnss_p90_m
    assert white.nees < 2.5 < alike.nees
