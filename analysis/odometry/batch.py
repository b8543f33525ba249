"""All readings of a ride at once: wheels, antenna and delay by robust least squares.

Nodes lie a second apart (`NODE_S`). A node k has the place p of the point that does not slip
sideways (as a complex number, east + i north), the yaw ψ, the gyroscope's bias b, and the error of
the fixes: e, which lasts `gnss.error_tau_s`, and ē, which lasts minutes. For the whole ride there
are the constants

    x_A, x_B   the wheels' way is 1 + x times what they counted,
    g          scale of the vertical gyroscope,
    l = l_x + i l_y   the antenna ahead and to the left of that point,
    τ          by which fixes are behind the wheels,
    w          by which the wheels stand further apart than is configured, as a part.

Between nodes, with the nominal way P(t) = ∫ e^{iψ_g} cosα ds of wheels and gyroscope (α: slope)
and each fix at t:

    p_{k+1} − p_k = e^{i(ψ̄ − ψ̄_g)} (P_{k+1} − P_k)(1 + x̄)           creep, side slip
    ψ_{k+1} − ψ_k = Δψ_g (1 + g) − b Δt                               N, and standing: 0
    (1 + w) l_t Δψ = s_B (1 + x_B) − s_A (1 + x_A)                    two wheels
    b, e, ē walk and decay as the filter has them (docs/theory.md, sections 5.4 and 6.3)
    fix(t + τ) = p(t) + e^{iψ} l + e + ē,      velocity(t + τ) = e^{iψ} (v (1 + x̄) + i ω l)

Gauss and Newton go on until nothing changes; each round weighs residuals as Student's t does. The
normal equations are a band with a border: its Cholesky factor costs milliseconds, and the inverse
of the border's Schur complement is the covariance of the constants.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from tramstream.analysis.odometry.nominal import Nominal
from tramstream.analysis.odometry.rows import CONSTANTS, PER_NODE, Rows, rows_of
from tramstream.analysis.odometry.stated import Stated

Array = NDArray[np.float64]

ROUNDS = 12
LEARNT_ROUNDS = 4
"""Rounds after which the size of the fixes' error is no longer changed."""
CONVERGED = 1e-3
"""Of a deviation, by which no constant changes any more."""


class Found(NamedTuple):
    """What the readings say of the constants."""

    value: Array
    """In the order of `rows.Constant`."""
    covariance: Array
    fix_error: float
    """Size of the fixes' error over what is stated."""
    misfit: float
    """Root of the mean square of what fixes and wheels leave, in deviations."""
    rounds: int
    fix_off_s: Array
    """Instants of fixes that do not fit,"""
    fix_off_m: Array
    """and by how much."""


def solve(nominal: Nominal, stated: Stated) -> Found | None:
    """Find the constants; None where the equations have no solution."""
    nodes = len(nominal.time_s)
    x = nominal.first_guess()
    constants = np.zeros(CONSTANTS)
    scale, before = 1.0, np.full(CONSTANTS, np.inf)
    for rounds in range(1, ROUNDS + 1):
        rows = rows_of(nominal, stated, x, constants, scale, rounds)
        step = _step(rows, nodes)
        if step is None:
            return None
        of_nodes, of_constants, covariance = step
        x = x + of_nodes.reshape(nodes, PER_NODE)
        constants = constants + of_constants
        if rounds <= LEARNT_ROUNDS:
            scale = nominal.fix_error(x, constants, stated)
        std = np.sqrt(np.diagonal(covariance))
        if rounds > LEARNT_ROUNDS and np.all(np.abs(constants - before) < CONVERGED * std):
            break
        before = constants.copy()
    rows = rows_of(nominal, stated, x, constants, scale)
    at_s, off_m = nominal.off(x, constants)
    return Found(constants, covariance, scale, rows.misfit, rounds, at_s, off_m)


def _step(rows: Rows, nodes: int) -> tuple[Array, Array, Array] | None:
    """Solve the normal equations: steps of nodes and constants, and the constants' covariance."""
    size = nodes * PER_NODE
    band, border, corner, g_nodes, g_constants = rows.normal(size)
    try:
        factor = cholesky_banded(band, lower=True, check_finite=True)
    except (LinAlgError, ValueError):
        return None
    solved = cho_solve_banded((factor, True), np.column_stack([border, g_nodes]))
    schur = corner - border.T @ solved[:, :-1]
    try:
        covariance = np.linalg.inv(schur)
    except np.linalg.LinAlgError:
        return None
    if not np.all(np.isfinite(covariance)) or np.any(np.diagonal(covariance) <= 0.0):
        return None
    of_constants = covariance @ (g_constants - border.T @ solved[:, -1])
    of_nodes = solved[:, -1] - solved[:, :-1] @ of_constants
    return of_nodes, of_constants, 0.5 * (covariance + covariance.T)
