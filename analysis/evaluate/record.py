"""What a record of estimates has against itself: with its truth if there is one, without if not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tramstream import keys
from tramstream.analysis.evaluate import consistency
from tramstream.analysis.evaluate.contradiction import Contradiction, contradictions
from tramstream.analysis.evaluate.evaluation import evaluated
from tramstream.analysis.evaluate.source import gather, holds, source_of
from tramstream.errors import RecordError
from tramstream.recorder.columns import read_ride
from tramstream.recorder.reader import open_record


def contradictions_in(
    file: Path, estimate: str = keys.EST_STATE.path, say: Callable[[str], None] = lambda _: None
) -> list[Contradiction]:
    """Judge the estimate in a record by its truth, or by its innovations alone without one.

    The truth may be in the record beside it, of which it was made.

    Raises
    ------
    RecordError
        If there is nothing to judge: no estimate, none of the truth's time, or no innovations.
    """
    if _has_truth(file):
        return evaluated(gather(file, "", estimate, say), 0.0, 5.0, str(file)).main.contradictions
    with open_record(file) as record:
        states = read_ride(record, [estimate]).states.get(estimate)
    if states is None or not len(states.innovations.value):
        raise RecordError(
            f"{file}: {estimate} has neither a truth nor innovations to be judged by",
            "raw/truth/state of a simulated ride is one",
        )
    return contradictions({}, "", consistency.nis(states.innovations), None, None)


def _has_truth(file: Path) -> bool:
    with open_record(file) as record:
        if holds(record, keys.TRUTH_STATE.path):
            return True
        beside = source_of(record)
    if beside is None:
        return False
    with open_record(beside) as source:
        return holds(source, keys.TRUTH_STATE.path)
