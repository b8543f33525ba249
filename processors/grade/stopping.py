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
    rolling = -GRAVITY * math.sin(slopes[0])
    reaction_s = min(reaction_s, speed_mps / -rolling) if rolling < 0.0 else reaction_s
    way = speed_mps * reaction_s + 0.5 * rolling * reaction_s * reaction_s
    left = max(speed_mps + rolling * reaction_s, 0.0)
    by_speed, by_slope = reaction_s, -0.5 * GRAVITY * reaction_s * reaction_s
    # Of the speed at which the brakes begin to hold.
    begun, slowing = left, 1.0
    slope_of_speed = -GRAVITY * reaction_s
    square = left * left
    piece, rising = int(way / PIECE_M), 0.0
    place = way
    while square > 0.0:
        slope = slopes[min(piece, PIECES - 1)]
        slowing = deceleration_mps2 + GRAVITY * math.sin(slope)
        last = piece >= PIECES - 1
        if last and slowing <= 0.0:
            return math.inf, math.inf, math.inf
        length = math.inf if last else (piece + 1) * PIECE_M - place
        after = square - 2.0 * slowing * length
        if after <= 0.0 and slowing > 0.0:
            length = square / (2.0 * slowing)
            after = 0.0
        rising += length * math.cos(slope)
        place += length
        square = after
        piece += 1
    # d(½ v²) of the begin is taken up by `slowing` at the end; a slope acts on all of the way.
    by_speed += begun / slowing
    by_slope += begun * slope_of_speed / slowing - GRAVITY * rising / slowing
    return place, by_speed, by_slope
