"""What one ride gave: rows of the fleet's table and more, or why it gave nothing.

A verb over many rides hands the loop (`cli.terminal.fleet`) a function of a module, which is given
the paths of a ride and answers a `Finding`; another process runs it. What is wrong with one record
must not end the work on others, so errors of a record are an answer too.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from tramstream.analysis.fleet.places import Place
from tramstream.errors import ConfigError, DamagedRecordError, RecordError


class Figure(msgspec.Struct, frozen=True, kw_only=True):
    """One number about a vehicle."""

    field: str
    """`scale left`, `receiver delay`, `imu.gyro_noise_radps_rthz` …"""
    value: float
    std: float
    """NaN where nobody can say."""
    unit: str = ""


class Finding(NamedTuple):
    """Of one ride."""

    vehicle: str
    start_ns: int
    """Vehicle clock."""
    duration_s: float
    digest: str
    """By which copies of a record are known (`recorder.identity`)."""
    verdict: str
    """Why there are no figures; empty where there are."""
    figures: tuple[Figure, ...] = ()
    detail: Any = None
    """What the verb needs beside; goes through a pipe, and into no table."""
    damaged: str = ""
    """One sentence; what could be read was used."""


class Outcome(NamedTuple):
    """A ride and what came of it."""

    place: Place
    finding: Finding | None
    refused: str = ""
    """Why there is no finding."""
    damaged: bool = False


def attempted(
    place: Place, function: Callable[..., Finding], arguments: tuple[Any, ...]
) -> Outcome:
    """Do the work on one ride."""
    try:
        finding = function(list(place.paths), *arguments)
    except DamagedRecordError as error:
        return Outcome(place, None, str(error), damaged=True)
    except (RecordError, ConfigError) as error:
        return Outcome(place, None, str(error))
    except OSError as error:
        return Outcome(place, None, f"{place.name}: {error.strerror or error}")
    return Outcome(place, finding, damaged=bool(finding.damaged))


def named(paths: list[Path]) -> Path | list[Path]:
    """What `open_record` is given for a ride."""
    return paths[0] if len(paths) == 1 else paths
