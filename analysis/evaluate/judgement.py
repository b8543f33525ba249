"""The figures of `tramstream evaluate`: what is judged of each estimate, and as one flat object."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

from tramstream.analysis.evaluate import consistency, outages
from tramstream.analysis.evaluate import errors as evaluation
from tramstream.analysis.evaluate.consistency import NEES_SLOTS, Nees, Nis, Protection
from tramstream.analysis.evaluate.contradiction import Contradiction, contradictions
from tramstream.analysis.evaluate.errors import Errors, Statistics
from tramstream.analysis.evaluate.outages import Outage, OutageGroup, Start
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.series import FixSeries, StateSeries, TruthSeries

Summary = dict[str, Statistics | None]
MAIN = "joint"
"""The NEES that says whether a filter is consistent; "position" where it cannot be judged."""


@dataclass(frozen=True)
class Terms:
    """How to judge."""

    origin_ns: int
    """Times of figures count from here."""
    skip_s: float
    """Left out after the first state."""
    outage_s: float
    lever_arm_m: tuple[float, float, float]
    """Antenna from the vehicle's origin, p_va_v."""
    integrity_risk: float | None
    """What the protection levels claim, if that is known."""


@dataclass(frozen=True)
class Judgement:
    """Everything said of one estimate."""

    states: int
    errors: Errors
    skipped: int
    summary: Summary
    nees: dict[str, Nees]
    nis: dict[str, Nis]
    protection: Protection | None
    contradictions: list[Contradiction]
    """What a filter that is right would not show, the gravest first."""
    start: Start | None
    outages: list[Outage]
    groups: list[OutageGroup]

    @property
    def main(self) -> Nees | None:
        return self.nees.get(main_of(self.nees))


def main_of(nees: dict[str, Nees]) -> str:
    return MAIN if MAIN in nees else "position"


def terms_of(vehicle: Vehicle | None, origin_ns: int, skip_s: float, outage_s: float) -> Terms:
    """How to judge, with what a record's configuration knows."""
    lever_arm_m, integrity_risk = (0.0, 0.0, 0.0), None
    if vehicle is not None:
        integrity_risk = vehicle.ekf.integrity_risk
        if vehicle.gnss is not None:
            lever_arm_m = vehicle.gnss.lever_arm_m
    return Terms(origin_ns, skip_s, outage_s, lever_arm_m, integrity_risk)


def judge(
    states: StateSeries, truth: TruthSeries, fixes: FixSeries | None, terms: Terms
) -> Judgement:
    """Judge one estimate; nothing may be left of it if the truth is of another time."""
    errors = evaluation.errors(states, truth)
    kept = errors.stamp_ns >= states.stamp_ns[0] + round(terms.skip_s * S)
    skipped = int((~kept).sum())
    if skipped:
        errors = errors.take(kept)
    nees = {
        name: each
        for name, slots in NEES_SLOTS.items()
        if (each := consistency.nees(errors, slots)) is not None
    }
    nis, protection = consistency.nis(states.innovations), consistency.protection(errors)
    gaps = outages.outages(errors, fixes, truth, terms.outage_s) if fixes is not None else []
    return Judgement(
        states=len(states),
        errors=errors,
        skipped=skipped,
        summary=evaluation.summary(errors, terms.origin_ns),
        nees=nees,
        nis=nis,
        protection=protection,
        contradictions=contradictions(nees, main_of(nees), nis, protection, terms.integrity_risk),
        start=outages.start(states, fixes) if fixes is not None else None,
        outages=gaps,
        groups=outages.grouped(gaps),
    )


