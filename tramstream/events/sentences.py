"""Events as people read them: facts with their units in the sentence, the cure behind it.

The sentence travels with the event, so that a reader needs neither our table nor a stranger's
package. It is filled in by name and by nothing else: no format, no attribute, no width that a
stranger's sentence could ask for.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

Known = Mapping[str, tuple[float | int | str, str]]
"""Facts by name: value and unit."""

UNITS = {
    "m": "m",
    "km": "km",
    "s": "s",
    "ms": "ms",
    "mps": "m/s",
    "mps2": "m/s²",
    "rad": "rad",
    "radps": "rad/s",
    "deg": "°",
    "degc": "°C",
    "hz": "Hz",
    "sigma": "σ",
    "percent": "%",
    "ppm": "ppm",
    "kg": "kg",
    "bytes": "B",
}
"""By the last word of a name, as everywhere in this house."""
_FACT = re.compile(r"\{([a-z][a-z0-9_]*)\}")
_PREFIXES = ("", "k", "M", "G", "T")


def unit_of(name: str) -> str:
    """Unit in which a fact's name ends; empty for a count or a text."""
    return UNITS.get(name.rpartition("_")[2], "") if "_" in name else ""


def names(sentence: str) -> set[str]:
    """Facts that a sentence names."""
    return set(_FACT.findall(sentence))


def worded(sentence: str, cure: str, known: Known, unsaid: int = 0) -> str:
    """Put a sentence together; a fact that is not there stays in its braces."""
    text = filled(sentence, known)
    if unsaid:
        text += f" (and {unsaid} more times since this was said last)"
    advice = filled(cure, known)
    return f"{text}; {advice}" if advice else text


def filled(sentence: str, known: Known) -> str:
    """Fill facts into a sentence."""

    def fact(match: re.Match[str]) -> str:
        found = known.get(match[1])
        return match[0] if found is None else quantity(*found)

    return _FACT.sub(fact, sentence)


def quantity(value: float | int | str, unit: str) -> str:
    """A fact for people: three digits of a number, all of a count, and the unit."""
    if isinstance(value, str):
        return value
    if unit == "B":
        return _scaled(float(value))
    text = f"{value}" if isinstance(value, int) else _three_digits(value)
    return f"{text}{unit}" if unit in ("°", "σ") else f"{text} {unit}".rstrip()


def _three_digits(value: float) -> str:
    if not math.isfinite(value):
        return str(value)
    return f"{value:.0f}" if 99.95 <= abs(value) < 1e15 else f"{value:.3g}"


def _scaled(value: float) -> str:
    place = 0
    while abs(value) >= 999.5 and place + 1 < len(_PREFIXES):
        value, place = value / 1000, place + 1
    return f"{_three_digits(value)} {_PREFIXES[place]}B"
