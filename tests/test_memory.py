"""Memories: copied, put back in place, and kept as plain data that another version refuses."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter, deque
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from tramstream.geodesy import LocalLevel
from tramstream.keys import SYNC_TICK
from tramstream.live.snapshots import pack, unpack
from tramstream.memory.annotations import VARYING, Varying, kind_of
from tramstream.memory.stage import State, assign, copied, from_plain, to_plain
from tramstream.processor import Processor, Sample
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry

RECORD = np.dtype([("stamp", "<u4"), ("gyro", ">i2", (3,))])


class Mode(Enum):
    REST = 1
    RIDE = 2


class Verdict(NamedTuple):
    name: str
    innovation: float


@dataclass
class Wheel:
    pulses: int = 0
    slips: list[float] = field(default_factory=list)


@dataclass
class Everything:
    count: int = 0
    share: float = 0.5
    known: bool = False
    name: str = "a"
    waiting: bytes = b""
    mode: Mode = Mode.REST
    velocity: complex = 0j
    x: NDArray[np.float64] = field(default_factory=lambda: np.zeros(4))
    record: NDArray[np.void] = field(default_factory=lambda: np.zeros(2, RECORD))
    columns: Varying = field(default_factory=lambda: np.zeros((2, 0)))
    stamps: Annotated[NDArray[np.int64], VARYING] = field(
        default_factory=lambda: np.zeros(0, np.int64)
    )
    first: Wheel = field(default_factory=Wheel)
    parked: Wheel | None = None
    wheels: dict[str, Wheel] = field(default_factory=dict)
    late: dict[tuple[str, int], int] = field(default_factory=dict)
    reasons: Counter[str] = field(default_factory=Counter)
    reads: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=8))
    ways: tuple[float, ...] = ()
    numbers: set[int] = field(default_factory=set)
    verdicts: list[Verdict] = field(default_factory=list)
    runs: list[NDArray[np.void]] = field(default_factory=list)
    level: LocalLevel | None = None
    fix: GnssFix | None = None
    measurements: list[tuple[int, GnssFix | Odometry]] = field(default_factory=list)
    anything: dict[str, Any] = field(default_factory=dict)


def full() -> Everything:
    """No field has what it begins with."""
    return Everything(
        count=7,
        share=0.25,
        known=True,
        name="b",
        waiting=b"\xb5b",
        mode=Mode.RIDE,
        velocity=1.5 - 2j,
        x=np.array([1.0, np.nan, np.inf, -0.0]),
        record=np.array([(1, (2, 3, -4)), (5, (6, 7, 8))], RECORD),
        columns=np.arange(6.0).reshape(2, 3),
        stamps=np.array([5, 6]),
        first=Wheel(3, [0.5]),
        parked=Wheel(4),
        wheels={"b": Wheel(1), "a": Wheel(2, [1.0])},
        late={("imu", 3): 4},
        reasons=Counter({"checksum": 2}),
        reads=deque([(1, 2), (3, 4)], maxlen=8),
        ways=(1.0, 2.0),
        numbers={1, 2},
        verdicts=[Verdict("wheel", 0.1)],
        runs=[np.zeros(1, RECORD)],
        level=LocalLevel(0.8, 0.2, 300.0),
        fix=GnssFix(satellites_used=9),
        measurements=[(1, GnssFix(satellites_used=8)), (2, Odometry(sequence=3))],
        anything={"a": [1, None]},
    )


def through_bytes(it: Everything) -> Everything:
    return from_plain(Everything, unpack(pack(to_plain(it))))


def test_every_field_survives_the_way_through_bytes() -> None:
    found = through_bytes(full())
    assert pack(to_plain(found)) == pack(to_plain(full()))
    assert found.wheels == full().wheels
    assert list(found.wheels) == ["b", "a"]
    assert found.mode is Mode.RIDE
    assert found.velocity == 1.5 - 2j
    assert isinstance(found.verdicts[0], Verdict)
    assert found.measurements == full().measurements
    assert found.late == full().late
    assert found.reasons.total() == 2
    assert found.record.dtype == RECORD
    assert found.x.tobytes() == full().x.tobytes()
    assert found.level == full().level
    assert found.numbers == {1, 2}
    assert found.ways == (1.0, 2.0)


def test_empty_memory_survives_as_well() -> None:
    assert pack(to_plain(through_bytes(Everything()))) == pack(to_plain(Everything()))


@pytest.mark.parametrize("made", [copied, through_bytes, lambda it: _assigned(it)])
def test_copies_share_nothing_that_anybody_changes(made: Any) -> None:
    first = full()
    second = made(first)
    before = pack(to_plain(second))
    first.x[0] = 9.0
    first.record["gyro"][0] = 9
    first.columns[0, 0] = first.stamps[0] = 9
    first.first.slips.append(9.0)
    assert first.parked is not None
    first.parked.pulses = 9
    first.wheels["a"].slips.append(9.0)
    first.late.clear()
    first.reasons["noise"] += 1
    first.reads.append((9, 9))
    first.numbers.add(9)
    first.verdicts.clear()
    first.runs[0]["stamp"] = 9
    first.anything["a"].append(9)
    assert pack(to_plain(second)) == before


def _assigned(it: Everything) -> Everything:
    other = Everything()
    assign(other, it)
    return other


def test_plain_data_share_nothing_with_their_memory() -> None:
    first = full()
    state = to_plain(first)
    before = pack(state)
    first.x[:] = 9.0
    first.runs[0]["stamp"] = 9
    first.wheels["a"].slips.append(9.0)
    assert pack(state) == before


def test_assigning_fills_what_others_hold() -> None:
    it = Everything(wheels={"a": Wheel(), "c": Wheel()}, parked=Wheel())
    view, gyro, wheel, parked, first = (
        it.x[1:3],
        it.record["gyro"],
        it.wheels["a"],
        it.parked,
        it.first,
    )
    wheels, reads = it.wheels, it.reads
    assign(it, full())
    assert np.array_equal(view, full().x[1:3], equal_nan=True)
    assert gyro.tolist() == [[2, 3, -4], [6, 7, 8]]
    assert it.wheels is wheels
    assert list(wheels) == ["b", "a"]
    assert wheels["a"] is wheel
    assert wheel.slips == [1.0]
    assert it.parked is parked
    assert parked is not None
    assert parked.pulses == 4
    assert it.first is first
    assert first.pulses == 3
    assert it.reads is reads
    assert reads.maxlen == 8
    assert pack(to_plain(it)) == pack(to_plain(full()))


def test_what_is_missing_comes_and_goes() -> None:
    it = Everything()
    assign(it, full())
    assign(it, Everything())
    assert it.parked is None
    assert it.fix is None
    assert it.columns.shape == (2, 0)


def test_a_memory_may_be_assigned_to_itself() -> None:
    it = full()
    assign(it, it)
    assert pack(to_plain(it)) == pack(to_plain(full()))


def without(state: State, name: str) -> State:
    return {key: value for key, value in state.items() if key != name}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"wheel": 1}, "Everything has no wheel"),
        ({"count": "7"}, "Everything.count is a str, not a int"),
        ({"share": None}, "Everything.share is a NoneType"),
        ({"mode": "FLY"}, "Everything.mode is a str, no Mode"),
        ({"first": {"pulses": 1}}, r"Everything.first.slips is missing"),
        ({"first": [1]}, "Everything.first is a list, not a memory"),
        ({"wheels": {"a": {"pulses": 1.5, "slips": []}}}, r"wheels.pulses is a float"),
        ({"x": [0.0] * 4}, "Everything.x is a list, not an array"),
        ({"fix": b"\xff"}, "Everything.fix is a bytes, no GnssFix"),
        ({"verdicts": [["wheel"]]}, "not 2 values"),
        ({"measurements": [[1, ["tramstream.ImuMean", b""]]]}, "not a message with its name"),
    ],
)
def test_memory_of_another_version_is_refused_with_its_place(
    change: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(TypeError, match=f"another version.*{sentence}"):
        from_plain(Everything, to_plain(full()) | change)


def test_memory_without_a_field_is_refused() -> None:
    with pytest.raises(TypeError, match=r"another version: Everything\.count is missing"):
        from_plain(Everything, without(to_plain(full()), "count"))


@pytest.mark.parametrize("x", [np.zeros(5), np.zeros(4, np.float32)])
def test_arrays_of_another_shape_or_type_are_refused(x: Any) -> None:
    with pytest.raises(TypeError, match="another version: an array"):
        assign(Everything(), Everything(x=x))


def test_memories_of_two_classes_are_not_one() -> None:
    with pytest.raises(TypeError, match="another version"):
        assign(Everything(), Wheel())  # type: ignore[arg-type]


def test_a_shorter_plain_form_is_used() -> None:
    class Long:
        def __init__(self, numbers: list[int]) -> None:
            self.numbers = numbers

        def to_plain(self) -> list[int]:
            return [each for each in self.numbers if each]

        @classmethod
        def from_plain(cls, plain: list[int]) -> Long:
            return cls(list(plain))

    kind = kind_of(Long, "here")
    long = Long([0, 1, 2])
    assert kind.plain(long) == [1, 2]
    assert kind.read([3], "").numbers == [3]
    assert kind.copy(long).numbers == [1, 2]


@dataclass
class Unkeepable:
    it: object = None


class Forgetful(Processor):
    name, inputs, outputs = "forgetful", (SYNC_TICK,), ()
    Memory = Unkeepable

    def step(self, sample: Sample) -> list[Sample]:
        return []


def test_a_processor_whose_memory_cannot_be_kept_is_not_made() -> None:
    with pytest.raises(TypeError, match=r"Unkeepable\.it: a memory cannot hold .*object"):
        Forgetful()


class Counting(Forgetful):
    Memory = Wheel
    derived = 0

    def restored(self) -> None:
        self.derived = 2 * self.memory.pulses


def test_a_processor_makes_anew_what_is_derived_when_memory_comes_back() -> None:
    one, two = Counting(), Counting()
    one.memory.pulses = 4
    held = two.memory
    two.restore(unpack(pack(one.snapshot())))
    assert held.pulses == 4
    assert two.derived == 8
    for state in ({}, {"memory": {}, "sequences": {}}, {"value": 1}):
        with pytest.raises(TypeError, match="another version"):
            two.restore(state)


def test_routers_and_supervisors_do_without_numpy() -> None:
    """They have no memory to keep; numpy takes 15 MB of each of them."""
    modules = ["tramstream.live.router", "tramstream.supervision.supervisor"]
    code = f"import sys, {', '.join(modules)}; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
