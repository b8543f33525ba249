"""The track network of a city: where the rails lie, how they join, and what people call them.

A **track** is a piece of rail between two nodes with no way off in between; it is *drawn* in one
direction, which says nothing of where trams go. Running it as it is drawn is *forwards*. A **run**
is a track with a direction: number 2 k is track k forwards, 2 k + 1 backwards. Rules (one-way use)
say which runs are **edges**, where trams are meant to go; rails alone say which runs follow which,
so a tram that goes where it should not is on the network all the same.

Geometry is sampled evenly along each track, at most `SAMPLE_M` apart, from a smooth curve through
the map's nodes: position, heading and curvature, each with the deviation that the curve has from
the rail. The plan is that of `level`, in which every point lies at the level's own height; heights
of track and vehicle never enter it (`plan_of`). Track that lies 250 m above it is 4e-5 of its
length longer than in the plan.

A network is a zip of numpy arrays and names; those in `_STEP` are packed, `load` unpacks them.
`network_build` makes it from maps.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
import zlib
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tramstream.errors import ConfigError
from tramstream.geodesy import LocalLevel
from tramstream.memory.arrays import read_npy
from tramstream.tracks import check
from tramstream.tracks.whole_file import write_whole

Array = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]
Bytes = NDArray[np.int8]

SAMPLE_M = 1.0
FORMAT = 1
"""Raised whenever a file changes so that an older reader would misread it."""
FORWARDS, BACKWARDS = 1, 2
"""Bits of `Network.rules`."""
PARTNER_LEFT, PARTNER_RIGHT = 1, 2
"""Bits of `Network.partner`."""


class Stop(NamedTuple):
    """A stopping place on a track."""

    name: str
    track: int
    chainage_m: float
    """Along the track as drawn."""
    ref: str = ""
    """The operator's number of it, where the map has one."""


class Way(NamedTuple):
    """What the map says of a part of a track."""

    track: int
    from_m: float
    to_m: float
    """Along the track as drawn."""
    osm_id: int
    """0: not from OpenStreetMap."""
    tags: dict[str, str]
    """Those that matter to a tram, as the map has them."""


class LineStop(NamedTuple):
    """A stop of a line."""

    name: str
    chainage_m: float
    """Along the line."""


class RouteLine(NamedTuple):
    """One direction of an operator's line as a path through the network."""

    line: str
    direction: str
    origin: str
    destination: str
    runs: tuple[int, ...]
    """In the order in which they are gone."""
    begin_m: float
    """Where the line begins on its first run, along that run."""
    length_m: float
    stops: tuple[LineStop, ...]


