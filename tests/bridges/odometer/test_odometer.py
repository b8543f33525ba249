"""The odometry bridge: cantools and a real bus as authority, wraps, dirt, memory."""

from __future__ import annotations

import csv
import pickle
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

import cantools
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tramstream import keys
from tramstream.bridges.odometer import candump
from tramstream.bridges.odometer.bridge import (
    NOTE_LATE,
    REJECT_NAN,
    REJECT_REMOTE,
    REJECT_SHORT,
    OdometerBridge,
)
from tramstream.bridges.odometer.dbc import EXTENDED_ID, Database
from tramstream.bridges.odometer.frames import (
    ERROR,
    EXTENDED,
    FD,
    REMOTE,
    CanFrame,
    host_overflow,
    pack,
)
from tramstream.config import Odometer, Signal, Vehicle, Wheel
from tramstream.errors import ConfigError
from tramstream.events.messages import facts_of
from tramstream.processor import Sample
from tramstream.proto.raw_pb2 import Odometry

DBC = """VERSION ""

NS_ :

BS_:

BU_: XXX

BO_ 256 LEFT: 8 XXX
 SG_ LEFT_PULSES : 0|16@1- (1,0) [0|0] "" XXX
 SG_ LEFT_COUNTER : 16|12@1+ (1,0) [0|0] "" XXX
 SG_ LEFT_HALVES : 32|16@1- (0.5,0) [0|0] "" XXX

BO_ 257 RIGHT: 8 XXX
 SG_ RIGHT_PULSES : 7|16@0- (1,0) [0|0] "" XXX
 SG_ RIGHT_COUNTER : 23|16@0+ (1,0) [0|0] "" XXX
 SG_ RIGHT_SPEED : 39|15@0- (0.01,-67.67) [0|0] "km/h" XXX

BO_ 2566844926 WIDE: 8 XXX
 SG_ DOORS : 3|2@1+ (1,0) [0|0] "" XXX
 SG_ FORCE : 8|32@1- (1,0) [0|0] "N" XXX
 SG_ ACROSS : 45|11@0- (0.125,3) [0|0] "" XXX

BO_ 300 PACKED: 8 XXX
 SG_ PAGE M : 0|3@1+ (1,0) [0|0] "" XXX
 SG_ SPEED_A m1 : 8|16@1+ (0.1,0) [0|0] "" XXX
 SG_ SPEED_B m2 : 8|16@1- (0.2,1) [0|0] "" XXX
 SG_ ALWAYS : 63|8@0+ (1,0) [0|0] "" XXX

SIG_VALTYPE_ 2566844926 FORCE : 1;
"""


@pytest.fixture
def dbc(tmp_path: Path) -> str:
    path = tmp_path / "tram.dbc"
    path.write_text(DBC)
    return str(path)


def bridge(dbc: str, **config: Any) -> OdometerBridge:
    wheels = config.pop("wheels", None) or {
        "left": Wheel(message="LEFT", signal="LEFT_PULSES", kind="pulses"),
        "right": Wheel(message="RIGHT", signal="RIGHT_PULSES", kind="pulses"),
    }
    return OdometerBridge(
        Vehicle(vehicle="t", odometer=Odometer(channel="can0", dbc=dbc, wheels=wheels, **config))
    )


def frame(ms: int, id_: int, data: bytes, flags: int = 0) -> CanFrame:
    return CanFrame(10**18 + ms * 1_000_000, "can0", id_, flags, data)


def left(ms: int, pulses: int = 0, counter: int = 0, halves: int = 0) -> CanFrame:
    return frame(ms, 256, struct.pack("<hHhxx", pulses, counter, halves))


def right(ms: int, pulses: int = 0, counter: int = 0) -> CanFrame:
    return frame(ms, 257, struct.pack(">hHxxxx", pulses, counter))


def run(node: OdometerBridge, frames: list[CanFrame]) -> list[Odometry]:
    message = pack(frames, "can0")
    out = node.step(Sample(keys.ODO_FRAMES, message, message.stamp_ns, 1))
    assert all(ledger.balanced for ledger in node.ledgers())
    return [sample.message for sample in out]


def pulses(readings: list[Odometry], wheel: int = 0) -> list[int]:
    return [reading.wheels[wheel].pulses for reading in readings]


