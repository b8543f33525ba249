from tramstream.proto import gnss_pb2 as _gnss_pb2
from tramstream.proto import raw_pb2 as _raw_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ImuMean(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "first_sample_sequence", "sample_count", "bridged_count", "interval_s", "gyro_x_radps", "gyro_y_radps", "gyro_z_radps", "accel_x_mps2", "accel_y_mps2", "accel_z_mps2", "temperature_degc", "gyro_x_std_radps", "gyro_y_std_radps", "gyro_z_std_radps", "accel_x_std_mps2", "accel_y_std_mps2", "accel_z_std_mps2")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    FIRST_SAMPLE_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SAMPLE_COUNT_FIELD_NUMBER: _ClassVar[int]
    BRIDGED_COUNT_FIELD_NUMBER: _ClassVar[int]
    INTERVAL_S_FIELD_NUMBER: _ClassVar[int]
    GYRO_X_RADPS_FIELD_NUMBER: _ClassVar[int]
    GYRO_Y_RADPS_FIELD_NUMBER: _ClassVar[int]
    GYRO_Z_RADPS_FIELD_NUMBER: _ClassVar[int]
    ACCEL_X_MPS2_FIELD_NUMBER: _ClassVar[int]
    ACCEL_Y_MPS2_FIELD_NUMBER: _ClassVar[int]
    ACCEL_Z_MPS2_FIELD_NUMBER: _ClassVar[int]
    TEMPERATURE_DEGC_FIELD_NUMBER: _ClassVar[int]
    GYRO_X_STD_RADPS_FIELD_NUMBER: _ClassVar[int]
    GYRO_Y_STD_RADPS_FIELD_NUMBER: _ClassVar[int]
    GYRO_Z_STD_RADPS_FIELD_NUMBER: _ClassVar[int]
    ACCEL_X_STD_MPS2_FIELD_NUMBER: _ClassVar[int]
    ACCEL_Y_STD_MPS2_FIELD_NUMBER: _ClassVar[int]
    ACCEL_Z_STD_MPS2_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    first_sample_sequence: int
    sample_count: int
    bridged_count: int
    interval_s: float
    gyro_x_radps: float
    gyro_y_radps: float
    gyro_z_radps: float
    accel_x_mps2: float
    accel_y_mps2: float
    accel_z_mps2: float
    temperature_degc: float
    gyro_x_std_radps: float
    gyro_y_std_radps: float
    gyro_z_std_radps: float
    accel_x_std_mps2: float
    accel_y_std_mps2: float
    accel_z_std_mps2: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., first_sample_sequence: _Optional[int] = ..., sample_count: _Optional[int] = ..., bridged_count: _Optional[int] = ..., interval_s: _Optional[float] = ..., gyro_x_radps: _Optional[float] = ..., gyro_y_radps: _Optional[float] = ..., gyro_z_radps: _Optional[float] = ..., accel_x_mps2: _Optional[float] = ..., accel_y_mps2: _Optional[float] = ..., accel_z_mps2: _Optional[float] = ..., temperature_degc: _Optional[float] = ..., gyro_x_std_radps: _Optional[float] = ..., gyro_y_std_radps: _Optional[float] = ..., gyro_z_std_radps: _Optional[float] = ..., accel_x_std_mps2: _Optional[float] = ..., accel_y_std_mps2: _Optional[float] = ..., accel_z_std_mps2: _Optional[float] = ...) -> None: ...

class SyncFrame(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "imu", "gnss", "odometry", "ahead")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    IMU_FIELD_NUMBER: _ClassVar[int]
    GNSS_FIELD_NUMBER: _ClassVar[int]
    ODOMETRY_FIELD_NUMBER: _ClassVar[int]
    AHEAD_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    imu: ImuMean
    gnss: _containers.RepeatedCompositeFieldContainer[_gnss_pb2.GnssFix]
    odometry: _containers.RepeatedCompositeFieldContainer[_raw_pb2.Odometry]
    ahead: _containers.RepeatedCompositeFieldContainer[ImuMean]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., imu: _Optional[_Union[ImuMean, _Mapping]] = ..., gnss: _Optional[_Iterable[_Union[_gnss_pb2.GnssFix, _Mapping]]] = ..., odometry: _Optional[_Iterable[_Union[_raw_pb2.Odometry, _Mapping]]] = ..., ahead: _Optional[_Iterable[_Union[ImuMean, _Mapping]]] = ...) -> None: ...

class SyncGap(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "first_missing", "missing_count", "duration_s", "bridged")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    FIRST_MISSING_FIELD_NUMBER: _ClassVar[int]
    MISSING_COUNT_FIELD_NUMBER: _ClassVar[int]
    DURATION_S_FIELD_NUMBER: _ClassVar[int]
    BRIDGED_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    first_missing: int
    missing_count: int
    duration_s: float
    bridged: bool
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., first_missing: _Optional[int] = ..., missing_count: _Optional[int] = ..., duration_s: _Optional[float] = ..., bridged: _Optional[bool] = ...) -> None: ...

class LateSample(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "key", "source_sequence", "source_publish_ns", "horizon_ns")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    KEY_FIELD_NUMBER: _ClassVar[int]
    SOURCE_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_PUBLISH_NS_FIELD_NUMBER: _ClassVar[int]
    HORIZON_NS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    key: str
    source_sequence: int
    source_publish_ns: int
    horizon_ns: int
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., key: _Optional[str] = ..., source_sequence: _Optional[int] = ..., source_publish_ns: _Optional[int] = ..., horizon_ns: _Optional[int] = ...) -> None: ...

class Position(_message.Message):
    __slots__ = ("key", "first_publish_ns", "last_publish_ns", "count", "first_stamp_ns")
    KEY_FIELD_NUMBER: _ClassVar[int]
    FIRST_PUBLISH_NS_FIELD_NUMBER: _ClassVar[int]
    LAST_PUBLISH_NS_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    FIRST_STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    key: str
    first_publish_ns: int
    last_publish_ns: int
    count: int
    first_stamp_ns: int
    def __init__(self, key: _Optional[str] = ..., first_publish_ns: _Optional[int] = ..., last_publish_ns: _Optional[int] = ..., count: _Optional[int] = ..., first_stamp_ns: _Optional[int] = ...) -> None: ...

class Tick(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "session", "positions")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    session: int
    positions: _containers.RepeatedCompositeFieldContainer[Position]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., session: _Optional[int] = ..., positions: _Optional[_Iterable[_Union[Position, _Mapping]]] = ...) -> None: ...

class ProcessorState(_message.Message):
    __slots__ = ("name", "state")
    NAME_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    name: str
    state: bytes
    def __init__(self, name: _Optional[str] = ..., state: _Optional[bytes] = ...) -> None: ...

class Snapshot(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "session", "start", "tick_sequence", "positions", "states", "configuration")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    START_FIELD_NUMBER: _ClassVar[int]
    TICK_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    STATES_FIELD_NUMBER: _ClassVar[int]
    CONFIGURATION_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    session: int
    start: bool
    tick_sequence: int
    positions: _containers.RepeatedCompositeFieldContainer[Position]
    states: _containers.RepeatedCompositeFieldContainer[ProcessorState]
    configuration: str
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., session: _Optional[int] = ..., start: _Optional[bool] = ..., tick_sequence: _Optional[int] = ..., positions: _Optional[_Iterable[_Union[Position, _Mapping]]] = ..., states: _Optional[_Iterable[_Union[ProcessorState, _Mapping]]] = ..., configuration: _Optional[str] = ...) -> None: ...
