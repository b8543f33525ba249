"""`tramstream map info NET`: what a track network holds, and a page to look at it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from tramstream.network import Network


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

    from tramstream.network import load
    from tramstream.shown import shown_json

    if out is not None:
        from tramstream.cli.page_file import make_place

        make_place(out, [net], overwrite)
    started_s = time.perf_counter()
    network = load(net)
    loading_s = time.perf_counter() - started_s
    size_bytes = net.stat().st_size
    figures: dict[str, Any] = {"file": str(net), "size_bytes": size_bytes, "loading_s": loading_s}
    figures |= describe(network)
    if out is not None:
        from tramstream.cli.map_info_page import compose
        from tramstream.cli.page_file import write

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


def facts(figures: dict[str, Any]) -> list[tuple[str, str]]:
    """Name and value of each figure, for people."""
    height = figures["height_share"]
    return [
        ("built from", figures["source"]),
        ("size", f"{figures['size_bytes'] / 1e6:.2f} MB, loaded in {figures['loading_s']:.2f} s"),
        ("tracks", f"{figures['tracks']}, {figures['track_m'] / 1000:.1f} km"),
        ("edges", f"{figures['edges']} directed, {figures['edge_m'] / 1000:.1f} km"),
        ("nodes", f"{figures['nodes']}, {figures['switches']} of them switches"),
        ("parallel", f"{figures['parallel_share']:.1%} of the track has another one beside it"),
        ("node error", f"σ {figures['node_std_m']:.2f} m from the rail, per axis"),
        ("heights", f"known for {height:.1%} of the track" if height else "none"),
        ("stops", str(figures["stops"])),
        ("lines", str(len(figures["lines"]))),
    ]


LINE_HEAD = ("line", "direction", "from", "to", "km", "stops")


def line_rows(figures: dict[str, Any]) -> list[tuple[str, str, str, str, float, int]]:
    """A row of the table of lines for each; see `LINE_HEAD`."""
    return [
        (
            line["line"],
            line["direction"],
            line["origin"],
            line["destination"],
            line["length_m"] / 1000,
            line["stops"],
        )
        for line in figures["lines"]
    ]


def _print(figures: dict[str, Any]) -> None:
    import sys

    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from tramstream.shown import shown

    console = Console(width=None if sys.stdout.isatty() else 160)
    for name, value in [("file", figures["file"]), *facts(figures)]:
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
