"""Where a page or table goes: never over what it is made from, and whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from tramstream.cli.terminal.session import make_room
from tramstream.errors import ConfigError


def make_place(out: Path, sources: Sequence[Path], overwrite: bool, option: str = "--out") -> None:
    """Refuse an output that would be in the wrong place, before it is made.

    Raises
    ------
    ConfigError
        One sentence with the file and the cure.
    """
    make_room(out, sources, overwrite=False)
    if out.exists() and not overwrite:
        raise ConfigError(f"{out}: exists already; choose another {option} or give --overwrite")
    if not out.absolute().parent.is_dir():
        raise ConfigError(f"{out}: its folder does not exist; make it or choose another {option}")


def write(out: Path, page: str) -> None:
    """Write a page whole or not at all; whoever is ended meanwhile leaves nothing."""
    unfinished = out.with_name(out.name + ".part")
    try:
        unfinished.write_text(page, encoding="utf-8")
        os.replace(unfinished, out)
    finally:
        unfinished.unlink(missing_ok=True)
