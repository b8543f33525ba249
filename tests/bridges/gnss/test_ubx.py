"""UBX decoding against pyubx2, encoding against decoding."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyubx2 import UBXReader

from tramstream.bridges.gnss import ubx, ubx_layouts
from tramstream.bridges.gnss.framer import UBX, Frame, Framer, Rejected, ubx_frame
from tramstream.bridges.gnss.ubx_layouts import LAYOUTS, Layout

PYUBX2_NAMES = {"sec": "second", "bitfield0": "flags", "sTtag": "sTag",
                "refStationId": "refStationID"}  # fmt: skip
"""Our names are the manual's; pyubx2 has another in some messages."""
UNLIKE_PYUBX2 = {
    "NAV-PL plPosHorizOrient": "it leaves the manual's scale of 1e-2 out",
    "NAV-PL plVelHorizOrient": "likewise",
}
RELATIVE = 1e-9
"""pyubx2 rounds scaled values to 12 digits."""


def frame_of(raw: bytes) -> Frame:
    return Frame(UBX, raw[2] << 8 | raw[3], raw, len(raw) - 1)


def random_message(layout: Layout, rng: np.random.Generator, groups: int) -> bytes:
    payload = bytearray(rng.bytes(layout.fixed.size))
    if layout.count:
        payload[layout.limit.count_at] = groups
    if layout.name == "ESF-MEAS":
        struct.pack_into("<H", payload, 4, groups << 11)
    if layout.version >= 0:
        payload[0] = layout.version
    return ubx_frame(layout.kind, bytes(payload) + rng.bytes(layout.repeated.size * groups))


def assert_same(ours: Any, theirs: Any, what: str) -> None:
    if isinstance(ours, float):
        # equal_nan: random bytes make NaN
        np.testing.assert_allclose(ours, theirs, rtol=RELATIVE, atol=1e-12, err_msg=what)
        return
    if isinstance(theirs, list):
        theirs = bytes(theirs)
    if isinstance(theirs, bytes) and not isinstance(ours, bytes):
        theirs = int.from_bytes(theirs, "little")
    assert ours == theirs, what


def compare(raw: bytes) -> int:
    """Compare all fields that pyubx2 has under their name; how many there were."""
    message = ubx.decode(frame_of(raw))
    assert not isinstance(message, Rejected)
    theirs = vars(UBXReader.parse(raw, parsebitfield=0))
    compared = 0
    values = dict(message.fields)
    for index, row in enumerate(message.rows(), 1):
        values |= {f"{name}_{index:02d}": value for name, value in row.items()}
    for name in ("lat", "lon", "height", "hMSL"):  # pyubx2 adds the high precision part itself
        if f"{name}Hp" in values:
            values[name] += values.pop(f"{name}Hp")
    for axis in ("N", "E", "D", "Length"):  # likewise, in cm
        if f"relPosHP{axis}" in values:
            values[f"relPos{axis}"] += values.pop(f"relPosHP{axis}") / 10.0
    for name, value in values.items():
        base, _, index = name.partition("_")
        other = PYUBX2_NAMES.get(base, base)
        candidates = [f"{n}_{index}" if index else n for n in (base, other)]
        key = next((c for c in candidates if c in theirs), None)
        if key is None or base.startswith("reserved"):
            continue
        compared += 1
        if f"{message.name} {base}" in UNLIKE_PYUBX2:
            continue
        assert_same(value, theirs[key], f"{message.name} {name}")
    return compared


KNOWN_TO_PYUBX2 = [layout for layout in LAYOUTS if layout.title != "MON-HW u-blox 5"]


