"""A digest of all that a kernel's machine code is made of.

The compiler sees a function's bytecode, the values of the globals that it names (numbers become
constants in the code), the functions that it calls, and the types of its arguments. All of them
count, and nothing else does: neither where a file lies nor its time, no docstring, no line number.
What the digest does not know it refuses: to leave it out would run old code after an edit.
"""

from __future__ import annotations

import enum
import hashlib
import types as python
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numba.core import types
from numba.core.dispatcher import Dispatcher

_PLAIN = (int, float, complex, bool, str, bytes, type(None), np.generic)


def digest_of_function(function: Callable[..., Any]) -> str:
    """Digest of a kernel and everything that it reaches.

    Raises
    ------
    TypeError
        If it names a global of a kind that cannot be told apart by its value.
    """
    digest = hashlib.sha256()
    for word in _function(function, set()):
        digest.update(f"{len(word)}:{word}".encode())
    return digest.hexdigest()


def digest_of_type(kind: Any) -> str:
    """Digest of an argument's type: its name, and the fields of a named tuple, which it lacks."""
    return hashlib.sha256("|".join(_type(kind)).encode()).hexdigest()


def _type(kind: Any) -> Iterator[str]:
    yield str(kind)
    members: Any = kind  # numba tells the type checker little
    if isinstance(kind, types.BaseNamedTuple):
        yield from _named(members.instance_class)
    if isinstance(kind, types.BaseTuple):
        for each in members:
            yield from _type(each)
    if isinstance(kind, types.Array):
        yield from _type(kind.dtype)


def _named(cls: type) -> Iterator[str]:
    yield f"{cls.__module__}.{cls.__qualname__}"
    yield from getattr(cls, "_fields", ())


def _function(function: Callable[..., Any], seen: set[int]) -> Iterator[str]:
    """What a function is made of; `seen` are those met before, itself perhaps."""
    yield f"{function.__module__}.{function.__qualname__}"
    if id(function) in seen:
        return
    seen.add(id(function))
    code = function.__code__
    yield from _code(code, function.__doc__)
    yield from _value("defaults", getattr(function, "__defaults__", None) or (), seen, set())
    names = _names(code)
    for name in sorted(names & function.__globals__.keys()):
        yield name
        yield from _value(name, function.__globals__[name], seen, names)
    cells = function.__closure__ or ()
    for name, cell in zip(code.co_freevars, cells, strict=True):
        yield name
        yield from _value(name, cell.cell_contents, seen, names)


def _code(code: python.CodeType, doc: str | None) -> Iterator[str]:
    yield code.co_code.hex()
    yield repr((code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars))
    yield repr((code.co_argcount, code.co_kwonlyargcount, code.co_flags))
    for constant in code.co_consts:
        if isinstance(constant, python.CodeType):
            yield from _code(constant, None)
        elif not (isinstance(constant, str) and constant == doc):
            yield f"{type(constant).__name__} {constant!r}"


def _names(code: python.CodeType) -> set[str]:
    """Every global or attribute that code names, that of functions within it too."""
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, python.CodeType):
            names |= _names(constant)
    return names


def _value(name: str, value: Any, seen: set[int], names: set[str]) -> Iterator[str]:
    """What a global is to the compiler; `names` are the attributes that may be asked of it."""
    if isinstance(value, Dispatcher):
        yield from _function(value.py_func, seen)
    elif isinstance(value, enum.Enum):
        yield f"{type(value).__qualname__}.{value.name} {value.value!r}"
    elif isinstance(value, _PLAIN):
        yield f"{type(value).__name__} {value!r}"
    elif isinstance(value, slice):
        for each in (value.start, value.stop, value.step):
            yield from _value(name, each, seen, names)
    elif isinstance(value, tuple):
        yield from _named(type(value))
        for each in value:
            yield from _value(name, each, seen, names)
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype.descr} {value.shape} {value.tobytes().hex()}"
    elif isinstance(value, np.dtype):
        yield f"{value.descr} {value.isalignedstruct}"
    elif isinstance(value, types.Type):
        yield from _type(value)
    elif isinstance(value, python.ModuleType):
        yield from _module(value, seen, names)
    elif isinstance(value, type):
        yield from _class(value, seen, names)
    elif isinstance(value, python.BuiltinFunctionType | np.ufunc):
        yield f"{getattr(value, '__module__', '')}.{value.__name__}"
    elif isinstance(value, python.FunctionType):
        if _ours(value.__module__):
            yield from _function(value, seen)
        else:
            yield f"{value.__module__}.{value.__qualname__}"
    else:
        raise TypeError(
            f"{name}: a kernel cannot be told apart by a {type(value).__name__}; "
            "hand it in as an argument, or as numbers"
        )


def _ours(module: str | None) -> bool:
    """Whether a module's source may be edited: what numba, numpy and Python bring has a version."""
    return (module or "").partition(".")[0] not in {"numba", "numpy", "math", "builtins", "cmath"}


def _module(module: python.ModuleType, seen: set[int], names: set[str]) -> Iterator[str]:
    yield module.__name__
    if not _ours(module.__name__):
        return
    for name in sorted(names & vars(module).keys()):
        yield name
        yield from _value(f"{module.__name__}.{name}", vars(module)[name], seen, names)


def _class(cls: type, seen: set[int], names: set[str]) -> Iterator[str]:
    yield from _named(cls)
    if not _ours(cls.__module__):
        return
    if issubclass(cls, enum.Enum):
        yield repr([(each.name, each.value) for each in cls])
        return
    for name in sorted(names & vars(cls).keys()):
        value = vars(cls)[name]
        if not hasattr(type(value), "__get__"):
            yield name
            yield from _value(f"{cls.__name__}.{name}", value, seen, names)
