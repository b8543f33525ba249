"""Numbers written into encoded messages against protobuf's own way."""

from __future__ import annotations

import numpy as np
import pytest

from tramstream.estimation import encode
from tramstream.proto.estimate_pb2 import MotionState

FIELDS = {"speed_mps": 1, "up_std_m": 1, "covariance": 28}
"""Tags of one byte and of two, and a repeated field whose length takes two."""


@pytest.mark.parametrize("values", [np.arange(1.0, 31.0), np.full(30, -0.0), np.full(30, np.inf)])
def test_filled_message_is_the_one_that_protobuf_makes(values: np.ndarray) -> None:
    encoded, places = encode.doubles(MotionState, FIELDS)
    encode.fill(encoded, places, values)
    expected = MotionState(speed_mps=values[0], up_std_m=values[1], covariance=values[2:])
    found = MotionState.FromString(encoded.tobytes())
    assert found.SerializeToString() == expected.SerializeToString()


def test_zeros_are_left_out_as_protobuf_does() -> None:
    encoded, _ = encode.doubles(MotionState, {"speed_mps": 1})
    assert MotionState.FromString(encoded.tobytes()).SerializeToString() == b""


def test_field_that_is_no_double_is_refused() -> None:
    with pytest.raises(AssertionError, match="standing"):
        encode.doubles(MotionState, {"standing": 1})
