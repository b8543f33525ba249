"""Estimates of a record held to the truth, from Python."""

from __future__ import annotations

import warnings
from contextlib import ExitStack
from dataclasses import replace

from tramstream import keys
from tramstream.analysis.evaluate.evaluation import Evaluation, evaluated
from tramstream.analysis.evaluate.source import (
    demand,
    estimates_in,
    gathered,
    holds,
    reprocessed_from,
    wanted_keys,
)
from tramstream.analysis.notebook.record import PathLike, Record, open_record
from tramstream.errors import LeftOutWarning
from tramstream.recorder import reader

_TRUTH_CURE = "give `truth=` a record that does; simulated rides have it"


def evaluate(
    estimates: Record | PathLike,
    truth: Record | PathLike | None = None,
    *,
    key: str = keys.EST_STATE.path,
    skip_s: float = 0.0,
    outage_s: float = 5.0,
) -> Evaluation:
    """Judge an estimate by the truth: errors, NEES, NIS, protection levels, GNSS outages.

    Parameters
    ----------
    estimates : Record, str or path
        Record with the estimate.
    truth : Record, str or path, optional
        Record with the truth (`raw/truth/state`), a simulated ride. None: the same record, or the
        one that it was made from.
    key : str
        The estimate; messages of the type MotionState.
    skip_s : float
        Leave out so much after the first state, s.
    outage_s : float
        Longer gaps in the valid fixes are outages, s.

    Raises
    ------
    RecordError
        If there is no such estimate, no truth, or they are of different times.
    """

    def warn(sentence: str) -> None:
        warnings.warn(sentence, LeftOutWarning, stacklevel=3)

    judged = estimates if isinstance(estimates, Record) else open_record(estimates)
    record = judged.reader
    by = truth if isinstance(truth, Record) or truth is None else open_record(truth)
    by = by or (None if holds(record, keys.TRUTH_STATE.path) else judged.source)
    with ExitStack() as stack:
        if by is not None:
            source = by.reader
        elif holds(record, keys.TRUTH_STATE.path):
            source = record
        else:
            beside = reprocessed_from(record, keys.TRUTH_STATE.path, lambda _: None)
            source = stack.enter_context(beside)
        demand(record, key, keys.EST_STATE, _estimate_cure(record))
        demand(source, keys.TRUTH_STATE.path, keys.TRUTH_STATE, _TRUTH_CURE)
        found = gathered(record, source, wanted_keys(key), keys.TRUTH_STATE.path, warn)
    for sentence in (found.damaged, found.left_out):
        if sentence:
            warn(sentence)
    name = keys.TRUTH_STATE.path
    name += "" if source is record else f" of {source.paths[0].name}"
    found = replace(found, origin_ns=judged.origin_ns, truth_name=name)
    return evaluated(found, skip_s, outage_s, str(record.paths[0]))


def _estimate_cure(record: reader.Record) -> str:
    """What to do without the estimate asked for."""
    others = ", ".join(repr(each) for each in estimates_in(record))
    return f"choose with `key=`: {others}" if others else "`ts.localise(record)` makes it"
