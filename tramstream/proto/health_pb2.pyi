from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Event(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "source", "kind", "severity", "facts", "sentence", "cure", "unsaid")
    class Severity(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        INFO: _ClassVar[Event.Severity]
        WARNING: _ClassVar[Event.Severity]
        ERROR: _ClassVar[Event.Severity]
        DEBUG: _ClassVar[Event.Severity]
    INFO: Event.Severity
    WARNING: Event.Severity
    ERROR: Event.Severity
    DEBUG: Event.Severity
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    SEVERITY_FIELD_NUMBER: _ClassVar[int]
    FACTS_FIELD_NUMBER: _ClassVar[int]
    SENTENCE_FIELD_NUMBER: _ClassVar[int]
    CURE_FIELD_NUMBER: _ClassVar[int]
    UNSAID_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    source: str
    kind: str
    severity: Event.Severity
    facts: _containers.RepeatedCompositeFieldContainer[Fact]
    sentence: str
    cure: str
    unsaid: int
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., source: _Optional[str] = ..., kind: _Optional[str] = ..., severity: _Optional[_Union[Event.Severity, str]] = ..., facts: _Optional[_Iterable[_Union[Fact, _Mapping]]] = ..., sentence: _Optional[str] = ..., cure: _Optional[str] = ..., unsaid: _Optional[int] = ...) -> None: ...

class Fact(_message.Message):
    __slots__ = ("name", "unit", "number", "integer", "text")
    NAME_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    INTEGER_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    name: str
    unit: str
    number: float
    integer: int
    text: str
    def __init__(self, name: _Optional[str] = ..., unit: _Optional[str] = ..., number: _Optional[float] = ..., integer: _Optional[int] = ..., text: _Optional[str] = ...) -> None: ...

class StageLedger(_message.Message):
    __slots__ = ("stage", "unit", "received", "delivered", "dropped", "pending")
    STAGE_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    RECEIVED_FIELD_NUMBER: _ClassVar[int]
    DELIVERED_FIELD_NUMBER: _ClassVar[int]
    DROPPED_FIELD_NUMBER: _ClassVar[int]
    PENDING_FIELD_NUMBER: _ClassVar[int]
    stage: str
    unit: str
    received: int
    delivered: int
    dropped: int
    pending: int
    def __init__(self, stage: _Optional[str] = ..., unit: _Optional[str] = ..., received: _Optional[int] = ..., delivered: _Optional[int] = ..., dropped: _Optional[int] = ..., pending: _Optional[int] = ...) -> None: ...

class NodeHealth(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "node", "state", "text", "pid", "uptime_s", "cpu_s", "rss_bytes", "messages_lost", "faults", "stages", "troubles")
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        OK: _ClassVar[NodeHealth.State]
        DEGRADED: _ClassVar[NodeHealth.State]
        FAILED: _ClassVar[NodeHealth.State]
    OK: NodeHealth.State
    DEGRADED: NodeHealth.State
    FAILED: NodeHealth.State
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    NODE_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    PID_FIELD_NUMBER: _ClassVar[int]
    UPTIME_S_FIELD_NUMBER: _ClassVar[int]
    CPU_S_FIELD_NUMBER: _ClassVar[int]
    RSS_BYTES_FIELD_NUMBER: _ClassVar[int]
    MESSAGES_LOST_FIELD_NUMBER: _ClassVar[int]
    FAULTS_FIELD_NUMBER: _ClassVar[int]
    STAGES_FIELD_NUMBER: _ClassVar[int]
    TROUBLES_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    node: str
    state: NodeHealth.State
    text: str
    pid: int
    uptime_s: float
    cpu_s: float
    rss_bytes: int
    messages_lost: int
    faults: int
    stages: _containers.RepeatedCompositeFieldContainer[StageLedger]
    troubles: _containers.RepeatedCompositeFieldContainer[Event]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., node: _Optional[str] = ..., state: _Optional[_Union[NodeHealth.State, str]] = ..., text: _Optional[str] = ..., pid: _Optional[int] = ..., uptime_s: _Optional[float] = ..., cpu_s: _Optional[float] = ..., rss_bytes: _Optional[int] = ..., messages_lost: _Optional[int] = ..., faults: _Optional[int] = ..., stages: _Optional[_Iterable[_Union[StageLedger, _Mapping]]] = ..., troubles: _Optional[_Iterable[_Union[Event, _Mapping]]] = ...) -> None: ...

