"""How far a vehicle goes until it stands: on the slope ahead, in closed form from piece to piece.

Brakes that slow down by d on the level slow down by d + g sin α uphill. Over a piece of one slope
the square of the speed falls by 2 (d + g sin α) a metre; where it reaches nothing the vehicle
stands. Before the brakes hold (`reaction_s`) it rolls on the slope where it is.

A slope that is wrong by δ all along makes a difference of ∂s/∂α; slope and speed count as
independent. Equations: docs/theory.md, section 18.5.
"""

from __future__ import annotations

import math

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.grade.kernels import GRAVITY

PIECE_M = 5.0
PIECES = 80
"""400 m: from 20 m/s with 0.5 m/s². What is farther ahead is like the last piece."""


@compiled
def stop(
    slopes: Array, speed_mps: float, deceleration_mps2: float, reaction_s: float
) -> tuple[float, float, float]:
    """Distance to stop, and how it changes with the speed and with all slopes alike.

    Parameters
    ----------
    slopes : ndarray, shape (PIECES,)
        Of pieces of `PIECE_M` ahead, uphill positive in the direction of motion, rad.
    speed_mps : float
        Not negative.

    Returns
    -------
    distance_m, by_speed_s, by_slope_m : float
        m, m per m/s, m per rad; infinite where the vehicle does not stop.
    """
    holds = GRAVITY * math.sin(slopes[0])
    stands = holds * reaction_s >= speed_mps
    if stands:  # before the brakes hold
        if speed_mps <= 0.0:
            return 0.0, 0.0, 0.0
        place = 0.5 * speed_mps * speed_mps / holds
        return place, speed_mps / holds, -GRAVITY * math.cos(slopes[0]) * place / holds
    place = speed_mps * reaction_s - 0.5 * holds * reaction_s * reaction_s
    left = speed_mps - holds * reaction_s
    square, piece = left * left, int(place / PIECE_M)
    first = deceleration_mps2 + GRAVITY * math.sin(slopes[min(piece, PIECES - 1)])
    slowing, rising = first, 0.0
    while square > 0.0:
        slope = slopes[min(piece, PIECES - 1)]
        slowing = deceleration_mps2 + GRAVITY * math.sin(slope)
        last = piece >= PIECES - 1
        if last and slowing <= 0.0:
            return math.inf, math.inf, math.inf
        length = math.inf if last else (piece + 1) * PIECE_M - place
        if slowing > 0.0 and square <= 2.0 * slowing * length:
            length = square / (2.0 * slowing)
            square = 0.0
        else:
            square -= 2.0 * slowing * length
        rising += length * math.cos(slope)
        place += length
        piece += 1
    # ½ v² of the begin, which the reaction has shifted, is taken up by `slowing` at the end.
    by_speed = (left + first * reaction_s) / slowing
    shifted = reaction_s * (left + 0.5 * first * reaction_s)
    by_slope = -GRAVITY * (shifted * math.cos(slopes[0]) + rising) / slowing
    return place, by_speed, by_slope
