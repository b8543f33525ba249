from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ResendStretch(_message.Message):
    __slots__ = ("topic", "session", "after_publish_ns", "before_publish_ns")
    TOPIC_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    AFTER_PUBLISH_NS_FIELD_NUMBER: _ClassVar[int]
    BEFORE_PUBLISH_NS_FIELD_NUMBER: _ClassVar[int]
    topic: str
    session: int
    after_publish_ns: int
    before_publish_ns: int
    def __init__(self, topic: _Optional[str] = ..., session: _Optional[int] = ..., after_publish_ns: _Optional[int] = ..., before_publish_ns: _Optional[int] = ...) -> None: ...

class ResendRequest(_message.Message):
    __slots__ = ("stretches", "expression", "after_publish_ns", "before_publish_ns", "always")
    STRETCHES_FIELD_NUMBER: _ClassVar[int]
    EXPRESSION_FIELD_NUMBER: _ClassVar[int]
    AFTER_PUBLISH_NS_FIELD_NUMBER: _ClassVar[int]
    BEFORE_PUBLISH_NS_FIELD_NUMBER: _ClassVar[int]
    ALWAYS_FIELD_NUMBER: _ClassVar[int]
    stretches: _containers.RepeatedCompositeFieldContainer[ResendStretch]
    expression: str
    after_publish_ns: int
    before_publish_ns: int
    always: bool
    def __init__(self, stretches: _Optional[_Iterable[_Union[ResendStretch, _Mapping]]] = ..., expression: _Optional[str] = ..., after_publish_ns: _Optional[int] = ..., before_publish_ns: _Optional[int] = ..., always: _Optional[bool] = ...) -> None: ...

class ResentMessage(_message.Message):
    __slots__ = ("publish_ns", "sequence", "encoding", "payload")
    PUBLISH_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    ENCODING_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_FIELD_NUMBER: _ClassVar[int]
    publish_ns: int
    sequence: int
    encoding: str
    payload: bytes
    def __init__(self, publish_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., encoding: _Optional[str] = ..., payload: _Optional[bytes] = ...) -> None: ...

class ResentStretch(_message.Message):
    __slots__ = ("topic", "after_publish_ns", "before_publish_ns", "after_sequence", "newest_publish_ns", "more", "messages")
    TOPIC_FIELD_NUMBER: _ClassVar[int]
    AFTER_PUBLISH_NS_FIELD_NUMBER: _ClassVar[int]
    BEFORE_PUBLISH_NS_FIELD_NUMBER: _ClassVar[int]
    AFTER_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    NEWEST_PUBLISH_NS_FIELD_NUMBER: _ClassVar[int]
    MORE_FIELD_NUMBER: _ClassVar[int]
    MESSAGES_FIELD_NUMBER: _ClassVar[int]
    topic: str
    after_publish_ns: int
    before_publish_ns: int
    after_sequence: int
    newest_publish_ns: int
    more: bool
    messages: _containers.RepeatedCompositeFieldContainer[ResentMessage]
    def __init__(self, topic: _Optional[str] = ..., after_publish_ns: _Optional[int] = ..., before_publish_ns: _Optional[int] = ..., after_sequence: _Optional[int] = ..., newest_publish_ns: _Optional[int] = ..., more: _Optional[bool] = ..., messages: _Optional[_Iterable[_Union[ResentMessage, _Mapping]]] = ...) -> None: ...

class ResendAnswer(_message.Message):
    __slots__ = ("session", "stretches", "more")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    STRETCHES_FIELD_NUMBER: _ClassVar[int]
    MORE_FIELD_NUMBER: _ClassVar[int]
    session: int
    stretches: _containers.RepeatedCompositeFieldContainer[ResentStretch]
    more: bool
    def __init__(self, session: _Optional[int] = ..., stretches: _Optional[_Iterable[_Union[ResentStretch, _Mapping]]] = ..., more: _Optional[bool] = ...) -> None: ...