class DeviceHealth(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "device", "port", "state", "text", "opened", "bytes_received", "messages_decoded", "frames_rejected", "bytes_rejected", "samples_lost", "silence_s", "clock_offset_s", "clock_skew_ppm", "clock_residual_s", "rejected_by_reason", "trouble")
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        OPEN: _ClassVar[DeviceHealth.State]
        SILENT: _ClassVar[DeviceHealth.State]
        LOST: _ClassVar[DeviceHealth.State]
    OPEN: DeviceHealth.State
    SILENT: DeviceHealth.State
    LOST: DeviceHealth.State
    class RejectedByReasonEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    DEVICE_FIELD_NUMBER: _ClassVar[int]
    PORT_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    OPENED_FIELD_NUMBER: _ClassVar[int]
    BYTES_RECEIVED_FIELD_NUMBER: _ClassVar[int]
    MESSAGES_DECODED_FIELD_NUMBER: _ClassVar[int]
    FRAMES_REJECTED_FIELD_NUMBER: _ClassVar[int]
    BYTES_REJECTED_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_LOST_FIELD_NUMBER: _ClassVar[int]
    SILENCE_S_FIELD_NUMBER: _ClassVar[int]
    CLOCK_OFFSET_S_FIELD_NUMBER: _ClassVar[int]
    CLOCK_SKEW_PPM_FIELD_NUMBER: _ClassVar[int]
    CLOCK_RESIDUAL_S_FIELD_NUMBER: _ClassVar[int]
    REJECTED_BY_REASON_FIELD_NUMBER: _ClassVar[int]
    TROUBLE_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    device: str
    port: str
    state: DeviceHealth.State
    text: str
    opened: int
    bytes_received: int
    messages_decoded: int
    frames_rejected: int
    bytes_rejected: int
    samples_lost: int
    silence_s: float
    clock_offset_s: float
    clock_skew_ppm: float
    clock_residual_s: float
    rejected_by_reason: _containers.ScalarMap[str, int]
    trouble: Event
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., device: _Optional[str] = ..., port: _Optional[str] = ..., state: _Optional[_Union[DeviceHealth.State, str]] = ..., text: _Optional[str] = ..., opened: _Optional[int] = ..., bytes_received: _Optional[int] = ..., messages_decoded: _Optional[int] = ..., frames_rejected: _Optional[int] = ..., bytes_rejected: _Optional[int] = ..., samples_lost: _Optional[int] = ..., silence_s: _Optional[float] = ..., clock_offset_s: _Optional[float] = ..., clock_skew_ppm: _Optional[float] = ..., clock_residual_s: _Optional[float] = ..., rejected_by_reason: _Optional[_Mapping[str, int]] = ..., trouble: _Optional[_Union[Event, _Mapping]] = ...) -> None: ...

class Loss(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "consumer", "key", "count", "after_publish_ns", "before_publish_ns", "cause")
    class Cause(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        BUS: _ClassVar[Loss.Cause]
        QUEUE: _ClassVar[Loss.Cause]
        DISK: _ClassVar[Loss.Cause]
        ABSENT: _ClassVar[Loss.Cause]
        UNDECODABLE: _ClassVar[Loss.Cause]
        STAMP: _ClassVar[Loss.Cause]
        SOURCE: _ClassVar[Loss.Cause]
    BUS: Loss.Cause
    QUEUE: Loss.Cause
    DISK: Loss.Cause
    ABSENT: Loss.Cause
    UNDECODABLE: Loss.Cause
    STAMP: Loss.Cause
    SOURCE: Loss.Cause
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    CONSUMER_FIELD_NUMBER: _ClassVar[int]
    KEY_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    AFTER_PUBLISH_NS_FIELD_NUMBER: _ClassVar[int]
    BEFORE_PUBLISH_NS_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    consumer: str
    key: str
    count: int
    after_publish_ns: int
    before_publish_ns: int
    cause: Loss.Cause
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., consumer: _Optional[str] = ..., key: _Optional[str] = ..., count: _Optional[int] = ..., after_publish_ns: _Optional[int] = ..., before_publish_ns: _Optional[int] = ..., cause: _Optional[_Union[Loss.Cause, str]] = ...) -> None: ...

class ClockReference(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "host_utc_ns", "boot_id")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    HOST_UTC_NS_FIELD_NUMBER: _ClassVar[int]
    BOOT_ID_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    host_utc_ns: int
    boot_id: str
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., host_utc_ns: _Optional[int] = ..., boot_id: _Optional[str] = ...) -> None: ...
