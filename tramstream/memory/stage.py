"""What a stage remembers: one dataclass, which is copied, put back, and kept as plain data.

A part of a stage (a framer, a clock fit) either is such a dataclass, where it has no settings, or
has one; its owner's memory holds it as a field. So the memory of a stage is one tree:

    @dataclass
    class BridgeMemory:
        framer: Framer = field(default_factory=Framer)
        clock: ClockMemory = field(default_factory=ClockMemory)
        reads: deque[tuple[int, int]] = field(default_factory=deque)
        covariance: GnssCovariance | None = None

What a field may hold stands in its annotation: numbers, texts, bytes, enumerations, protobuf
messages, numpy arrays (structured ones too), dataclasses, named tuples, and lists, deques, sets,
tuples and dictionaries of these; `| None` where it may be missing. Messages, named tuples of values
and frozen dataclasses are values: nobody changes them, and copies share them.

`assign` fills in place: dataclasses, arrays, lists and dictionaries stay the objects that they are,
so that a part which holds its memory, or a view of its numbers, goes on with it. For that an array
keeps its shape; one that does not is annotated as `Varying`
(`tramstream/memory/annotations.py`). What a constructor does not take
(`init=False`) is derived, and no part of memory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar, cast

if TYPE_CHECKING:
    from tramstream.memory.kinds import Kind

State = dict[str, Any]
"""Plain data: None, bool, int, float, str, bytes, lists, dicts and numpy arrays of these."""
Memory = TypeVar("Memory")


def copied(memory: Memory) -> Memory:
    """A memory of the same contents, which shares nothing that anybody changes."""
    return cast("Memory", _kind(type(memory)).copy(memory))


def assign(memory: Memory, other: Memory) -> None:
    """Give `memory` the contents of `other`, in place; they share nothing afterwards.

    Raises
    ------
    TypeError
        If `other` is of another class, or an array has another shape or type.
    """
    if type(other) is not type(memory):
        raise TypeError(f"memory of another version: {type(other)} instead of {type(memory)}")
    _kind(type(memory)).merge(memory, other)


def to_plain(memory: Any) -> State:
    """A memory as plain data, which share nothing with it."""
    state: State = _kind(type(memory)).plain(memory)
    return state


def from_plain(kind: type[Memory], state: State) -> Memory:
    """The memory of class `kind` of which `to_plain` made `state`; they share nothing.

    Raises
    ------
    TypeError
        If it is of another version: with other fields, or values of other types.
    """
    return cast("Memory", _kind(kind).read(state, kind.__name__))


def check(kind: type) -> None:
    """See to it that memories of class `kind` can be kept.

    Raises
    ------
    TypeError
        If it is no dataclass, or a field is annotated with what cannot be kept.
    """
    _kind(kind)


_kinds: dict[type, Kind] = {}


def _kind(kind: type) -> Kind:
    if kind not in _kinds:
        # Not before it is needed: routers and supervisors have no memory, and do without numpy's
        # 15 MB.
        from tramstream.memory.annotations import dataclass_kind

        _kinds[kind] = dataclass_kind(kind)
    return _kinds[kind]