@dataclass(frozen=True)
class Network:
    """See the module. Arrays are read-only; per-sample ones lie track after track."""

    latitude_rad: float
    longitude_rad: float
    height_m: float
    """Of the plan's origin, above the ellipsoid."""
    starts: Integers
    """First sample of each track, and the number of all: shape (tracks + 1,)."""
    length_m: Array
    """Of each track."""
    rules: Bytes
    """Of each track: bits FORWARDS and BACKWARDS, where trams are meant to go."""
    from_node: Integers
    to_node: Integers
    """Of each track as drawn."""
    node_id: NDArray[np.int64]
    """Of each node, the map's own number; negative where the map has none."""
    node_switch: Bytes
    """Of each node: 1 where a run has a choice."""
    following_starts: Integers
    """By run, (2 tracks + 1,): where in `following` the runs begin that rails let follow it."""
    following: Integers
    east: Array
    north: Array
    yaw_rad: Array
    """Of the track as drawn, counter-clockwise from the plan's east, continuous along a track."""
    curvature_per_m: Array
    """Left positive, of the track as drawn."""
    across_std_m: Singles
    yaw_std_rad: Singles
    """Deviation of the fitted curve from the rail."""
    height: Singles
    """Above the ellipsoid, m; NaN where it is not known."""
    grade_rad: Singles
    """Uphill positive, of the track as drawn; NaN where it is not known."""
    grade_std_rad: Singles
    partner: Bytes
    """Bits PARTNER_LEFT and PARTNER_RIGHT of the track as drawn: a parallel track within
    `network_partners.PARTNER_M` on that side."""
    stops: tuple[Stop, ...] = ()
    ways: tuple[Way, ...] = ()
    """In order of tracks and chainage."""
    lines: tuple[RouteLine, ...] = ()
    source: str = ""
    """What it was built from, when, and under which licence."""
    node_std_m: float = 0.0
    """Deviation of the map's nodes from the rail, per axis, as estimated or given."""

    @property
    def level(self) -> LocalLevel:
        return LocalLevel(self.latitude_rad, self.longitude_rad, self.height_m)

    @property
    def track_count(self) -> int:
        return len(self.length_m)

    @property
    def edges(self) -> Integers:
        """Runs where trams are meant to go, ascending."""
        allowed = np.stack([self.rules & FORWARDS, self.rules & BACKWARDS], axis=1).ravel()
        found: Integers = np.flatnonzero(allowed).astype(np.int32)
        return found

    @property
    def spacing_m(self) -> Array:
        """Of the samples of each track."""
        spacing: Array = self.length_m / (np.diff(self.starts) - 1)
        return spacing

    def following_of(self, run: int) -> Integers:
        """Runs that rails let follow a run."""
        begin, end = self.following_starts[run : run + 2]
        return self.following[begin:end]

    def samples_of(self, track: int) -> slice:
        """Where the samples of a track lie."""
        return slice(int(self.starts[track]), int(self.starts[track + 1]))

    def name_of(self, run: int) -> str:
        """What a run is called: the map's numbers of the nodes that it goes from and to.

        Where several tracks join the same two nodes, the second and further ones have `/2` and so
        on behind it; a ring that is run against how it is drawn has `/back`.
        """
        nodes = self.node_id[self.from_node[run >> 1]], self.node_id[self.to_node[run >> 1]]
        begin, end = nodes if run % 2 == 0 else nodes[::-1]
        number = self._numbers.get(run >> 1)
        back = "/back" if begin == end and run % 2 else ""
        return f"{begin}-{end}" + (f"/{number}" if number else "") + back

    @cached_property
    def _numbers(self) -> dict[int, int]:
        """Which one of those that join the same two nodes a track is, from the second one on."""
        seen: dict[tuple[int, int], int] = {}
        numbers = {}
        for track, (one, other) in enumerate(
            zip(self.from_node.tolist(), self.to_node.tolist(), strict=True)
        ):
            pair = min(one, other), max(one, other)
            seen[pair] = seen.get(pair, 0) + 1
            if seen[pair] > 1:
                numbers[track] = seen[pair]
        return numbers

    def plan_of(self, geodetic: ArrayLike) -> Array:
        """Give places in the plan.

        Parameters
        ----------
        geodetic : array_like, shape (2,), (3,), (n, 2) or (n, 3)
            Latitude, longitude, rad; a height is not looked at.

        Returns
        -------
        plan : ndarray, shape (2,) or (n, 2)
            East, north, m.
        """
        rows = np.asarray(geodetic, dtype=float)
        height = np.full((*rows.shape[:-1], 1), self.height_m)
        plan: Array = self.level.from_geodetic(np.concatenate([rows[..., :2], height], axis=-1))
        return plan[..., :2]

    def geodetic_of(self, plan: ArrayLike) -> Array:
        """Give latitude and longitude, rad, of places in the plan; the inverse of `plan_of`."""
        rows = np.asarray(plan, dtype=float)
        level, up = self.level, np.zeros((*rows.shape[:-1], 1))
        for _ in range(3):  # up of a place that lies at the plan's height, away from its origin
            found = level.to_geodetic(np.concatenate([rows, up], axis=-1))
            up = up - (found[..., 2:] - self.height_m)
        geodetic: Array = level.to_geodetic(np.concatenate([rows, up], axis=-1))[..., :2]
        return geodetic

    # Files ---------------------------------------------------------------------------------------
    def save(self, path: Path) -> None:
        """Write the network; an existing file is replaced at once or not at all."""
        packed = io.BytesIO()
        names: dict[str, Any] = {"format": FORMAT}
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
            for each in fields(self):
                value = getattr(self, each.name)
                if isinstance(value, np.ndarray):
                    with archive.open(_entry(f"{each.name}.npy"), "w") as file:
                        np.lib.format.write_array(file, _packed(each.name, value))
                else:
                    names[each.name] = value
            archive.writestr(_entry("names.json"), json.dumps(names, ensure_ascii=False))
        write_whole(path, packed.getvalue())


def _entry(name: str) -> zipfile.ZipInfo:
    """An entry without a date: the same network is the same file."""
    entry = zipfile.ZipInfo(name)
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


