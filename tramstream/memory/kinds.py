"""How each kind of value in a memory is copied, kept as plain data, read back, and assigned.

`tramstream/memory/stage.py` makes one of these for each annotation, once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from copy import deepcopy
from enum import Enum
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError, Message


class Kind:
    """Values of one type. As it stands: of whatever kind, copied to the last depth."""

    def copy(self, value: Any) -> Any:
        """A value that shares nothing with `value` that anybody changes."""
        return deepcopy(value)

    def plain(self, value: Any) -> Any:
        """The same as plain data, which share nothing with `value`."""
        return self.copy(value)

    def read(self, value: Any, path: str) -> Any:
        """Back from plain data, which stand at `path` of a memory.

        Raises
        ------
        TypeError
            If they are of another type.
        """
        return self.copy(value)

    def merge(self, old: Any, new: Any) -> Any:
        """What a field with `old` holds after it was assigned `new`."""
        return self.copy(new)


def _unfit(path: str, value: Any, expected: str) -> TypeError:
    return TypeError(f"memory of another version: {path} is a {type(value).__name__}, {expected}")


# Values that nobody changes ----------------------------------------------------------------------
TAKEN_FOR: dict[Any, tuple[type, ...]] = {
    bool: (bool, np.bool_),
    int: (int, np.integer),
    float: (float, int, np.floating, np.integer),
    str: (str,),
    bytes: (bytes,),
    type(None): (type(None),),
}
"""What is taken for each type: numpy's numbers are as good as Python's."""


class Value(Kind):
    """Numbers, texts and bytes, and all that is a value like these."""

    def __init__(self, *accepted: type) -> None:
        self._accepted = accepted

    def copy(self, value: Any) -> Any:
        return value

    def read(self, value: Any, path: str) -> Any:
        if not isinstance(value, self._accepted):
            raise _unfit(path, value, f"not a {self._accepted[0].__name__}")
        return value

    def merge(self, old: Any, new: Any) -> Any:
        return new


class Complex(Value):
    def plain(self, value: complex) -> list[float]:
        return [value.real, value.imag]

    def read(self, value: Any, path: str) -> complex:
        if not isinstance(value, list) or len(value) != 2:
            raise _unfit(path, value, "not a real and an imaginary part")
        return complex(*value)


class Member(Value):
    """Members of an enumeration, by name."""

    def __init__(self, kind: type[Enum]) -> None:
        self._kind = kind

    def plain(self, value: Enum) -> str:
        return value.name

    def read(self, value: Any, path: str) -> Enum:
        if value not in self._kind.__members__:
            raise _unfit(path, value, f"no {self._kind.__name__}")
        return self._kind[value]


class OneMessage(Value):
    """Messages of one type."""

    def __init__(self, kind: type[Message]) -> None:
        self._kind = kind

    def plain(self, value: Message) -> bytes:
        return value.SerializeToString()

    def read(self, value: Any, path: str) -> Message:
        try:
            return self._kind.FromString(value)
        except (TypeError, DecodeError) as error:
            raise _unfit(path, value, f"no {self._kind.__name__}") from error


class OneOfMessages(Value):
    """Messages of several types, each beside its type's name."""

    def __init__(self, kinds: Iterable[type[Message]]) -> None:
        self._kinds = {kind.DESCRIPTOR.full_name: OneMessage(kind) for kind in kinds}

    def plain(self, value: Message) -> list[Any]:
        return [value.DESCRIPTOR.full_name, value.SerializeToString()]

    def read(self, value: Any, path: str) -> Message:
        if not isinstance(value, list) or len(value) != 2 or value[0] not in self._kinds:
            raise _unfit(path, value, "not a message with its name")
        return self._kinds[value[0]].read(value[1], path)


# Arrays ------------------------------------------------------------------------------------------
class WholeArray(Kind):
    """Arrays that are replaced as a whole."""

    def copy(self, value: Any) -> Any:
        return value.copy()

    def read(self, value: Any, path: str) -> Any:
        if not isinstance(value, np.ndarray):
            raise _unfit(path, value, "not an array")
        return value.copy()


class FilledArray(WholeArray):
    """Arrays that keep their shape, and are filled: others may hold views of them."""

    def merge(self, old: Any, new: Any) -> Any:
        if not isinstance(old, np.ndarray):
            return new.copy()
        if old.shape != new.shape or old.dtype != new.dtype:
            raise TypeError(
                f"memory of another version: an array of {new.shape} {new.dtype}, "
                f"not {old.shape} {old.dtype}"
            )
        old[...] = new
        return old


# Containers --------------------------------------------------------------------------------------
class Maybe(Kind):
    def __init__(self, inner: Kind) -> None:
        self._inner = inner

    def copy(self, value: Any) -> Any:
        return None if value is None else self._inner.copy(value)

    def plain(self, value: Any) -> Any:
        return None if value is None else self._inner.plain(value)

    def read(self, value: Any, path: str) -> Any:
        return None if value is None else self._inner.read(value, path)

    def merge(self, old: Any, new: Any) -> Any:
        return self.copy(new) if old is None or new is None else self._inner.merge(old, new)


