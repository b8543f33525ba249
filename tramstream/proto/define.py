"""A message type in one line of Python, for processors of other packages: nobody needs protoc.

    Comfort = message("comfort.Comfort", horizontal_mps2=float, uncomfortable=bool)

`stamp_ns` and `sequence` come first; fields are numbered in the order in which they stand, so new
ones are added at the end. Whoever has a `.proto` file compiles that instead; to readers there is no
difference.
"""

from __future__ import annotations

from typing import Any, get_args, get_origin

from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
from google.protobuf.descriptor_pb2 import FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass

KINDS = {
    float: Field.TYPE_DOUBLE,
    int: Field.TYPE_SINT64,
    bool: Field.TYPE_BOOL,
    str: Field.TYPE_STRING,
    bytes: Field.TYPE_BYTES,
}


def message(name: str, **fields: Any) -> Any:
    """Make a message class.

    Parameters
    ----------
    name : str
        Full name, `package.Message`; no two packages may have the same.
    **fields : type
        float, int, bool, str, bytes, or a list of one of these (`list[float]`); units in the names.

    Raises
    ------
    ValueError
        If the name has no package, or a field is of no such type.
    """
    package, _, short = name.rpartition(".")
    if not package or not short.isidentifier():
        raise ValueError(f"message {name!r}: must be package.Message")
    file = FileDescriptorProto(name=f"{name}.proto", package=package, syntax="proto3")
    made = file.message_type.add(name=short)
    made.field.add(name="stamp_ns", number=1, type=Field.TYPE_INT64, label=Field.LABEL_OPTIONAL)
    made.field.add(name="sequence", number=2, type=Field.TYPE_UINT64, label=Field.LABEL_OPTIONAL)
    for number, (field, type_) in enumerate(fields.items(), start=3):
        many = get_origin(type_) is list
        kind = KINDS.get(get_args(type_)[0] if many else type_)
        if kind is None:
            known = ", ".join(each.__name__ for each in KINDS)
            raise ValueError(f"message {name!r}: {field} must be one of {known}, or a list of one")
        label = Field.LABEL_REPEATED if many else Field.LABEL_OPTIONAL
        made.field.add(name=field, number=number, type=kind, label=label)
    pool = DescriptorPool()
    pool.Add(file)
    class_: type[Message] = GetMessageClass(pool.FindMessageTypeByName(name))
    return class_
