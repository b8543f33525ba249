"""A vehicle configuration out of its file: strict, with paths made absolute, and what names it.

Sections of processors and bridges of other packages are checked against the `Settings` of their
class, found by entry point, as strictly as ours.
"""

from __future__ import annotations

import hashlib
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import msgspec.inspect

from tramstream import calibration_file, mounting, plugins, toml_text
from tramstream.config import MATCHER, Bus, Recorder, Vehicle
from tramstream.errors import ConfigError
from tramstream.input_file import TEXT_LIMIT_BYTES, read_limited
from tramstream.strict_toml import convert, read_toml

RECORD_ENTRY = "config"
"""Entry of a record's metadata that holds `to_json`."""


def load(path: Path) -> Vehicle:
    """Read a vehicle configuration; relative paths in it are relative to the file.

    Raises
    ------
    ConfigError
        One sentence with the file, the path of the field and what was expected.
    """
    try:
        data = read_limited(path, TEXT_LIMIT_BYTES)
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot read the configuration ({error.strerror})",
            cure="`tramstream init` writes one",
        ) from error
    return parse(data, str(path), path.parent)


def parse(data: bytes, name: str, folder: Path) -> Vehicle:
    """Decode configuration text; see `load`."""
    raw = calibration_file.merge(read_toml(data, name), name, folder)
    sections = {section: raw.pop(section) for section in _strangers() if section in raw}
    if SECTIONS in raw:
        raise ConfigError(
            f"{name}: $.{SECTIONS}: unknown field",
            cure="settings of a processor of another package stand in a section of its name",
        )
    vehicle = _resolve(_one_mounting(convert(raw, Vehicle, name), raw, name), folder)
    _check_names(vehicle, name)
    return msgspec.structs.replace(vehicle, sections=_checked(vehicle, sections, name, folder))


def _one_mounting(vehicle: Vehicle, raw: dict[str, Any], name: str) -> Vehicle:
    """Give a mounting that is stated as a quaternion its angles too, for whoever reads those.

    Raises
    ------
    ConfigError
        If both are stated, and are different turns.
    """
    imu = vehicle.imu
    if imu is None or not imu.mounting_q_bv:
        return vehicle
    try:
        whole = mounting.unit(imu.mounting_q_bv)
        if "mounting_deg" in raw["imu"]:
            mounting.check(imu.mounting_deg, whole)
    except ValueError as error:
        raise ConfigError(f"{name}: $.imu.mounting_q_bv: {error}") from error
    both = msgspec.structs.replace(imu, mounting_deg=mounting.angles_of(whole), mounting_q_bv=whole)
    return msgspec.structs.replace(vehicle, imu=both)


SECTIONS = "sections"


def _strangers() -> list[str]:
    """Names of sections that processors and bridges of other packages have."""
    known = {*plugins.names("processors"), *plugins.names("bridges")}
    return sorted(known - {*Vehicle.__struct_fields__, MATCHER})


def _check_names(vehicle: Vehicle, file: str) -> None:
    """Refuse processors that are not installed, or are named twice."""
    installed = plugins.names("processors")
    for field, known in (("processors", installed), ("separate", list(vehicle.processors))):
        chosen: tuple[str, ...] = getattr(vehicle, field)
        for index, name in enumerate(chosen):
            if name not in known:
                sentence = plugins.unknown("processor", name, known)
                raise ConfigError(f"{file}: $.{field}[{index}]: {sentence}")
            if name in chosen[:index]:
                raise ConfigError(f"{file}: $.{field}[{index}]: {name} is named twice")


def _checked(
    vehicle: Vehicle, sections: dict[str, Any], file: str, folder: Path
) -> dict[str, dict[str, Any]]:
    """Strangers' sections against the `Settings` of their classes, defaults filled in."""
    bridges = plugins.names("bridges")
    strangers = _strangers()
    running = [name for name in vehicle.processors if name in strangers]
    made = {}
    for section in dict.fromkeys((*sections, *running)):
        class_ = plugins.load("bridges" if section in bridges else "processors", section)
        type_ = class_.Settings
        if type_ is None:
            if section in sections:
                raise ConfigError(
                    f"{file}: $.{section}: {section} has no settings", cure="delete it"
                )
            continue
        found = convert(sections.get(section, {}), type_, file, f"$.{section}")
        made[section] = _with_files(msgspec.to_builtins(found), type_, folder)
    return made


def _with_files(
    values: dict[str, Any], type_: type[msgspec.Struct], folder: Path
) -> dict[str, Any]:
    """A section whose files (`FilePath`, or a tuple of them) are absolute."""
    info = msgspec.inspect.type_info(type_)
    assert isinstance(info, msgspec.inspect.StructType)
    for field in info.fields:
        value = values[field.encode_name]
        if isinstance(field.type, msgspec.inspect.VarTupleType) and _is_file(field.type.item_type):
            values[field.encode_name] = [_absolute(each, folder) for each in value]
        elif _is_file(field.type):
            values[field.encode_name] = _absolute(value, folder)
    return values


def _is_file(type_: msgspec.inspect.Type) -> bool:
    return isinstance(type_, msgspec.inspect.Metadata) and bool((type_.extra or {}).get("file"))


def _absolute(path: str, folder: Path) -> str:
    return str((folder / path).absolute()) if path else path


