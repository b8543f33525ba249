"""`tramstream reproduce NAME`: the figures of one of the five works beside ours."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

WORKS = ("konecny2004", "kaspar2023", "drives")


@dataclass(frozen=True)
class Options:
    """What the command line said; each work takes what concerns it."""

    seed: int | None
    seeds: int | None
    lines: tuple[str, ...]
    duration_s: float | None
    json: bool
    data: Path | None = None
    mappings: Path | None = None
    kinds: tuple[str, ...] = ()


def reproduce(
    name: Annotated[str, typer.Argument(help=f"One of: {', '.join(WORKS)}.")],
    seed: Annotated[
        int | None, typer.Option(help="Of the random numbers; of the first ride.", min=0)
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(help="kaspar2023: rides of each kind; default 5.", min=1)
    ] = None,
    line: Annotated[
        list[str] | None,
        typer.Option(
            help="kaspar2023: FILE.geojson, FILE.geojson#LINE/DIRECTION, or built-in (the "
            "default); may be given several times.",
            metavar="FILE[#LINE]",
        ),
    ] = None,
    kind: Annotated[
        list[str] | None,
        typer.Option(
            help="kaspar2023: two wheels, one wheel, slip or white; may be given several times; "
            "default all.",
        ),
    ] = None,
    duration_s: Annotated[
        float, typer.Option("--duration-s", help="kaspar2023: end rides early; 0 is never.", min=0)
    ] = 0.0,
    data: Annotated[
        Path | None,
        typer.Option(help="drives: where they are; default ../shared/data/drives.", metavar="DIR"),
    ] = None,
    mappings: Annotated[
        Path | None, typer.Option(help="drives: of mapping files; default mappings.", metavar="DIR")
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Reproduce the figures of a published work, or ours on the real drives."""
    from importlib import import_module

    from tramstream.errors import ConfigError

    if name not in WORKS:
        raise ConfigError(f"no work is called {name!r}; there are: {', '.join(WORKS)}")
    lines, kinds = tuple(line or ()), tuple(kind or ())
    options = Options(seed, seeds, lines, duration_s or None, json_, data, mappings, kinds)
    import_module(f"tramstream.cli.reproduce_{name}").reproduce(options)
