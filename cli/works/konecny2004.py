"""`tramstream reproduce konecny2004`: the table of the travelled-distance filter."""

from __future__ import annotations

import json
from dataclasses import asdict

from rich.console import Console
from rich.table import Table

from tramstream.analysis.studies import konecny2004
from tramstream.cli.figures.options import Options

NAME = "konecny2004"
SEED = 2004


def reproduce(options: Options) -> None:
    """Print the cases."""
    seed = SEED if options.seed is None else options.seed
    cases = konecny2004.cases(seed)
    if options.json:
        figures = {"work": NAME, "seed": seed, "runs": konecny2004.RUNS}
        print(json.dumps({**figures, "cases": [asdict(case) for case in cases]}))
        return
    table = Table(
        title=f"{NAME}: travelled distance, σ = 40 m; {konecny2004.RUNS} runs of "
        f"{konecny2004.STEPS} steps",
        box=None,
        pad_edge=False,
        collapse_padding=True,
    )
    columns = ("case", "raw m", "predicted m", "filtered m", "gain", "speed m/s", "±2σ")
    for column in columns:
        table.add_column(column, justify="left" if column == "case" else "right", no_wrap=True)
    for case in cases:
        table.add_row(
            case.name,
            f"{case.raw_rmse_m:.2f}",
            f"{case.predicted_rmse_m:.2f}",
            f"{case.filtered_rmse_m:.2f}",
            f"{case.gain:.2f}",
            f"{case.speed_rmse_mps:.2f}",
            f"{100 * case.within_two_sigma:.1f} %",
        )
    console = Console()
    console.print(table)
    console.print(
        "Root mean square errors. raw: the measurement; predicted: before, filtered: after "
        "the data step;\ngain: raw / filtered. In the last line the filter is told the mean "
        "interval, not the true one."
    )
