"""A line's signature as a file: a zip of arrays and names, like a network's."""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from tramstream.errors import ConfigError
from tramstream.input_file import read_limited
from tramstream.memory.arrays import read_npy
from tramstream.tracks.signature import Signature
from tramstream.tracks.whole_file import write_whole

FORMAT = 1
LIMIT_BYTES = 64 << 20
ARRAYS = ("yaw_rad", "stops_m", "switches_m", "plan")
LONGEST = 2_000_000
"""Headings: no line is so long."""


class _Names(msgspec.Struct, forbid_unknown_fields=True):
    format: int
    line: str
    direction: str
    stop_names: tuple[str, ...]
    yaw_std_rad: float
    stop_std_m: float
    rides: int


def save(signature: Signature, path: Path) -> None:
    """Write a signature; an existing file is replaced at once or not at all."""
    names = _Names(
        FORMAT,
        signature.line,
        signature.direction,
        signature.stop_names,
        signature.yaw_std_rad,
        signature.stop_std_m,
        signature.rides,
    )
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ARRAYS:
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w") as file:
                np.lib.format.write_array(file, getattr(signature, name))
        archive.writestr(zipfile.ZipInfo("names.json"), msgspec.json.encode(names))
    write_whole(path, packed.getvalue())


def load(path: Path) -> Signature:
    """Read a signature.

    Raises
    ------
    ConfigError
        One sentence with the file and what is wrong with it.
    """
    try:
        data = read_limited(path, LIMIT_BYTES)
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read ({error.strerror})", cure="check the name"
        ) from error
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(each.file_size for each in archive.infolist()) > LIMIT_BYTES:
                raise ValueError("states more than a line has")
            names = msgspec.json.decode(archive.read("names.json"), type=_Names)
            arrays = {name: read_npy(archive.read(f"{name}.npy")) for name in ARRAYS}
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        KeyError,
        ValueError,
        NotImplementedError,
        RuntimeError,
        msgspec.MsgspecError,
    ) as error:
        raise _no_signature(path) from error
    if names.format != FORMAT or not _sound(arrays):
        raise _no_signature(path)
    return Signature(
        names.line,
        names.direction,
        arrays["yaw_rad"],
        arrays["stops_m"],
        names.stop_names,
        arrays["switches_m"],
        arrays["plan"],
        names.yaw_std_rad,
        names.stop_std_m,
        names.rides,
    )


def _sound(arrays: dict[str, NDArray[Any]]) -> bool:
    yaw, plan = arrays["yaw_rad"], arrays["plan"]
    flat = all(arrays[name].ndim == 1 for name in ARRAYS[:3])
    if not flat or not all(arrays[name].dtype == np.float64 for name in ARRAYS):
        return False
    if not 10 <= len(yaw) <= LONGEST or plan.shape not in ((0, 2), (len(yaw), 2)):
        return False
    return all(bool(np.all(np.isfinite(arrays[name]))) for name in ARRAYS)


def _no_signature(path: Path) -> ConfigError:
    return ConfigError(
        f"{path}: is no signature of a line, or a damaged one",
        cure="`tramstream learn-line` makes it anew",
    )