def load(path: Path) -> Network:
    """Read a network.

    Raises
    ------
    ConfigError
        One sentence with the file and what is wrong with it.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = _entries(archive, path.stat().st_size)
            names = msgspec.json.decode(archive.read(entries.pop("names.json")), type=_Names)
            if names.format != FORMAT:
                raise ConfigError(
                    f"{path}: was built by another version",
                    cure="build it anew with `tramstream map build`",
                )
            arrays = {
                name.removesuffix(".npy"): read_npy(archive.read(entry))
                for name, entry in entries.items()
            }
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read ({error.strerror})", cure="check the name"
        ) from error
    except _DAMAGES as error:
        raise _no_network(path) from error
    unpacked: dict[str, Any] = {name: _unpacked(name, array) for name, array in arrays.items()}
    doubt = check.doubt_of(unpacked) or _doubt_of(names, len(arrays.get("length_m", ())))
    if doubt:
        raise _no_network(path) from ValueError(doubt)
    told = msgspec.structs.asdict(names)
    del told["format"]
    return Network(**unpacked, **told)


class _Names(msgspec.Struct, forbid_unknown_fields=True):
    """What a file holds beside arrays; fields as in `Network`."""

    format: int
    latitude_rad: float
    longitude_rad: float
    height_m: float
    stops: tuple[Stop, ...]
    ways: tuple[Way, ...]
    lines: tuple[RouteLine, ...]
    source: str
    node_std_m: float


_LEAST_BYTES, _MOST_FOLD = 16 << 20, 20
"""A network unpacks to five to eight times its size; this is what it may at most."""
_DAMAGES = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    KeyError,
    ValueError,
    NotImplementedError,
    RuntimeError,
    msgspec.MsgspecError,
)
"""What a damaged file raises (RuntimeError: one that is encrypted, or nests too deeply)."""


def _entries(archive: zipfile.ZipFile, size: int) -> dict[str, zipfile.ZipInfo]:
    """What a network's file of `size` bytes holds, by name.

    Raises
    ------
    ValueError
        If it states more than a file of this size can hold, or something else than a network.
    """
    found = archive.infolist()
    stated = sum(entry.file_size for entry in found)
    known = {"names.json", *(f"{name}.npy" for name in check.KINDS)}
    plain = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
    if stated > _LEAST_BYTES + _MOST_FOLD * size or len(found) != len(known):
        raise ValueError(f"{len(found)} entries that state {stated} bytes")
    if {entry.filename for entry in found} != known:
        raise ValueError("entries of other names")
    if any(entry.compress_type not in plain for entry in found):
        raise ValueError("entries packed in another way")
    return {entry.filename: entry for entry in found}


def _doubt_of(names: _Names, tracks: int) -> str:
    """What the names say of tracks that are not there; empty if nothing."""
    of_tracks = [stop.track for stop in names.stops] + [way.track for way in names.ways]
    of_runs = [run for line in names.lines for run in line.runs]
    lengths = [names.height_m, names.node_std_m, *(stop.chainage_m for stop in names.stops)]
    lengths += [end for way in names.ways for end in (way.from_m, way.to_m)]
    for line in names.lines:
        lengths += [line.begin_m, line.length_m, *(stop.chainage_m for stop in line.stops)]
    if not check.are_below(of_tracks, tracks):
        return "stops or ways on tracks that are not there"
    if not check.are_below(of_runs, 2 * tracks) or not all(line.runs for line in names.lines):
        return "lines over tracks that are not there"
    if abs(names.latitude_rad) > math.pi / 2 or abs(names.longitude_rad) > 2 * math.pi:
        return "a place that is none"
    return "" if check.are_lengths(lengths) else "lengths that nothing on Earth has"


def _no_network(path: Path) -> ConfigError:
    return ConfigError(
        f"{path}: is no track network, or a damaged one",
        cure="`tramstream map build` makes it anew",
    )


_STEP = {"east": 1e-3, "north": 1e-3, "yaw_rad": 1e-6, "curvature_per_m": 1e-7}
"""What a unit in the file is: samples are kept as differences of whole numbers, which pack to a
fifth."""


def _packed(name: str, array: NDArray[Any]) -> NDArray[Any]:
    step = _STEP.get(name)
    if step is None:
        return array
    return np.diff(np.rint(array / step).astype(np.int64), prepend=0).astype(np.int32)


def _unpacked(name: str, array: NDArray[Any]) -> NDArray[Any]:
    step = _STEP.get(name)
    whole = array if step is None else np.cumsum(array, dtype=np.int64) * step
    whole.flags.writeable = False
    return whole


def rule(forwards: bool, backwards: bool) -> int:
    """Bits of `Network.rules`."""
    return FORWARDS * forwards + BACKWARDS * backwards
