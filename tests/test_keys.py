"""The table of keys, and key expressions with zenoh as the authority."""

from __future__ import annotations

import pytest
import zenoh
from google.protobuf import descriptor_pool, message_factory
from hypothesis import given
from hypothesis import strategies as st

from tramstream import keys
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame

chunks = st.sampled_from(["a", "b", "raw", "gnss"])
names = st.lists(chunks, min_size=1, max_size=5).map("/".join)
expressions = st.lists(chunks | st.sampled_from(["*", "**"]), min_size=1, max_size=5).map("/".join)


def well_formed(expression: str) -> str:
    """zenoh wants `**` once in a row, and after any `*`."""
    return str(zenoh.KeyExpr.autocanonize(expression))


@given(expressions.map(well_formed), names)
def test_matches_is_what_zenoh_includes_and_intersects(expression: str, name: str) -> None:
    authority = zenoh.KeyExpr(expression)
    assert keys.matches(expression, name) == authority.includes(zenoh.KeyExpr(name))
    assert keys.matches(expression, name) == authority.intersects(zenoh.KeyExpr(name))


def slowly(pattern: list[str], parts: list[str]) -> bool:
    """As the definition says, whatever it takes."""
    if not pattern:
        return not parts
    if pattern[0] == "**":
        return any(slowly(pattern[1:], parts[skip:]) for skip in range(len(parts) + 1))
    return bool(parts) and pattern[0] in ("*", parts[0]) and slowly(pattern[1:], parts[1:])


@given(expressions, names)
def test_matches_is_its_definition_for_expressions_that_zenoh_refuses_too(
    expression: str, name: str
) -> None:
    assert keys.matches(expression, name) == slowly(expression.split("/"), name.split("/"))


@pytest.mark.parametrize("wild", ["**/a", "**", "**/*"])
def test_expression_of_many_wild_parts_is_answered_at_once(wild: str) -> None:
    """Else it takes longer than anybody lives."""
    expression = "/".join([wild] * 100 + ["end"])
    assert not keys.matches(expression, "/".join(["a"] * 200))
    assert keys.matches(expression, "/".join(["a"] * 200 + ["end"]))


def test_every_key_is_a_key_expression_of_five_parts() -> None:
    for key in keys.ALL:
        assert len(key.on("tram-1").split("/")) == 5
        assert str(zenoh.KeyExpr(key.on("tram-1"))) == key.on("tram-1")
        assert key.layer in ("raw", "sync", "est", "map", "health")


def test_every_path_is_there_once_with_its_type() -> None:
    assert len({key.path for key in keys.ALL}) == len(keys.ALL)
    for key in keys.ALL:
        assert key.encoding == f"application/protobuf;{key.type.DESCRIPTOR.full_name}"
        assert key.doc
        assert key.rate_hz >= 0


def test_find_knows_every_key_and_no_other() -> None:
    for key in keys.ALL:
        assert keys.find(key.path) is key
    for path in ("", "raw", "raw/gnss", "raw/gnss/nothing", "raw/gnss/fix/more", "est/imu/batch"):
        assert keys.find(path) is None


def test_find_gives_health_keys_of_any_source() -> None:
    found = keys.find("health/imu/heartbeat")
    assert found == keys.HEARTBEAT.at("imu")
    assert found is not None
    assert (found.path, found.type) == ("health/imu/heartbeat", keys.HEARTBEAT.type)


@pytest.mark.parametrize("path", ["health//heartbeat", "health/**/heartbeat", "health/i*/loss"])
def test_find_refuses_sources_that_name_none(path: str) -> None:
    assert keys.find(path) is None


def test_at_changes_the_source_alone() -> None:
    moved = keys.GNSS_FIX.at("gnss2")
    assert moved.path == "raw/gnss2/fix"
    assert moved.at("gnss") == keys.GNSS_FIX


def test_split_undoes_on_and_refuses_strangers() -> None:
    for key in keys.ALL:
        assert keys.split(key.on("tram-1")) == ("tram-1", key.path)
    for full in ("", "tram", "tram/x", "bus/x/raw/gnss/fix"):
        assert keys.split(full) == ("", "")


def test_full_and_alive_are_below_the_vehicle() -> None:
    assert keys.full("v", "raw/**") == f"{keys.ROOT}/v/raw/**"
    assert keys.split(keys.alive("v", "imu")) == ("v", "health/imu/alive")
    assert keys.matches(keys.alive("*", "*"), keys.alive("v", "imu"))
    assert keys.matches(keys.schema("*"), keys.schema("tramstream.ImuMean"))


def test_descriptors_decode_a_message_without_our_code() -> None:
    pool = descriptor_pool.DescriptorPool()
    for file in keys.descriptor_set(SyncFrame).file:
        pool.Add(file)
    descriptor = pool.FindMessageTypeByName("tramstream.SyncFrame")
    sent = SyncFrame(stamp_ns=5, imu=ImuMean(sample_count=20))
    found = message_factory.GetMessageClass(descriptor).FromString(sent.SerializeToString())
    assert found.imu.sample_count == 20
    assert [file.name for file in keys.descriptor_set(SyncFrame).file][-1].endswith("sync.proto")
