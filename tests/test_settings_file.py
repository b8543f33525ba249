"""Settings as commented TOML: what a struct says of its fields, for ours and for strangers'."""

from __future__ import annotations

import enum
import re
import tomllib
from typing import Annotated, Any, Literal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta

from tramstream import config
from tramstream.errors import ConfigError
from tramstream.settings_file import Setting, notes_of, scalars, section, settings_of
from tramstream.strict_toml import FILL_IN, decode_toml

SETTING = re.compile(r"^#(?=\[|[\w\"'-]+ = )", re.MULTILINE)
"""A commented-out line of TOML; prose has a blank behind its #."""


class Colour(enum.Enum):
    RED = "red"
    GREEN = "green"


class Lamp(msgspec.Struct, frozen=True, kw_only=True):
    """A lamp."""

    watts: Annotated[float, Meta(gt=0)] = 5.0
    """Power of the lamp."""
    colour: Colour = Colour.GREEN
    """Its colour."""


class Serial(msgspec.Struct, frozen=True, kw_only=True, tag="serial"):
    """A serial line."""

    port: str = "/dev/ttyS0"
    """The line."""


class Network(msgspec.Struct, frozen=True, kw_only=True, tag="network"):
    """A host on the network."""

    host: str = "localhost"
    """The host."""


class Base(msgspec.Struct, frozen=True, kw_only=True):
    """What all stages of that house have."""

    enabled: bool = True
    """Whether it does anything."""
    gain: float = 1.0
    """This is explained again below."""


class Doorbell(Base, frozen=True, kw_only=True, rename="kebab"):
    """Rings when somebody stands before the door.

    Of another house, with habits of its own.
    """

    pin: int
    """Pin of the button."""
    melody: str
    """What it plays. `a piece of code that must stay on one line, even when it is as long as this`
    is, and more."""
    gain: float = 2.0
    """Loudness, 1 being that of the manual."""
    hold_s: Annotated[float, Meta(ge=0, le=60)] = 0.5
    """How long the button must be held."""
    mode: Literal["loud", "soft", 3] = "soft"
    """How it rings."""
    limit_m: float | None = None
    """Farthest visitor that is heard; no limit if it is not given."""
    offsets: tuple[float, float, float] = (0.0, 0.5, 1.0)
    """Three places."""
    names: list[str] = msgspec.field(default_factory=lambda: ["Ada", 'the "other"'])
    """Who rings."""
    codes: dict[str, int] = msgspec.field(default_factory=lambda: {"a b": 1})
    """Codes by name."""
    lamp: Lamp = Lamp(watts=7.0)
    """The lamp in the button."""
    spare: Lamp | None = None
    """Another lamp; there need not be one."""
    rooms: dict[str, Lamp] = msgspec.field(default_factory=dict)
    """One for each room."""
    chain: list[Lamp] = msgspec.field(default_factory=list)
    """Lamps in a row."""
    link: Serial | Network = Network()
    """How the button is heard."""
    undocumented: int = 5


def by_name(settings: type[msgspec.Struct]) -> dict[str, Setting]:
    return {each.name: each for each in settings_of(settings)}


def decoded(text: str, settings: type[msgspec.Struct]) -> Any:
    """The section `s` of a text."""
    return msgspec.convert(tomllib.loads(text)["s"], settings)


# What a struct says ------------------------------------------------------------------------------


def test_note_is_the_text_below_the_field_and_that_of_the_class_itself_comes_first() -> None:
    notes = notes_of(Doorbell)
    assert notes["pin"] == "Pin of the button."
    assert notes["enabled"] == "Whether it does anything."
    assert notes["gain"] == "Loudness, 1 being that of the manual."
    assert "undocumented" not in notes
    assert by_name(Doorbell)["hold-s"].note == notes["hold_s"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("pin", "whole number"),
        ("melody", "text"),
        ("hold-s", "number, 0 to 60"),
        ("mode", '3, "loud" or "soft"'),
        ("limit-m", "number"),
        ("offsets", "3 numbers"),
        ("names", "list of texts"),
        ("codes", "table of whole numbers"),
        ("enabled", "true or false"),
    ],
)
def test_type_of_a_field_is_told_in_words(name: str, words: str) -> None:
    assert by_name(Doorbell)[name].words == words


def test_bounds_and_choices_are_told() -> None:
    class Bounded(msgspec.Struct):
        above: Annotated[float, Meta(gt=0, le=0.5)] = 0.1
        below: Annotated[int, Meta(lt=8)] = 1
        finite: Annotated[float, Meta(ge=-1e9, le=1e9)] = 0.0
        code: Annotated[str, Meta(pattern="^[a-z]+$")] = "a"
        axes: tuple[Annotated[float, Meta(ge=0)], Annotated[float, Meta(ge=0)]] = (0.0, 0.0)

    assert {each.name: each.words for each in settings_of(Bounded)} == {
        "above": "number, above 0, 0.5 at most",
        "below": "whole number, below 8",
        "finite": "number",
        "code": "text",
        "axes": "2 numbers, each 0 or more",
    }
    assert by_name(Lamp)["colour"].words == '"red" or "green"'


