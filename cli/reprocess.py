"""`tramstream reprocess FILE -o OUT`: the processors over a record, without a bus."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tramstream.analysis.evaluate.contradiction import Contradiction
    from tramstream.errors import CheckFailedError
    from tramstream.recorder.reprocess.compare import Comparison
    from tramstream.recorder.reprocess.run import Rerun


def reprocess(
    file: Annotated[Path, typer.Argument(help="Record, or a folder with the parts of one.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Record of the outputs.")],
    config: Annotated[
        Path | None, typer.Option(help="Use this configuration, not the record's own.")
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Compare with the outputs recorded live.")
    ] = False,
    fresh: Annotated[
        bool,
        typer.Option("--fresh", help="Ignore what the live run had read and remembered."),
    ] = False,
    late: Annotated[
        str, typer.Option(help="as-recorded: what was late stays late; accept: use it.")
    ] = "as-recorded",
    smooth: Annotated[
        bool,
        typer.Option(
            "--smooth",
            help="Add est/ekf/smoothed: ten states a second that know the whole ride. Takes 0.6 GB "
            "of memory an hour.",
        ),
    ] = False,
    judge: Annotated[
        bool,
        typer.Option(
            "--judge",
            help="Judge what the filter claims by its innovations (NIS), and by the truth where "
            "there is one (NEES, protection levels); status 1 where they contradict it.",
        ),
    ] = False,
    with_inputs: Annotated[
        bool,
        typer.Option(
            "--with-inputs",
            help="Write also inputs, fixes and truth (all of raw/ but devices' bytes): one file "
            "for a viewer.",
        ),
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace OUT.")] = False,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Run the processors over a record; --check holds them to what they did live.

    --judge holds them to what they claim. Log times of what is made are its stamps.
    """
    import json
    import time

    from tramstream.cli.terminal.session import make_room, say
    from tramstream.errors import (
        CheckFailedError,
        ConfigError,
        DamagedRecordError,
        MachineCodeError,
    )
    from tramstream.machine import compilation
    from tramstream.recorder.reprocess.run import rerun

    if late not in ("as-recorded", "accept"):
        raise ConfigError(f"--late {late}: must be as-recorded or accept")
    if check and (fresh or late == "accept"):
        raise ConfigError("--check compares with the live run; leave out --fresh and --late accept")
    make_room(out, [file], overwrite)
    try:
        compilation.ensure(say)
    except MachineCodeError as error:
        say(f"{error}; what is needed is compiled on the way")
    started_s = time.perf_counter()
    result = rerun(
        file,
        out,
        config,
        check=check,
        fresh=fresh or late == "accept",
        smooth=smooth,
        with_inputs=with_inputs,
    )
    figures: dict[str, Any] = {"file": str(file), "out": str(out)}
    figures |= _figures(result, time.perf_counter() - started_s)
    against: list[Contradiction] = []
    if judge:
        from tramstream.analysis.evaluate.record import contradictions_in

        against = contradictions_in(out)
        figures |= {"contradicted": bool(against), "contradictions": [str(one) for one in against]}
    if json_:
        print(json.dumps(figures))
    else:
        say(
            f"{file}: {result.duration_s:.1f} s in {figures['elapsed_s']:.2f} s "
            f"({figures['speed']:.0f} times real time), {result.outputs} outputs to {out}"
        )
    for text in _remarks(file, result):
        say(text)
    for one in against:
        say(f"{out}: {one}; {one.cure}")
    failed = None
    if result.comparison is not None:
        failed = _compare(file, result, result.comparison, not json_)
    if result.damaged:
        raise DamagedRecordError(f"{result.damaged}; what could be proved right was reprocessed")
    if failed is not None:
        raise failed
    if against:
        raise CheckFailedError(f"{out}: contradicts what its filter claims ({against[0].figure})")


def _remarks(file: Path, result: Rerun) -> Iterator[str]:
    """What is to be known of a run, one sentence each."""
    from tramstream.boundary import left_out

    if result.changed:
        yield f"{file}: settings that differ from the record's own: {len(result.changed)}"
        yield from (f"  {text}" for text in result.changed)
    if result.without_map:
        yield (
            f"{result.without_map}; localisation went on without the map "
            "(--config takes a configuration that names the file where it is now)"
        )
    if result.forgotten:
        yield (
            f"{file}: the record's memory was made with other settings, so the processors begin "
            f"afresh with the new ones ({result.forgotten} of {result.sessions} sessions)"
        )
    if result.unfit:
        yield (
            f"{file}: the record's memory is of other processors or of another version of them, so "
            f"they begin afresh ({result.unfit} of {result.sessions} sessions)"
        )
    if result.paused_s:
        yield (
            f"{file}: nothing was recorded for {result.paused_s:.0f} s in pauses of more than a "
            "minute; no time passed in them"
        )
    if left_out_ := left_out(result.undecodable.items()):
        yield f"{file}: {left_out_}, as live"
    for path, count in result.missing.items():
        yield f"{path}: {count} messages that the live processors read are not in the record"


def _figures(result: Rerun, elapsed_s: float) -> dict[str, Any]:
    """What a run came to, by name."""
    figures: dict[str, Any] = {
        "outputs": result.outputs,
        "smoothed": result.smoothed,
        "sessions": result.sessions,
        "duration_s": result.duration_s,
        "elapsed_s": elapsed_s,
        "speed": result.duration_s / elapsed_s if elapsed_s else 0.0,
        "inputs_missing": result.missing,
        "undecodable": result.undecodable,
        "sessions_afresh": result.forgotten + result.unfit,
        "damaged": result.damaged,
        "paused_s": result.paused_s,
        "settings_changed": result.changed,
        "copied": result.copied,
    }
    comparison = result.comparison
    if comparison is not None:
        figures |= {
            "identical": result.identical,
            "compared": comparison.compared,
            "unrecorded": comparison.unrecorded,
            "unanchored": comparison.unanchored,
            "difference_count": comparison.difference_count,
            "differences": comparison.differences,
        }
    return figures


def _compare(
    file: Path, result: Rerun, comparison: Comparison, aloud: bool
) -> CheckFailedError | None:
    """Say how outputs made again compare with those recorded live; what to raise if they differ."""
    from tramstream.cli.terminal.session import say
    from tramstream.errors import CheckFailedError

    if aloud:
        verdict = "identical" if result.identical else "different"
        print(f"{verdict}: {comparison.compared} outputs compared")
    if comparison.unrecorded or comparison.unanchored:
        say(
            f"{comparison.unrecorded} outputs made again were not in the record; "
            f"{comparison.unanchored} recorded ones came after the last tick of a session that died"
        )
    if result.identical:
        return None
    for text in comparison.differences:
        say(text)
    if comparison.compared == 0:
        say(f"{file}: the record holds no outputs of processors to compare with")
    return CheckFailedError(f"{file}: reprocessing does not give what was recorded live")
