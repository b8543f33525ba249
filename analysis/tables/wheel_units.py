"""Units of wheels' signals as DBCs spell them: a speed and its factor, pulses, or nobody knows."""

from __future__ import annotations

import re

from tramstream.analysis.tables.units import UNITS

PULSES = "pulses"
_SPEEDS: dict[str, float] = {
    **UNITS["speed"],
    "kmh": 1 / 3.6, "kph": 1 / 3.6, "kmph": 1 / 3.6, "mps": 1.0, "mi/h": 0.44704,
    "cmps": 1e-2, "mmps": 1e-3, "dm/s": 0.1, "m/min": 1 / 60, "ft/s": 0.3048, "fps": 0.3048,
    "ftps": 0.3048, "kt": 1852 / 3600, "kts": 1852 / 3600, "knot": 1852 / 3600,
    "knots": 1852 / 3600, "kns": 1852 / 3600,
}  # fmt: skip
"""Factors to m/s by the plain spelling."""
_WORDS = (
    (r"[\s_.\[\]()·*]|\\", ""),
    (r"(km|mm|cm|m)(h|s)(?:\^?-1|⁻¹)", r"\1/\2"),  # km h^-1
    (r"kilomet(?:er|re)s?", "km"),
    (r"milli(?:met(?:er|re)s?)", "mm"),
    (r"centi(?:met(?:er|re)s?)", "cm"),
    (r"met(?:er|re)s?", "m"),
    (r"miles?", "mi"),
    (r"feet|foot", "ft"),
    (r"per", "/"),
    (r"/(?:hours?|hrs?|std|stunde)$", "/h"),
    (r"/(?:seconds?|secs?)$", "/s"),
    (r"/(?:minutes?|mins?)$", "/min"),
    (r"^(km|m|mi)hr$", r"\1h"),
    (r"^(km|m|cm|mm|ft)(?:sec)$", r"\1/s"),
)
_COUNTS = re.compile(
    r"|1|-|counts?|cnts?|pulses?|puls|pls|imp|impulses?|impulse|ticks?|edges?|incr?|increments?|"
    r"teeth|tooth|unitless|none|steps?"
)
_SAYS_NOTHING = ("", "1", "-", "none", "unitless")
_SAYS_SPEED = re.compile(r"speed|veloc|spd|geschw|vitesse", re.IGNORECASE)


def factor_to_mps(unit: str) -> float | None:
    """Factor of a speed's unit to m/s, in whatever spelling; None for what is no speed."""
    return _SPEEDS.get(_plain(unit))


def kind_of(unit: str, signal: str) -> tuple[str, float] | None:
    """Kind and scale of a wheel's signal; None where nobody can tell.

    Parameters
    ----------
    unit : str
        As the DBC has it; may be empty.
    signal : str
        Its name: a speed without a unit is not taken for pulses.
    """
    factor = factor_to_mps(unit)
    if factor is not None:
        return "speed", factor
    plain = _plain(unit)
    if not _COUNTS.fullmatch(plain) or (plain in _SAYS_NOTHING and _SAYS_SPEED.search(signal)):
        return None
    return PULSES, 1.0


def _plain(unit: str) -> str:
    text = unit.strip().lower()
    for pattern, plain in _WORDS:
        text = re.sub(pattern, plain, text)
    return text
