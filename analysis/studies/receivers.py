"""Positions of captured receivers beside those that gpsd reports of the same bytes.

A capture `X.log` lies beside `X.log.chk`, what gpsd made of it: one JSON report a line, among other
lines. Each position that gpsd reports has to be one of ours, of any protocol that the receiver
speaks: gpsd takes what comes, and where two protocols tell an epoch we publish the better one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tramstream import keys
from tramstream.bridges.gnss.bridge import GnssBridge
from tramstream.bridges.gnss.framer import NMEA, UBX, Frame, Framer
from tramstream.bridges.gnss.nmea_sentences import sentence_type
from tramstream.clock import S
from tramstream.config import Gnss, Vehicle
from tramstream.errors import ConfigError
from tramstream.processor import Sample
from tramstream.proto.raw_pb2 import RawBytes

EQUAL_DEG = 2e-9
"""gpsd prints nine decimals."""
LAST_DIGIT_DEG = 1.01e-7
"""One unit of what NAV-PVT tells: where gpsd has merged an epoch of two protocols."""
_SOLUTIONS = ("NAV-PVAT", "NAV-PVT", "HNR-PVT")
_PLACES = ("GGA", "GNS", "RMC", "GLL")
"""Sentences that tell a position; in one epoch they may differ in their digits."""
_READ = 4096
Place = tuple[float, float]


@dataclass(frozen=True)
class Agreement:
    """What became of gpsd's positions of one capture."""

    capture: str
    protocols: dict[str, int]
    """Frames of each protocol in the capture."""
    positions: int
    """Different ones that gpsd reports."""
    equal: dict[str, int]
    """Those that are ours, by where from: the source of our fix."""
    nearly: int
    """Those that differ by one unit of the last digit."""
    fixes: int
    """Ours."""
    missing: list[Place] = field(default_factory=list)
    """Positions of gpsd's that we do not have."""

    @property
    def agrees(self) -> bool:
        """Whether every position is ours."""
        return not self.missing


def captures(folder: Path) -> list[Path]:
    """Captures of receivers that have gpsd's report beside them, in `folder` and below.

    Raises
    ------
    ConfigError
        If there is none.
    """
    found = [path.with_suffix("") for path in sorted(folder.rglob("*.chk"))]
    found = [path for path in found if path.is_file()]
    if not found:
        raise ConfigError(f"{folder}: no capture has gpsd's .chk beside it; give --data")
    return found


def compare(capture: Path) -> Agreement:
    """Decode a capture and look for each of gpsd's positions."""
    data = capture.read_bytes()
    framer = Framer()
    frames = [item for item in framer.feed(data) + framer.flush() if isinstance(item, Frame)]
    ours, count = _ours(frames)
    equal: dict[str, int] = {}
    nearly, missing = 0, []
    reported = list(dict.fromkeys(_reported(capture)))
    for place in reported:
        source, off = _nearest(place, ours)
        if off <= EQUAL_DEG:
            equal[source] = equal.get(source, 0) + 1
        elif off <= LAST_DIGIT_DEG:
            nearly += 1
        else:
            missing.append(place)
    protocols: dict[str, int] = {}
    for frame in frames:
        protocols[frame.protocol] = protocols.get(frame.protocol, 0) + 1
    return Agreement(capture.name, protocols, len(reported), equal, nearly, count, missing)


def _reported(capture: Path) -> Iterator[Place]:
    """Positions of gpsd's reports in their order."""
    text = capture.with_name(f"{capture.name}.chk").read_text(errors="replace")
    for line in text.splitlines():
        if not line.startswith('{"class":"TPV"'):
            continue
        report = json.loads(line)
        if "lat" in report and "lon" in report:
            yield report["lat"], report["lon"]


def _ours(frames: list[Frame]) -> tuple[dict[tuple[int, int], list[tuple[Place, str]]], int]:
    """Our positions by cell of a grid, and how many fixes there are of the whole capture.

    Beside the whole capture each protocol is decoded alone, of UBX each solution, and of NMEA each
    sentence: gpsd reports the place of every one.
    """
    streams = [frames]
    ubx = [frame for frame in frames if frame.protocol == UBX]
    parts = [frame for frame in ubx if frame.name not in _SOLUTIONS]
    nmea = [frame for frame in frames if frame.protocol == NMEA]
    streams += [nmea, parts]
    streams += [[frame for frame in nmea if sentence_type(frame) == kind] for kind in _PLACES]
    streams += [[frame for frame in ubx if frame.name == name] for name in _SOLUTIONS]
    grid: dict[tuple[int, int], list[tuple[Place, str]]] = {}
    counts = []
    for stream in streams:
        fixes = 0
        for sample in _decoded(b"".join(frame.raw for frame in stream)):
            if sample.key not in (keys.GNSS_FIX, keys.GNSS_HIGH_RATE, keys.GNSS_POSITION):
                continue
            fixes += sample.key == keys.GNSS_FIX
            place = sample.message.latitude_deg, sample.message.longitude_deg
            grid.setdefault(_cell(place), []).append((place, sample.message.source))
        counts.append(fixes)
    return grid, counts[0]


def _decoded(data: bytes) -> Iterator[Sample]:
    bridge = GnssBridge(Vehicle(vehicle="captures", gnss=Gnss(device="capture")))
    for number, start in enumerate(range(0, len(data), _READ), 1):
        message = RawBytes(stamp_ns=number * S, data=data[start : start + _READ])
        yield from bridge.step(Sample(keys.GNSS_BYTES, message, message.stamp_ns, number))
    yield from bridge.finish()


_CELL_DEG = 1e-6


def _cell(place: Place) -> tuple[int, int]:
    return round(place[0] / _CELL_DEG), round(place[1] / _CELL_DEG)


def _nearest(
    place: Place, grid: dict[tuple[int, int], list[tuple[Place, str]]]
) -> tuple[str, float]:
    """Source of our position that is nearest, and how far it is off, degrees."""
    row, column = _cell(place)
    best = ("", math.inf)
    for i in (row - 1, row, row + 1):
        for j in (column - 1, column, column + 1):
            for (latitude, longitude), source in grid.get((i, j), ()):
                off = max(abs(latitude - place[0]), abs(longitude - place[1]))
                if off < best[1]:
                    best = (source, off)
    return best
