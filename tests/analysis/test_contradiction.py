"""A ride contradicts a filter that is wrong, and hardly ever one that is right."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from circling import along_across, motion, states, truth
from scipy.signal import lfilter
from scipy.stats import norm

from tramstream.analysis.evaluate.consistency import NEES_SLOTS, nees, nis, protection
from tramstream.analysis.evaluate.contradiction import (
    CAUSES,
    UNSEEN,
    Contradiction,
    contradictions,
)
from tramstream.analysis.evaluate.errors import errors
from tramstream.config import Vehicle
from tramstream.estimation.series import Innovations, Slot

RISK = 0.001
LEVEL = float(norm.ppf(1 - RISK / 4))
"""Protection level of unit deviations: exactly the risk, on two sides along and across."""
STATE_S = np.arange(0.0, 300.0, 0.2)
TRUTH_S = np.arange(0.0, 301.0, 0.25)
TRUTH = truth(TRUTH_S)
SEEDS = 150
MOST_FALSE = 0.03
"""Share of rides on which a right filter may fail: what `cli/evaluate.py` says."""
SOURCES = ("gnss_east", "gnss_north", "wheel_a", "lateral_force", "zero_velocity")
Array = np.ndarray


def lasting(rng: np.random.Generator, n: int, time_s: float, d: int) -> Array:
    """Errors of unit variance that last so long, (n, d)."""
    phi = np.exp(-0.2 / time_s)
    noise = rng.standard_normal((n, d))
    noise[1:] *= np.sqrt(1 - phi**2)
    return lfilter([1.0], [1.0, -phi], noise, axis=0)


def against(
    rng: np.random.Generator, error: Array, innovation: float = 1.0, refused: float = 0.0
) -> list[Contradiction]:
    """What a filter has against it that claims unit deviations of east, north, speed and yaw.

    The yaw is in hundredths of a radian, the innovations are white and of this deviation.
    """
    scale = np.ones(len(Slot))
    scale[Slot.YAW] = 1e-4
    east_north = np.pad(error[:, :2], ((0, 0), (0, 1)))
    series = states(STATE_S, east_north, error[:, 2], 0.01 * error[:, 3], np.diag(scale))
    series.protection_m[:] = LEVEL
    found = errors(series, TRUTH)
    count = 600 * len(SOURCES)
    tested = Innovations(
        np.arange(count),
        SOURCES,
        np.arange(count) % len(SOURCES),
        innovation * rng.standard_normal(count),
        np.ones(count),
        rng.random(count) >= refused,
    )
    judged = {name: nees(found, slots) for name, slots in NEES_SLOTS.items()}
    known = {name: each for name, each in judged.items() if each is not None}
    return contradictions(known, "joint", nis(tested), protection(found), RISK)


def share_failed(make: Callable[[np.random.Generator], Array], seeds: int = SEEDS) -> float:
    failed = 0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        failed += bool(against(rng, make(rng)))
    return failed / seeds


@pytest.mark.parametrize("time_s", [0.1, 2.0, 20.0, 1e6])
def test_right_filter_hardly_ever_fails_however_long_its_errors_last(time_s: float) -> None:
    assert share_failed(lambda rng: lasting(rng, len(STATE_S), time_s, 4)) <= MOST_FALSE


@pytest.mark.parametrize("time_s", [0.1, 2.0])
def test_variance_twice_as_large_as_claimed_is_found(time_s: float) -> None:
    n = len(STATE_S)
    assert share_failed(lambda rng: np.sqrt(2.0) * lasting(rng, n, time_s, 4), 30) >= 0.9


def test_deviations_four_times_too_small_are_found_though_errors_last_long() -> None:
    assert share_failed(lambda rng: 4.0 * lasting(rng, len(STATE_S), 20.0, 4), 30) >= 0.9


@pytest.mark.parametrize("parts", [1, 3])
def test_third_of_the_time_beyond_the_protection_level_is_found(parts: int) -> None:
    """As on line 7 before the convergence was applied: 34 %, which was printed as consistent."""
    n = len(STATE_S)

    def excursions(rng: np.random.Generator) -> Array:
        error = lasting(rng, n, 20.0, 4)
        beyond = (np.arange(n) % (n // parts)) < 0.34 * n / parts
        error[beyond, 0] += 7.0
        return error

    for seed in range(10):
        rng = np.random.default_rng(seed)
        figures = [each.figure for each in against(rng, excursions(rng))]
        assert figures[0] == "protection_exceeded_share"
        assert "nees_joint_mean" in figures


def test_one_short_stretch_beyond_says_nothing() -> None:
    """A right filter has one of some seconds in every tenth ride."""
    rng = np.random.default_rng(2)
    error = lasting(rng, len(STATE_S), 2.0, 4)
    error[400:420, 0] = 5.0
    assert against(rng, error) == []


def test_source_that_states_too_much_is_named_without_any_truth() -> None:
    found = against(np.random.default_rng(4), np.zeros((len(STATE_S), 4)), innovation=1.5)
    assert {each.figure for each in found} == {f"nis_{name}_mean" for name in SOURCES}
    wheel = next(each for each in found if "wheel" in each.figure)
    assert wheel.value == pytest.approx(2.25, rel=0.2)
    assert "$.wheels.m_per_pulse" in wheel.cure


def test_source_that_is_mostly_refused_is_named() -> None:
    found = against(np.random.default_rng(5), np.zeros((len(STATE_S), 4)), refused=0.7)
    assert {each.figure for each in found} == {f"nis_{name}_accepted_share" for name in SOURCES}


def test_worst_quantity_is_the_likely_cause() -> None:
    rng = np.random.default_rng(6)
    error = lasting(rng, len(STATE_S), 1.0, 4)
    error[:, 3] *= 5.0
    found = against(rng, error)
    assert found[0].figure == "nees_joint_mean"
    assert "mounting" in found[0].cause


def test_filter_that_claims_too_much_error_deceives_nobody() -> None:
    rng = np.random.default_rng(7)
    assert against(rng, 0.3 * lasting(rng, len(STATE_S), 1.0, 4), innovation=0.5) == []


def test_levels_that_claim_an_unknown_risk_are_not_judged() -> None:
    _, yaw = motion(STATE_S)
    series = states(STATE_S, along_across(yaw, 9.0 + 0 * yaw, 0 * yaw))
    series.protection_m[:] = LEVEL
    judged = protection(errors(series, TRUTH))
    assert judged is not None
    assert judged.exceeded_any_share == 1.0
    assert contradictions({}, "", {}, judged, None) == []
    assert len(contradictions({}, "", {}, judged, RISK)) == 1


def test_settings_that_are_named_exist() -> None:
    named = {entry[2] for entry in CAUSES} | {setting for _, setting in UNSEEN.values()}
    for path in {each for text in named for each in f"$.{text}".split(", ")}:
        kind: object = Vehicle
        for name in path.removeprefix("$.").split("."):
            types = [kind, *getattr(kind, "__args__", ())]
            struct = next(each for each in types if hasattr(each, "__struct_fields__"))
            fields = {each.name: each.type for each in msgspec.structs.fields(struct)}
            assert name in fields, path
            kind = fields[name]
