"""Files of strangers, made by mutation, and what is done with each kind: no verb may trace.

A *kind* has files to begin with, a way to change one, and a use: what verbs make of such a file. A
use may refuse in one sentence (`TramstreamError`); whatever else it raises is a finding.
"""

from __future__ import annotations

import io
import random
import re
import resource
import struct
import time
import traceback
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tramstream.errors import TramstreamError

Change = Callable[[bytes, random.Random], bytes]
Use = Callable[[Path], None]

NUMBERS = tuple(
    b"0 -1 1 1e308 -1e308 1e-320 1e9 1e15 1e16 nan inf -inf 255 256 65535 2147483647 2147483648 "
    b"-2147483649 4294967296 9223372036854775807 9223372036854775808 18446744073709551616 1e400 "
    b"0.1 359.9999 90 -90 180 1970 0x7f 1_000".split()
)
WORDS = (b'""', b"true", b"null", b"[]", b"{}", b"[[1]]", b'"x"', b"'", b'"', b"\xff", b"\0", b"")
LONG = b"9" * 5000
DEEP = 2000
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WHOLE = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, (1 << 63) - 1, 1 << 63)


def change_text(data: bytes, chance: random.Random) -> bytes:
    """A number, a word, a line or a bracket of a text that is another; once or a few times."""
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        data = chance.choice(_TEXT)(data, chance)
    return data


def _other_number(data: bytes, chance: random.Random) -> bytes:
    found = list(_NUMBER.finditer(data))
    if not found:
        return data
    one = chance.choice(found)
    new = LONG if chance.random() < 0.03 else chance.choice(NUMBERS + WORDS)
    return data[: one.start()] + new + data[one.end() :]


def _other_line(data: bytes, chance: random.Random) -> bytes:
    lines = data.split(b"\n")
    one, other = chance.randrange(len(lines)), chance.randrange(len(lines))
    match chance.randrange(3):
        case 0:
            del lines[one]
        case 1:
            lines.insert(one, lines[other])
        case _:
            lines[one], lines[other] = lines[other], lines[one]
    return b"\n".join(lines)


def _other_word(data: bytes, chance: random.Random) -> bytes:
    found = list(re.finditer(rb'"[^"\n]*"|\b[a-z_]+\b', data))
    if not found:
        return data
    one, other = chance.choice(found), chance.choice(found)
    new = other.group() if chance.random() < 0.6 else chance.choice(WORDS + NUMBERS)
    return data[: one.start()] + new + data[one.end() :]


def _deeper(data: bytes, chance: random.Random) -> bytes:
    at = chance.randrange(len(data) + 1)
    bracket = chance.choice((b"[", b"{", b'{"a":', b"[["))
    return data[:at] + bracket * chance.choice((1, 3, DEEP)) + data[at:]


_TEXT: tuple[Change, ...] = (
    _other_number,
    _other_number,
    _other_number,
    _other_line,
    _other_word,
    _other_word,
    _deeper,
)


def change_bytes(data: bytes, chance: random.Random) -> bytes:
    """Bits, whole numbers, cuts, insertions and repetitions, wherever they fall."""
    for _ in range(chance.choice((1, 1, 2, 4))):
        at = chance.randrange(max(len(data), 1))
        end = min(len(data), at + chance.choice((1, 2, 4, 8, 16, 64, 256)))
        match chance.randrange(6):
            case 0:
                flipped = (data[at] if data else 0) ^ (1 << chance.randrange(8))
                data = data[:at] + bytes([flipped]) + data[at + 1 :]
            case 1:
                data = data[:at]
            case 2:
                data = data[:at] + data[end:]
            case 3:
                data = data[:at] + data[at:end] * chance.choice((2, 3, 100)) + data[end:]
            case 4:
                layout = chance.choice(("<I", "<Q", ">H", "<B"))
                size = struct.calcsize(layout)
                value = chance.choice(_WHOLE) & ((1 << 8 * size) - 1)
                data = data[:at] + struct.pack(layout, value) + data[at + size :]
            case _:
                data = data[:at] + chance.randbytes(end - at) + data[end:]
    return data