class Several(Kind):
    """Lists, deques, sets, and tuples of any length."""

    def __init__(self, kind: type, inner: Kind) -> None:
        self._kind, self._inner = kind, inner
        self._of_values = _shared(inner)

    def copy(self, value: Any) -> Any:
        each = value if self._of_values else map(self._inner.copy, value)
        return deque(each, value.maxlen) if self._kind is deque else self._kind(each)

    def plain(self, value: Any) -> Any:
        return [self._inner.plain(each) for each in value]

    def read(self, value: Any, path: str) -> Any:
        if not isinstance(value, list):
            raise _unfit(path, value, "not a list")
        return self._kind(self._inner.read(each, path) for each in value)

    def merge(self, old: Any, new: Any) -> Any:
        copies = self.copy(new)
        if self._kind is tuple:
            return copies
        old.clear()
        if self._kind is set:
            old.update(copies)
        else:
            old.extend(copies)
        return old


class Row(Kind):
    """Tuples of so many elements, and named ones."""

    def __init__(self, kind: Any, inner: list[Kind]) -> None:
        self._make = kind._make if hasattr(kind, "_make") else tuple
        self._inner = inner
        self.shared: bool = all(_shared(each) for each in inner)

    def copy(self, value: Any) -> Any:
        if self.shared:
            return value
        return self._make(kind.copy(each) for kind, each in zip(self._inner, value, strict=True))

    def plain(self, value: Any) -> Any:
        return [kind.plain(each) for kind, each in zip(self._inner, value, strict=True)]

    def read(self, value: Any, path: str) -> Any:
        if not isinstance(value, list) or len(value) != len(self._inner):
            raise _unfit(path, value, f"not {len(self._inner)} values")
        pairs = zip(self._inner, value, strict=True)
        return self._make(kind.read(each, path) for kind, each in pairs)


def _shared(kind: Kind) -> bool:
    """Whether copies share what is of this kind, for nobody can change it."""
    return isinstance(kind, Value) or (isinstance(kind, Row) and kind.shared)


class Dictionary(Kind):
    """Dictionaries; kept as pairs where their keys are no texts."""

    def __init__(self, kind: type, key: Kind, inner: Kind, by_text: bool) -> None:
        self._kind, self._key, self._inner, self._by_text = kind, key, inner, by_text

    def copy(self, value: Any) -> Any:
        return self._kind({key: self._inner.copy(each) for key, each in value.items()})

    def plain(self, value: Any) -> Any:
        if self._by_text:
            return {key: self._inner.plain(each) for key, each in value.items()}
        pairs = value.items()
        return [[self._key.plain(key), self._inner.plain(each)] for key, each in pairs]

    def read(self, value: Any, path: str) -> Any:
        if not isinstance(value, dict if self._by_text else list):
            raise _unfit(path, value, "not a dictionary")
        pairs = value.items() if isinstance(value, dict) else value
        return self._kind(
            {self._key.read(key, path): self._inner.read(each, path) for key, each in pairs}
        )

    def merge(self, old: Any, new: Any) -> Any:
        inner = self._inner
        merged = {
            key: inner.merge(old[key], each) if key in old else inner.copy(each)
            for key, each in new.items()
        }
        old.clear()
        old.update(merged)  # in the order of `new`
        return old


class Fields(Kind):
    """Dataclasses that are filled field by field."""

    def __init__(self, kind: type, by_name: dict[str, Kind]) -> None:
        self._kind, self._fields = kind, list(by_name.items())

    def copy(self, value: Any) -> Any:
        return self._kind(**{name: kind.copy(getattr(value, name)) for name, kind in self._fields})

    def plain(self, value: Any) -> Any:
        return {name: kind.plain(getattr(value, name)) for name, kind in self._fields}

    def read(self, value: Any, path: str) -> Any:
        if not isinstance(value, dict):
            raise _unfit(path, value, "not a memory")
        unknown = value.keys() - {name for name, _ in self._fields}
        if unknown:
            raise TypeError(
                f"memory of another version: {path} has no {', '.join(sorted(unknown))}"
            )
        for name, _ in self._fields:
            if name not in value:
                raise TypeError(f"memory of another version: {path}.{name} is missing")
        return self._kind(
            **{name: kind.read(value[name], f"{path}.{name}") for name, kind in self._fields}
        )

    def merge(self, old: Any, new: Any) -> Any:
        for name, kind in self._fields:
            setattr(old, name, kind.merge(getattr(old, name), getattr(new, name)))
        return old


class FrozenFields(Fields):
    """Dataclasses that nobody changes."""

    def copy(self, value: Any) -> Any:
        return value

    def merge(self, old: Any, new: Any) -> Any:
        return new


class Shorter(Kind):
    """Classes that know a shorter plain form of themselves: `to_plain` and `from_plain`."""

    def __init__(self, kind: Any) -> None:
        self._kind = kind

    def copy(self, value: Any) -> Any:
        return self._kind.from_plain(value.to_plain())

    def plain(self, value: Any) -> Any:
        return value.to_plain()

    def read(self, value: Any, path: str) -> Any:
        return self._kind.from_plain(value)

    def merge(self, old: Any, new: Any) -> Any:
        vars(old).update(vars(self.copy(new)))
        return old
