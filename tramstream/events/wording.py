"""Numbers and durations as people read them, in a known width."""

from __future__ import annotations


def clipped(text: str, width: int) -> str:
    """`text` in at most `width` characters, an ellipsis where something is missing."""
    return text if len(text) <= width else text[: max(0, width - 1)].rstrip() + "…"


def number(value: float | None, digits: int = 2) -> str:
    """A number with fixed decimals; a dash for none."""
    return "–" if value is None else f"{value:.{digits}f}"


def scaled(value: float | None, unit: str) -> str:
    """A quantity with a prefix: `48.1 kB`."""
    if value is None:
        return "–"
    for prefix in ("", "k", "M", "G"):
        if abs(value) < 999.5 or prefix == "G":
            break
        value /= 1000
    text = f"{value:.0f}" if prefix == "" or abs(value) >= 99.95 else f"{value:.1f}"
    return f"{text} {prefix}{unit}"


def lasting(seconds: float | None) -> str:
    """A duration for people, in at most six characters: `0.12 s`, `14 s`, `3 min`, `2.5 h`."""
    if seconds is None:
        return "–"
    if seconds < 9.995:
        return f"{seconds:.2f} s"
    if seconds < 119.5:
        return f"{seconds:.0f} s"
    if seconds < 5970:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 359_000 else f"{seconds / 86400:.0f} d"
