"""`tramstream grade-map show MAP.parquet`: what a grade map holds, and a page to look at it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def show(
    grades: Annotated[Path, typer.Argument(metavar="MAP.parquet", help="Of `grade-map build`.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Page to write, PAGE.html.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace PAGE.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Describe a grade map: rides, profiles and their steepest places; with -o draw it on a page.

    The page is one file that opens in any browser and asks no network.
    """
    import json

    from tramstream.analysis.grade_map import file
    from tramstream.analysis.grade_map.summary import summary
    from tramstream.analysis.grade_map.tables import profile_rows, ride_rows
    from tramstream.shown import shown_json

    if out is not None:
        from tramstream.cli.terminal.page_file import make_place

        make_place(out, [grades], overwrite)
    made = file.read(grades)
    figures: dict[str, Any] = {"file": str(grades), "bytes": grades.stat().st_size, **summary(made)}
    figures |= {"profiles": profile_rows(made), "by_ride": ride_rows(made)}
    if out is not None:
        from tramstream.analysis.report.grade_map_page import compose
        from tramstream.cli.terminal.page_file import write

        write(out, compose(made, grades.name, figures))
        figures["out"] = str(out)
    if as_json:
        print(shown_json(json.dumps(figures, ensure_ascii=False)))
    else:
        _print(figures)


def _print(figures: dict[str, Any]) -> None:
    import sys

    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from tramstream.analysis.grade_map.summary import sentences
    from tramstream.analysis.grade_map.tables import PROFILE_HEAD, RIDE_HEAD, cells_of_table
    from tramstream.shown import shown

    console = Console(width=None if sys.stdout.isatty() else 160)
    for text in sentences(figures):
        console.print(shown(text), markup=False, highlight=False, soft_wrap=True)
    for head, rows in ((PROFILE_HEAD, figures["profiles"]), (RIDE_HEAD, figures["by_ride"])):
        table = Table(box=None, pad_edge=False, header_style="bold")
        for name, _ in head:
            left = name in ("profile", "ride", "verdict")
            table.add_column(name, justify="left" if left else "right")
        for row in cells_of_table(head, rows):
            table.add_row(*(escape(shown(cell)) for cell in row))
        console.print()
        console.print(table)
    if "out" in figures:
        console.print(f"page: {figures['out']}", markup=False, highlight=False)
