"""Files that people name: read whole, or refused in one sentence."""

from __future__ import annotations

from pathlib import Path

from tramstream.errors import ConfigError


def read_bytes(path: Path) -> bytes:
    """Read a file.

    Raises
    ------
    ConfigError
        One sentence with the file and why it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); check the name") from error