# against outside authorities ----------------------------------------------------------------------


@pytest.mark.realdata
def test_wheel_speeds_of_the_car_are_those_of_its_reference(data_dir: Path) -> None:
    folder = data_dir / "can"
    names = ("fl", "fr", "rl", "rr")
    wheels = {
        name: Wheel(
            message="WHEEL_SPEEDS",
            signal=f"WHEEL_SPEED_{name.upper()}",
            kind="speed",
            scale=1 / 3.6,
        )
        for name in names
    }
    node = bridge(str(folder / "toyota_2017.dbc"), wheels=wheels)
    lines = (folder / "rav4_minute.candump").read_text().splitlines()
    frames = [candump.parse_line(line) for line in lines]
    assert [candump.format_line(f) for f in frames if isinstance(f, CanFrame)] == lines
    readings: list[Odometry] = []
    for start in range(0, len(frames), 20):
        readings += run(node, frames[start : start + 20])  # type: ignore[arg-type]
    with (folder / "rav4_minute_wheel_speed_mps.csv").open() as file:
        reference = list(csv.DictReader(file))
    assert len(readings) == len(reference) > 4000
    for reading, row in zip(readings, reference, strict=True):
        assert reading.stamp_ns == round(float(row["t_s"]) * 1e6) * 1000
        for wheel in reading.wheels:
            assert wheel.speed_mps == pytest.approx(float(row[f"{wheel.wheel}_mps"]), abs=1e-9)


