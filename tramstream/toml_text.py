"""Plain data as TOML text: Python reads TOML, but writes none."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from decimal import Decimal
from typing import Any

from tramstream.shown import shown

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def document(
    values: Mapping[str, Any], path: str = "", remarks: Mapping[str, str] | None = None
) -> str:
    """A whole document; what is None is left out, for TOML has no word for it.

    Parameters
    ----------
    values : mapping
        Of strings, numbers, truth values, lists of these, and mappings likewise: a table each.
    path : str
        Of the table that `values` is.
    remarks : mapping, optional
        Comments beside values, by their whole name: `imu.rate_hz`.
    """
    return "\n".join(_lines(values, path, remarks or {})) + "\n"


def _lines(values: Mapping[str, Any], path: str, remarks: Mapping[str, str]) -> Iterator[str]:
    def beside(name: str) -> str:
        # What a remark quotes may hold what ends a comment.
        remark = shown(remarks.get(name, ""))
        return f"  # {remark}" if remark else ""

    tables = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            tables[name] = value
        elif value is not None:
            whole = f"{path}.{name}" if path else name
            yield f"{key_text(name)} = {value_text(value)}{beside(whole)}"
    for name, table in tables.items():
        inner = f"{path}.{key_text(name)}" if path else key_text(name)
        if not table or not all(isinstance(each, Mapping) for each in table.values()):
            yield ""
            yield f"[{inner}]{beside(inner) or beside(path)}"
        yield from _lines(table, inner, remarks)


def key_text(name: str) -> str:
    """The name of a field, in quotes where it must be."""
    return name if _BARE.fullmatch(name) else value_text(name)


def value_text(value: Any) -> str:
    """A plain value in TOML; numbers without exponents, long ones in groups of three digits."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return f"{value:_}" if abs(value) >= 1_000_000 else str(value)
    if isinstance(value, float):
        text = format(Decimal(repr(value)), "f")
        return text if "." in text or not text.strip("-").isdigit() else f"{text}.0"
    if isinstance(value, Mapping):
        inside = ", ".join(f"{key_text(key)} = {value_text(each)}" for key, each in value.items())
        return f"{{ {inside} }}" if inside else "{}"
    if isinstance(value, list | tuple | set | frozenset):
        return f"[{', '.join(value_text(each) for each in value)}]"
    return str(value)
