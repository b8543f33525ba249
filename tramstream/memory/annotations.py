"""From the annotation of a memory's field to how its values are copied and kept."""

from __future__ import annotations

import types
import typing
from collections import Counter, deque
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Annotated, Any

import numpy as np
from google.protobuf.message import Message
from numpy.typing import NDArray

from tramstream.memory import kinds
from tramstream.memory.kinds import Kind

VARYING = "varying"
"""In an annotation: an array that is replaced as a whole, whatever its shape."""
Varying = Annotated[NDArray[np.float64], VARYING]


@cache
def dataclass_kind(kind: type) -> Kind:
    """How memories of the dataclass `kind` are kept.

    Raises
    ------
    TypeError
        If it is no dataclass, or holds what cannot be kept.
    """
    if not is_dataclass(kind):
        raise TypeError(f"{kind.__name__} is no memory: a memory is a dataclass")
    hints = typing.get_type_hints(kind, include_extras=True)
    by_name = {
        each.name: kind_of(hints[each.name], f"{kind.__name__}.{each.name}")
        for each in fields(kind)
        if each.init
    }
    frozen: bool = kind.__dataclass_params__.frozen  # type: ignore[attr-defined]
    return kinds.FrozenFields(kind, by_name) if frozen else kinds.Fields(kind, by_name)


def kind_of(hint: Any, where: str) -> Kind:
    """How values are kept that `where` are annotated with `hint`.

    Raises
    ------
    TypeError
        If such values cannot be kept.
    """
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return kinds.WholeArray() if VARYING in arguments else kind_of(arguments[0], where)
    if origin in (typing.Union, types.UnionType):
        return _choice(arguments, where)
    kind = origin or hint
    if kind is Any:
        return Kind()
    if kind in kinds.TAKEN_FOR:
        return kinds.Value(*kinds.TAKEN_FOR[kind])
    found = _class_kind(kind, arguments, where) if isinstance(kind, type) else None
    if found is None:
        raise TypeError(f"{where}: a memory cannot hold {hint!r}")
    return found


def _choice(arguments: tuple[Any, ...], where: str) -> Kind:
    """`X | None`, numbers and texts of several types, messages of several types."""
    rest = [each for each in arguments if each is not type(None)]
    if all(each in kinds.TAKEN_FOR for each in rest):
        return kinds.Value(*(one for each in arguments for one in kinds.TAKEN_FOR[each]))
    if len(rest) == 1:
        return kinds.Maybe(kind_of(rest[0], where))
    if not all(isinstance(each, type) and issubclass(each, Message) for each in rest):
        raise TypeError(f"{where}: a memory cannot hold one of {rest}")
    kind = kinds.OneOfMessages(rest)
    return kinds.Maybe(kind) if len(rest) < len(arguments) else kind


def _class_kind(kind: type, arguments: tuple[Any, ...], where: str) -> Kind | None:
    """How instances of a class are kept; None if they cannot be."""
    if issubclass(kind, np.ndarray):
        return kinds.FilledArray()
    if issubclass(kind, Message):
        return kinds.OneMessage(kind)
    if issubclass(kind, Enum):
        return kinds.Member(kind)
    if issubclass(kind, complex):
        return kinds.Complex()
    if issubclass(kind, dict):
        return _dict_kind(kind, arguments, where)
    if issubclass(kind, tuple):
        return _tuple_kind(kind, arguments, where)
    if kind in (list, deque, set):
        return kinds.Several(kind, kind_of(arguments[0] if arguments else Any, where))
    if is_dataclass(kind):
        return dataclass_kind(kind)
    return kinds.Shorter(kind) if hasattr(kind, "to_plain") else None


def _dict_kind(kind: type, arguments: tuple[Any, ...], where: str) -> Kind:
    key, inner = (*arguments, int)[:2] if kind is Counter else arguments or (str, Any)
    return kinds.Dictionary(kind, kind_of(key, where), kind_of(inner, where), by_text=key is str)


def _tuple_kind(kind: Any, arguments: tuple[Any, ...], where: str) -> Kind:
    if hasattr(kind, "_fields"):
        hints = typing.get_type_hints(kind, include_extras=True)
        return kinds.Row(kind, [kind_of(hints[name], where) for name in kind._fields])
    if not arguments or arguments[-1] is Ellipsis:
        return kinds.Several(tuple, kind_of(arguments[0] if arguments else Any, where))
    return kinds.Row(kind, [kind_of(each, where) for each in arguments])