def flat(judgement: Judgement, terms: Terms) -> dict[str, Any]:
    """One estimate as keys and numbers; None for what is not known."""
    errors, start = judgement.errors, judgement.start
    first_ns, last_ns = int(errors.stamp_ns[0]), int(errors.stamp_ns[-1])
    figures: dict[str, Any] = {
        "states": judgement.states,
        "judged": len(errors),
        **errors.left_out,
        "skipped": judgement.skipped,
        "at_truth_stamps": errors.at_truth,
        "duration_s": (last_ns - first_ns) / S,
        "distance_m": outages.distance_m(errors.truth, first_ns, last_ns),
        "first_state_after_s": start.to_state_s if start else None,
        "tracking_after_s": start.to_tracking_s if start else None,
        **flat_summary(judgement.summary),
        "consistent": judgement.main.consistent if judgement.main else None,
        "verdict": judgement.main.verdict if judgement.main else None,
        "contradicted": bool(judgement.contradictions),
        "contradiction": str(judgement.contradictions[0]) if judgement.contradictions else None,
    }
    for name in NEES_SLOTS:
        figures |= flat_nees(f"nees_{name}", judgement.nees.get(name))
    for measurement, each in judgement.nis.items():
        figures |= _flat_nis(f"nis_{_key(measurement)}", each)
    figures |= _flat_protection(judgement.protection, terms)
    figures |= _flat_outages(judgement)
    return {name: plain(value) for name, value in figures.items()}


def flat_summary(summary: Summary) -> dict[str, Any]:
    """`horizontal_p90_m`, `yaw_max_at_s` and so on."""
    figures: dict[str, Any] = {}
    for column, each in summary.items():
        name, unit = column.rsplit("_", 1)
        figures[f"{name}_count"] = each.count if each else 0
        for kind in ("mean", "std", "rms", "p50", "p90", "p95", "p99", "max"):
            figures[f"{name}_{kind}_{unit}"] = getattr(each, kind) if each else None
        figures[f"{name}_max_at_s"] = each.max_at_s if each else None
    return figures


def group_name(to_s: float) -> str:
    """`to_30_s`, `beyond_120_s`."""
    return f"to_{to_s:g}_s" if math.isfinite(to_s) else f"beyond_{outages.EDGES_S[-1]:g}_s"


def flat_nees(name: str, each: Nees | None) -> dict[str, Any]:
    """`nees_speed_mean` and so on."""
    return {
        f"{name}_count": each.count if each else 0,
        f"{name}_undefined": each.undefined if each else None,
        f"{name}_dimensions": each.dimensions if each else None,
        f"{name}_mean": each.mean if each else None,
        f"{name}_low": each.bounds.low if each else None,
        f"{name}_high": each.bounds.high if each else None,
        f"{name}_effective_samples": each.effective if each else None,
        f"{name}_inside_share": each.inside_share if each else None,
        f"{name}_consistent": each.consistent if each else None,
    }


def _flat_nis(name: str, each: Nis) -> dict[str, Any]:
    return {
        f"{name}_count": each.count,
        f"{name}_accepted_share": each.accepted_share,
        f"{name}_mean": each.mean,
        f"{name}_mean_all": each.mean_all,
        f"{name}_low": each.bounds.low,
        f"{name}_high": each.bounds.high,
        f"{name}_effective_samples": each.effective,
        f"{name}_lag1": each.lag1,
        f"{name}_consistent": each.consistent,
    }


def _flat_protection(each: Protection | None, terms: Terms) -> dict[str, Any]:
    risk = terms.integrity_risk
    return {
        "integrity_risk": risk,
        "protection_count": each.count if each else 0,
        "protection_along_exceeded_share": each.exceeded_share[0] if each else None,
        "protection_across_exceeded_share": each.exceeded_share[1] if each else None,
        "protection_exceeded_share": each.exceeded_any_share if each else None,
        "protection_stretches": each.stretches if each else None,
        "protection_chance": each.chance(risk) if each and risk is not None else None,
        "protection_along_mean_m": each.mean_m[0] if each else None,
        "protection_across_mean_m": each.mean_m[1] if each else None,
    }


def _flat_outages(judgement: Judgement) -> dict[str, Any]:
    figures: dict[str, Any] = {"outages": len(judgement.outages)}
    for group in judgement.groups:
        name = f"outages_{group_name(group.to_s)}"
        figures |= {
            f"{name}_count": group.count,
            f"{name}_distance_mean_m": group.distance_m,
            f"{name}_horizontal_rms_m": group.horizontal_rms_m,
            f"{name}_along_rms_m": group.along_rms_m,
            f"{name}_across_rms_m": group.across_rms_m,
        }
    return figures


def _key(measurement: str) -> str:
    """A measurement's name as part of a key."""
    return re.sub(r"\W+", "_", measurement).strip("_")


def plain(value: Any) -> Any:
    """JSON has no NaN."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
