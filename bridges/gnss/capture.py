"""Captures of receivers that hold no arrival times: when each piece of the bytes may have come."""

from __future__ import annotations

from itertools import accumulate, pairwise
from statistics import median

from tramstream.bridges.gnss import ubx
from tramstream.bridges.gnss.clock import GpsTimeline, leap_seconds_on
from tramstream.bridges.gnss.framer import NMEA, UBX, Frame, Framer, Rejected
from tramstream.bridges.gnss.nmea import Epoch, EpochAssembler
from tramstream.bridges.gnss.nmea_sentences import TIMED, parse, sentence_type
from tramstream.clock import GPS_EPOCH_UNIX_S, S

JUMP_BACK_S = 2
"""A receiver's time that falls back this far has jumped."""
_PAUSE_S = 60
"""Epochs without a date that lie further apart may be of different days."""
_DAY_NS = 86_400 * S
_LONGEST_PAUSE_NS = 10 * 365 * _DAY_NS
"""No capture pauses for longer; half of the 1024 weeks by which a receiver can be wrong."""


def unix_like_ns(gps_time_ns: int) -> int:
    """GPS time as the vehicle clock of an imported capture: since 1970, leap seconds included."""
    return gps_time_ns + GPS_EPOCH_UNIX_S * S


def read_times(data: bytes) -> list[tuple[int, int]]:
    """When the pieces of a capture may have come, on the vehicle clock of an import.

    They keep the order of the file. Where the receiver's clock jumps (back, or by years ahead, as
    one does that begins in 1980 and then finds the date) arrivals go on as between the epochs
    before; what is on the other side of the jump is moved to the latest time that is told.

    Returns
    -------
    list of tuple
        Place in `data` just behind a frame, and the arrival of what ends there, ns.
    """
    times = epoch_times(data)
    if not times:
        return []
    steps = [after - before for (_, before), (_, after) in pairwise(times)]
    likely = [step for step in steps if 0 < step <= _PAUSE_S * S]
    usual_ns = round(median(likely)) if likely else S
    paced = [step if 0 <= step <= _LONGEST_PAUSE_NS else usual_ns for step in steps]
    since = list(accumulate(paced, initial=0))
    latest = max(range(len(times)), key=lambda at: times[at][1])
    begin_ns = unix_like_ns(times[latest][1]) - since[latest]
    return [(end, begin_ns + gone) for (end, _), gone in zip(times, since, strict=True)]


def epoch_times(data: bytes) -> list[tuple[int, int]]:
    """GPS times in a capture that has no arrival times, for assigning arrivals to its pieces.

    Week and leap seconds may come late in a capture: they are looked for first. Where no message
    tells the leap seconds, the date does. A time older than its predecessor (NAV-PVT behind the
    HNR-PVT of a later epoch) is left out, unless it is so by more than `JUMP_BACK_S`. Where nobody
    tells a date, the times of day count on from 1970-01-02.

    Returns
    -------
    list of tuple
        Place in `data` just behind a frame, and GPS time of its epoch, ns since 1980-01-06.
    """
    framer = Framer()
    frames = [item for item in framer.feed(data) + framer.flush() if isinstance(item, Frame)]
    messages = [(frame.end + 1, ubx.decode(frame)) for frame in frames if frame.protocol == UBX]
    timeline = GpsTimeline()
    for _, message in messages:
        if not isinstance(message, Rejected):
            timeline.of(message)
        if timeline.reference_ns is not None and timeline.leap_seconds is not None:
            break
    leap_seconds = timeline.leap_seconds
    times = [
        (end, gps_ns)
        for end, message in messages
        if not isinstance(message, Rejected) and (gps_ns := timeline.of(message)) is not None
    ]
    epochs = _nmea_epochs(frames)
    if times or any(epoch.date for epoch in epochs):
        dated = _dated(epochs, leap_seconds)
        times += [(end, timeline.in_its_age(gps_ns)) for end, gps_ns in dated]
    else:
        times = [(e.first_arrival_ns, e.utc_ns - GPS_EPOCH_UNIX_S * S) for e in epochs]
    times.sort(key=lambda time: time[0])
    return _never_back(times)


def _nmea_epochs(frames: list[Frame]) -> list[Epoch]:
    """Epochs of NMEA; the arrival of their first sentence is its place in the capture."""
    assembler = EpochAssembler()
    epochs: list[Epoch] = []
    for frame in frames:
        if frame.protocol != NMEA or sentence_type(frame) not in TIMED:
            continue
        sentence = parse(frame)
        if not isinstance(sentence, Rejected):
            epochs += assembler.feed(sentence, frame.end + 1, 0)
    return epochs + assembler.flush()


def _dated(epochs: list[Epoch], leap_seconds: int | None) -> list[tuple[int, int]]:
    """GPS times of NMEA epochs with a date, and of those right before the first of them."""
    times: list[tuple[int, int]] = []
    first = next((at for at, epoch in enumerate(epochs) if epoch.date), len(epochs))
    for epoch in epochs[first:]:
        leap_s = leap_seconds_on(epoch.utc_ns) if leap_seconds is None else leap_seconds
        times.append((epoch.first_arrival_ns, epoch.utc_ns + (leap_s - GPS_EPOCH_UNIX_S) * S))
    for before, after in pairwise(reversed(epochs[: first + 1])):
        step_ns = (before.time_of_day_ns - after.time_of_day_ns) % _DAY_NS
        if not times or step_ns > _PAUSE_S * S:
            break
        times.insert(0, (after.first_arrival_ns, times[0][1] - step_ns))
    return times


def _never_back(times: list[tuple[int, int]]) -> list[tuple[int, int]]:
    kept: list[tuple[int, int]] = []
    for end, gps_ns in times:
        late_ns = kept[-1][1] - gps_ns if kept else 0
        if late_ns <= 0 or late_ns > JUMP_BACK_S * S:
            kept.append((end, gps_ns))
    return kept
