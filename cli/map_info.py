"""`tramstream map info NET`: what a track network holds, and a page to look at it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tramstream.tracks.network import Network


def info(
    net: Annotated[Path, typer.Argument(metavar="NET", help="Network of `map build`.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Page to write, PAGE.html.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace PAGE.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Describe a track network; with -o draw it on a page.

    The page is one file that opens in any browser and asks no network.
    """
    import json
    import time

    from tramstream.shown import shown_json
    from tramstream.tracks.network import load

    if out is not None:
        from tramstream.cli.terminal.page_file import make_place

        make_place(out, [net], overwrite)
    started_s = time.perf_counter()
    network = load(net)
    loading_s = time.perf_counter() - started_s
    size_bytes = net.stat().st_size
    figures: dict[str, Any] = {"file": str(net), "size_bytes": size_bytes, "loading_s": loading_s}
    figures |= describe(network)
    if out is not None:
        from tramstream.analysis.report.map_info_page import compose
        from tramstream.cli.terminal.page_file import write

        write(out, compose(network, net.name, figures))
        figures["out"] = str(out)
    if as_json:
        print(shown_json(json.dumps(figures, ensure_ascii=False)))
    else:
        _print(figures)


def describe(network: Network) -> dict[str, Any]:
    """Give the figures of a network, by name."""
    import numpy as np

    length_m = np.repeat(network.length_m, 2)
    of_sample = np.repeat(network.spacing_m, np.diff(network.starts))

    def share(which: Any) -> float:
        return float(np.sum(of_sample, where=which) / np.sum(of_sample))

    return {
        "source": network.source,
        "nodes": len(network.node_id),
        "tracks": network.track_count,
        "edges": len(network.edges),
        "switches": int(np.count_nonzero(network.node_switch)),
        "track_m": float(np.sum(network.length_m)),
        "edge_m": float(np.sum(length_m[network.edges])),
        "samples": int(network.starts[-1]),
        "node_std_m": network.node_std_m,
        "parallel_share": share(network.partner != 0),
        "height_share": share(np.isfinite(network.height)),
        "stops": len(network.stops),
        "lines": [
            {
                "line": line.line,
                "direction": line.direction,
                "origin": line.origin,
                "destination": line.destination,
                "length_m": line.length_m,
                "stops": len(line.stops),
            }
            for line in network.lines
        ],
    }


def _print(figures: dict[str, Any]) -> None:
    import sys

    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from tramstream.analysis.report.network_tables import LINE_HEAD, line_rows, network_facts
    from tramstream.shown import shown

    console = Console(width=None if sys.stdout.isatty() else 160)
    for name, value in [("file", figures["file"]), *network_facts(figures)]:
        console.print(f"{name:<12}{shown(value)}", markup=False, highlight=False, soft_wrap=True)
    if figures["lines"]:
        table = Table(box=None, pad_edge=False, header_style="bold")
        for name in LINE_HEAD:
            table.add_column(name, justify="right" if name in ("km", "stops") else "left")
        for *names, length_km, stops in line_rows(figures):
            table.add_row(
                *(escape(shown(str(name))) for name in names), f"{length_km:.3f}", str(stops)
            )
        console.print(table)
    if "out" in figures:
        console.print(f"{'page':<12}{figures['out']}", markup=False, highlight=False)
