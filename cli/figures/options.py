"""What the command line of `tramstream reproduce` said."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Options:
    """What the command line said; each work takes what concerns it."""

    seed: int | None
    seeds: int | None
    lines: tuple[str, ...]
    duration_s: float | None
    json: bool
    data: Path | None = None
    mappings: Path | None = None
    kinds: tuple[str, ...] = ()
    network: Path | None = None
    detours: int | None = None
    worlds: tuple[str, ...] = ()
    hours: float | None = None
    frame_hz: float | None = None
    rate_hz: float | None = None
    pace: float | None = None
    capture: Path | None = None
