"""What a value may be is named where another one is refused."""

from __future__ import annotations

import enum
from typing import Annotated, Literal

import msgspec
import pytest
from msgspec import Meta

from tramstream.errors import ConfigError
from tramstream.strict_toml import decode_toml


class Colour(enum.Enum):
    RED = "red"
    GREEN = "green"


class Lamp(msgspec.Struct, frozen=True, kw_only=True):
    watts: Annotated[float, Meta(gt=0, le=100)] = 5.0
    count: Annotated[int, Meta(ge=1)] = 1
    dim: Annotated[float, Meta(ge=0, lt=1)] | None = None
    colour: Colour = Colour.RED
    cap: Literal["E14", "E27"] = "E14"
    place_m: tuple[Annotated[float, Meta(ge=-1, le=1)], float] = (0.0, 0.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("watts = 0", "$.watts: 0 is out of range; it must be > 0 and <= 100"),
        ("watts = 1e308", "$.watts: 1e+308 is out of range; it must be > 0 and <= 100"),
        ("count = 0", "$.count: 0 is out of range; it must be >= 1"),
        ("dim = 1.0", "$.dim: 1.0 is out of range; it must be >= 0 and < 1"),
        ("colour = 'blue'", "$.colour: 'blue' is none of the choices; there are: red, green"),
        ("cap = 'E40'", "$.cap: 'E40' is none of the choices"),
        ("place_m = [2, 0]", "$.place_m[0]: 2 is out of range; it must be >= -1"),
        ("watts = nan", "$.watts: nan is not a finite number"),
    ],
)
def test_refusal_names_what_is_allowed(text: str, says: str) -> None:
    with pytest.raises(ConfigError) as refused:
        decode_toml(text.encode(), Lamp, "f.toml")
    assert str(refused.value).startswith(f"f.toml: {says}")


def test_edges_of_ranges_are_in_them() -> None:
    text = "watts = 100\ncount = 1\ndim = 0\ncolour = 'green'\nplace_m = [-1, 5]"
    lamp = decode_toml(text.encode(), Lamp, "f")
    assert (lamp.watts, lamp.count, lamp.dim, lamp.colour) == (100, 1, 0, Colour.GREEN)
