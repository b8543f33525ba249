"""`tramstream recover FILE`: save what can be proved right of a cut or damaged record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def recover(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A record, cut or damaged.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Write here. Default: an unfinished FILE.active is finished in place, anything "
            "else goes to FILE with .recovered.mcap at its end.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Save all messages that can be proved right; ends with 3 if some bytes were damaged."""
    import json
    import sys
    from dataclasses import asdict

    from tramstream.errors import DamagedRecordError, RecordError
    from tramstream.recorder.file.recover import recover as save
    from tramstream.recorder.file.repair import repair
    from tramstream.shown import shown

    if file.is_dir():
        raise RecordError(f"{file}: is a folder; name one record in it")
    if out is None and file.suffix == ".active":
        recovery = repair(file)
    else:
        recovery = save(file, out or file.with_name(_stem(file) + ".recovered.mcap"))
    if as_json:
        values = {
            **asdict(recovery),
            "source": str(recovery.source),
            "target": str(recovery.target) if recovery.target else None,
            "sentence": recovery.sentence,
        }
        print(json.dumps(values))
    elif recovery.target is not None:
        print(shown(str(recovery.target)))
    if not recovery.clean:
        raise DamagedRecordError(recovery.sentence)
    print(shown(recovery.sentence), file=sys.stderr)


def _stem(file: Path) -> str:
    return file.name.removesuffix(".active").removesuffix(".mcap")
