"""Whether a ride contradicts what a filter claims: which figure, which limit, the likely cause.

Three claims are judged: the protection levels (exceeded for no more than the stated share of
time), the covariance of the errors (NEES), and, without any truth, that of the innovations of each
source (NIS, and how much of it the gate refused). Only too much confidence contradicts: a filter
that claims more error than it has wastes something and deceives nobody; the tables call it too
cautious.

A figure contradicts where it is both certain (a filter that is right would show it in less than
`DOUBT` of rides, however long its errors last) and large (beyond `FACTOR` of what is right). With
the figures together a right filter fails in less than 3 % of rides
(tests/analysis/test_contradiction.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tramstream.analysis.evaluate.consistency import (
    Interval,
    Nees,
    Nis,
    Protection,
    mean_bounds,
)

DOUBT = 0.01
"""How often each of protection levels, NEES, and all NIS together may fail a filter that is
right."""
FACTOR = 1.5
"""A mean NEES or NIS so many times what is right harms nobody yet; twice must be found, and a
covariance is known no better than this (docs/accuracy.md: 0.7 to 1.4 on rides that fit)."""
MOST_REFUSED = 0.5
"""A source of which more than this is refused is no source: it or the filter is wrong."""
LEAST_REFUSED = 100
"""Measurements of which the share refused says something: seconds of the slowest receiver."""

CAUSES = (
    ("gnss_velocity", "the receiver states its velocity too well, or clocks differ", "gnss"),
    (
        "gnss",
        "the receiver states its fixes too well, or its errors last longer than is configured",
        "gnss.error_floor_m, $.gnss.error_tau_s",
    ),
    ("wheel", "wheels slip or are scaled wrongly", "wheels.m_per_pulse, $.ekf.wheel_creep_m_rtm"),
    ("rim", "wheels slip or are scaled wrongly", "odometer.wheels, $.wheels.speed_std_mps"),
    ("track", "the map lies beside the rails", "map.std_m"),
    ("zero", "the vehicle shakes at stops, or its sensors are noisier than is configured", "imu"),
    (
        "",
        "the IMU is mounted otherwise than is configured, or shakes more",
        "imu.mounting_deg, $.ekf.pivot_m, $.ekf.sway_std_mps2_rthz",
    ),
)
"""By the beginning of a measurement's name: what is likely, and the setting to look at."""
UNSEEN = {
    "position": (
        "an error that the innovations do not show: of fixes for long, of the antenna's place",
        "gnss.error_tau_s, $.gnss.lever_arm_m",
    ),
    "speed": ("the wheels' scale, or the pitch of the IMU", "wheels.m_per_pulse"),
    "yaw": (
        "the IMU's mounting, or the point that does not slip",
        "imu.mounting_deg, $.ekf.pivot_m",
    ),
}
"""Where the innovations fit: by the quantity that is worst against what it claims."""


@dataclass(frozen=True)
class Contradiction:
    """One figure that a filter which is right would not show."""

    figure: str
    """Name as in `evaluate --json`."""
    value: float
    limit: float
    sentence: str
    cause: str
    setting: str
    """Where to look: fields of the configuration."""

    def __str__(self) -> str:
        return f"{self.sentence}; likely {self.cause}"

    @property
    def cure(self) -> str:
        return f"look at $.{self.setting}"


def contradictions(
    nees: Mapping[str, Nees],
    main: str,
    nis: Mapping[str, Nis],
    protection: Protection | None,
    integrity_risk: float | None,
) -> list[Contradiction]:
    """Find what contradicts the filter, the gravest first.

    Parameters
    ----------
    nees, nis : mapping
        By name, as `consistency` judged them; empty without a truth.
    main : str
        The NEES that decides.
    integrity_risk : float, optional
        What the protection levels claim; None if that is not known: they are not judged then.
    """
    of_innovations = _of_innovations(nis)
    cause = _cause(nees, of_innovations)
    found = []
    if protection is not None and integrity_risk is not None:
        found += _of_protection(protection, integrity_risk, cause)
    if main in nees:
        found += _of_errors(main, nees[main], cause)
    return found + of_innovations


def _of_protection(
    protection: Protection, risk: float, cause: tuple[str, str]
) -> list[Contradiction]:
    share = protection.exceeded_any_share
    chance = protection.chance(risk)
    if share <= FACTOR * risk or chance >= DOUBT:
        return []
    sentence = (
        f"the true error is beyond the protection level for {100 * share:.3g} % of the time in "
        f"{protection.stretches} stretches, claimed are {100 * risk:.3g} % (a right filter would "
        f"show that with a chance of {chance:.2g}, limit {DOUBT:g})"
    )
    return [Contradiction("protection_exceeded_share", share, risk, sentence, *cause)]


def _of_errors(name: str, nees: Nees, cause: tuple[str, str]) -> list[Contradiction]:
    limit = _limit(nees.dimensions, nees.effective, DOUBT)
    if nees.mean <= limit:
        return []
    sentence = (
        f"NEES ({name}) is {nees.mean:.3g}, limit {limit:.3g}: {nees.dimensions} if the stated "
        f"deviations were right, and the ride is worth {nees.effective:.0f} independent samples"
    )
    return [Contradiction(f"nees_{name}_mean", nees.mean, limit, sentence, *cause)]


def _of_innovations(nis: Mapping[str, Nis]) -> list[Contradiction]:
    found = []
    for name, each in nis.items():
        _, cause, setting = next(entry for entry in CAUSES if name.startswith(entry[0]))
        refused = 1.0 - each.accepted_share
        if each.count >= LEAST_REFUSED and refused > MOST_REFUSED:
            sentence = (
                f"{100 * refused:.0f} % of {name} is refused, limit {100 * MOST_REFUSED:.0f} %"
            )
            figure = f"nis_{name}_accepted_share"
            found.append(Contradiction(figure, refused, MOST_REFUSED, sentence, cause, setting))
        elif each.accepted_share and each.mean > (
            limit := _limit(1, each.effective, DOUBT / len(nis))
        ):
            sentence = (
                f"NIS of {name} is {each.mean:.3g}, limit {limit:.3g}: 1 if its stated deviation "
                f"were right, and it is worth {each.effective:.0f} independent innovations"
            )
            figure = f"nis_{name}_mean"
            found.append(Contradiction(figure, each.mean, limit, sentence, cause, setting))
    return sorted(found, key=lambda each: each.limit / each.value)


def _limit(dimensions: int, effective: float, doubt: float) -> float:
    """What a mean may come to from above."""
    bounds: Interval = mean_bounds(dimensions, effective, confidence=1.0 - 2.0 * doubt)
    return max(bounds.high, FACTOR * dimensions)


def _cause(nees: Mapping[str, Nees], of_innovations: list[Contradiction]) -> tuple[str, str]:
    """What is likely behind errors that are too large: the worst source, else the worst error."""
    if of_innovations:
        return of_innovations[0].cause, of_innovations[0].setting
    ratios = {name: each.mean / each.dimensions for name, each in nees.items() if name in UNSEEN}
    return UNSEEN[max(ratios, key=ratios.__getitem__) if ratios else "position"]
