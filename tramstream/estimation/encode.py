"""Messages of many numbers, filled as the bytes that they have on the wire.

Setting forty fields of a protobuf message one by one costs more than what is computed for them. So
compiled code writes the numbers into the encoded message, where each has a fixed place, and the
message is decoded from that (https://protobuf.dev/programming-guides/encoding).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message
from numpy.typing import NDArray

from tramstream.estimation.kalman import Array, Indices, compiled

Bytes = NDArray[np.uint8]
_FIXED64, _DELIMITED = 1, 2
"""Wire types."""


def doubles(type_: type[Message], fields: Mapping[str, int]) -> tuple[Bytes, Indices]:
    """An encoded message with zeros for its numbers, and the place of each.

    Parameters
    ----------
    type_ : type of Message
    fields : Mapping[str, int]
        Names of fields of type double, in the order of the numbers: how many there are, 1 unless
        the field is a repeated one.
    """
    encoded, places = bytearray(), []
    for name, count in fields.items():
        field = type_.DESCRIPTOR.fields_by_name[name]
        assert field.type == FieldDescriptor.TYPE_DOUBLE, name
        if field.is_repeated:
            encoded += _integer(field.number << 3 | _DELIMITED) + _integer(8 * count)
        else:
            encoded += _integer(field.number << 3 | _FIXED64)
        for _ in range(count):
            places.append(len(encoded))
            encoded += bytes(8)
    return np.frombuffer(encoded, np.uint8).copy(), np.array(places, dtype=np.int64)


def _integer(value: int) -> bytes:
    """Encode with variable length: seven bits a byte, the last byte below 128."""
    encoded = bytearray()
    while value > 127:
        encoded.append(value & 127 | 128)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)


@compiled
def fill(encoded: Bytes, places: Indices, values: Array) -> None:
    """Put numbers into a message that `doubles` gave."""
    octets = values.view(np.uint8)
    for k in range(places.shape[0]):
        for i in range(8):
            encoded[places[k] + i] = octets[8 * k + i]
