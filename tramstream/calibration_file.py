"""The owner of calibration: a file with fields of `[imu]`, `[wheels]`, `[gnss]` and their origin.

A vehicle's configuration names it (`calibration = "FILE"`), and its loader puts the fields in. Each
field is stated in one of the two files: in both it is an error that names both. What the merged
configuration says of it (`calibrated`) goes into the record, so that every value there tells where
it came from.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from tramstream import toml_text
from tramstream.calibrated import Calibrated, Provenance
from tramstream.config import Gnss, Imu, Struct, Wheels
from tramstream.errors import ConfigError
from tramstream.input_file import TEXT_LIMIT_BYTES, read_bytes
from tramstream.strict_toml import convert, read_toml

FIELD = "calibration"
"""Of the vehicle's configuration: the file, relative to it."""
PROVENANCE = "provenance"
SECTIONS: dict[str, type[Struct]] = {"imu": Imu, "wheels": Wheels, "gnss": Gnss}
_OF_THE_VEHICLE = {"device", "baud_rate"}
"""How a device is reached is no calibration."""


def document(sections: Mapping[str, Mapping[str, Any]], provenance: Provenance) -> str:
    """The text of a calibration, as `merge` reads it."""
    plain = msgspec.to_builtins(provenance)
    sources = plain.pop("records")
    text = toml_text.document({**sections, PROVENANCE: plain})
    for source in sources:
        text += f"\n[[{PROVENANCE}.records]]\n{toml_text.document(source)}"
    head = '# Name this file in the vehicle\'s configuration:  calibration = "FILE"\n'
    return head + text


def merge(raw: dict[str, Any], name: str, folder: Path) -> dict[str, Any]:
    """Put the calibration that a configuration names into it.

    Parameters
    ----------
    raw : dict
        The configuration as its file has it.
    name : str
        Of its file, for sentences.
    folder : Path
        Where relative paths begin.

    Returns
    -------
    raw : dict
        The configuration without the name of the calibration and with its fields, and the section
        `calibrated` that tells which they are.

    Raises
    ------
    ConfigError
        If the calibration cannot be read, states what is none, or what the configuration states.
    """
    if FIELD not in raw:
        return raw
    merged = dict(raw)
    place = merged.pop(FIELD)
    if place == "":
        return merged
    if not isinstance(place, str):
        raise ConfigError(f"{name}: $.{FIELD}: must be the name of a file")
    path = (folder / place).absolute()
    sections, provenance = read(path)
    fields = []
    for section, values in sections.items():
        own = merged.get(section)
        if own is None and section != "wheels":
            raise ConfigError(
                f"{name}: $.{section}: is not there, but {path} calibrates it",
                cure="add the section, or name another calibration",
            )
        own = {} if own is None else own
        if not isinstance(own, dict):
            continue  # the configuration itself is refused for that
        for field in values:
            if field in own:
                raise ConfigError(
                    f"{name}: $.{section}.{field}: is stated here and in {path}",
                    cure="state it in one of them",
                )
            fields.append(f"{section}.{field}")
        merged[section] = own | values
    origin = msgspec.structs.asdict(provenance)
    known = Calibrated(file=str(path), fields=tuple(fields), **origin)
    merged["calibrated"] = msgspec.to_builtins(known)
    return merged


def read(path: Path) -> tuple[dict[str, dict[str, Any]], Provenance]:
    """Fields of a calibration by section, each of a kind that it can be, and their origin.

    Raises
    ------
    ConfigError
    """
    raw = read_toml(read_bytes(path, TEXT_LIMIT_BYTES), str(path))
    provenance = convert(raw.pop(PROVENANCE, {}), Provenance, str(path), f"$.{PROVENANCE}")
    for section, values in raw.items():
        type_ = SECTIONS.get(section)
        if type_ is None:
            raise ConfigError(
                f"{path}: $.{section}: is no part of a calibration; there are: "
                f"{', '.join((*SECTIONS, PROVENANCE))}"
            )
        if not isinstance(values, dict):
            raise ConfigError(f"{path}: $.{section}: must be a section")
        for field in sorted(_OF_THE_VEHICLE & values.keys()):
            raise ConfigError(
                f"{path}: $.{section}.{field}: is of the vehicle, not of its calibration",
                cure="state it in the vehicle's configuration",
            )
        device = {"device": "unknown"} if "device" in type_.__struct_fields__ else {}
        convert(values | device, type_, str(path), f"$.{section}")
    return raw, provenance
