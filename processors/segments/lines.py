"""The lines that are looked for: those of the vehicle's network, and those learned from rides."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from tramstream.config import Vehicle
from tramstream.errors import ConfigError
from tramstream.processors.segments.settings import SegmentsSettings
from tramstream.tracks import network as networks
from tramstream.tracks import signature, signature_file
from tramstream.tracks.signature import Signature


class Lines(NamedTuple):
    """What there is to look for."""

    signatures: list[Signature]
    unread: tuple[str, str] | None
    """Why there is less than the settings ask for, and the cure."""


def signatures_of(vehicle: Vehicle, settings: SegmentsSettings) -> Lines:
    """Read what the settings name."""
    found: list[Signature] = []
    unread = None
    if vehicle.map is not None:
        try:
            found += signature.of_network(networks.load(Path(vehicle.map.network)), settings.lines)
        except ConfigError as error:
            unread = (error.reason, error.cure)
        missing = [
            each
            for each in settings.lines
            if not any(each in (line.line, line.name) for line in found)
        ]
        if missing and unread is None:
            reason = f"$.segments.lines has {missing[0]}, which the network has not"
            unread = (reason, "`tramstream map info` says which lines it has")
    for name in settings.signatures:
        try:
            found.append(signature_file.load(Path(name)))
        except ConfigError as error:
            unread = (error.reason, error.cure)
    return Lines(found, unread)
