"""DBCs as they are found: pages, floats, identifiers and named values that are not in order."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from tramstream.bridges.odometer.dbc import EXTENDED_ID, NAMED_NONE, NO_NUMBER, SHORT, Database
from tramstream.errors import ConfigError

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: ECU\n'


def database(tmp_path: Path, text: str) -> Database:
    path = tmp_path / "x.dbc"
    path.write_text(HEAD + text)
    return Database(str(path), "$.odometer.dbc")


def test_frame_is_as_long_as_its_page_needs(tmp_path: Path) -> None:
    found = database(
        tmp_path,
        "BO_ 770 MUX: 8 ECU\n"
        ' SG_ page M : 0|8@1+ (1,0) [0|0] "" ECU\n'
        ' SG_ A m0 : 8|8@1+ (0.5,0) [0|100] "" ECU\n'
        ' SG_ B m3 : 8|16@1- (0.1,0) [0|0] "" ECU\n',
    )
    a, b = (found.find("MUX", name, "$")[1] for name in "AB")
    assert [a.read(b"\x00\x04"), b.read(b"\x00\x04")] == [2.0, None]
    assert [a.read(b"\x03\x0a\x00"), b.read(b"\x03\x0a\x00")] == [None, 1.0]
    assert [a.read(b"\x00"), b.read(b"\x00")] == [SHORT, None]
    assert [a.read(b"\x03\x0a"), b.read(b"\x03\x0a")] == [None, SHORT]
    assert [a.read(b""), b.read(b"")] == [SHORT, SHORT]
    assert [a.read(b"\x07" * 8), b.read(b"\x07" * 8)] == [None, None]


@pytest.mark.parametrize("multiplexers", [(), ("P", "Q")], ids=["none", "two"])
def test_page_without_its_multiplexer_is_refused(
    tmp_path: Path, multiplexers: tuple[str, ...]
) -> None:
    declared = "".join(
        f' SG_ {name} M : {8 * place}|8@1+ (1,0) [0|0] "" ECU\n'
        for place, name in enumerate(multiplexers)
    )
    found = database(
        tmp_path, f'BO_ 770 MUX: 8 ECU\n{declared} SG_ W m3 : 16|8@1+ (1,0) [0|0] "" ECU\n'
    )
    with pytest.raises(ConfigError, match=r"'W' is on a page of 'MUX'.*with M"):
        found.find("MUX", "W", "$.odometer.wheels.w")


@pytest.mark.parametrize("length", [8, 12, 24, 40, 63])
def test_number_of_ieee_754_of_a_length_that_does_not_exist_is_refused(
    tmp_path: Path, length: int
) -> None:
    found = database(
        tmp_path,
        f'BO_ 1 M: 8 ECU\n SG_ W : 0|{length}@1- (1,0) [0|0] "" ECU\n\nSIG_VALTYPE_ 1 W : 1;\n',
    )
    with pytest.raises(ConfigError, match=rf"IEEE 754 with {length} bits"):
        found.find("M", "W", "$.odometer.wheels.w")


def test_numbers_of_ieee_754_are_read_and_those_that_are_none_told(tmp_path: Path) -> None:
    found = database(
        tmp_path,
        'BO_ 1 M: 8 ECU\n SG_ W : 0|64@1- (1,0) [0|0] "" ECU\n'
        ' SG_ H : 0|16@1- (1,0) [0|0] "" ECU\n\n'
        "SIG_VALTYPE_ 1 W : 2;\nSIG_VALTYPE_ 1 H : 1;\n",
    )
    double, half = (found.find("M", name, "$")[1] for name in "WH")
    assert double.read(struct.pack("<d", 3.25)) == 3.25
    assert half.read(struct.pack("<e", 1.5)) == 1.5
    assert double.read(struct.pack("<d", float("inf"))) == NO_NUMBER
    assert half.read(struct.pack("<e", float("nan"))) == NO_NUMBER


def test_identifier_of_29_bits_without_its_mark_is_one_all_the_same(tmp_path: Path) -> None:
    id_ = 0x18FF5521
    found = database(
        tmp_path,
        f"BO_ {id_} M: 8 ECU\n"
        ' SG_ P M : 0|8@1+ (1,0) [0|0] "" ECU\n SG_ W m2 : 8|32@1- (1,0) [0|0] "" ECU\n\n'
        f'CM_ SG_ {id_} W "of BO_ 5000";\nSIG_VALTYPE_ {id_} W : 1;\n'
        f'VAL_ {id_} P 2 "second" ;\nSG_MUL_VAL_ {id_} W P 2-2;\n',
    )
    key, field = found.find("M", "W", "$")
    assert key == id_ | EXTENDED_ID
    assert field.read(b"\x02" + struct.pack("<f", 2.5)) == 2.5
    assert field.read(b"\x01" + struct.pack("<f", 2.5)) is None


@pytest.mark.parametrize(
    "name",
    ["SNA", "sna", "Not_Available", "not available", "Invalid", "N/A", "Error", "Speed_SNA",
     "Error_Indicator", "Undefined", "unavailable"],
)  # fmt: skip
def test_value_that_the_dbc_names_as_none_is_none(tmp_path: Path, name: str) -> None:
    found = database(
        tmp_path,
        'BO_ 1 M: 8 ECU\n SG_ W : 0|16@1+ (0.1,0) [0|0] "km/h" ECU\n\n'
        f'VAL_ 1 W 65535 "{name}" 0 "Standing" ;\n',
    )
    _, field = found.find("M", "W", "$")
    assert field.read(b"\xff\xff") == NAMED_NONE
    assert [field.read(b"\0\0"), field.read(b"\x0a\0")] == [0.0, 1.0]


def test_value_with_a_name_is_a_value(tmp_path: Path) -> None:
    names = ("Open", "Standing", "Snap", "Terror", "Signal")
    values = " ".join(f'{value} "{name}"' for value, name in enumerate(names))
    found = database(
        tmp_path,
        f'BO_ 1 M: 8 ECU\n SG_ W : 0|8@1+ (1,0) [0|0] "" ECU\n\nVAL_ 1 W {values} ;\n',
    )
    _, field = found.find("M", "W", "$")
    assert [field.read(bytes((value,))) for value in range(5)] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("place", ["-1|8", "8|-8", "-90|4"])
def test_signal_outside_of_all_frames_is_refused(tmp_path: Path, place: str) -> None:
    text = f'BO_ 1 M: 8 ECU\n SG_ W : {place}@1+ (1,0) [0|0] "" ECU\n'
    with pytest.raises(ConfigError, match="signal W begins before its frame"):
        database(tmp_path, text)


@pytest.mark.parametrize("size", [300, 308, 400])
@pytest.mark.parametrize("what", ["scale", "offset"])
def test_scale_or_offset_beyond_all_numbers_gives_none(
    tmp_path: Path, what: str, size: int
) -> None:
    """As digits without end, which a DBC may have and a float may not."""
    digits = "9" * size
    pair = f"({digits},0.5)" if what == "scale" else f"(0.5,{digits})"
    found = database(tmp_path, f'BO_ 1 M: 8 ECU\n SG_ W : 0|8@1+ {pair} [0|0] "" ECU\n')
    field = found.find("M", "W", "$")[1]
    assert [field.read(b"\x07"), field.read(b"\x00")] == [NO_NUMBER, NO_NUMBER]


def test_signal_that_is_longer_than_a_number_is_none(tmp_path: Path) -> None:
    """As a vehicle's identification number, which is a text; and one of thousands of bits."""
    found = database(tmp_path, 'BO_ 1 M: 1785 ECU\n SG_ W : 0|4000@1+ (0.1,0) [0|0] "" ECU\n')
    field = found.find("M", "W", "$")[1]
    assert [field.read(b"\xff" * 500), field.read_counter(b"\xff" * 500)] == [NO_NUMBER, NO_NUMBER]
