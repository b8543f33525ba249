"""Places in a damaged file where something may begin that a walk can go on from."""

from __future__ import annotations

import struct
from bisect import bisect_left
from collections.abc import Iterator

from mcap.opcode import Opcode

from tramstream.recorder.file.diskfile import Source
from tramstream.recorder.file.layout import GUARD_MAGIC, RECORD

DATA_END = RECORD.pack(Opcode.DATA_END, 4)
_WINDOW_BYTES = 1 << 20
_OVERLAP_BYTES = 64
_COMPRESSIONS = tuple(struct.pack("<I", len(name)) + name for name in (b"zstd", b"lz4"))


class Places:
    """Where guards, chunks and the end of the data may begin, by the bytes that they begin with.

    A stretch of the file is looked through once, however often the walk goes astray in it.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self._number = -1
        self._found: list[int] = []

    def between(self, begin: int, limit: int) -> Iterator[int]:
        """Offsets from `begin` on and before `limit`, ascending."""
        for number in range(begin // _WINDOW_BYTES, -(-limit // _WINDOW_BYTES)):
            found = self._window(number)
            for index in range(bisect_left(found, begin), len(found)):
                if found[index] >= limit:
                    return
                yield found[index]

    def _window(self, number: int) -> list[int]:
        if number != self._number:
            begin = number * _WINDOW_BYTES
            data = self._source.read(begin, _WINDOW_BYTES + _OVERLAP_BYTES)
            places = {begin + place for place in _places(data) if place < _WINDOW_BYTES}
            self._number, self._found = number, sorted(places)
        return self._found


def _places(window: bytes) -> Iterator[int]:
    """Where in `window` a guard, a chunk or the end of data may begin."""
    for pattern, back in (
        (GUARD_MAGIC, RECORD.size),
        (DATA_END, 0),
        *((compression, 37) for compression in _COMPRESSIONS),
    ):
        place = window.find(pattern)
        while place >= 0:
            if place >= back:
                yield place - back
            place = window.find(pattern, place + 1)
