"""Which ride a record is of: a short name that copies share, and what was made from it.

It is a digest of the beginning and the end of each part; the end of a finished part lists all its
chunks with their places and sizes, so that two rides do not share it. A record that was made from
another carries that one's in its metadata, under `ENTRY`.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from tramstream.recorder.reader import Record

ENTRY = "source_digest"
"""Entry of a record's metadata."""
_LOOKED_AT_BYTES = 1 << 16


def identity_of(record: Record) -> str:
    """Give the digest of the ride that a record is of, however often it was reprocessed.

    Raises
    ------
    OSError
        If a file cannot be read.
    """
    told = record.metadata.get(ENTRY)
    return told or digest_of(record.paths)


def digest_of(paths: list[Path]) -> str:
    """Give the digest of the parts of a record, in whatever order, under whatever names."""
    found = hashlib.blake2b(digest_size=8)
    for part in sorted(map(_part, paths)):
        found.update(part)
    return found.hexdigest()


def _part(path: Path) -> bytes:
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(0)
        head = file.read(_LOOKED_AT_BYTES)
        file.seek(max(size - _LOOKED_AT_BYTES, 0))
        tail = file.read(_LOOKED_AT_BYTES)
    return hashlib.blake2b(b"%d " % size + head + tail, digest_size=16).digest()
