"""Which rides globs and folders mean: a file each, parts of one boot together."""

from __future__ import annotations

import glob
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tramstream.errors import RecordError

_PART = re.compile(r"(?P<ride>.+_b\d+)-\d+_[^_/]+\.mcap(\.active)?")
"""Of the recorder: `<vehicle>_b<boot>-<number>_<start>.mcap`."""


class Place(NamedTuple):
    """A ride."""

    name: str
    """The file, or what its parts share."""
    paths: tuple[Path, ...]


def places(named: Sequence[Path | str]) -> list[Place]:
    """Rides of files, folders (all below them) and globs, each once, in order of their names.

    Raises
    ------
    RecordError
        If a name means nothing.
    """
    found: dict[Path, None] = {}
    for each in named:
        path = Path(each)
        if path.is_dir():
            inside = [*path.rglob("*.mcap"), *path.rglob("*.mcap.active")]
            inside = [one for one in inside if one.stat().st_size]
        elif path.exists():
            inside = [path]
        else:
            inside = [Path(one) for one in glob.glob(str(each), recursive=True)]
            inside = [one for one in inside if one.is_file()]
        if not inside:
            raise RecordError(
                f"{each}: means no record (*.mcap)", cure="name a file, a folder, or a glob"
            )
        found.update(dict.fromkeys(inside))
    rides: dict[str, list[Path]] = {}
    for path in sorted(found):
        part = _PART.fullmatch(path.name)
        name = str(path.with_name(part["ride"])) if part else str(path)
        rides.setdefault(name, []).append(path)
    return [Place(name, tuple(paths)) for name, paths in rides.items()]
