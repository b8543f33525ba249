"""What is registered by entry point, ours and strangers': the library imports none of it by name.

Groups: `bridges` (processor class), `ports` (port factory of the bridge with the same name),
`processors` (processor class), `nodes` (whole node), `verbs` (of the command line); each is the
entry-point group `tramstream.<group>`. What is installed does not run by being installed: the
configuration says what does.
"""

from __future__ import annotations

import difflib
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from tramstream.errors import ConfigError


def points(group: str) -> list[EntryPoint]:
    """Entry points of `tramstream.<group>`, by name."""
    return sorted(entry_points(group=f"tramstream.{group}"), key=lambda point: point.name)


def names(group: str) -> list[str]:
    """Names registered in `tramstream.<group>`."""
    return [point.name for point in points(group)]


def load(group: str, name: str) -> Any:
    """The object registered as `name`.

    Raises
    ------
    ConfigError
        If there is none, with those that there are; or if its package cannot be imported.
    """
    for point in points(group):
        if point.name == name:
            try:
                return point.load()
            except Exception as error:
                package = point.dist.name if point.dist is not None else point.module
                raise ConfigError(
                    f"{group.rstrip('s')} {name}: package {package} cannot be loaded "
                    f"({type(error).__name__}: {error})",
                    cure="mend or uninstall it, or do not name it",
                ) from error
    raise ConfigError(unknown(group.rstrip("s"), name, names(group)))


def unknown(what: str, name: str, known: list[str]) -> str:
    """The sentence for a name that nobody has registered."""
    near = difflib.get_close_matches(name, known, n=1)
    guess = f"did you mean {near[0]}? " if near else ""
    there = ", ".join(known) or "none; is tramstream installed (`pip install -e .`)?"
    return f"no {what} is called {name!r}; {guess}there are: {there}"
