"""Messages of many chunks in one order, however the chunks' times overlap."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator
from heapq import heappop, heappush
from operator import attrgetter, itemgetter

from tramstream.recorder.file.layout import Entry
from tramstream.recorder.file.opened import Chunk

_ORDER = itemgetter(2, 5, 4)
_LOG_NS = attrgetter("log_ns")
_FOREVER_NS = 1 << 64

_Run = tuple[int, int, int, list[Entry]]
"""What is left of a chunk: log time of the next message, number of the chunk, place of the next
message, all messages in order."""


def in_order(chunks: Iterable[Chunk], load: Callable[[Chunk], list[Entry]]) -> Iterator[Entry]:
    """Messages by (log_ns, channel_id, sequence), of equal ones those of the earlier chunk first.

    A chunk is loaded when everything before its start has been handed out, and a message waits
    for no chunk that begins after it. n messages of k chunks that all overlap take n log k steps.

    Parameters
    ----------
    chunks : iterable of Chunk
        By ascending start.
    load : callable
        Gives the messages of a chunk.
    """
    waiting: list[_Run] = []
    for number, chunk in enumerate(chunks):
        if waiting and waiting[0][0] < chunk.start_ns:
            yield from _before(waiting, chunk.start_ns)
        entries = load(chunk)
        if entries:
            entries.sort(key=_ORDER)
            heappush(waiting, (entries[0].log_ns, number, 0, entries))
    if waiting:
        yield from _before(waiting, _FOREVER_NS)


def _before(waiting: list[_Run], limit_ns: int) -> list[Entry]:
    """Take the messages before `limit_ns` out of what waits, a heap."""
    due: list[_Run] = []
    while waiting and waiting[0][0] < limit_ns:
        due.append(heappop(waiting))
    due.sort(key=itemgetter(1))
    ready: list[Entry] = []
    for _, number, begin, entries in due:
        end = bisect_left(entries, limit_ns, lo=begin, key=_LOG_NS)
        ready += entries[begin:end]
        if end < len(entries):
            heappush(waiting, (entries[end].log_ns, number, end, entries))
    if len(due) > 1:
        ready.sort(key=_ORDER)
    return ready
