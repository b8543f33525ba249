"""What needs packages that a vehicle has not: one sentence with the line that installs them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from tramstream.errors import ConfigError


@contextmanager
def needs(extra: str) -> Iterator[None]:
    """Import inside; a module of another package that is missing becomes a sentence.

    Raises
    ------
    ConfigError
        With the cure.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        name = (error.name or "").partition(".")[0]
        if name in ("", "tramstream"):
            raise
        raise ConfigError(
            f"the package {name} is not installed",
            cure=f"pip install 'tramstream[{extra}]'",
        ) from error
