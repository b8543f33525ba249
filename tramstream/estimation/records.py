"""Structured records for compiled code, declared once as a class of annotated fields.

A kernel says `c.gravity`, not `c[0]`. The class is what mypy sees and where each field's unit is
told; `dtype_of` makes the numpy type that numba compiles for. Kernels that Python calls take the
numbers of a record as a plain array and see it as one at once: `c = parameters.view(PARAMETERS)[0]`
(eight bytes a field make that possible). On a busy core a call with four or five arguments took

    plain arrays                        0.5 µs
    plain arrays, seen as records       0.6 µs
    arrays of one record                1.3 to 2.1 µs: their types are looked up each time
    a named tuple of thirty numbers     2.8 µs
    records themselves                  7.7 µs: they go through the buffer protocol

(numba 0.68). A read-only array is looked up as slowly: what is frozen is what Python code sees.
"""

from __future__ import annotations

from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

Records = NDArray[np.void]
"""Array of records; those of one record have the shape (1,)."""
_SCALARS: dict[Any, str] = {float: "f8", int: "i8"}


def dtype_of(fields: type) -> np.dtype[np.void]:
    """Give the numpy type of a record whose fields a class annotates.

    `float` and `int` have eight bytes; arrays are `Annotated[Array, shape]` or
    `Annotated[Indices, shape]`; another such class is a record inside.

    Raises
    ------
    TypeError
        For any other annotation.
    """
    hints = get_type_hints(fields, include_extras=True)
    return np.dtype([(name, *_field(hint)) for name, hint in hints.items()])


def _field(hint: Any) -> tuple[Any, ...]:
    if get_origin(hint) is Annotated:
        array, shape = get_args(hint)
        scalar = get_args(get_args(array)[1])[0]
        return np.dtype(scalar), shape
    if hint in _SCALARS:
        return (_SCALARS[hint],)
    if isinstance(hint, type) and get_type_hints(hint):
        return (dtype_of(hint),)
    raise TypeError(f"a record cannot hold a {hint}")


def one(dtype: np.dtype[np.void]) -> Records:
    """Make one record of zeros, as the array that kernels take."""
    return np.zeros(1, dtype)


def frozen(record: Records) -> Records:
    """Give a view of a record through which nobody changes it."""
    view = record.view()
    view.setflags(write=False)
    return view


def numbers(record: Records) -> NDArray[np.float64]:
    """View one record of floating-point fields as plain numbers, in the order of its fields."""
    return record.view(np.float64)
