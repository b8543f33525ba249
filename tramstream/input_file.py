"""Files that people name: read whole, or refused in one sentence.

A file may come from anybody: no more of it is read than its kind can have, and what it holds is
bounded before something is made of it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tramstream.errors import ConfigError

LIMIT_BYTES = 150_000_000
"""A city's rails with everything beside them are some tens of megabytes of text."""
TEXT_LIMIT_BYTES = 1_000_000
"""A configuration, a mapping, a list of lines has some kilobytes."""
_LARGEST = 1 << 63


def read_bytes(path: Path, limit_bytes: int = LIMIT_BYTES) -> bytes:
    """Read a file.

    Raises
    ------
    ConfigError
        One sentence with the file and why it cannot be read.
    """
    try:
        return read_limited(path, limit_bytes)
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read ({error.strerror})", cure="check the name"
        ) from error


def read_limited(path: Path, limit_bytes: int) -> bytes:
    """Read a file of at most `limit_bytes`; a device or a pipe may have no end.

    Raises
    ------
    OSError
        If it cannot be read.
    ConfigError
        If it is longer.
    """
    with path.open("rb") as file:
        data = file.read(limit_bytes + 1)
    if len(data) > limit_bytes:
        raise ConfigError(
            f"{path}: is longer than {limit_bytes / 1e6:.0f} MB, which none of its kind is",
            cure="check the name",
        )
    return data


def parse_json(data: bytes) -> Any:
    """JSON text as plain values; a whole number that 64 bits do not hold becomes a float.

    Raises
    ------
    ValueError
        If it is none, or nests deeper than anybody's data.
    """
    try:
        return json.loads(data, parse_int=_whole)
    except RecursionError:
        raise ValueError("it nests too deeply") from None


def _whole(digits: str) -> int | float:
    value = int(digits) if len(digits) < 25 else float(digits)
    return value if isinstance(value, int) and abs(value) < _LARGEST else float(value)
