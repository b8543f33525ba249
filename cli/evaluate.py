"""`tramstream evaluate FILE`: errors against the truth, and whether the filter knows its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def evaluate(
    file: Annotated[Path, typer.Argument(help="Record, or a folder with the parts of one.")],
    truth: Annotated[
        str,
        typer.Option(
            metavar="KEY|FILE",
            help="Key of the truth, or the record that holds it; else raw/truth/state here, or in "
            "the record beside this one that it was reprocessed from.",
        ),
    ] = "",
    estimate: Annotated[
        str, typer.Option(metavar="KEY", help="What is judged; else est/ekf/state.")
    ] = "",
    skip_s: Annotated[
        float, typer.Option(min=0.0, help="Leave out so much after the first state.")
    ] = 0.0,
    outage_s: Annotated[
        float, typer.Option(min=0.0, help="Longer gaps in the valid fixes are outages.")
    ] = 5.0,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Judge an estimate by the truth: errors, NEES, NIS, protection levels, GNSS outages.

    Raw GNSS of the same ride, and est/ekf/smoothed where it is there, stand beside; the track's
    slope in % where est/grade/state is there (roll and pitch are the body's). Ends with
    status 1 where the ride contradicts what the estimate claims of its own errors: a filter that is
    right ends so in less than 3 % of rides.
    """
    import json

    from rich.console import Console

    from tramstream.analysis.evaluate.evaluation import evaluated
    from tramstream.analysis.evaluate.source import gather
    from tramstream.cli.terminal.session import say
    from tramstream.errors import CheckFailedError, DamagedRecordError
    from tramstream.shown import shown

    with Console(stderr=True).status(shown(str(file))):
        found = gather(file, truth, estimate, say)
        judged = evaluated(found, skip_s, outage_s, str(file))
    if json_:
        names = {"file": str(file), "estimate": judged.key, "truth": judged.truth}
        print(json.dumps(names | judged.figures))
    else:
        from tramstream.cli.figures.evaluate_tables import print_judgements

        title = f"{file}: {judged.key} against {judged.truth}"
        print_judgements(judged, title)
    against = judged.main.contradictions
    for each in against[1:] if not (found.damaged or found.left_out) else against:
        say(f"{file}: {each}; {each.cure}")
    if found.damaged:
        raise DamagedRecordError(f"{found.damaged}; what could be proved right was judged")
    if found.left_out:
        raise DamagedRecordError(found.left_out)
    if against:
        raise CheckFailedError(f"{file}: {against[0]}", against[0].cure)
