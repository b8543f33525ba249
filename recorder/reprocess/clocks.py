"""Whether the inputs of a record stand on one clock: sources that share no instant do not.

A logger that thinks it is 1970 beside a receiver that knows the year makes a record in which
nothing belongs together. Where the summary says which chunk holds which topics that costs nothing;
a chunk that lasts longer than `LONGEST_NS` is looked into.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from tramstream import keys
from tramstream.clock import S
from tramstream.errors import RecordError
from tramstream.recorder.file.layout import entries_of
from tramstream.recorder.file.opened import Chunk, load
from tramstream.recorder.reader import Record
from tramstream.shown import date

APART_NS = 3600 * S
"""Sources that are nearer than that were on one clock, one after the other perhaps."""
LONGEST_NS = 600 * S
_FOREVER_NS = 1 << 64

Span = tuple[int, int]


def check_one_clock(record: Record, paths: Iterable[str]) -> None:
    """Refuse inputs that share no instant, nor nearly one.

    Parameters
    ----------
    record : Record
    paths : iterable of str
        Key paths of the inputs.

    Raises
    ------
    RecordError
        With two that are apart, and when each is.
    """
    spans = _spans(record, set(paths))
    groups: list[tuple[str, list[Span]]] = []
    for path, own in sorted(spans.items()):
        near = [group for group in groups if _meet(group[1], own)]
        groups = [group for group in groups if group not in near]
        joined = _joined([span for each in (*near, (path, own)) for span in each[1]])
        groups.append((near[0][0] if near else path, joined))
    if len(groups) > 1:
        (one, first), (other, second) = groups[0], groups[1]
        raise RecordError(
            f"{record.paths[0]}: its sources are on clocks that share no instant: {one} "
            f"{_told(first)}, {other} {_told(second)}",
            cure="import them again onto one clock (--offset-s of `tramstream import`)",
        )


def _spans(record: Record, paths: set[str]) -> dict[str, list[Span]]:
    """By path, when there are messages, in stretches."""
    found: dict[str, list[Span]] = {}
    for chunk in (chunk for file in record.files for chunk in file.chunks):
        for path, span in _spans_in(chunk, paths):
            found.setdefault(path, []).append(span)
    return {path: _joined(spans) for path, spans in found.items()}


def _spans_in(chunk: Chunk, paths: set[str]) -> Iterator[tuple[str, Span]]:
    topics = {
        id_: known
        for id_, known in chunk.file.topics.items()
        if keys.split(known[0])[1] in paths and (not chunk.channels or id_ in chunk.channels)
    }
    if not topics:
        return
    if chunk.channels and chunk.end_ns - chunk.start_ns <= LONGEST_NS:
        for topic, _ in topics.values():
            yield keys.split(topic)[1], (chunk.start_ns, chunk.end_ns)
        return
    for entry in entries_of(load(chunk).raw, topics, 0, _FOREVER_NS):
        yield keys.split(entry.topic)[1], (entry.log_ns, entry.log_ns)


def _joined(spans: Iterable[Span]) -> list[Span]:
    """Ascending stretches, of which those that are nearly one are one."""
    joined: list[Span] = []
    for begin, end in sorted(spans):
        if joined and begin <= joined[-1][1] + APART_NS:
            joined[-1] = joined[-1][0], max(joined[-1][1], end)
        else:
            joined.append((begin, end))
    return joined


def _meet(one: list[Span], other: list[Span]) -> bool:
    return any(
        begin <= last + APART_NS and first <= end + APART_NS
        for begin, end in one
        for first, last in other
    )


def _told(spans: list[Span]) -> str:
    return f"from {date(spans[0][0])} to {date(spans[-1][1])}"
