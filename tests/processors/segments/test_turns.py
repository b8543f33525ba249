"""Turns by the way, against the closed form of clothoids and arcs."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tramstream.geodesy import LocalLevel
from tramstream.lines.line import Line, Segment, curve
from tramstream.processors.segments.turns import ROWS, TURN, WINDOW_M, Turn, take_metre
from tramstream.tracks.signature import LIMIT_PER_M, curves_of, curves_of_line, of_line

Array = NDArray[np.float64]

LEVEL = LocalLevel.at_deg(50.08, 14.42, 250.0)
DEGREE = math.radians(1.0)
CM = 0.01


def seen(yaw_rad: Array, smear_m2: float = 0.0) -> list[Array]:
    """Turns of headings each metre."""
    t, out, found = np.zeros(ROWS), np.zeros(TURN), []
    for k, yaw in enumerate(yaw_rad.tolist()):
        if take_metre(t, float(k), yaw, 0.1 * k, smear_m2, out) == 1:
            found.append(out.copy())
    return found


def line_of(*pieces: list[Segment]) -> Line:
    segments = [each for piece in pieces for each in piece]
    length = sum(each.length_m for each in segments)
    return Line(segments, [0.0, length], LEVEL)


def headings(line: Line) -> Array:
    return line.yaw_rad(np.arange(math.floor(line.length_m)) * 1.0)


@pytest.mark.parametrize("radius_m", [20.0, 50.0, 100.0, 200.0])
@pytest.mark.parametrize("angle_deg", [-90.0, -30.0, 20.0, 60.0])
def test_turn_of_an_arc_has_its_angle_and_radius(radius_m: float, angle_deg: float) -> None:
    """Clothoids lie partly below the limit: what they turn there is no part of the turn.

    A clothoid of length T turns by l²/2RT until it has gone l, and passes the limit at l = RT/300.
    """
    angle = math.radians(angle_deg)
    pieces = curve(radius_m, angle)
    line = line_of([Segment(50.0)], pieces, [Segment(50.0)])
    (turn,) = seen(headings(line))
    clothoid = pieces[0].length_m
    below = radius_m * clothoid * LIMIT_PER_M
    lost = below**2 / (radius_m * clothoid)
    exact = math.copysign(abs(angle) - lost, angle)
    way = 2.0 * (clothoid - below) + pieces[1].length_m
    assert turn[Turn.ANGLE] == pytest.approx(exact, abs=0.2 * DEGREE)
    assert turn[Turn.END_M] - turn[Turn.BEGIN_M] == pytest.approx(way, abs=1.0)
    assert turn[Turn.BEGIN_M] == pytest.approx(50.0 + below, abs=0.6)
    assert turn[Turn.BEGIN_S] == pytest.approx(0.1 * turn[Turn.BEGIN_M], abs=1e-6)


@pytest.mark.parametrize("radius_m", [25.0, 35.0, 50.0, 100.0])
@pytest.mark.parametrize("clothoids", [True, False])
def test_radius_of_a_body_on_bogies_is_that_of_the_track(radius_m: float, clothoids: bool) -> None:
    """Its heading is smeared over 6.4 m, which would make an arc of 25 m a fifth wider."""
    angle = math.radians(60.0)
    k = 1.0 / radius_m
    bend = curve(radius_m, angle) if clothoids else [Segment(radius_m * angle, k, k)]
    line = line_of([Segment(50.0)], bend, [Segment(50.0)])
    (turn,) = seen(of_line(line).seen_by(3.2, 6.4), 6.4**2 + WINDOW_M**2)
    (exact,) = curves_of_line(line)
    radius = (turn[Turn.END_M] - turn[Turn.BEGIN_M]) / abs(turn[Turn.ANGLE])
    assert radius == pytest.approx(exact.radius_m, rel=0.05)
    assert turn[Turn.ANGLE] == pytest.approx(exact.angle_rad, abs=0.5 * DEGREE)


def test_curve_wider_than_the_limit_is_no_turn() -> None:
    assert not seen(headings(line_of([Segment(50.0)], curve(310.0, 0.6), [Segment(50.0)])))


def test_both_halves_of_an_s_curve_are_turns() -> None:
    line = line_of([Segment(40.0)], curve(60.0, 0.8), curve(60.0, -0.8), [Segment(40.0)])
    first, second = seen(headings(line))
    assert first[Turn.ANGLE] == pytest.approx(-second[Turn.ANGLE], abs=0.1 * DEGREE)
    assert first[Turn.END_M] < second[Turn.BEGIN_M]


def test_turn_interrupted_for_two_metres_is_one_and_for_ten_are_two() -> None:
    for gap_m, count in ((2.0, 1), (12.0, 2)):
        arc = [Segment(40.0, 1 / 60.0, 1 / 60.0)]
        line = line_of([Segment(40.0)], arc, [Segment(gap_m)], arc, [Segment(40.0)])
        assert len(seen(headings(line))) == count


@given(
    st.lists(
        st.tuples(
            st.floats(20.0, 280.0),
            st.floats(-1.5, 1.5).filter(lambda angle: abs(angle) > 0.15),
            st.floats(0.0, 80.0),
        ),
        min_size=1,
        max_size=6,
    )
)
@settings(max_examples=40, deadline=None)
def test_turns_seen_metre_by_metre_are_those_of_the_whole_line(
    plan: list[tuple[float, float, float]],
) -> None:
    """Two ways to the same: the vehicle's, sample by sample, and the signature's at once."""
    pieces = [[*curve(radius, angle), Segment(5.0 + gap)] for radius, angle, gap in plan]
    yaw = headings(line_of([Segment(30.0)], *pieces, [Segment(30.0)]))
    one, other = seen(yaw), curves_of(yaw)
    assert len(one) == len(other)
    for turn, piece in zip(one, other, strict=True):
        assert turn[Turn.BEGIN_M] == pytest.approx(piece.begin_m, abs=CM)
        assert turn[Turn.END_M] == pytest.approx(piece.end_m, abs=CM)
        assert turn[Turn.ANGLE] == pytest.approx(piece.angle_rad, abs=1e-3)


def test_pieces_of_a_line_cover_it_without_gap() -> None:
    line = line_of([Segment(80.0)], curve(40.0, 1.2), [Segment(120.0)], curve(70.0, -0.7))
    pieces = of_line(line).pieces()
    assert pieces[0].begin_m == 0.0
    assert pieces[-1].end_m == pytest.approx(of_line(line).length_m)
    for one, other in pairwise(pieces):
        assert one.end_m == other.begin_m
    assert sum(each.curve for each in pieces) == 2
