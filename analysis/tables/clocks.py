"""The clocks of an import's sources: shifted by stated offsets, and refused where they are apart.

A receiver's capture tells GPS time, an IMU's counts from its start, a CAN log has the logger's
time. Sources of one ride share instants; what has none in common is on another clock.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import isfinite
from typing import Protocol

from tramstream import keys
from tramstream.clock import S
from tramstream.errors import ConfigError
from tramstream.shown import date

SOURCES = {keys.GNSS_BYTES.path: "gnss", keys.IMU_BYTES.path: "imu", keys.ODO_FRAMES.path: "can"}
"""Names of captures by the key of their bytes."""
TABLES = "tables"
JOINED_NS = 3600 * S
"""Of one source, what is nearer belongs together: a jump of its clock does not."""
_LONGEST_S = 10e9

_DATED_NS = 315_532_800 * S
"""1980: what lies before counts from a start."""

Span = tuple[int, int]
_Source = tuple[str, list[Span]]


class Timed(Protocol):
    """A message on its way into a record."""

    @property
    def key(self) -> keys.Key:
        """Where it goes."""

    @property
    def arrival_ns(self) -> int:
        """When it came."""


def parse_offset(text: str) -> tuple[str, int]:
    """SOURCE=SECONDS as the source and nanoseconds.

    Raises
    ------
    ConfigError
        If it does not read so.
    """
    source, _, number = text.partition("=")
    try:
        offset_s = float(number)
    except ValueError:
        offset_s = float("nan")
    known = sorted(SOURCES.values())
    if source not in known or not isfinite(offset_s) or abs(offset_s) > _LONGEST_S:
        raise ConfigError(
            f"--offset-s {text}: must read SOURCE=SECONDS, of which SOURCE is one of "
            f"{', '.join(known)}"
        )
    return source, round(offset_s * S)


def name_of(item: Timed) -> str:
    """The source that a message is of."""
    return SOURCES.get(item.key.path, TABLES)


def check(items: Iterable[Timed], offsets: Mapping[str, int]) -> None:
    """Refuse sources that share no instant, or of which one lies before 1970.

    Parameters
    ----------
    items : iterable of Timed
        Of all sources, shifted already.
    offsets : mapping
        By source, what they were shifted by, ns: to say what would put them together.

    Raises
    ------
    ConfigError
        With two that are apart, when each is, and the offset that makes them begin together.
    """
    times: dict[str, list[int]] = {}
    for item in items:
        times.setdefault(name_of(item), []).append(item.arrival_ns)
    spans = {source: _spans(sorted(each)) for source, each in times.items()}
    for source, own in spans.items():
        if own[0][0] <= 0:
            raise ConfigError(
                f"{source}: begins {date(own[0][0])}, before 1970",
                cure=f"state another --offset-s {source}=SECONDS",
            )
    for source, own in spans.items():
        others = {name: each for name, each in spans.items() if name != source}
        if not others or any(_meet(own, each) for each in others.values()):
            continue
        other, theirs = next(iter(others.items()))
        moved, kept = _movable((source, own), (other, theirs))
        offset_s = (offsets.get(moved[0], 0) + kept[1][-1][0] - moved[1][-1][0]) / S
        raise ConfigError(
            f"{source} ({_told(own)}) and {other} ({_told(theirs)}) share no instant: they are on "
            "different clocks",
            cure=f"state what to add to one: --offset-s {moved[0]}={offset_s:.3f} makes both "
            "begin together",
        )


def _movable(one: _Source, other: _Source) -> tuple[_Source, _Source]:
    """The source to shift, and the one to keep: a receiver knows the time, most of 1970 do not."""
    order = (TABLES, "gnss", "can", "imu")
    kept, moved = sorted(
        (one, other), key=lambda each: (each[1][-1][1] < _DATED_NS, order.index(each[0]))
    )
    return moved, kept


def _spans(times: Sequence[int]) -> list[Span]:
    """Stretches of ascending times."""
    spans: list[Span] = []
    for at_ns in times:
        if spans and at_ns - spans[-1][1] <= JOINED_NS:
            spans[-1] = spans[-1][0], at_ns
        else:
            spans.append((at_ns, at_ns))
    return spans


def _meet(one: Iterable[Span], other: Sequence[Span]) -> bool:
    return any(begin <= last and first <= end for begin, end in one for first, last in other)


def _told(spans: Sequence[Span]) -> str:
    return f"{date(spans[0][0])} to {date(spans[-1][1])}"