def change_either(data: bytes, chance: random.Random) -> bytes:
    return chance.choice((change_text, change_text, change_bytes))(data, chance)


def change_archive(data: bytes, chance: random.Random) -> bytes:
    """A zip of arrays and names whose checksums hold, with other numbers in it."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    if chance.random() < 0.1:
        return change_bytes(data, chance)
    for _ in range(chance.choice((1, 1, 2))):
        name = chance.choice(sorted(entries))
        content = entries[name]
        if name.endswith(".npy") and chance.random() < 0.9:
            entries[name] = _other_array(content, chance)
        elif name.endswith(".npy"):
            entries[name] = change_bytes(content, chance)
        else:
            entries[name] = change_text(content, chance)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return packed.getvalue()


def _other_array(content: bytes, chance: random.Random) -> bytes:
    array = np.lib.format.read_array(io.BytesIO(content)).copy()
    limits = np.finfo(array.dtype) if array.dtype.kind == "f" else np.iinfo(array.dtype)
    extremes = [limits.max, limits.min, 0, 1, -1, 2, 7]
    if array.dtype.kind == "f":
        extremes += [np.nan, np.inf, -np.inf, limits.tiny, 1e-30, 1e10, 1e20, 100.0]
    for _ in range(chance.choice((1, 1, 2, 5))):
        if not len(array):
            break
        at = chance.randrange(len(array))
        match chance.randrange(6):
            case 0 | 1 | 2:
                array[at] = chance.choice(extremes)
            case 3:
                array[:] = chance.choice(extremes)
            case 4:
                array[at] = array[chance.randrange(len(array))]
            case _:
                array = array[:at]
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array)
    return stream.getvalue()


@dataclass(frozen=True)
class Kind:
    """One kind of file that people hand to a verb."""

    name: str
    suffix: str
    seeds: Callable[[Path], Sequence[bytes]]
    """Gets a folder that it may use."""
    use: Use
    change: Change
    cases: int
    """How many in a run of a minute."""


@dataclass
class Findings:
    """What a run came to."""

    cases: int = 0
    refused: int = 0
    seconds: float = 0.0
    peak_mb: float = 0.0
    """How much the largest memory of this process grew."""
    slowest_s: float = 0.0
    traces: list[str] = field(default_factory=list)

    @property
    def per_minute(self) -> float:
        return 60.0 * self.cases / max(self.seconds, 1e-3)


TOLD = 20


def run(kind: Kind, folder: Path, seed: int, cases: int = 0, for_s: float = 0.0) -> Findings:
    """Mutate and use files of `kind`, a number of times or for so long; the same seed, the same."""
    chance = random.Random(f"{kind.name} {seed}")
    seeds = list(kind.seeds(folder))
    path = folder / f"case{kind.suffix}"
    findings = Findings()
    for data in seeds:  # compiles and loads; must be right
        path.write_bytes(data)
        _used(kind, path)
    before_mb, begun_s = _peak_mb(), time.monotonic()
    for number in _counted(cases, begun_s + for_s):
        data = kind.change(chance.choice(seeds), chance)
        path.write_bytes(data)
        case_s = time.monotonic()
        try:
            _used(kind, path)
        except TramstreamError:
            findings.refused += 1
        except Exception as error:  # noqa: BLE001  that is what is looked for
            if len(findings.traces) < TOLD:
                kept = folder / f"found-{kind.name}-{number}{kind.suffix}"
                kept.write_bytes(data)
                where = "".join(traceback.format_exception(error)[-4:])
                findings.traces.append(f"{kept}: {where}")
        findings.cases += 1
        findings.slowest_s = max(findings.slowest_s, time.monotonic() - case_s)
    findings.seconds = time.monotonic() - begun_s
    findings.peak_mb = _peak_mb() - before_mb
    return findings


def _counted(cases: int, until_s: float) -> Iterator[int]:
    number = 0
    while number < cases or time.monotonic() < until_s:
        yield number
        number += 1


def _used(kind: Kind, path: Path) -> None:
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), suppress(SystemExit):
        kind.use(path)


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