@pytest.mark.parametrize("layout", KNOWN_TO_PYUBX2, ids=lambda layout: layout.title)
def test_random_payloads_decode_as_pyubx2_does(layout: Layout) -> None:
    rng = np.random.default_rng(layout.kind)
    named = [f for f in layout.fields if not f.name.startswith("reserved")]
    for groups in (0, 1, 5) if layout.group else (0,):
        compared = compare(random_message(layout, rng, groups))
        # TIM-TP refInfo, RXM-RAWX version, NAV-PL's reasons, the high precision parts have no
        # counterpart there
        without = {"NAV-HPPOSLLH": 4, "NAV-RELPOSNED": 4, "NAV-PL": 3}.get(layout.name, 1)
        assert compared >= len(named) - without


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.title)
def test_what_was_decoded_encodes_to_the_same_bytes(layout: Layout) -> None:
    rng = np.random.default_rng(layout.kind)
    for groups in (0, 1, 7) if layout.group else (0,):
        raw = random_message(layout, rng, groups)
        message = ubx.decode(frame_of(raw))
        assert not isinstance(message, Rejected)
        assert (message.name, message.form) == (layout.name, layout.form)
        assert ubx.encode(layout.title, message.fields, message.records) == raw
        assert ubx.encode(layout.title, message.fields, message.rows()) == raw


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.title)
def test_every_wrong_length_is_refused_and_never_raises(layout: Layout) -> None:
    """Wrong is what no form of the message has."""
    right = ubx.encode(layout.title)[6:-2]
    forms = {form.fixed.size for form in LAYOUTS if form.name == layout.name}
    sizes = [n for n in range(len(right) + 40) if n not in forms]
    for size in sizes:
        raw = ubx_frame(layout.kind, (right + bytes(40))[:size])
        message = ubx.decode(frame_of(raw))
        steps = layout.repeated.size
        free = steps and not layout.count and size > len(right)
        if not (free and (size - len(right)) % steps == 0):
            assert isinstance(message, Rejected)
            assert message.reason.startswith(layout.name)


def test_encode_with_no_fields_is_all_zero() -> None:
    assert ubx.encode("NAV-EOE") == ubx_frame(0x0161, bytes(4))


def test_nano_may_be_negative() -> None:
    message = ubx.decode(frame_of(ubx.encode("NAV-PVT", {"nano": -422_154})))
    assert not isinstance(message, Rejected)
    assert message.fields["nano"] == -422_154


def test_scaled_value_is_the_decimal_fraction_that_was_sent() -> None:
    message = ubx.decode(frame_of(ubx.encode("NAV-PVT", {"lat": 50.0870001, "lon": -14.4212349})))
    assert not isinstance(message, Rejected)
    assert (message.fields["lat"], message.fields["lon"]) == (50.0870001, -14.4212349)


def test_what_does_not_fit_is_an_error_that_names_the_message() -> None:
    with pytest.raises(ValueError, match="NAV-PVT has no field latitude"):
        ubx.encode("NAV-PVT", {"latitude": 1})
    with pytest.raises(ValueError, match="NAV-PVT"):
        ubx.encode("NAV-PVT", {"fixType": 256})
    with pytest.raises(ValueError, match="NAV-NOTHING"):
        ubx.encode("NAV-NOTHING")


def test_unknown_types_have_names_or_numbers() -> None:
    assert ubx_layouts.name_of(0x0107) == "NAV-PVT"
    assert ubx_layouts.name_of(0x0122) == "NAV-CLOCK"
    assert ubx_layouts.name_of(0x7F01) == "7F-01"
    unknown = ubx.decode(frame_of(ubx_frame(0x7F01, b"1")))
    assert unknown == Rejected("UBX without a decoder", 0, 9)


@pytest.mark.realdata
def test_captures_decode_as_pyubx2_does_and_encode_back(data_dir: Path) -> None:
    compared: dict[str, int] = {}
    for path in sorted((data_dir / "ubx").glob("*")):
        if path.suffix not in (".log", ".ubx"):
            continue
        framer = Framer()
        for item in framer.feed(path.read_bytes())[:6000]:
            if not isinstance(item, Frame) or not ubx.knows(item.kind) or not item.payload:
                continue
            message = ubx.decode(item)
            assert not isinstance(message, Rejected)
            assert ubx.encode(message.name, message.fields, message.records) == item.raw
            if compared.get(item.name, 0) < 60:  # pyubx2 needs 3 ms for a RAWX
                compare(item.raw)
                compared[item.name] = compared.get(item.name, 0) + 1
    assert len(compared) >= 18  # of the types with a table, those that the captures hold
