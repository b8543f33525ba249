"""J1939: who sends what, and values that are none; by the tables of SAE J1939-71."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tramstream import keys
from tramstream.bridges.odometer.bridge import NOTE_SENDER, OdometerBridge
from tramstream.bridges.odometer.frames import EXTENDED, CanFrame, pack
from tramstream.bridges.odometer.j1939 import (
    IN_ERROR,
    NOT_AVAILABLE,
    RESERVED,
    address_of,
    ends_like_a_parameter,
    why_no_value,
)
from tramstream.config import Odometer, Signal, Vehicle, Wheel
from tramstream.events.messages import facts_of
from tramstream.processor import Sample
from tramstream.proto.raw_pb2 import Odometry

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: ECU\n'
SPEED = ' SG_ Speed : 8|16@1+ (0.00390625,0) [0|250.996] "km/h" ECU\n'
DOORS = ' SG_ Doors : 0|2@1+ (1,0) [0|3] "" ECU\n'
J1939 = (
    'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n'
)
KMH = 1 / 3.6


def dbc(path: Path, source: int, *, marked: bool = False, more: str = "") -> str:
    """CCVS1 (PGN 65265) of a source address."""
    id_ = 0x80000000 | 0x18FEF100 | source
    text = f"{HEAD}BO_ {id_} CCVS1: 8 ECU\n{SPEED}{DOORS}{more}\n"
    if marked:
        text += f'{J1939}BA_ "VFrameFormat" BO_ {id_} 3;\n'
    path.write_text(text)
    return str(path)


def bridge(path: str, **changes: Any) -> OdometerBridge:
    wheel = Wheel(message="CCVS1", signal="Speed", kind="speed", scale=KMH)
    odometer = Odometer(channel="can0", dbc=path, wheels={"v": wheel}, **changes)
    return OdometerBridge(Vehicle(vehicle="t", odometer=odometer))


def frame(ms: int, id_: int, raw: int, doors: int = 0) -> CanFrame:
    data = bytes((0xFC | doors,)) + raw.to_bytes(2, "little") + b"\xff" * 5
    return CanFrame(10**18 + ms * 1_000_000, "can0", id_, EXTENDED, data)


def run(node: OdometerBridge, frames: list[CanFrame]) -> tuple[list[Odometry], list[Any]]:
    message = pack(frames, "can0")
    out = node.step(Sample(keys.ODO_FRAMES, message, message.stamp_ns, 1))
    assert all(ledger.balanced for ledger in node.ledgers())
    readings = [each.message for each in out if each.key is keys.ODO_WHEELS]
    return readings, [each.message for each in out if each.key == keys.EVENT.at("odometer")]


def speeds(readings: list[Odometry]) -> list[float]:
    return [reading.wheels[0].speed_mps * 3.6 for reading in readings]


@pytest.mark.parametrize(
    ("id_", "group", "source"),
    [
        (0x18FEF100, 65265, 0x00),
        (0x0CF00427, 61444, 0x27),  # EEC1
        (0x18EAFF0B, 0xEA00, 0x0B),  # a request, to everybody: PDU1, the destination is no part
        (0x19FEF1FE, 0x1FEF1, 0xFE),  # data page
    ],
)
def test_identifier_has_group_and_source(id_: int, group: int, source: int) -> None:
    assert address_of(id_) == (group, source)


@pytest.mark.parametrize(
    ("bits", "length", "reason"),
    [
        (0xFA, 8, ""),
        (0xFB, 8, RESERVED),
        (0xFE, 8, IN_ERROR),
        (0xFF, 8, NOT_AVAILABLE),
        (0xFAFF, 16, ""),
        (0xFB00, 16, RESERVED),
        (0xFE00, 16, IN_ERROR),
        (0xFE37, 16, IN_ERROR),
        (0xFF00, 16, NOT_AVAILABLE),
        (0xFFFF, 16, NOT_AVAILABLE),
        (0xFAFFFFFF, 32, ""),
        (0xFEFFFFFF, 32, IN_ERROR),
        (0xFFFFFFFF, 32, NOT_AVAILABLE),
        (0b01, 2, ""),
        (0b10, 2, IN_ERROR),
        (0b11, 2, NOT_AVAILABLE),
        (0xE, 4, IN_ERROR),
        (0xF, 4, NOT_AVAILABLE),
        (1, 1, ""),
    ],
)
def test_values_that_are_none_are_those_of_the_standard(
    bits: int, length: int, reason: str
) -> None:
    assert why_no_value(bits, length) == reason


@pytest.mark.parametrize("priority", [0x18, 0x0C])
@pytest.mark.parametrize("source", [0x00, 0x0B, 0x31])
def test_dbc_that_names_nobody_takes_whoever_sends(
    tmp_path: Path, source: int, priority: int
) -> None:
    node = bridge(dbc(tmp_path / "a.dbc", 0xFE))
    id_ = priority << 24 | 0xFEF100 | source
    readings, events = run(node, [frame(k * 100, id_, 256 * k) for k in range(20)])
    assert speeds(readings) == pytest.approx(list(range(20)))
    assert events == []


def test_second_sender_of_a_group_is_not_mixed_in_until_the_first_is_silent(tmp_path: Path) -> None:
    node = bridge(dbc(tmp_path / "a.dbc", 0xFE), silence_s=1.0)
    both = [frame(k, 0x18FEF100 | (0x0B if k % 2 else 0), 256 * (k % 2)) for k in range(20)]
    readings, events = run(node, both)
    assert speeds(readings) == [0.0] * 10
    assert node.device_counters()["rejected_by_reason"] == {NOTE_SENDER: 10}
    (event,) = events
    assert facts_of(event) == {"message": "CCVS1", "heard": "0B", "wanted": "00"}
    later = [frame(2000 + k, 0x18FEF10B, 512) for k in range(3)]
    assert speeds(run(node, later)[0]) == pytest.approx([2.0] * 3)


def test_sender_that_the_dbc_names_is_the_only_one(tmp_path: Path) -> None:
    node = bridge(dbc(tmp_path / "a.dbc", 0x0B, marked=True))
    readings, events = run(
        node, [frame(0, 0x18FEF100, 256), frame(1, 0x0CFEF10B, 512), frame(2, 0x18FEF127, 0)]
    )
    assert speeds(readings) == pytest.approx([2.0])
    assert node.device_counters()["rejected_by_reason"] == {NOTE_SENDER: 2}
    assert [facts_of(each)["heard"] for each in events] == ["00", "27"]


def test_frames_that_another_message_of_the_dbc_names_are_not_taken_for_anybodys(
    tmp_path: Path,
) -> None:
    more = f'\nBO_ {0x98FEF121} OTHER: 8 ECU\n SG_ X : 0|8@1+ (1,0) [0|0] "" ECU\n'
    node = bridge(dbc(tmp_path / "a.dbc", 0xFE, more=more))
    readings, _ = run(node, [frame(0, 0x18FEF121, 256), frame(1, 0x18FEF100, 512)])
    assert speeds(readings) == pytest.approx([2.0])


@pytest.mark.parametrize("raw", [0xFFFF, 0xFF00, 0xFEFF, 0xFE00, 0xFC80])
def test_values_that_are_none_are_not_published_and_counted(tmp_path: Path, raw: int) -> None:
    node = bridge(dbc(tmp_path / "a.dbc", 0xFE))
    raws = [256, raw, raw, 512]
    readings, _ = run(node, [frame(k, 0x18FEF100, each) for k, each in enumerate(raws)])
    assert speeds(readings) == pytest.approx([1.0, 2.0])
    counters = node.device_counters()
    assert counters["frames_rejected"] == 2
    assert sum(counters["rejected_by_reason"].values()) == 2


def test_doors_that_are_not_available_are_not_known_and_the_wheel_is_read(tmp_path: Path) -> None:
    node = bridge(dbc(tmp_path / "a.dbc", 0xFE), doors_open=Signal(message="CCVS1", signal="Doors"))
    doors = [1, 3, 2, 0]
    readings, _ = run(node, [frame(k, 0x18FEF100, 256, each) for k, each in enumerate(doors)])
    assert [reading.HasField("doors_open") for reading in readings] == [True, False, False, True]
    assert [reading.doors_open for reading in readings] == [True, False, False, False]
    counters = node.device_counters()
    assert counters["frames_rejected"] == 0
    assert counters["rejected_by_reason"] == {NOT_AVAILABLE: 1, IN_ERROR: 1}


def test_range_of_a_signal_tells_j1939_where_nothing_else_does(tmp_path: Path) -> None:
    """250.996 km/h is FAFF, the last value; so FE… and FF… behind it are none."""
    node = bridge(dbc(tmp_path / "a.dbc", 0x00))
    readings, _ = run(node, [frame(0, 0x18FEF100, 256), frame(1, 0x18FEF100, 0xFFFF)])
    assert speeds(readings) == pytest.approx([1.0])
    assert node.device_counters()["rejected_by_reason"] == {NOT_AVAILABLE: 1}


@pytest.mark.parametrize(
    ("largest", "scale", "offset", "length", "is_one"),
    [
        (250.996, 1 / 256, 0, 16, True),
        (8031.875, 0.125, 0, 16, True),  # engine speed
        (125, 1, -125, 8, True),  # torque
        (210, 1, -40, 8, True),  # temperature
        (21055406, 0.005, 0, 32, True),  # distance
        (255, 1, 0, 8, False),
        (6553.5, 0.1, 0, 16, False),
        (250, 1, 0, 16, False),
        (0, 1, 0, 16, False),
        (None, 1, 0, 16, False),
    ],
)
def test_last_value_of_a_parameter_is_known(
    largest: float | None, scale: float, offset: float, length: int, is_one: bool
) -> None:
    assert ends_like_a_parameter(largest, scale, offset, length) is is_one


def test_same_bits_outside_of_j1939_are_values(tmp_path: Path) -> None:
    path = tmp_path / "a.dbc"
    speed = SPEED.replace("250.996", "256")
    path.write_text(f"{HEAD}BO_ {0x80000000 | 0x18FEF100} CCVS1: 8 ECU\n{speed}{DOORS}\n")
    readings, _ = run(bridge(str(path)), [frame(0, 0x18FEF100, 0xFFFF)])
    assert speeds(readings) == pytest.approx([0xFFFF / 256])
