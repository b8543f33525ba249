"""Where the antenna is and how fast it moves, by the state of the vehicle, compiled.

p_a = p + C_lv p_va with the lever arm p_va from the pivot to the antenna, and its velocity over
ground with the vehicle's yaw rate (P. D. Groves, Principles of GNSS, Inertial, and Multisensor
Integrated Navigation Systems, 2nd ed., equations 14.102 and 14.103, here without roll and pitch
rates). While the heading is unknown, the position is the antenna's and there is no lever arm.
"""

from __future__ import annotations

import math

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.tram_model.records import Parameters, Situation, X, Y, Z
from tramstream.processors.tram_model.states import Ix


@compiled
def lever_arm(x: Array, c: Parameters, s: Situation) -> tuple[float, float, float]:
    """Give p_va from the pivot to the antenna, resolved in v, m."""
    arm = c.antenna_lever
    if not s.heading_known:
        return 0.0, 0.0, 0.0
    return arm[X] + x[Ix.PIVOT], arm[Y], arm[Z]


@compiled
def antenna(x: Array, c: Parameters, s: Situation) -> tuple[float, float, float, float, float]:
    """Give C_lv p_va (east, north, up), and the lever along and across the level heading, m."""
    ax, ay, az = lever_arm(x, c, s)
    sr, cr = math.sin(x[Ix.ROLL]), math.cos(x[Ix.ROLL])
    sp, cp = math.sin(x[Ix.PITCH]), math.cos(x[Ix.PITCH])
    sy, cy = math.sin(x[Ix.YAW]), math.cos(x[Ix.YAW])
    along = cp * ax + sp * (sr * ay + cr * az)
    across = cr * ay - sr * az
    up = -sp * ax + cp * (sr * ay + cr * az)
    return cy * along - sy * across, sy * along + cy * across, up, along, across


@compiled
def antenna_velocity(x: Array, c: Parameters, s: Situation, yaw_rate: float) -> tuple[float, float]:
    """Give the antenna's velocity over ground, east and north, m/s."""
    _, _, _, along, across = antenna(x, c, s)
    sy, cy = math.sin(x[Ix.YAW]), math.cos(x[Ix.YAW])
    # An antenna before or behind the pivot swings sideways with the yaw rate.
    ahead = x[Ix.SPEED] * math.cos(x[Ix.PITCH]) - yaw_rate * across
    aside = yaw_rate * along
    return cy * ahead - sy * aside, sy * ahead + cy * aside
