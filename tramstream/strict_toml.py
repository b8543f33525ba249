"""TOML into structs, strictly: unknown fields, and numbers that are none, are refused."""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

import msgspec
import msgspec.inspect

from tramstream.errors import ConfigError
from tramstream.input_file import TEXT_LIMIT_BYTES

_DEEP_KEY = re.compile(rb"""(?:\.[ \t]*(?:[\w-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')[ \t]*){40}""")
"""A key of forty parts: Python's parser takes time with the square of them."""
FILL_IN = "FILL IN"
"""Stands in a written configuration where only the user knows what belongs there."""
Decoded = TypeVar("Decoded", bound=msgspec.Struct)


def decode_toml(data: bytes, type_: type[Decoded], name: str) -> Decoded:
    """Decode TOML text into a struct, as strictly as a configuration.

    Parameters
    ----------
    data : bytes
        The text.
    type_ : type
        What the whole document is.
    name : str
        Of the file, for the sentence.

    Raises
    ------
    ConfigError
        One sentence with the file, the path of the field and what was expected.
    """
    return convert(read_toml(data, name), type_, name)


def read_toml(data: bytes, name: str) -> dict[str, Any]:
    """TOML text as plain data.

    Raises
    ------
    ConfigError
        If it is none, or too long, or too deep.
    """
    if len(data) > TEXT_LIMIT_BYTES or _DEEP_KEY.search(data):
        raise ConfigError(f"{name}: not TOML that can be used: it is too long or nests too deeply")
    try:
        raw: dict[str, Any] = msgspec.toml.decode(data)
    except RecursionError:
        raise ConfigError(f"{name}: not TOML that can be used: it nests too deeply") from None
    except (msgspec.DecodeError, ValueError) as error:
        raise ConfigError(f"{name}: not TOML: {error}") from error
    return raw


def convert(raw: Any, type_: type[Decoded], name: str, path: str = "$") -> Decoded:
    """Plain data as a struct, strictly; `path` is where it stands in the document.

    Raises
    ------
    ConfigError
        One sentence with the file, the path of the field and what was expected.
    """
    try:
        _check(raw, _info(type_), path)
        return msgspec.convert(raw, type_)
    except msgspec.ValidationError as error:  # its paths begin at the part, not at the document
        text = str(error).replace("`$", f"`{path}")
        where = "" if path in text else f" - at `{path}`"
        raise ConfigError(f"{name}: {text}{where}") from error
    except ValueError as error:
        raise ConfigError(f"{name}: {error}") from error


_info = cache(msgspec.inspect.type_info)


def _check(value: Any, expected: msgspec.inspect.Type, path: str) -> None:
    """Refuse what msgspec would let pass, or refuse without a cure.

    Raises
    ------
    ValueError
        For an unknown field or choice, with the nearest known ones, for nan and infinity, and for
        what is still to be filled in.
    """
    if value == FILL_IN:
        raise ValueError(f"{path}: is still to be filled in; write the value of this vehicle")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{path}: {value} is not a finite number")
    expected = _bare(expected)
    if isinstance(expected, msgspec.inspect.UnionType):
        expected = _chosen(expected, value)
    choices = _choices(expected)
    if choices and value not in choices:
        names = [str(choice) for choice in choices]
        raise ValueError(_unknown(path, f"{value!r} is none of the choices", str(value), names))
    if isinstance(value, int | float) and not isinstance(value, bool):
        _check_range(value, expected, path)
    if isinstance(value, list):
        item_type = getattr(expected, "item_type", msgspec.inspect.AnyType())
        types = getattr(expected, "item_types", ())
        types = types if len(types) == len(value) else (item_type,) * len(value)
        for index, item in enumerate(value):
            _check(item, types[index], f"{path}[{index}]")
    elif isinstance(value, dict) and isinstance(expected, msgspec.inspect.DictType):
        for name, item in value.items():
            _check(item, expected.value_type, f"{path}.{name}")
    elif isinstance(value, dict) and isinstance(expected, msgspec.inspect.StructType):
        known = {field.encode_name: field.type for field in expected.fields}
        if expected.tag_field:
            known[expected.tag_field] = msgspec.inspect.AnyType()
        for name, item in value.items():
            if name not in known:
                raise ValueError(_unknown(f"{path}.{name}", "unknown field", name, list(known)))
            _check(item, known[name], f"{path}.{name}")


def _bare(expected: msgspec.inspect.Type) -> msgspec.inspect.Type:
    while isinstance(expected, msgspec.inspect.Metadata):
        expected = expected.type
    return expected


def _choices(expected: msgspec.inspect.Type) -> list[Any]:
    """What may be written where only some words may; else empty."""
    if isinstance(expected, msgspec.inspect.LiteralType):
        return list(expected.values)
    if isinstance(expected, msgspec.inspect.EnumType):
        return [each.value for each in expected.cls]
    return []


def _check_range(value: float, expected: msgspec.inspect.Type, path: str) -> None:
    """Refuse a number out of its range, and name the whole range.

    Raises
    ------
    ValueError
    """
    if not isinstance(expected, msgspec.inspect.IntType | msgspec.inspect.FloatType):
        return
    within: dict[str, tuple[float | None, Callable[[Any, Any], bool]]] = {
        ">": (expected.gt, operator.gt),
        ">=": (expected.ge, operator.ge),
        "<": (expected.lt, operator.lt),
        "<=": (expected.le, operator.le),
    }
    known = [(sign, bound, holds) for sign, (bound, holds) in within.items() if bound is not None]
    if all(holds(value, bound) for _, bound, holds in known):
        return
    allowed = " and ".join(f"{sign} {bound:.15g}" for sign, bound, _ in known)
    raise ValueError(f"{path}: {value!r:.40} is out of range; it must be {allowed}")


def _chosen(union: msgspec.inspect.UnionType, value: Any) -> msgspec.inspect.Type:
    """The member that `value` is: a section that may be absent, or one of several by its tag."""
    structs = [each for each in union.types if isinstance(each, msgspec.inspect.StructType)]
    if isinstance(value, dict):
        structs = [
            each for each in structs if not each.tag_field or value.get(each.tag_field) == each.tag
        ]
    others = [each for each in union.types if not isinstance(each, msgspec.inspect.NoneType)]
    if not structs and len(others) == 1:
        return _bare(others[0])
    return structs[0] if structs else msgspec.inspect.AnyType()


def _unknown(path: str, what: str, name: str, known: list[str]) -> str:
    near = difflib.get_close_matches(name, known, n=2)
    guess = f"did you mean {' or '.join(near)}? " if near else ""
    return f"{path}: {what}; {guess}there are: {', '.join(each or repr('') for each in known)}"
