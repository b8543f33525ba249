"""The loop over many rides: a process a core, one line of progress, each answer in its place.

A verb names a function of a module that makes a `Finding` of the paths of a ride; what comes back
is in the order of the rides, whoever was done first, so that one worker and two give the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tramstream.analysis.fleet.outcome import Finding, Outcome
    from tramstream.analysis.fleet.places import Place
    from tramstream.analysis.fleet.table import Row


def over(
    places: Sequence[Place],
    function: Callable[..., Finding],
    arguments: tuple[Any, ...] = (),
    workers: int = 0,
) -> list[Outcome]:
    """Do the work on all rides; what a signal leaves undone is told and left out.

    Parameters
    ----------
    places : sequence of Place
    function : callable
        Of a module; called with the paths of a ride and `arguments`.
    workers : int
        Processes; 0 is one a core. One ride, or one worker, stays in this process.
    """
    from tramstream.analysis.fleet.outcome import attempted
    from tramstream.cli.terminal import pool
    from tramstream.cli.terminal.session import say

    jobs = [pool.Job(attempted, (place, function, arguments)) for place in places]
    outcomes: dict[Place, Outcome] = {
        job.arguments[0]: outcome for job, outcome in pool.shown(jobs, workers, "rides")
    }
    if len(outcomes) < len(places):
        say(f"stopped; {len(places) - len(outcomes)} records are missing")
    for place in places:
        outcome = outcomes.get(place)
        if outcome is not None and outcome.refused:
            say(f"{place.name}: left out: {outcome.refused}")
    return [outcomes[place] for place in places if place in outcomes]


def kept(verb: str, outcomes: Sequence[Outcome], table: Path | None, overwrite: bool) -> list[Row]:
    """Rows of all rides, those of the table before included; written to the table if there is one.

    Parameters
    ----------
    verb : str
        By which the rows are known.
    table : Path or None
        PARQUET; one that exists is added to.
    overwrite : bool
        Leave out what it held.
    """
    from tramstream.analysis.fleet.table import merged, read, rows_of, write

    before = read(table) if table is not None and table.exists() and not overwrite else []
    rows = merged(before, rows_of(verb, outcomes))
    if table is not None:
        write(rows, table)
    return rows
