"""Which grades a filter was held to: a digest of those in a network, which a record carries.

A filter on a map takes the grades of the map as measurements. What it then says of the slope is no
new witness of it: whoever makes a map of grades from rides has to know which grades were in them.
The entry `GRADES_ENTRY` of a record's metadata says so: `NO_GRADES`, or the digest of the network's
grades and their deviations. Records of older versions have no such entry.

Reads the two arrays and nothing else, without numpy: the recorder does it when it starts.
"""

from __future__ import annotations

import hashlib
import struct
import zipfile
import zlib
from array import array
from pathlib import Path

from tramstream.config import MATCHER, Vehicle

GRADES_ENTRY = "grades"
"""Entry of a record's metadata."""
NO_GRADES = "none"
_LIMIT_BYTES = 64 << 20
"""Sixteen million samples: more than any city has metres of track."""
_DAMAGES = (
    OSError,
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    KeyError,
    ValueError,
    RuntimeError,
    NotImplementedError,
    struct.error,
)


def digest_in(path: Path) -> str:
    """Give the short name of the grades in a network's file; `NO_GRADES` where none is known.

    A file that is none has no grades: processors go on without it.
    """
    found = hashlib.blake2b(digest_size=8)
    try:
        with zipfile.ZipFile(path) as archive:
            grades = _numbers(archive, "grade_rad.npy")
            deviations = _numbers(archive, "grade_std_rad.npy")
    except _DAMAGES:
        return NO_GRADES
    if all(grade != grade for grade in grades):  # NaN is not known
        return NO_GRADES
    found.update(grades.tobytes())
    found.update(deviations.tobytes())
    return found.hexdigest()


def _numbers(archive: zipfile.ZipFile, name: str) -> array[float]:
    """Single floats of an array in .npy form."""
    entry = archive.getinfo(name)
    if entry.file_size > _LIMIT_BYTES:
        raise ValueError(f"{name} states {entry.file_size} bytes")
    data = archive.read(entry)
    kind, begin = ("<H", 10) if data[6:7] == b"\x01" else ("<I", 12)
    begin += struct.unpack_from(kind, data, 8)[0]
    numbers = array("f")
    numbers.frombytes(data[begin:])
    return numbers


def held_to(vehicle: Vehicle) -> str:
    """Give the short name of the grades that filters of a vehicle are held to."""
    if vehicle.map is None or MATCHER not in vehicle.processors:
        return NO_GRADES
    return digest_in(Path(vehicle.map.network))
