"""A CAN log as a list of frames on one clock that only goes forward; what is odd is told.

A log has the clock of the host that wrote it, which may be set meanwhile. A stamp that fits neither
its neighbours before nor those behind costs its frame; where the clock was set back, later frames
are moved on behind those before. Stamps of `candump` are UTC where they are dates at all; the
record's are GPS time as Unix time.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from statistics import median_low

from tramstream.bridges.gnss.clock import leap_seconds_on
from tramstream.bridges.odometer import candump
from tramstream.bridges.odometer.frames import CanFrame, Rejected
from tramstream.clock import GPS_EPOCH_UNIX_S, S
from tramstream.errors import ConfigError

MOST_ODD = 5
"""So many frames in a row with stamps that do not fit are odd; more are a clock that was set."""
UNORDERED_NS = S // 50
"""Frames of several interfaces come so much out of order; they are put in order."""
NEIGHBOURS_NS = S
"""Frames on either side of odd ones are no further apart, most likely."""
LONG_NS = 3600 * S
"""A few frames at the log's beginning or end that are further away than this have odd stamps."""
FEW = 10
"""A log of fewer frames does not tell what is odd at its ends."""
OTHER_DBC = (
    "is it the DBC of this vehicle and of this bus, and does --wheel name signals that are on it?"
)
CURE = "candump -L writes a log that is read, candump -t a one that is read too"


NO_FRAME = CanFrame(0, "", 0, 0, b"")


@dataclass
class CanLog:
    """What a log held."""

    frames: list[CanFrame] = field(default_factory=list)
    """In order; on the record's clock. Whoever takes them may leave none."""
    malformed: int = 0
    """Lines that are no frames."""
    first_malformed: str = ""
    """What is wrong with the first of them, and where."""
    odd: int = 0
    """Frames that were left out for their stamps."""
    set_back: int = 0
    """How often the clock was set back."""
    set_back_s: float = 0.0
    """By how much in all."""
    unheard: list[str] = field(default_factory=list)
    """Wanted messages of which there is no frame."""
    dated: bool = False
    """Whether its stamps are dates; else they count from anywhere."""

    @property
    def interfaces(self) -> list[str]:
        return sorted({frame.interface for frame in self.frames})


def read(path: Path, text: str) -> CanLog:
    """Read the text of a log.

    Raises
    ------
    ConfigError
        If no line is a frame, or if the stamps are differences.
    """
    log = CanLog()
    reasons: Counter[str] = Counter()
    lines = 0
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        lines += 1
        frame = candump.parse_line(line)
        if isinstance(frame, Rejected):
            reasons[frame.reason] += 1
            log.malformed += 1
            log.first_malformed = log.first_malformed or f"line {number}: {frame.reason}"
        else:
            log.frames.append(frame._replace(interface=sys.intern(frame.interface)))
    if not log.frames:
        reason = reasons.most_common(1)[0][0] if reasons else "there is none"
        raise ConfigError(
            f"{path}: nothing in it decodes: none of its {lines} lines is a CAN frame with a stamp "
            f"({reason})",
            cure=CURE,
        )
    stamps = [frame.stamp_ns for frame in log.frames]
    if _are_differences(stamps):
        raise ConfigError(
            f"{path}: its stamps are differences, as candump -t d shows them", cure=CURE
        )
    _put_in_order(log, stamps)
    return log


def _are_differences(stamps: Sequence[int]) -> bool:
    """Whether each stamp counts from the frame before: time then stands still."""
    if len(stamps) < FEW or stamps[0] != 0 or max(stamps) > LONG_NS:
        return False
    standing = sum(after <= before for before, after in pairwise(stamps))
    return 4 * standing > len(stamps)


def _put_in_order(log: CanLog, stamps: list[int]) -> None:
    """Leave out what is odd, move on what a clock that was set back put too early."""
    frames = log.frames
    forward = [after - before for before, after in pairwise(stamps) if after > before]
    usual_ns = median_low(forward) if forward else UNORDERED_NS
    kept: list[tuple[int, int]] = []
    shift_ns = 0
    for place in range(len(frames)):
        stamp_ns = stamps[place] + shift_ns
        if kept and stamp_ns < kept[-1][0] - UNORDERED_NS:
            ahead = _ahead(kept, stamp_ns)
            behind = _behind(stamps, place, kept[-1][0] - shift_ns)
            before_ns = kept[-ahead - 1][0] if ahead < len(kept) else None
            after_ns = stamps[place + behind] if place + behind < len(stamps) else None
            doubts = (
                _doubt(ahead, before_ns, stamp_ns),
                _doubt(behind, kept[-1][0] - shift_ns, after_ns),
            )
            if min(ahead, behind) <= MOST_ODD and doubts[0] <= doubts[1]:
                del kept[-ahead:]
                log.odd += ahead
            elif min(ahead, behind) <= MOST_ODD:
                log.odd += 1
                continue
            else:
                back_ns = kept[-1][0] + usual_ns - stamp_ns
                shift_ns, stamp_ns = shift_ns + back_ns, stamp_ns + back_ns
                log.set_back += 1
                log.set_back_s += back_ns / S
        kept.append((stamp_ns, place))
    _cut_ends(log, kept)
    kept.sort()
    first_ns = kept[0][0]
    log.dated = first_ns >= GPS_EPOCH_UNIX_S * S
    # What counts from zero begins a second after 1970, as an IMU's capture: nothing lies before it.
    leap_ns = leap_seconds_on(first_ns) * S if log.dated else S * (first_ns < S)
    log.frames = []
    for stamp_ns, place in kept:
        log.frames.append(frames[place]._replace(stamp_ns=stamp_ns + leap_ns))
        frames[place] = NO_FRAME  # a log may be long: not everything twice


