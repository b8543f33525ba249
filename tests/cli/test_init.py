"""init: its file holds every field with its note and default, loads, and overwrites nothing."""

from __future__ import annotations

import re
import tomllib
import typing

import msgspec
import pytest
from looking import tramstream

from tramstream import config, config_file, plugins
from tramstream.cli.init import COMMENTED, CONFIG_NAME, DBC_NAME, EXAMPLE, init, template
from tramstream.errors import ConfigError
from tramstream.live import registry
from tramstream.settings_file import notes_of

SETTING = re.compile(r"^#(?=\[|\w+ = )", re.MULTILINE)
"""A commented-out line of TOML; prose has a blank behind its #."""
TEMPLATE = template()


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


def of_ours() -> dict[str, type[msgspec.Struct]]:
    """Sections of our processors that no vehicle has by itself."""
    found = {name: plugins.load("processors", name) for name in plugins.names("processors")}
    return {
        name: class_.Settings
        for name, class_ in found.items()
        if class_.__module__.startswith("tramstream.")
        and class_.Settings is not None
        and name not in _names(config.Vehicle)
    }


def test_template_names_every_field_with_its_default():
    given = everything()
    assert set(of_ours()) >= {"grade"}
    found = differences(config.Vehicle, {k: given[k] for k in given if k not in of_ours()}, "$")
    for name, settings in of_ours().items():
        found += differences(settings, given[name], f"$.{name}")
    # The example's own choices, which are no defaults; and what a file has by other names.
    example = (
        "$.simulators.ride.link",
        "$.odometer.wheels",
        f"$.{config_file.SECTIONS}",
        "$.calibrated",
    )
    assert [text for text in found if not text.startswith(example)] == []


def structs(struct: type[msgspec.Struct], name: str) -> dict[str, type[msgspec.Struct]]:
    """A struct and all within it, by the path at which the template has them first."""
    found = {name: struct}
    for field in msgspec.structs.fields(struct):
        inner = struct_of(field.type)
        if field.name == "calibrated":  # the loader's own
            continue
        if inner is not None and inner not in found.values():
            path = f"{name}.{field.name}".removeprefix(".")
            key = next(iter(everything_at(path)), "") if is_table(field.type) else ""
            found |= {
                each: type_
                for each, type_ in structs(inner, f"{path}.{key}".removesuffix(".")).items()
                if type_ not in found.values()
            }
    return found


def is_table(type_) -> bool:
    return typing.get_origin(type_) is dict


def everything_at(path: str) -> dict:
    found = everything()
    for part in path.split("."):
        found = found[part]
    return found


STRUCTS = structs(config.Vehicle, "")


@pytest.mark.parametrize("path", STRUCTS)
def test_every_setting_is_explained_once_right_above_its_line(path):
    """A field without a note, here or in a struct that is to come, fails."""
    struct, lines = STRUCTS[path], TEMPLATE.splitlines()
    notes = notes_of(struct)
    heads = [index for index, line in enumerate(lines) if re.match(r"#?\[", line)]
    if path:
        (start,) = (index for index in heads if lines[index].lstrip("#") == f"[{path}]")
        assert lines[start - 1].startswith("# "), f"[{path}] is not explained"
    else:
        start = 0
    end = min((index for index in heads if index > start), default=len(lines))
    for field in msgspec.structs.fields(struct):
        if struct_of(field.type) is not None or field.name == config_file.SECTIONS:
            continue
        assert notes.get(field.name), f"{struct.__name__}.{field.name} has no note below it"
        (at,) = (
            index for index in range(start, end) if re.match(rf"#?{field.name} = ", lines[index])
        )
        note = lines[at - 1 : at]
        while lines[at - len(note) - 1].startswith("# "):
            note = [lines[at - len(note) - 1], *note]
        text = " ".join(line.removeprefix("# ") for line in note)
        assert text.startswith(" ".join(notes[field.name].split()))


def test_template_gives_exactly_the_defaults_and_the_example():
    shown = {name: each for name, each in EXAMPLE.items() if name not in COMMENTED}
    given = tomllib.loads(TEMPLATE)
    assert msgspec.convert(given, config.Vehicle) == msgspec.convert(shown, config.Vehicle)


def test_template_loads_as_it_is_and_with_every_setting_taken_in(tmp_path):
    vehicle = config_file.parse(TEMPLATE.encode(), "t", tmp_path)
    assert vehicle.simulators == {}
    given = SETTING.sub("", TEMPLATE).encode()
    whole = config_file.parse(given, "t", tmp_path)
    assert whole.map is not None
    assert whole.map.network == str(tmp_path / "network.tracks")
    assert set(whole.wheels.each) == {"name"}
    wheels = msgspec.structs.replace(whole.wheels, each={})
    assert set(whole.sections) == set(of_ours())
    plain = msgspec.structs.replace(whole, simulators={}, map=None, wheels=wheels, sections={})
    assert plain == vehicle


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


class Bell(msgspec.Struct, frozen=True):
    """Rings at every stop."""

    pin: int
    """Pin of the relay."""
    pause_s: float = 0.5
    """Between two strokes."""


class Chime:
    """A processor, or a bridge, of another package."""

    Settings = Bell


class Plain:
    """One without settings."""

    Settings = None


@pytest.fixture
def strangers(monkeypatch):
    """A bridge and two processors of another package, installed beside ours."""
    ours, load = plugins.names, plugins.load
    theirs = {"bridges": {"gong": Chime}, "processors": {"chime": Chime, "plain": Plain}}
    monkeypatch.setattr(plugins, "names", lambda group: [*ours(group), *theirs.get(group, {})])
    monkeypatch.setattr(
        plugins, "load", lambda group, name: theirs.get(group, {}).get(name) or load(group, name)
    )


def test_sections_of_other_packages_are_there_and_switch_nothing_on(strangers, tmp_path):
    text = template()
    assert tomllib.loads(text) == tomllib.loads(TEMPLATE)
    added = [line for line in text.splitlines() if line not in TEMPLATE.splitlines()]
    body = [
        "# Rings at every stop.",
        "#[gong]",
        "# Pin of the relay.",
        '#pin = "FILL IN"  # whole number',
        "# Between two strokes.",
        "#pause_s = 0.5",
    ]
    when = ("this section is there", "`processors` above names it")
    assert added == [
        line.replace("gong", name)
        for name, reason in zip(("gong", "chime"), when, strict=True)
        for line in (f"# Of another package; it runs if {reason}.", *body)
    ]
    named = SETTING.sub("", text.replace("#processors = [", '#processors = ["chime", '))
    with pytest.raises(ConfigError, match=r"\$\.chime\.pin: is still to be filled in"):
        config_file.parse(named.replace('pin = "FILL IN"', "pin = 1", 1).encode(), "t", tmp_path)
    filled = named.replace('pin = "FILL IN"', "pin = 7").encode()
    vehicle = config_file.parse(filled, "t", tmp_path)
    theirs = {name: each for name, each in vehicle.sections.items() if name not in of_ours()}
    assert theirs == {name: {"pin": 7, "pause_s": 0.5} for name in ("chime", "gong")}


def test_sections_are_the_settings_that_the_classes_name():
    types = typing.get_type_hints(config.Vehicle)
    for group in ("bridges", "processors"):
        for name in plugins.names(group):
            if name in config.Vehicle.__struct_fields__:
                assert struct_of(types[name]) is plugins.load(group, name).Settings
