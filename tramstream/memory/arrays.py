"""numpy's `.npy` form out of files of strangers: what its head claims must be what is there."""

from __future__ import annotations

import io
import math
import tokenize
from typing import Any

import numpy as np
from numpy.typing import NDArray

_NO_HEAD = (
    ValueError,
    TypeError,
    SyntaxError,
    KeyError,
    MemoryError,
    RecursionError,
    tokenize.TokenError,
)
"""What numpy raises for heads that are none: it reads them as Python."""


def read_npy(data: bytes | memoryview) -> NDArray[Any]:
    """An array whose head and length agree.

    `numpy.lib.format.read_array` makes room for what the head claims before it looks for it: 100
    bytes may claim 128 GiB.

    Raises
    ------
    ValueError
        If it is no array, one of Python's objects, or the head claims more or less than there is.
    """
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read_head = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, is_fortran, kind = read_head(stream)
        size = math.prod(shape) * kind.itemsize
    except _NO_HEAD as error:
        raise ValueError(f"no array in .npy form ({error})") from error
    if kind.hasobject or not kind.itemsize or min(shape, default=0) < 0:
        raise ValueError(f"an array of {kind}")
    begin = stream.tell()
    if size != len(data) - begin:
        raise ValueError(f"an array that claims {size} bytes and has {len(data) - begin}")
    flat = np.frombuffer(data, dtype=kind, offset=begin) if size else np.empty(0, kind)
    array: NDArray[Any] = flat.reshape(shape, order="F" if is_fortran else "C").copy(order="K")
    return array
