"""Where the calibrated fields of a configuration come from, as the configuration keeps it."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime

import msgspec

from tramstream import __version__

_SECONDS = "%Y-%m-%dT%H:%M:%SZ"


class _Struct(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    pass


class Source(_Struct, frozen=True, kw_only=True):
    """A record that a calibration was made from."""

    file: str
    vehicle: str = ""
    start: str = ""
    """First arrival, as the vehicle clock had it."""
    duration_s: float = 0.0

    @classmethod
    def of(cls, file: str, vehicle: str, start_ns: int, end_ns: int) -> Source:
        """Of a record with its first and last arrival."""
        start = datetime.fromtimestamp(start_ns // 1_000_000_000, UTC)
        return cls(
            file=file,
            vehicle=vehicle,
            start=start.strftime(_SECONDS),
            duration_s=(end_ns - start_ns) / 1e9,
        )


class Provenance(_Struct, frozen=True, kw_only=True):
    """How a calibration was made."""

    tool: str = ""
    """The verb that wrote it."""
    software: str = ""
    """Its version."""
    made: str = ""
    """When, UTC."""
    records: tuple[Source, ...] = ()
    std: dict[str, float | tuple[float, ...]] = {}
    """Deviations as far as they are known, by `section.field`, in the units of the fields."""
    notes: tuple[str, ...] = ()

    @classmethod
    def now(
        cls,
        tool: str,
        records: tuple[Source, ...],
        std: Mapping[str, float | tuple[float, ...]],
        notes: tuple[str, ...] = (),
    ) -> Provenance:
        """Of a calibration that this version makes at this instant."""
        made = datetime.now(UTC).strftime(_SECONDS)
        software = f"tramstream {__version__}"
        return Provenance(
            tool=tool, software=software, made=made, records=records, std=dict(std), notes=notes
        )


class Calibrated(Provenance, frozen=True, kw_only=True):
    """Which fields of a configuration a calibration gave; written by the loader."""

    file: str
    """The calibration that the configuration named."""
    fields: tuple[str, ...] = ()
    """`section.field` of each."""
