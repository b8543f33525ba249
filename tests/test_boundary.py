"""The boundary: any bytes give a message or an `Undecodable`, never an exception."""

from __future__ import annotations

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from hypothesis import given, settings
from hypothesis import strategies as st

from tramstream import keys
from tramstream.boundary import LATEST_NS, Undecodable, decode, left_out, name_of
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.health_pb2 import NodeHealth


@settings(deadline=None, max_examples=300)
@given(key=st.sampled_from(keys.ALL), payload=st.binary(max_size=200))
def test_any_bytes_on_any_key_are_a_message_or_undecodable(key: keys.Key, payload: bytes) -> None:
    found = decode(key.type, payload, key.path)
    if isinstance(found, Undecodable):
        assert (found.key, found.size) == (key.path, len(payload))
        assert key.type.DESCRIPTOR.full_name in str(found)
    else:
        assert isinstance(found, key.type)


def test_message_comes_out_as_it_went_in() -> None:
    fix = GnssFix(stamp_ns=LATEST_NS, sequence=3, latitude_deg=50.0)
    assert decode(GnssFix, fix.SerializeToString(), "raw/gnss/fix") == fix
    log = Log(message="ein Satz")
    log.timestamp.FromSeconds(1_700_000_000)
    assert decode(Log, log.SerializeToString(), "health/x/log") == log


def test_instant_that_no_clock_shows_is_undecodable() -> None:
    late = decode(GnssFix, GnssFix(stamp_ns=LATEST_NS + 1).SerializeToString(), "raw/gnss/fix")
    assert isinstance(late, Undecodable)
    log = Log()
    log.timestamp.seconds = 1 << 62
    assert isinstance(decode(Log, log.SerializeToString(), "health/x/log"), Undecodable)


@pytest.mark.parametrize(("number", "name"), [(1, "DEGRADED"), (99, "UNKNOWN_99")])
def test_value_of_a_newer_version_is_named_by_its_number(number: int, name: str) -> None:
    assert name_of(NodeHealth.State, number) == name


def test_what_was_left_out_is_one_sentence() -> None:
    assert left_out([]) == ""
    assert left_out([("a/b/c", 2), ("d/e/f", 0), ("g/h/i", 1)]) == (
        "messages that cannot be decoded were left out: 2 on a/b/c, 1 on g/h/i"
    )
