"""Attitude against an outside authority, and rates against differences of attitudes."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tramstream.attitude import C_vl, body_rates, euler_rates

ROUNDING = 1e-12
angles = st.floats(-3.1, 3.1)
slopes = st.floats(-1.4, 1.4)
rates = st.floats(-2.0, 2.0)


@given(angles, slopes, angles)
def test_turn_is_yaw_then_pitch_then_roll(roll: float, pitch: float, yaw: float) -> None:
    def about(axis: int, angle: float) -> np.ndarray:
        """Turn of components about one axis, from its definition."""
        cos, sin = np.cos(angle), np.sin(angle)
        matrix = np.eye(3)
        first, second = (axis + 1) % 3, (axis + 2) % 3
        matrix[[first, second], [first, second]] = cos
        matrix[first, second], matrix[second, first] = sin, -sin
        return matrix

    expected = about(0, roll) @ about(1, pitch) @ about(2, yaw)
    np.testing.assert_allclose(C_vl(roll, pitch, yaw), expected, atol=ROUNDING)


def test_positive_pitch_is_nose_down_and_positive_roll_right_side_down() -> None:
    nose_l = C_vl(0.0, 0.1, 0.3).T @ [1.0, 0.0, 0.0]
    left_l = C_vl(0.1, 0.0, 0.3).T @ [0.0, 1.0, 0.0]
    assert nose_l[2] < 0
    assert left_l[2] > 0


def test_many_attitudes_at_once_are_each_one() -> None:
    roll, pitch, yaw = np.random.default_rng(1).uniform(-1, 1, (3, 5))
    many = C_vl(roll, pitch, yaw)
    assert many.shape == (5, 3, 3)
    for index in range(5):
        np.testing.assert_array_equal(many[index], C_vl(roll[index], pitch[index], yaw[index]))


@given(angles, slopes, st.tuples(rates, rates, rates))
def test_euler_rates_are_the_inverse_of_body_rates(
    roll: float, pitch: float, given_rates: tuple[float, float, float]
) -> None:
    omega = body_rates(roll, pitch, given_rates)  # type: ignore[arg-type]
    np.testing.assert_allclose(euler_rates(roll, pitch, omega), given_rates, atol=1e-10)  # type: ignore[arg-type]


@given(st.tuples(angles, slopes, angles), st.tuples(rates, rates, rates))
def test_body_rates_turn_the_attitude(
    attitude: tuple[float, float, float], change: tuple[float, float, float]
) -> None:
    step_s = 1e-5
    before = C_vl(*(a - r * step_s / 2 for a, r in zip(attitude, change, strict=True)))
    after = C_vl(*(a + r * step_s / 2 for a, r in zip(attitude, change, strict=True)))
    x, y, z = body_rates(attitude[0], attitude[1], change)  # type: ignore[arg-type]
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    # Ċ_vl = −[ω]× C_vl; central differences err with the square of the step.
    np.testing.assert_allclose((after - before) / step_s, -skew @ C_vl(*attitude), atol=1e-6)