def has_section(vehicle: Vehicle, name: str) -> bool:
    """Whether the configuration has a section for the bridge `name`."""
    return name in vehicle.sections or getattr(vehicle, name, None) is not None


Settings = TypeVar("Settings", bound=msgspec.Struct)


def settings(vehicle: Vehicle, name: str, type_: type[Settings]) -> Settings:
    """The settings of the processor or bridge `name`, whose class says that they are a `type_`.

    Raises
    ------
    ConfigError
        If the section, of another version perhaps, does not fit.
    """
    own = getattr(vehicle, name, None)
    if isinstance(own, type_):
        return own
    return convert(vehicle.sections.get(name, {}), type_, vehicle.vehicle, f"$.{name}")


def _resolve(vehicle: Vehicle, folder: Path) -> Vehicle:
    """Make file paths absolute; device names and channels stay what they are."""
    absolute = partial(_absolute, folder=folder)
    changes: dict[str, Any] = {
        "recorder": msgspec.structs.replace(
            vehicle.recorder, directory=absolute(vehicle.recorder.directory)
        ),
        "simulators": {
            name: msgspec.structs.replace(
                simulator, file=absolute(simulator.file), link=absolute(simulator.link)
            )
            for name, simulator in vehicle.simulators.items()
        },
        "bus": msgspec.structs.replace(vehicle.bus, runtime_dir=absolute(vehicle.bus.runtime_dir)),
    }
    if vehicle.odometer is not None:
        changes["odometer"] = msgspec.structs.replace(
            vehicle.odometer,
            dbc=absolute(vehicle.odometer.dbc),
            channel=_device(vehicle.odometer.channel, folder),
        )
    if vehicle.map is not None:
        changes["map"] = msgspec.structs.replace(vehicle.map, network=absolute(vehicle.map.network))
    if vehicle.gnss is not None:
        changes["gnss"] = msgspec.structs.replace(
            vehicle.gnss, device=_device(vehicle.gnss.device, folder)
        )
    if vehicle.imu is not None:
        changes["imu"] = msgspec.structs.replace(
            vehicle.imu, device=_device(vehicle.imu.device, folder)
        )
    return msgspec.structs.replace(vehicle, **changes)


def _device(name: str, folder: Path) -> str:
    """A path with a slash in it is relative to the configuration; `can0` is an interface."""
    return str((folder / name).absolute()) if "/" in name and "://" not in name else name


def to_json(vehicle: Vehicle) -> str:
    """A configuration as it goes into a record's metadata; `msgspec.json` reads it back."""
    return msgspec.json.encode(vehicle).decode()


def to_toml(vehicle: Vehicle) -> str:
    """A configuration as the text of a file that gives it again, every setting written out.

    Settings that a calibration gave say so beside them.
    """
    return toml_text.document(_plain(vehicle), remarks=remarks(vehicle))


def remarks(vehicle: Vehicle) -> dict[str, str]:
    """What is to be said beside settings, by `section.field`: where calibrated ones come from."""
    known = vehicle.calibrated
    if known is None:
        return {}
    made = f"{known.tool or 'calibration'} {known.made}".strip()
    found = {}
    for field in known.fields:
        std = known.std.get(field)
        spread = f", σ {toml_text.value_text(std)}" if std is not None else ""
        found[field] = f"{known.file}: {made}{spread}"
    return found


def differences(old: Vehicle, new: Vehicle) -> list[str]:
    """Each setting of `new` that is another in `old`, a record's: its path and both values."""
    without = {"calibrated": None}
    return _differences(_plain(old) | without, _plain(new) | without, "$")


def _plain(vehicle: Vehicle) -> dict[str, Any]:
    """A configuration as its file has it: sections of strangers stand beside ours."""
    plain: dict[str, Any] = msgspec.to_builtins(vehicle)
    sections: dict[str, Any] = plain.pop(SECTIONS)
    return plain | sections


def _differences(old: Any, new: Any, path: str) -> list[str]:
    if old == new:
        return []
    if isinstance(old, dict) and isinstance(new, dict):
        return [
            text
            for name in dict.fromkeys((*old, *new))
            for text in _differences(old.get(name), new.get(name), f"{path}.{name}")
        ]
    return [f"{path}: {_shown(old)} in the record, {_shown(new)} now"]


def _shown(value: Any) -> str:
    if value is None:
        return "absent"
    return "a section" if isinstance(value, dict) else toml_text.value_text(value)


def digest(vehicle: Vehicle) -> str:
    """Short name of what processors are made of: equal where their memory fits.

    Where the vehicle's bus, records, devices and files are, where calibrated values come from, and
    which processor has a process of its own, does not count.
    """
    plain = msgspec.structs.replace
    changes: dict[str, Any] = {
        "bus": Bus(),
        "recorder": Recorder(),
        "simulators": {},
        "separate": (),
        "calibrated": None,
    }
    if vehicle.gnss is not None:
        changes["gnss"] = plain(vehicle.gnss, device="")
    if vehicle.imu is not None:
        changes["imu"] = plain(vehicle.imu, device="")
    if vehicle.odometer is not None:
        changes["odometer"] = plain(vehicle.odometer, channel="", dbc="")
    if vehicle.map is not None:
        changes["map"] = plain(vehicle.map, network=Path(vehicle.map.network).name)
    return text_digest(to_json(plain(vehicle, **changes)))


def text_digest(text: str) -> str:
    """Short name of a text; of a whole configuration, older records' snapshots have it."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]
