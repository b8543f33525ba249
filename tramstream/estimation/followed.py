"""Whom a processor follows that follows a localiser, any one: the key that its settings name."""

from __future__ import annotations

from typing import Any

from tramstream import keys
from tramstream.errors import ConfigError
from tramstream.keys import Key
from tramstream.proto.estimate_pb2 import MotionState


def followed(field: str, source: str, also: tuple[Key, ...] = ()) -> Key:
    """Give the key of a localiser's states, or one that carries what those of `also` do.

    Parameters
    ----------
    field : str
        The setting that names it, for the message: `map.source`.
    source : str
        The key's path.

    Raises
    ------
    ConfigError
        If it is a key of something else.
    """
    key = keys.find(source)
    if key is None:  # another package's: it says what all localisers say
        return keys.define(source, MotionState, 0.0, "state", "State of a localiser")
    known: tuple[Any, ...] = (MotionState, *(each.type for each in also))
    if key.type not in known:
        examples = " or ".join(each.path for each in (keys.EST_STATE, *also))
        raise ConfigError(
            f"$.{field}: {source} carries {key.type.DESCRIPTOR.full_name}; "
            f"{examples} can be followed"
        )
    return key
