"""`tramstream evaluate FILE`: errors against the truth, and whether the filter knows its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

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

    Raw GNSS of the same ride, and est/ekf/smoothed where it is there, stand beside.
    """
    import json

    from rich.console import Console

    from tramstream.analysis.evaluate import errors as evaluation
    from tramstream.analysis.evaluate.judgement import flat, flat_summary, judge, terms_of
    from tramstream.analysis.evaluate.source import gather
    from tramstream.cli.terminal.session import say
    from tramstream.errors import DamagedRecordError, RecordError
    from tramstream.shown import shown

    with Console(stderr=True).status(shown(str(file))):
        found = gather(file, truth, estimate, say)
        terms = terms_of(found.vehicle, found.origin_ns, skip_s, outage_s)
        of = {
            path.rsplit("/", 1)[1]: judge(states, found.truth, found.fixes, terms)
            for path, states in found.states.items()
        }
    key, (name, main) = next(iter(found.states)), next(iter(of.items()))
    if not len(main.errors):
        raise RecordError(
            f"{file}: no state of {key} can be judged by {found.truth_name} "
            f"({_reasons(main.errors.left_out, main.skipped)}); are they of one ride?"
        )
    of = {each: judgement for each, judgement in of.items() if len(judgement.errors)}
    gnss = None
    if found.fixes is not None:
        errors = evaluation.fix_errors(found.fixes, found.truth, terms.lever_arm_m)
        gnss = evaluation.summary(errors, found.origin_ns)
    if json_:
        figures: dict[str, Any] = {"file": str(file), "estimate": key, "truth": found.truth_name}
        for each, judgement in of.items():
            prefix = "" if each == name else f"{each}_"
            figures |= {prefix + k: value for k, value in flat(judgement, terms).items()}
        if gnss is not None:
            figures |= {f"gnss_{k}": value for k, value in flat_summary(gnss).items()}
        print(json.dumps(figures))
    else:
        from tramstream.cli.figures.evaluate_tables import print_judgements

        print_judgements(of, gnss, terms, f"{file}: {key} against {found.truth_name}")
    if found.damaged:
        raise DamagedRecordError(f"{found.damaged}; what could be proved right was judged")
    if found.left_out:
        raise DamagedRecordError(found.left_out)


def _reasons(left_out: dict[str, int], skipped: int) -> str:
    counts = {**left_out, "skipped": skipped}
    return ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if count)
