"""Estimates against the truth: the judgement of a record as figures by name, and as errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

from tramstream.analysis.evaluate import errors as evaluation
from tramstream.analysis.evaluate.errors import Errors
from tramstream.analysis.evaluate.grade import (
    GradeErrors,
    GradeJudgement,
    flat_grade,
    judge_grade,
    lacking,
)
from tramstream.analysis.evaluate.judgement import (
    Judgement,
    Summary,
    Terms,
    flat,
    flat_summary,
    judge,
    terms_of,
)
from tramstream.analysis.evaluate.source import Gathered
from tramstream.clock import S
from tramstream.errors import RecordError
from tramstream.estimation.series import Array

_SHOWN = ("judged", "horizontal_rms_m", "speed_rms_mps", "yaw_rms_deg", "nees_joint_mean")
"""The figures that tell most; what there is to see of an evaluation at a prompt."""


class Evaluation(Mapping[str, Any]):
    """Figures of an estimate by name, with units, as `tramstream evaluate --json` prints them.

    Raw GNSS of the same ride stands beside as `gnss_…`, the smoother's as `smoothed_…`, the track's
    slope as `grade_…`; None is what is not known.
    """

    def __init__(
        self,
        key: str,
        truth: str,
        of: dict[str, Judgement],
        gnss: Summary | None,
        terms: Terms,
        grade: GradeJudgement | str = "",
    ) -> None:
        self.key = key
        """Of the estimate."""
        self.truth = truth
        """Key of the truth, and its file if it is another."""
        self.of = of
        """Judgements by the estimate's quantity (`state`, `smoothed`), the wanted one first."""
        self.gnss = gnss
        self.terms = terms
        self.grade = grade
        """Of `est/grade/state`; or why there is none."""

    @property
    def main(self) -> Judgement:
        return next(iter(self.of.values()))

    @property
    def errors(self) -> Errors:
        """Estimate minus truth at each judged instant: `along_m`, `across_m`, `yaw_rad` …"""
        return self.main.errors

    @property
    def grade_errors(self) -> GradeErrors | None:
        """The same of the track's slope: `grade_pct`, `body_pitch_rad` …; None without one."""
        return None if isinstance(self.grade, str) else self.grade.errors

    @property
    def time_s(self) -> Array:
        """Their instants in seconds since the first arrival in the record."""
        time_s: Array = (self.errors.stamp_ns - self.terms.origin_ns) / S
        return time_s

    @cached_property
    def figures(self) -> dict[str, Any]:
        """All figures as one flat dictionary."""
        main = next(iter(self.of))
        figures: dict[str, Any] = {}
        for each, judgement in self.of.items():
            prefix = "" if each == main else f"{each}_"
            figures |= {prefix + k: value for k, value in flat(judgement, self.terms).items()}
        if self.gnss is not None:
            figures |= {f"gnss_{k}": value for k, value in flat_summary(self.gnss).items()}
        return figures | flat_grade(None if isinstance(self.grade, str) else self.grade)

    def __getitem__(self, name: str) -> Any:
        return self.figures[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.figures)

    def __len__(self) -> int:
        return len(self.figures)

    def __repr__(self) -> str:
        lines = [f"{self.key} against {self.truth}"]
        for name in _SHOWN:
            beside = self.figures.get(f"gnss_{name}")
            gnss = f"  (GNSS alone {_shown(beside)})" if beside is not None else ""
            lines.append(f"  {name:16}  {_shown(self.figures[name])}{gnss}")
        return "\n".join(lines)


def _shown(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def evaluated(found: Gathered, skip_s: float, outage_s: float, name: str) -> Evaluation:
    """Judge what was gathered; `name` is the record's, for the sentence.

    Raises
    ------
    RecordError
        If none of the states can be judged.
    """
    terms = terms_of(found.vehicle, found.origin_ns, skip_s, outage_s)
    of = {
        path.rsplit("/", 1)[1]: judge(states, found.truth, found.fixes, terms)
        for path, states in found.states.items()
    }
    key, main = next(iter(found.states)), next(iter(of.values()))
    if not len(main.errors):
        raise RecordError(
            f"{name}: no state of {key} can be judged by {found.truth_name} "
            f"({_reasons(main.errors.left_out, main.skipped)}); are they of one ride?"
        )
    of = {each: judgement for each, judgement in of.items() if len(judgement.errors)}
    gnss = None
    if found.fixes is not None:
        errors = evaluation.fix_errors(found.fixes, found.truth, terms.lever_arm_m)
        gnss = evaluation.summary(errors, found.origin_ns)
    slope = judge_grade(found.grade, found.truth, terms) if found.grade is not None else None
    why = lacking(found.grade, slope)
    return Evaluation(key, found.truth_name, of, gnss, terms, slope or why)


def _reasons(left_out: dict[str, int], skipped: int) -> str:
    counts = {**left_out, "skipped": skipped}
    return ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if count)