@given(payload=st.binary(min_size=8, max_size=64))
@settings(max_examples=200)
def test_fields_are_those_of_cantools_for_any_payload(
    tmp_path_factory: pytest.TempPathFactory, payload: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.dbc"
    path.write_text(DBC)
    check_against_cantools(path, payload)


@pytest.mark.realdata
@given(payload=st.binary(min_size=8, max_size=8))
@settings(max_examples=50)
def test_fields_of_a_real_dbc_are_those_of_cantools(data_dir: Path, payload: bytes) -> None:
    check_against_cantools(data_dir / "can" / "toyota_2017.dbc", payload)


DATABASES: dict[Path, tuple[Any, Database]] = {}


def check_against_cantools(path: Path, payload: bytes) -> None:
    if path not in DATABASES:
        theirs = cantools.database.load_file(path, strict=False)
        DATABASES[path] = theirs, Database(str(path), "$.odometer.dbc")
    theirs, ours = DATABASES[path]
    for message in theirs.messages:
        try:
            expected = message.decode(payload[: message.length], decode_choices=False)
        except cantools.database.Error:
            expected = {}  # a page of the multiplexer that does not exist, or bits beyond the end
            if message.name != "PACKED":
                continue
        for signal in message.signals:
            key, field = ours.find(message.name, signal.name, "$")
            assert key == message.frame_id | EXTENDED_ID * message.is_extended_frame
            got = field.physical(payload)
            if expected or signal.multiplexer_ids:
                wanted = expected.get(signal.name)
                assert got == wanted or (got != got and wanted != wanted)


# counting -----------------------------------------------------------------------------------------


def test_pulses_add_up_and_never_wrap(dbc: str) -> None:
    node = bridge(dbc)
    readings = []
    for k in range(100):
        readings += run(node, [left(2 * k, 30_000), right(2 * k + 1, -5)])
    assert pulses(readings) == [30_000 * (k + 1) for k in range(100)]
    assert pulses(readings, 1) == [-5 * (k + 1) for k in range(100)]
    assert [wheel.wheel for wheel in readings[0].wheels] == ["left", "right"]
    assert not readings[0].wheels[0].HasField("speed_mps")
    assert [reading.sequence for reading in readings] == list(range(1, 101))


def test_reading_waits_for_all_wheels_and_has_the_stamp_of_the_last(dbc: str) -> None:
    node = bridge(dbc)
    readings = run(node, [left(0, 1), left(20, 2), left(40, 4), right(41, 8), right(61, 16)])
    assert [(r.stamp_ns - 10**18) // 1_000_000 for r in readings] == [41]
    assert pulses(readings) == [7]
    readings = run(node, [left(80, 32)])
    assert (pulses(readings), pulses(readings, 1)) == ([39], [24])
    frames, values = node.ledgers()
    assert (frames.received, frames.delivered, frames.dropped) == (6, 6, 0)
    assert (values.received, values.delivered, values.dropped, values.pending) == (6, 6, 0, 0)


def test_silent_wheel_is_left_out_after_a_while_and_taken_back(dbc: str) -> None:
    node = bridge(dbc, silence_s=0.1)
    both = [f for ms in range(0, 100, 20) for f in (left(ms, 1), right(ms + 1, 1))]
    assert len(run(node, both)) == 5
    alone = run(node, [left(ms, 1) for ms in range(100, 300, 20)])
    assert all([wheel.wheel for wheel in r.wheels] == ["left"] for r in alone)
    assert len(alone) == 5  # from 182 ms on: the other was there last at 81 ms
    assert pulses(alone)[-1] == 15
    again = run(node, [left(300, 1), right(301, 4), left(320, 1)])
    assert (pulses(again[-1:]), pulses(again[-1:], 1)) == ([17], [9])


@pytest.mark.parametrize(("later_ms", "readings"), [(99, 0), (100, 0), (101, 1)])
def test_wheel_is_silent_once_more_than_the_configured_time_has_gone(
    dbc: str, later_ms: int, readings: int
) -> None:
    node = bridge(dbc, silence_s=0.1)
    assert len(run(node, [left(0, 1), right(10, 1)])) == 1
    assert len(run(node, [left(10 + later_ms, 1)])) == readings


@pytest.mark.parametrize("step", [0, 1, 700, 2047, -1, -700, -2048])
def test_counter_is_unwrapped_in_both_directions(dbc: str, step: int) -> None:
    wheel = Wheel(message="LEFT", signal="LEFT_COUNTER", kind="counter", counter_bits=12)
    node = bridge(dbc, wheels={"left": wheel})
    readings = run(node, [left(k, counter=(4000 + k * step) % 4096) for k in range(50)])
    assert pulses(readings) == [k * step for k in range(50)]


def test_counter_of_sixteen_bits_big_endian_wraps(dbc: str) -> None:
    wheel = Wheel(message="RIGHT", signal="RIGHT_COUNTER", kind="counter")
    node = bridge(dbc, wheels={"right": wheel})
    readings = run(node, [right(k, counter=(65_000 + 300 * k) % 65_536) for k in range(300)])
    assert pulses(readings) == [300 * k for k in range(300)]


def test_fractions_of_pulses_are_carried_on(dbc: str) -> None:
    halves = Wheel(message="LEFT", signal="LEFT_HALVES", kind="pulses")
    node = bridge(dbc, wheels={"left": halves})
    readings = run(node, [left(k, halves=1) for k in range(101)])  # half a pulse each
    assert pulses(readings)[-1] == round(50.5)
    scaled = Wheel(
        message="LEFT", signal="LEFT_COUNTER", kind="counter", counter_bits=12, scale=0.1
    )
    node = bridge(dbc, wheels={"left": scaled})
    assert pulses(run(node, [left(k, counter=k) for k in range(1001)]))[-1] == 100


def test_speed_is_the_last_one_and_replaced_ones_are_counted(dbc: str) -> None:
    wheels = {
        "right": Wheel(message="RIGHT", signal="RIGHT_SPEED", kind="speed", scale=1 / 3.6),
        "left": Wheel(message="LEFT", signal="LEFT_PULSES", kind="pulses"),
    }
    node = bridge(dbc, wheels=wheels)
    raws = [
        frame(k, 257, bytes(4) + struct.pack(">H", (9000 + k) << 1) + bytes(2)) for k in range(3)
    ]
    (reading,) = run(node, [*raws, left(5, 1)])
    assert reading.wheels[0].speed_mps == pytest.approx((90.02 - 67.67) / 3.6, abs=1e-12)
    assert not reading.wheels[0].HasField("pulses")
    values = node.ledgers()[1]
    assert (values.delivered, values.dropped, values.pending) == (2, 2, 0)


def test_doors_and_force_ride_along_as_last_known(dbc: str) -> None:
    node = bridge(
        dbc,
        wheels={"left": Wheel(message="LEFT", signal="LEFT_PULSES", kind="pulses")},
        doors_open=Signal(message="WIDE", signal="DOORS"),
        motor_force_n=Signal(message="WIDE", signal="FORCE", scale=1000.0),
    )

    def wide(ms: int, doors: int, force: float) -> CanFrame:
        id_ = 2566844926 & 0x1FFFFFFF
        return frame(ms, id_, bytes((doors << 3,)) + struct.pack("<f", force) + bytes(3), EXTENDED)

    frames = [left(0), wide(1, 1, -2.5), left(2), left(3), wide(4, 0, 8.0), left(5)]
    readings = run(node, frames)
    assert [r.HasField("doors_open") for r in readings] == [False, True, True, True]
    assert [r.doors_open for r in readings] == [False, True, True, False]
    assert [r.motor_force_n for r in readings] == [0.0, -2500.0, -2500.0, 8000.0]
    # the same number with 11 bits is another message
    assert run(node, [frame(6, 256, left(0, 9).data, EXTENDED)]) == []


def test_multiplexed_speed_is_taken_from_its_page_only(dbc: str) -> None:
    wheels = {"a": Wheel(message="PACKED", signal="SPEED_A", kind="speed")}
    node = bridge(dbc, wheels=wheels)
    pages = [
        frame(k, 300, bytes((k % 4,)) + struct.pack("<H", 10 * k) + bytes(5)) for k in range(8)
    ]
    assert [reading.wheels[0].speed_mps for reading in run(node, pages)] == [1.0, 5.0]


def test_late_frames_of_a_reader_are_stamped_by_their_cycle_and_counted(dbc: str) -> None:
    """A reader that stands still for 150 ms in each 400; arrivals are that late, stamps 1 ms."""
    node = bridge(dbc)
    errors_ms, out = [], []
    for k in range(400):
        sent_ms = 20 * k
        waits_ms = 150 - sent_ms % 400 if k > 150 and sent_ms % 400 < 150 else 0
        sent = [left(sent_ms + waits_ms, 5), right(sent_ms + waits_ms, 6)]
        message = pack(sent, "/dev/ttyACM0", read_stamps=True)
        out += node.step(Sample(keys.ODO_FRAMES, message, message.stamp_ns, k))
        readings = [each.message for each in out if each.key is keys.ODO_WHEELS]
        errors_ms.append((readings[-1].stamp_ns - 10**18) / 1e6 - sent_ms)
    assert len(readings) == 400
    assert max(map(abs, errors_ms)) < 1.0
    stamps = [reading.stamp_ns for reading in readings]
    assert all(after > before for before, after in pairwise(stamps))
    late = sum(1 for k in range(151, 400) if 20 * k % 400 < 145)
    assert node.device_counters()["rejected_by_reason"] == {NOTE_LATE: 2 * late}
    assert node.device_counters()["frames_rejected"] == 0
    events = [each.message for each in out if each.key == keys.EVENT.at("odometer")]
    assert {each.kind for each in events} == {"odometer.read_late"}
    assert len(events) == 2  # one for each message; the same again only after ten seconds


def test_frames_that_the_kernel_stamped_keep_their_stamps(dbc: str) -> None:
    node = bridge(dbc)
    at_ms = [20 * k + (150 - 20 * k % 400 if 20 * k % 400 < 150 else 0) for k in range(200)]
    readings = []
    for ms in at_ms:
        readings += run(node, [left(ms, 5), right(ms, 6)])
    assert [(reading.stamp_ns - 10**18) // 1_000_000 for reading in readings] == at_ms


def test_any_cut_of_late_frames_and_a_restored_bridge_give_the_same(dbc: str) -> None:
    frames = []
    for k in range(200):
        ms = 20 * k + (150 - 20 * k % 400 if k > 130 and 20 * k % 400 < 150 else 0)
        frames += [left(ms, k), right(ms, k)]

    def feed(node: OdometerBridge, part: list[CanFrame]) -> list[Odometry]:
        message = pack(part, "can0", read_stamps=True)
        out = node.step(Sample(keys.ODO_FRAMES, message, message.stamp_ns, 1))
        return [sample.message for sample in out if sample.key is keys.ODO_WHEELS]

    whole = bridge(dbc)
    expected = feed(whole, frames)
    for cut in range(1, len(frames), 29):
        first, second = bridge(dbc), bridge(dbc)
        readings = feed(first, frames[:cut])
        second.restore(first.snapshot())
        assert readings + feed(second, frames[cut:]) == expected
        assert second.snapshot() == whole.snapshot()


def test_bus_without_a_configured_frame_is_said(dbc: str) -> None:
    node = bridge(dbc)
    message = pack([frame(100 * k, 0x555, b"") for k in range(60)], "can0")
    out = node.step(Sample(keys.ODO_FRAMES, message, message.stamp_ns, 1))
    (event,) = [each.message for each in out if each.key == keys.EVENT.at("odometer")]
    assert event.kind == "odometer.unheard"
    assert facts_of(event)["messages"] == "LEFT, RIGHT"


# dirt ---------------------------------------------------------------------------------------------


def test_unusable_frames_are_counted_by_reason_and_never_raise(dbc: str) -> None:
    node = bridge(dbc, motor_force_n=Signal(message="WIDE", signal="FORCE"))
    wide = 2566844926 & 0x1FFFFFFF
    frames = [
        left(0, 1),
        frame(1, 256, b"\x01"),
        frame(2, 257, b""),
        frame(3, 256, b"", REMOTE),
        frame(4, wide, b"\0" + struct.pack("<f", float("nan")) + bytes(3), EXTENDED),
        frame(5, 0x040, bytes(8), ERROR),
        frame(6, 0x004, b"\0\x20" + bytes(6), ERROR),
        frame(7, 0x020, bytes(8), ERROR),
        frame(8, 256, bytes(8), ERROR),
        host_overflow(10**18, "can0", 12),
        frame(9, 0x555, b"whatever"),
        right(10, 2),
    ]
    (reading,) = run(node, frames)
    assert [wheel.pulses for wheel in reading.wheels] == [1, 2]
    assert not reading.HasField("motor_force_n")
    counters = node.device_counters()
    assert counters["rejected_by_reason"] == {
        REJECT_SHORT: 2,
        REJECT_REMOTE: 1,
        REJECT_NAN: 1,
        "bus-off": 1,
        "error passive": 1,
        "no acknowledge": 1,
        "controller restarted": 1,
        "host overflow": 1,
    }
    assert counters["frames_rejected"] == 9
    assert counters["samples_lost"] == 12
    assert counters["messages_decoded"] == 2
    (frames_ledger, _) = node.ledgers()
    assert (frames_ledger.received, frames_ledger.delivered, frames_ledger.dropped) == (12, 3, 9)


@pytest.mark.parametrize("kind", ["pulses", "speed"])
@pytest.mark.parametrize("value", [1e300, -1e30, 1.7e308, float("inf")])
def test_number_beyond_all_vehicles_is_none(tmp_path: Path, kind: Any, value: float) -> None:
    path = tmp_path / "big.dbc"
    path.write_text(
        'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: XXX\n\nBO_ 1 BIG: 8 XXX\n'
        ' SG_ W : 0|64@1- (1,0) [0|0] "" XXX\n\nSIG_VALTYPE_ 1 W : 2;\n'
    )
    wheels = {"w": Wheel(message="BIG", signal="W", kind=kind, scale=100.0)}
    node = bridge(str(path), wheels=wheels)
    frames = [frame(k, 1, struct.pack("<d", each)) for k, each in enumerate([2.0, value, 3.0])]
    readings = run(node, frames)
    read = [each.wheels[0].pulses or each.wheels[0].speed_mps for each in readings]
    assert read == ([200, 500] if kind == "pulses" else [200.0, 300.0])
    assert node.device_counters()["rejected_by_reason"] == {REJECT_NAN: 1}


@given(
    st.lists(
        st.tuples(
            st.sampled_from([256, 257, 300, 0x40, 2566844926 & 0x1FFFFFFF]),
            st.integers(0, 15),
            st.binary(max_size=64),
        ),
        min_size=1,
        max_size=30,
    )
)
@settings(max_examples=100)
def test_no_frame_raises_and_the_ledgers_hold(
    tmp_path_factory: pytest.TempPathFactory, items: list[tuple[int, int, bytes]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.dbc"
    path.write_text(DBC)
    force = Signal(message="WIDE", signal="FORCE")
    counter = Wheel(message="LEFT", signal="LEFT_COUNTER", kind="counter", counter_bits=12)
    speed = Wheel(message="RIGHT", signal="RIGHT_SPEED", kind="speed")
    node = bridge(str(path), wheels={"l": counter, "r": speed}, motor_force_n=force)
    run(node, [frame(k, id_, data, flags) for k, (id_, flags, data) in enumerate(items)])
    assert node.ledgers()[0].received == len(items)


def test_frames_padded_or_of_can_fd_are_read_alike(dbc: str) -> None:
    node = bridge(dbc)
    frames = [
        frame(0, 256, left(0, 3).data + bytes(56), FD),
        frame(1, 257, right(0, 4).data[:4]),  # short of its message, not of its signal
    ]
    (reading,) = run(node, frames)
    assert [wheel.pulses for wheel in reading.wheels] == [3, 4]


# memory and configuration -------------------------------------------------------------------------


def test_any_cut_of_the_frames_and_a_restored_bridge_give_the_same(dbc: str) -> None:
    wheels = {
        "left": Wheel(message="LEFT", signal="LEFT_COUNTER", kind="counter", counter_bits=12),
        "right": Wheel(message="RIGHT", signal="RIGHT_PULSES", kind="pulses"),
    }
    frames = [
        f for k in range(20) for f in (left(3 * k, counter=300 * k % 4096), right(3 * k + 1, k))
    ]
    frames.insert(11, frame(16, 256, b""))
    whole = bridge(dbc, wheels=wheels)
    expected = run(whole, frames)
    for cut in range(1, len(frames)):
        first, second = bridge(dbc, wheels=wheels), bridge(dbc, wheels=wheels)
        readings = run(first, frames[:cut])
        state = first.snapshot()
        copy = pickle.dumps(state)
        second.restore(state)
        assert readings + run(second, frames[cut:]) == expected
        assert second.snapshot() == whole.snapshot()
        assert pickle.dumps(state) == copy


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"wheels": {"left": Wheel(message="LEFT", signal="LEFT_PULSE", kind="pulses")}},
            [r"$.odometer.wheels.left.signal", "tram.dbc", "LEFT_PULSE'", "LEFT_PULSES"],
        ),
        (
            {"wheels": {"left": Wheel(message="LEFTT", signal="LEFT_PULSES", kind="pulses")}},
            [r"$.odometer.wheels.left.message", "tram.dbc", "LEFTT", "near: LEFT"],
        ),
        (
            {"wheels": {"left": Wheel(message="qqq", signal="LEFT_PULSES", kind="pulses")}},
            [r"$.odometer.wheels.left.message", "it has LEFT, PACKED, RIGHT, WIDE"],
        ),
        (
            {"doors_open": Signal(message="wide", signal="doors")},
            [r"$.odometer.doors_open.message", "WIDE"],
        ),
        (
            {"wheels": {"left": Wheel(message="LEFT", signal="LEFT_COUNTER", kind="counter")}},
            [r"$.odometer.wheels.left.counter_bits", "16", "12 bits"],
        ),
    ],
)
def test_name_that_the_dbc_has_not_is_a_config_error(
    dbc: str, change: dict[str, Any], words: list[str]
) -> None:
    with pytest.raises(ConfigError) as caught:
        bridge(dbc, **change)
    for word in words:
        assert word in str(caught.value)


def test_dbc_that_is_absent_or_none_is_a_config_error(dbc: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"\$\.odometer\.dbc: cannot read .*none\.dbc"):
        bridge(str(tmp_path / "none.dbc"))
    (tmp_path / "bad.dbc").write_text("this is no DBC")
    with pytest.raises(ConfigError, match=r"\$\.odometer\.dbc: .*bad\.dbc"):
        bridge(str(tmp_path / "bad.dbc"))


def test_vehicle_without_odometer_or_wheels_is_a_config_error(dbc: str) -> None:
    with pytest.raises(ConfigError, match=r"\$\.odometer: missing"):
        OdometerBridge(Vehicle(vehicle="t"))
    with pytest.raises(ConfigError, match=r"\$\.odometer\.wheels: empty"):
        OdometerBridge(Vehicle(vehicle="t", odometer=Odometer(channel="can0", dbc=dbc, wheels={})))