def _ahead(kept: list[tuple[int, int]], stamp_ns: int) -> int:
    """How many frames at the end are ahead of a stamp; one more than may be odd, at most."""
    for count, (earlier_ns, _) in enumerate(reversed(kept[-MOST_ODD - 1 :])):
        if earlier_ns <= stamp_ns + UNORDERED_NS:
            return count
    return min(len(kept), MOST_ODD + 1)


def _behind(stamps: list[int], place: int, latest_ns: int) -> int:
    """How many frames from `place` on are behind a stamp; one more than may be odd, at most."""
    for count, stamp_ns in enumerate(stamps[place : place + MOST_ODD + 1]):
        if stamp_ns >= latest_ns - UNORDERED_NS:
            return count
    return min(len(stamps) - place, MOST_ODD + 1)


def _doubt(odd: int, before_ns: int | None, after_ns: int | None) -> tuple[bool, bool, int]:
    """How doubtful it is that so many frames are odd, between two that then are neighbours."""
    apart = before_ns is None or after_ns is None or abs(after_ns - before_ns) > NEIGHBOURS_NS
    return odd > MOST_ODD, apart, odd


def _cut_ends(log: CanLog, kept: list[tuple[int, int]]) -> None:
    """Leave out a few frames at either end that are far away from all others."""
    if len(kept) < FEW * MOST_ODD:
        return
    for count in range(MOST_ODD, 0, -1):
        if kept[-count][0] - kept[-count - 1][0] > LONG_NS:
            del kept[-count:]
            log.odd += count
            break
    for count in range(MOST_ODD, 0, -1):
        if kept[count][0] - kept[count - 1][0] > LONG_NS:
            del kept[:count]
            log.odd += count
            break


def gathers(frames: Sequence[CanFrame], longest_ns: int) -> Iterator[list[CanFrame]]:
    """Frames in groups that last no longer, as a port gathers them."""
    group: list[CanFrame] = []
    for frame in frames:
        if group and frame.stamp_ns - group[0].stamp_ns >= longest_ns:
            yield group
            group = []
        group.append(frame)
    if group:
        yield group


def buses(
    path: Path, log: CanLog, wanted: Callable[[int, int], str | None], chosen: str
) -> tuple[set[str], set[str]]:
    """Interfaces whose frames are decoded, and the wanted messages that come on them.

    Parameters
    ----------
    wanted : callable
        What message a frame is wanted as, by identifier and flags; None where it is not.
    chosen : str
        The interface that the user names; empty: nobody has.

    Raises
    ------
    ConfigError
        If the log has no such interface, if none has a wanted frame, or if one message comes on
        several and nobody says of which.
    """
    if chosen and chosen not in log.interfaces:
        raise ConfigError(f"--bus {chosen}: {path} has {', '.join(log.interfaces)}")
    counts = Counter((frame.interface, frame.id, frame.flags) for frame in log.frames)
    found: dict[str, dict[str, int]] = {}
    for (interface, id_, flags), count in counts.items():
        message = wanted(id_, flags)
        if message is not None and chosen in ("", interface):
            by_bus = found.setdefault(message, {})
            by_bus[interface] = by_bus.get(interface, 0) + count
    if not found:
        most = [f"{id_:X}" for (_, id_, _), _ in counts.most_common(3)]
        raise ConfigError(
            f"{path}: nothing in it decodes: none of its {len(log.frames)} frames is one that the "
            f"DBC and the wheels name (most are {', '.join(most)})",
            cure=OTHER_DBC,
        )
    for message, by_bus in found.items():
        if len(by_bus) > 1:
            told = " and ".join(f"{bus} ({count})" for bus, count in sorted(by_bus.items()))
            raise ConfigError(
                f"{path}: frames of {message} come on {told}",
                cure=f"say which bus is meant, e.g. --bus {min(by_bus)}",
            )
    return {bus for by_bus in found.values() for bus in by_bus}, set(found)
