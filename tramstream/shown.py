"""Texts of strangers for a terminal: what moves the cursor or turns the reading becomes visible.

A log text, a key, a file name or a field of a record may hold anything. Control characters (C0, C1,
DEL), bidirectional overrides, line separators, invisible characters and lone surrogates are written
as the escapes that Python gives them (`\\x1b`, `\\u202e`); letters of every script, and blanks of
every width, stay. Whatever comes from the bus or a file goes through here before it is printed.
"""

from __future__ import annotations

import unicodedata
from datetime import UTC, datetime

from tramstream.clock import S

_LAST_S = 253_402_300_800
"""Year 10000: what comes later has no date."""


def shown(text: str, lines: bool = False) -> str:
    """Give `text` in one line, or, with `lines`, in those that it has."""
    if text.isprintable():
        return text
    return "".join(c if _harmless(c) or (lines and c == "\n") else _escaped(c) for c in text)


def shown_json(text: str) -> str:
    """Give JSON text that a terminal may see: within its strings `\\u009b` means the same."""
    if text.isprintable():
        return text
    return "".join(c if _harmless(c) or c == "\n" else _unit(c) for c in text)


def _harmless(character: str) -> bool:
    return character.isprintable() or unicodedata.category(character) == "Zs"


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode()


def _unit(character: str) -> str:
    """One or two JSON escapes, for beyond the 16-bit plane JSON wants a pair."""
    units = character.encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{units[place : place + 4]}" for place in range(0, len(units), 4))


_FORMULA = tuple("=+-@\t\r\n＝＋－＠")
"""What a spreadsheet takes for the begin of a formula. OWASP, "CSV Injection"."""


def cell(value: object) -> object:
    """Give a cell of a CSV table: a text that a spreadsheet would run gets a `'` in front.

    Numbers are none and stay as they are, negative ones too.
    """
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


def date(stamp_ns: int) -> str:
    """An instant to the second; what has no date is told in seconds."""
    if not 0 <= stamp_ns < _LAST_S * S:
        return f"{stamp_ns / S:.0f} s"
    return datetime.fromtimestamp(stamp_ns // S, UTC).strftime("%Y-%m-%d %H:%M:%S")
