"""What a record has of inputs, fixes and truth, beside what the processors make of it."""

from __future__ import annotations

from collections.abc import Sequence

from tramstream import keys
from tramstream.processor import Processor
from tramstream.proto.gnss_pb2 import UbxFrame
from tramstream.proto.raw_pb2 import CanFrames, RawBytes
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import Record

_AS_READ = {type_.DESCRIPTOR.full_name for type_ in (RawBytes, CanFrames, UbxFrame)}
"""Bytes of devices: what decoders made of them is beside them, and they are most of a record."""


def copy_inputs(record: Record, target: RecordFile, processors: Sequence[Processor]) -> int:
    """Append to `target` what the processors read, and all else of the layer raw, as it is.

    Their own outputs, which are made again, and devices' bytes are left out; so is what tells of
    the live run (ticks, snapshots), for it is not the run that made these outputs.

    Returns
    -------
    int
        How many messages.
    """
    made = {key.path for each in processors for key in each.outputs}
    read = {key.path for each in processors for key in each.inputs} - {keys.SYNC_TICK.path}

    def wanted(topic: str) -> bool:
        path = keys.split(topic)[1]
        if path in made or keys.is_apart(topic) or record.type_of(topic) in _AS_READ:
            return False
        return path in read or path.startswith(f"{keys.GNSS_FIX.layer}/")

    count = 0
    for entry in record.messages(wanted):
        kind = keys.find(keys.split(entry.topic)[1]) or record.class_of(entry.topic)
        if isinstance(kind, str):  # of no type that the record describes
            kind = "protobuf"
        sent = entry.log_ns, entry.publish_ns, entry.sequence
        target.append(entry.topic, kind, entry.payload, *sent)
        count += 1
    return count
