"""`tramstream reproduce NAME`: the figures of one of the five works beside ours."""

from __future__ import annotations

from typing import Annotated

import typer

WORKS = ("konecny2004",)


def reproduce(
    name: Annotated[str, typer.Argument(help=f"One of: {', '.join(WORKS)}.")],
    seed: Annotated[int, typer.Option(help="Of the random numbers.")] = 2004,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Reproduce the figures of a published work."""
    import json
    from dataclasses import asdict

    from tramstream.errors import ConfigError
    from tramstream.processors import konecny2004

    if name not in WORKS:
        raise ConfigError(f"no work is called {name!r}; there are: {', '.join(WORKS)}")
    cases = konecny2004.cases(seed)
    if json_:
        figures = {"work": name, "seed": seed, "runs": konecny2004.RUNS}
        print(json.dumps({**figures, "cases": [asdict(case) for case in cases]}))
        return

    from rich.console import Console
    from rich.table import Table

    table = Table(
        title=f"{name}: travelled distance, σ = 40 m; {konecny2004.RUNS} runs of "
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
