"""Profiles against their own derivatives and the shape of their points."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tramstream.lines.profile import Profile

points = st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=12)
lengths = st.lists(st.floats(0.5, 50.0), min_size=12, max_size=12)


def knots_of(steps: list[float], count: int) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(steps)])[:count]


@given(points, lengths)
def test_profile_goes_through_its_points_and_never_beyond_them(
    values: list[float], steps: list[float]
) -> None:
    knots = knots_of(steps, len(values))
    for profile in (Profile.through(knots, values), Profile(knots, values)):
        np.testing.assert_allclose(profile(knots), values, atol=1e-12)
        for a, b, low, high in zip(knots, knots[1:], values, values[1:], strict=False):
            inside = profile(np.linspace(a, b, 40))
            assert np.min(inside) >= min(low, high) - 1e-12
            assert np.max(inside) <= max(low, high) + 1e-12
            rising = np.diff(inside) * np.sign(high - low)
            assert np.all(rising >= -1e-12)


@given(points, lengths)
def test_shape_holds_the_derivatives(values: list[float], steps: list[float]) -> None:
    profile = Profile.through(knots_of(steps, len(values)), values)
    s = np.linspace(profile.knots_m[0] - 1.0, profile.knots_m[-1] + 1.0, 997)
    step_m = 1e-4
    shape = profile.shape(s)
    np.testing.assert_array_equal(shape.value, profile(s))
    derivative = (profile(s + step_m) - profile(s - step_m)) / (2 * step_m)
    corner = step_m * (np.max(np.abs(shape.bend_per_m2)) + 100)
    np.testing.assert_allclose(derivative, shape.slope_per_m, atol=corner)


def test_profile_keeps_its_end_values_beyond_its_ends() -> None:
    profile = Profile([10.0, 20.0], [0.3, -0.2])
    np.testing.assert_array_equal(profile([0.0, 10.0, 20.0, 99.0]), [0.3, 0.3, -0.2, -0.2])
    assert not np.any(profile.shape([0.0, 99.0]).slope_per_m)


def test_level_profile_is_flat() -> None:
    assert Profile.level().flat
    assert not Profile([0.0, 1.0], [0.0, 0.1]).flat
    assert not np.any(Profile.level()([-1.0, 0.5, 2.0]))
