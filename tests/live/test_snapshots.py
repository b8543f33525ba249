"""Memory as bytes: exact, harmless, and never the reason that a node does not start."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tramstream.clock import S
from tramstream.events.kinds import Event
from tramstream.live import snapshots
from tramstream.live.events import SNAPSHOT_UNREADABLE
from tramstream.processor import Processor, Sample, State
from tramstream.proto.sync_pb2 import ProcessorState, Snapshot

NOW_NS = 1_700_000_000 * S

scalars = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=False)
    | st.text()
    | st.binary()
)
plain = st.recursive(
    scalars, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=20
)
arrays = hnp.arrays(
    dtype=hnp.floating_dtypes(sizes=(32, 64))
    | hnp.integer_dtypes()
    | hnp.boolean_dtypes()
    | st.just(np.dtype([("stamp_us", "<u4"), ("gyro", "<i2", (3,))])),
    shape=hnp.array_shapes(min_dims=0, min_side=0),
)


class Memory(Processor):
    """Remembers one thing."""

    inputs = ()
    outputs = ()

    def __init__(self, name: str = "memory", value: Any = 0) -> None:
        super().__init__()
        self.name = name  # type: ignore[misc]
        self.value = value

    def step(self, sample: Sample) -> list[Sample]:
        return []

    def snapshot(self) -> State:
        return {"value": self.value}

    def restore(self, state: State) -> None:
        self.value = state["value"]


def snapshot_of(*processors: Processor, stamp_ns: int = NOW_NS) -> Snapshot:
    return Snapshot(stamp_ns=stamp_ns, session=7, states=snapshots.take(processors))


@given(st.dictionaries(st.text(), plain))
def test_plain_data_survives(state: dict[str, Any]) -> None:
    assert snapshots.unpack(snapshots.pack(state)) == state


@given(arrays)
def test_arrays_survive_bit_for_bit(array: np.ndarray) -> None:
    found = snapshots.unpack(snapshots.pack({"a": [array]}))["a"][0]
    assert found.dtype == array.dtype
    assert found.shape == array.shape
    assert found.tobytes() == array.tobytes()


@pytest.mark.parametrize(
    "scalar", [np.float64(0.1), np.float32(0.5), np.int64(-3), np.uint8(200), np.bool_(True)]
)
def test_numpy_scalars_become_plain_ones(scalar: Any) -> None:
    found = snapshots.unpack(snapshots.pack({"a": scalar}))["a"]
    assert found == scalar.item()
    assert type(found) is type(scalar.item())


def test_restored_arrays_may_be_written() -> None:
    found = snapshots.unpack(snapshots.pack({"a": np.zeros(3)}))["a"]
    found[0] = 1.0
    assert found.tolist() == [1.0, 0.0, 0.0]


def test_what_could_run_code_is_refused() -> None:
    with pytest.raises(ValueError, match=r"[Oo]bject"):
        snapshots.pack({"a": np.array([print], dtype=object)})
    with pytest.raises(TypeError, match="function"):
        snapshots.pack({"a": lambda: None})
    for payload in (pickle.dumps(print), b"PK\x03\x04"):
        data = msgspec.msgpack.encode({"a": msgspec.msgpack.Ext(snapshots.ARRAY, payload)})
        with pytest.raises(ValueError, match=r"magic|EOF|invalid"):
            snapshots.unpack(data)
    with pytest.raises(ValueError, match="unknown extension"):
        snapshots.unpack(msgspec.msgpack.encode({"a": msgspec.msgpack.Ext(2, b"")}))


def test_file_brings_the_memory_back(tmp_path: Path) -> None:
    path = tmp_path / "processors.snapshot"
    snapshots.save(path, snapshot_of(Memory("a", 5), Memory("b", np.arange(3))))
    found = snapshots.load(path, NOW_NS + S)
    assert isinstance(found, Snapshot)
    a, b = Memory("a"), Memory("b")
    assert snapshots.restore(found, [b, a])
    assert a.value == 5
    assert b.value.tolist() == [0, 1, 2]
    assert [entry.name for entry in tmp_path.iterdir()] == ["processors.snapshot"]


def test_absent_file_is_no_news(tmp_path: Path) -> None:
    assert snapshots.load(tmp_path / "none", NOW_NS) is None


def test_file_cut_at_any_byte_is_refused_or_of_other_processors(tmp_path: Path) -> None:
    path = tmp_path / "s"
    whole = snapshot_of(Memory("a", 5), Memory("b", np.arange(3))).SerializeToString()
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        found = snapshots.load(path, NOW_NS)
        a, b = Memory("a", "untouched"), Memory("b", "untouched")
        assert not isinstance(found, Snapshot) or not snapshots.restore(found, [a, b])
        assert (a.value, b.value) == ("untouched", "untouched")


def test_file_that_is_no_snapshot_is_named(tmp_path: Path) -> None:
    path = tmp_path / "s"
    path.write_bytes(b"\xff" * 40)
    for place in (path, tmp_path):  # a folder
        found = snapshots.load(place, NOW_NS)
        assert isinstance(found, Event)
        assert (found.kind, found.facts["path"]) == (SNAPSHOT_UNREADABLE, str(place))


@pytest.mark.parametrize(
    ("age_s", "young"), [(0.0, True), (59.0, True), (61.0, False), (-1.0, False)]
)
def test_only_young_memory_is_worth_anything(tmp_path: Path, age_s: float, young: bool) -> None:
    path = tmp_path / "s"
    snapshots.save(path, snapshot_of(Memory()))
    found = snapshots.load(path, NOW_NS + round(age_s * S))
    assert isinstance(found, Snapshot) if young else found is None


def test_memory_of_other_processors_is_not_taken() -> None:
    snapshot = snapshot_of(Memory("a", 1))
    a, b = Memory("a"), Memory("b")
    assert not snapshots.restore(snapshot, [a, b])
    assert not snapshots.restore(snapshot, [])
    assert (a.value, b.value) == (0, 0)


def test_memory_of_another_version_leaves_everybody_as_they_were() -> None:
    snapshot = snapshot_of(Memory("a", 1))
    snapshot.states.append(ProcessorState(name="b", state=snapshots.pack({"renamed": 1})))
    a, b = Memory("a", "fresh"), Memory("b", "fresh")
    assert not snapshots.restore(snapshot, [a, b])
    assert (a.value, b.value) == ("fresh", "fresh")
