"""Processors' memory as bytes: on the bus for the record, in a file for a restart.

MessagePack with one extension for numpy arrays: nothing in a snapshot can run code.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from google.protobuf.message import DecodeError

from tramstream import private
from tramstream.clock import S
from tramstream.events.kinds import Event
from tramstream.live.events import SNAPSHOT_UNREADABLE
from tramstream.memory.arrays import read_npy
from tramstream.processor import Processor
from tramstream.proto.sync_pb2 import ProcessorState, Snapshot

ARRAY = 1
"""MessagePack extension type: a numpy array in .npy form."""
MAX_AGE_S = 60.0
"""Older memory is worth less than a fresh start."""


def _encode(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        buffer = io.BytesIO()
        np.save(buffer, value, allow_pickle=False)
        return msgspec.msgpack.Ext(ARRAY, buffer.getvalue())
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a snapshot cannot hold a {type(value).__name__}")


def _decode(code: int, data: memoryview) -> Any:
    if code != ARRAY:
        raise ValueError(f"a snapshot holds the unknown extension {code}")
    return read_npy(data)


def pack(state: dict[str, Any]) -> bytes:
    """Plain data to bytes; see `tramstream.processor.State` for what it may hold."""
    return msgspec.msgpack.encode(state, enc_hook=_encode)


def unpack(data: bytes) -> dict[str, Any]:
    state: dict[str, Any] = msgspec.msgpack.decode(data, ext_hook=_decode)
    return state


def take(processors: Sequence[Processor]) -> list[ProcessorState]:
    """Memory of all processors."""
    return [ProcessorState(name=p.name, state=pack(p.snapshot())) for p in processors]


def restore(snapshot: Snapshot, processors: Sequence[Processor], some: bool = False) -> bool:
    """Put the memory back; False, and nothing changed, if it is of other processors.

    The same processors of another version count as others: what they remember has another shape.
    With `some`, processors that the snapshot does not know keep the memory they have.
    """
    states = {entry.name: entry.state for entry in snapshot.states}
    ours = {processor.name for processor in processors}
    if not set(states) <= ours or (set(states) != ours and not some):
        return False
    processors = [processor for processor in processors if processor.name in states]
    before = [processor.snapshot() for processor in processors]
    try:
        for processor in processors:
            processor.restore(unpack(states[processor.name]))
    except Exception:  # noqa: BLE001  whatever an unfit memory breaks: a node must start without it
        for processor, state in zip(processors, before, strict=True):
            processor.restore(state)
        return False
    return True


def fits(snapshot: Snapshot, processors: Sequence[Processor]) -> bool:
    """Whether `restore` would put the memory back, into some of `processors`; they keep theirs."""
    before = [processor.snapshot() for processor in processors]
    fit = restore(snapshot, processors, some=True)
    for processor, state in zip(processors, before, strict=True):
        processor.restore(state)
    return fit


def save(path: Path, snapshot: Snapshot) -> None:
    """Write the snapshot file so that a reader sees the old or the new one, never half of one."""
    private.write(path, snapshot.SerializeToString())


def load(path: Path, now_ns: int) -> Snapshot | Event | None:
    """The snapshot in `path` if it is young enough; what is wrong if it cannot be read."""
    try:
        snapshot = Snapshot.FromString(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, DecodeError) as error:
        return SNAPSHOT_UNREADABLE(path=path, reason=error)
    age_s = (now_ns - snapshot.stamp_ns) / S
    return snapshot if 0 <= age_s <= MAX_AGE_S else None
