"""init: the template holds every field with its default, loads, and overwrites nothing."""

from __future__ import annotations

import re
import tomllib
import typing

import msgspec
import pytest
from looking import tramstream

from tramstream import config, config_file, plugins
from tramstream.cli.init import CONFIG_NAME, DBC_NAME, TEMPLATE, init
from tramstream.errors import ConfigError
from tramstream.live import registry

SETTING = re.compile(r"^#(?=\[|\w+ = )", re.MULTILINE)
"""A commented-out line of TOML; prose has a blank behind its #."""


def everything() -> dict:
    """The template with each commented-out setting taken in."""
    return tomllib.loads(SETTING.sub("", TEMPLATE))


def struct_of(type_) -> type[msgspec.Struct] | None:
    """The section's struct in `Gnss | None` or `dict[str, Wheel]`."""
    for part in (type_, *typing.get_args(type_)):
        if isinstance(part, type) and issubclass(part, msgspec.Struct):
            return part
    return None


def differences(struct: type[msgspec.Struct], table: dict, path: str) -> list[str]:
    """Fields that the template lacks or gives another default."""
    found = [f"{path}.{name} does not exist" for name in table if name not in _names(struct)]
    for field in msgspec.structs.fields(struct):
        where = f"{path}.{field.name}"
        if field.name not in table:
            found.append(f"{where} is missing")
            continue
        value, inner = table[field.name], struct_of(field.type)
        if inner is not None:
            by_name = typing.get_origin(field.type) is dict
            for name, section in value.items() if by_name else [("", value)]:
                found += differences(inner, section, f"{where}.{name}" if name else where)
        elif field.default is not msgspec.NODEFAULT:
            value = tuple(value) if isinstance(value, list) else value
            found += [] if value == field.default else [f"{where} is {value}, not {field.default}"]
    return found


def _names(struct: type[msgspec.Struct]) -> set[str]:
    return {field.name for field in msgspec.structs.fields(struct)}


def test_template_names_every_field_with_its_default():
    given = everything()
    found = differences(config.Vehicle, given, "$")
    # The example's own choices, which are no defaults.
    example = ("$.simulators.ride.link", "$.odometer.wheels")
    assert [text for text in found if not text.startswith(example)] == []


def test_template_loads_as_it_is_and_with_every_setting_taken_in(tmp_path):
    vehicle = config_file.parse(TEMPLATE.encode(), "t", tmp_path)
    assert vehicle.simulators == {}
    given = SETTING.sub("", TEMPLATE).encode()
    whole = config_file.parse(given, "t", tmp_path)
    assert whole.map is not None
    assert whole.map.network == str(tmp_path / "network.tracks")
    assert msgspec.structs.replace(whole, simulators={}, map=None) == vehicle


def test_written_configuration_makes_bridges_and_processors(tmp_path):
    init(tmp_path / "new")
    vehicle = config_file.load(tmp_path / "new" / CONFIG_NAME)
    for name in registry.configured_bridges(vehicle):
        plugins.load("bridges", name)(vehicle)
    assert registry.configured_bridges(vehicle) == ["gnss", "imu", "odometer"]
    assert registry.make_processors(vehicle)


def test_init_overwrites_only_when_told(tmp_path):
    init(tmp_path)
    path, dbc = tmp_path / CONFIG_NAME, tmp_path / DBC_NAME
    path.write_text("mine")
    dbc.write_text("mine too")
    with pytest.raises(ConfigError, match=r"exists already.*--force"):
        init(tmp_path)
    assert path.read_text() == "mine"
    init(tmp_path, force=True)
    assert path.read_text() == TEMPLATE
    assert dbc.read_text() == "mine too"


def test_init_says_what_is_in_the_way(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be written"):
        init(tmp_path / "file" / "below")


def test_init_as_a_command_ends_with_2_if_there_is_one(tmp_path):
    assert tramstream("init", tmp_path).returncode == 0
    again = tramstream("init", tmp_path)
    assert again.returncode == 2
    assert len(again.stderr.splitlines()) == 1
