"""`tramstream report FILE -o OUT.html`: one page to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def report(
    file: Annotated[Path, typer.Argument(help="Record, or a folder with the parts of one.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Page to write, OUT.html.")],
    truth: Annotated[
        str,
        typer.Option(
            metavar="KEY|FILE",
            help="Key of the truth, or the record that holds it; else raw/truth/state here, or in "
            "the record beside this one that it was reprocessed from.",
        ),
    ] = "",
    estimate: Annotated[
        str, typer.Option(metavar="KEY", help="What is drawn as the filter; else est/ekf/state.")
    ] = "",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace OUT.")] = False,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Draw a ride on one page: map, speed, errors, what the filter learned, health, losses.

    The page is one file that opens in any browser and asks no network.
    """
    import json
    import time

    from rich.console import Console

    from tramstream.analysis.report.compose import compose
    from tramstream.analysis.report.source import collect
    from tramstream.cli.terminal.page_file import write
    from tramstream.cli.terminal.session import make_room, say
    from tramstream.errors import ConfigError, DamagedRecordError
    from tramstream.shown import shown

    started_s = time.perf_counter()
    make_room(out, [file], overwrite=False)
    if out.exists() and not overwrite:
        raise ConfigError(f"{out}: exists already; choose another --out or give --overwrite")
    if not out.absolute().parent.is_dir():
        raise ConfigError(f"{out}: its folder does not exist; make it or choose another --out")
    with Console(stderr=True).status(shown(str(file))):
        material = collect(file, truth, estimate, say)
        write(out, compose(material))
    figures = {
        "file": str(file),
        "out": str(out),
        "size_bytes": out.stat().st_size,
        "duration_s": (material.end_ns - material.start_ns) / 1e9,
        "elapsed_s": time.perf_counter() - started_s,
    }
    print(json.dumps(figures) if json_ else out)
    if material.damaged:
        raise DamagedRecordError(f"{material.damaged}; what could be proved right was drawn")
    if material.left_out:
        raise DamagedRecordError(material.left_out)
