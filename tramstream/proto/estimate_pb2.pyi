from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Innovation(_message.Message):
    __slots__ = ("measurement", "value", "variance", "accepted")
    MEASUREMENT_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    VARIANCE_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    measurement: str
    value: float
    variance: float
    accepted: bool
    def __init__(self, measurement: _Optional[str] = ..., value: _Optional[float] = ..., variance: _Optional[float] = ..., accepted: _Optional[bool] = ...) -> None: ...

class DistanceState(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "distance_m", "speed_mps", "distance_std_m", "speed_std_mps", "covariance", "innovations")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    SPEED_MPS_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_STD_M_FIELD_NUMBER: _ClassVar[int]
    SPEED_STD_MPS_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    INNOVATIONS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    distance_m: float
    speed_mps: float
    distance_std_m: float
    speed_std_mps: float
    covariance: _containers.RepeatedScalarFieldContainer[float]
    innovations: _containers.RepeatedCompositeFieldContainer[Innovation]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., distance_m: _Optional[float] = ..., speed_mps: _Optional[float] = ..., distance_std_m: _Optional[float] = ..., speed_std_mps: _Optional[float] = ..., covariance: _Optional[_Iterable[float]] = ..., innovations: _Optional[_Iterable[_Union[Innovation, _Mapping]]] = ...) -> None: ...