def test_struct_without_source_is_written_without_notes() -> None:
    made = msgspec.defstruct("Made", [("rate_hz", float, 2.5)])
    assert section("s", made) == "[s]\n#rate_hz = 2.5\n"


def test_struct_within_a_function_with_text_at_the_margin_has_its_notes() -> None:
    class Local(msgspec.Struct):
        one: int = 1
        """First
line."""
        two: int = 2
        """Second."""

    assert set(notes_of(Local)) == {"one", "two"}


# What is written ---------------------------------------------------------------------------------


def test_section_of_a_stranger_has_each_setting_once_with_its_note_above() -> None:
    lines = section("doorbell", Doorbell).splitlines()
    assert lines[:3] == [
        "# Rings when somebody stands before the door.",
        "#",
        "# Of another house, with habits of its own.",
    ]
    assert lines[3] == "[doorbell]"
    at = lines.index("#hold-s = 0.5  # 0 to 60")
    assert lines[at - 1] == "# How long the button must be held."
    for name in ("pin", "melody", "gain", "limit-m", "undocumented"):
        assert len([line for line in lines if re.match(rf"#?{name} = ", line)]) == 1


def test_lines_are_as_wide_as_the_file_and_code_in_a_note_is_not_broken() -> None:
    lines = section("doorbell", Doorbell).splitlines()
    code = [line for line in lines if "`" in line]
    assert [line.count("`") for line in code] == [2]
    assert max(len(line) for line in lines if line not in code) <= 100


def test_required_settings_are_to_be_filled_in_and_the_loader_says_which() -> None:
    class Whole(msgspec.Struct):
        s: Doorbell

    text = section("s", Doorbell)
    assert f'\npin = "{FILL_IN}"  # whole number\n' in text
    with pytest.raises(ConfigError, match=r"^f: \$\.s\.pin: is still to be filled in") as caught:
        decode_toml(text.encode(), Whole, "f")
    assert len(str(caught.value).splitlines()) == 1
    filled = text.replace(f'pin = "{FILL_IN}"', "pin = 7")
    with pytest.raises(ConfigError, match=r"\$\.s\.melody: is still"):
        decode_toml(filled.encode(), Whole, "f")


def test_section_gives_the_defaults_and_so_does_every_line_uncommented() -> None:
    values = {"pin": 7, "melody": "gong"}
    bell = Doorbell(pin=7, melody="gong")
    text = section("s", Doorbell, values)
    assert decoded(text, Doorbell) == bell
    every = decoded(section("s", Doorbell, values | {"limit-m": 3.0}), Doorbell)
    whole = SETTING.sub("", section("s", Doorbell, values | {"limit-m": 3.0}))
    assert every.limit_m == 3.0
    assert decoded(whole, Doorbell) == msgspec.structs.replace(
        every, spare=Lamp(), rooms={"name": Lamp()}, chain=[Lamp()]
    )


def test_values_are_written_in_place_of_defaults_at_every_depth() -> None:
    values = {
        "pin": 1,
        "melody": "",
        "gain": 2.0,
        "spare": {"watts": 1.5},
        "rooms": {"hall": {"colour": "red"}, "living room": {}},
        "chain": [{"watts": 1.0}, {"watts": 2.0}],
    }
    text = section("s", Doorbell, values)
    bell = decoded(text, Doorbell)
    assert bell == msgspec.convert(values, Doorbell)
    assert '\n[s.rooms."living room"]\n' in text
    assert "\n#gain = 2.0\n" in text, "a value that is the default is commented out"


def test_commented_section_is_nothing_to_toml_until_it_is_uncommented() -> None:
    values = {"pin": 1, "melody": "x"}
    text = section("s", Doorbell, values, commented=True)
    assert tomllib.loads(text) == {}
    assert tomllib.loads(SETTING.sub("", text))["s"]["pin"] == 1


def test_struct_that_comes_again_is_not_explained_again() -> None:
    text = section("s", Doorbell, {"pin": 1, "melody": "", "chain": [{}, {}]})
    assert text.count("# Power of the lamp.") == 1
    assert text.count("watts = ") == 5


def test_scalars_are_the_fields_that_are_no_sections() -> None:
    text = scalars(config.Odometer, {"channel": "c", "dbc": "d"}, without=["bitrate"])
    written = tomllib.loads(SETTING.sub("", text))
    assert written == {"interface": "socketcan", "channel": "c", "dbc": "d", "silence_s": 2.0}


plain = st.recursive(
    st.booleans()
    | st.integers(-(2**62), 2**62)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)


class Anything(msgspec.Struct):
    value: Any = None


@given(plain)
def test_any_plain_value_is_read_back_by_pythons_own_toml_reader(value: Any) -> None:
    assert tomllib.loads(section("s", Anything, {"value": value})) == {"s": {"value": value}}


def test_numbers_are_written_as_people_read_them() -> None:
    written = [
        section("s", Anything, {"value": each}).splitlines()[1]
        for each in (7.563e-05, 2.0, 460800, 1_000_000_000, 1e16, -0.5)
    ]
    assert written == [
        "value = 0.00007563  # any",
        "value = 2.0  # any",
        "value = 460800  # any",
        "value = 1_000_000_000  # any",
        "value = 10000000000000000.0  # any",
        "value = -0.5  # any",
    ]
