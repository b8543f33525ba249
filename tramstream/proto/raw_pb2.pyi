from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class CanFlag(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CAN_FLAG_NONE: _ClassVar[CanFlag]
    CAN_FLAG_EXTENDED: _ClassVar[CanFlag]
    CAN_FLAG_ERROR: _ClassVar[CanFlag]
    CAN_FLAG_REMOTE: _ClassVar[CanFlag]
    CAN_FLAG_FD: _ClassVar[CanFlag]
CAN_FLAG_NONE: CanFlag
CAN_FLAG_EXTENDED: CanFlag
CAN_FLAG_ERROR: CanFlag
CAN_FLAG_REMOTE: CanFlag
CAN_FLAG_FD: CanFlag

class RawBytes(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "device", "data", "read_length", "read_offset_ns", "folding", "folded_from")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    DEVICE_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    READ_LENGTH_FIELD_NUMBER: _ClassVar[int]
    READ_OFFSET_NS_FIELD_NUMBER: _ClassVar[int]
    FOLDING_FIELD_NUMBER: _ClassVar[int]
    FOLDED_FROM_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    device: str
    data: bytes
    read_length: _containers.RepeatedScalarFieldContainer[int]
    read_offset_ns: _containers.RepeatedScalarFieldContainer[int]
    folding: str
    folded_from: int
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., device: _Optional[str] = ..., data: _Optional[bytes] = ..., read_length: _Optional[_Iterable[int]] = ..., read_offset_ns: _Optional[_Iterable[int]] = ..., folding: _Optional[str] = ..., folded_from: _Optional[int] = ...) -> None: ...

class CanFrames(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "device", "offset_ns", "id", "flags", "data", "read_stamps")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    DEVICE_FIELD_NUMBER: _ClassVar[int]
    OFFSET_NS_FIELD_NUMBER: _ClassVar[int]
    ID_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    READ_STAMPS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    device: str
    offset_ns: _containers.RepeatedScalarFieldContainer[int]
    id: _containers.RepeatedScalarFieldContainer[int]
    flags: _containers.RepeatedScalarFieldContainer[int]
    data: _containers.RepeatedScalarFieldContainer[bytes]
    read_stamps: bool
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., device: _Optional[str] = ..., offset_ns: _Optional[_Iterable[int]] = ..., id: _Optional[_Iterable[int]] = ..., flags: _Optional[_Iterable[int]] = ..., data: _Optional[_Iterable[bytes]] = ..., read_stamps: _Optional[bool] = ...) -> None: ...

class ImuBatch(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "model", "first_sample_sequence", "period_ns", "gyro_scale_radps", "accel_scale_mps2", "temperature_scale_degc", "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z", "temperature", "diag_stat")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    FIRST_SAMPLE_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    PERIOD_NS_FIELD_NUMBER: _ClassVar[int]
    GYRO_SCALE_RADPS_FIELD_NUMBER: _ClassVar[int]
    ACCEL_SCALE_MPS2_FIELD_NUMBER: _ClassVar[int]
    TEMPERATURE_SCALE_DEGC_FIELD_NUMBER: _ClassVar[int]
    GYRO_X_FIELD_NUMBER: _ClassVar[int]
    GYRO_Y_FIELD_NUMBER: _ClassVar[int]
    GYRO_Z_FIELD_NUMBER: _ClassVar[int]
    ACCEL_X_FIELD_NUMBER: _ClassVar[int]
    ACCEL_Y_FIELD_NUMBER: _ClassVar[int]
    ACCEL_Z_FIELD_NUMBER: _ClassVar[int]
    TEMPERATURE_FIELD_NUMBER: _ClassVar[int]
    DIAG_STAT_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    model: str
    first_sample_sequence: int
    period_ns: float
    gyro_scale_radps: float
    accel_scale_mps2: float
    temperature_scale_degc: float
    gyro_x: _containers.RepeatedScalarFieldContainer[int]
    gyro_y: _containers.RepeatedScalarFieldContainer[int]
    gyro_z: _containers.RepeatedScalarFieldContainer[int]
    accel_x: _containers.RepeatedScalarFieldContainer[int]
    accel_y: _containers.RepeatedScalarFieldContainer[int]
    accel_z: _containers.RepeatedScalarFieldContainer[int]
    temperature: int
    diag_stat: int
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., model: _Optional[str] = ..., first_sample_sequence: _Optional[int] = ..., period_ns: _Optional[float] = ..., gyro_scale_radps: _Optional[float] = ..., accel_scale_mps2: _Optional[float] = ..., temperature_scale_degc: _Optional[float] = ..., gyro_x: _Optional[_Iterable[int]] = ..., gyro_y: _Optional[_Iterable[int]] = ..., gyro_z: _Optional[_Iterable[int]] = ..., accel_x: _Optional[_Iterable[int]] = ..., accel_y: _Optional[_Iterable[int]] = ..., accel_z: _Optional[_Iterable[int]] = ..., temperature: _Optional[int] = ..., diag_stat: _Optional[int] = ...) -> None: ...

class WheelReading(_message.Message):
    __slots__ = ("wheel", "pulses", "speed_mps")
    WHEEL_FIELD_NUMBER: _ClassVar[int]
    PULSES_FIELD_NUMBER: _ClassVar[int]
    SPEED_MPS_FIELD_NUMBER: _ClassVar[int]
    wheel: str
    pulses: int
    speed_mps: float
    def __init__(self, wheel: _Optional[str] = ..., pulses: _Optional[int] = ..., speed_mps: _Optional[float] = ...) -> None: ...

class Odometry(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "wheels", "doors_open", "motor_force_n", "yaw_rate_radps")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    WHEELS_FIELD_NUMBER: _ClassVar[int]
    DOORS_OPEN_FIELD_NUMBER: _ClassVar[int]
    MOTOR_FORCE_N_FIELD_NUMBER: _ClassVar[int]
    YAW_RATE_RADPS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    wheels: _containers.RepeatedCompositeFieldContainer[WheelReading]
    doors_open: bool
    motor_force_n: float
    yaw_rate_radps: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., wheels: _Optional[_Iterable[_Union[WheelReading, _Mapping]]] = ..., doors_open: _Optional[bool] = ..., motor_force_n: _Optional[float] = ..., yaw_rate_radps: _Optional[float] = ...) -> None: ...

class TruthState(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "arc_length_m", "speed_mps", "acceleration_mps2", "latitude_deg", "longitude_deg", "height_ellipsoid_m", "yaw_rad", "yaw_rate_radps", "standing", "roll_rad", "pitch_rad", "position_std_m", "grade_rad")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    ARC_LENGTH_M_FIELD_NUMBER: _ClassVar[int]
    SPEED_MPS_FIELD_NUMBER: _ClassVar[int]
    ACCELERATION_MPS2_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_ELLIPSOID_M_FIELD_NUMBER: _ClassVar[int]
    YAW_RAD_FIELD_NUMBER: _ClassVar[int]
    YAW_RATE_RADPS_FIELD_NUMBER: _ClassVar[int]
    STANDING_FIELD_NUMBER: _ClassVar[int]
    ROLL_RAD_FIELD_NUMBER: _ClassVar[int]
    PITCH_RAD_FIELD_NUMBER: _ClassVar[int]
    POSITION_STD_M_FIELD_NUMBER: _ClassVar[int]
    GRADE_RAD_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    arc_length_m: float
    speed_mps: float
    acceleration_mps2: float
    latitude_deg: float
    longitude_deg: float
    height_ellipsoid_m: float
    yaw_rad: float
    yaw_rate_radps: float
    standing: bool
    roll_rad: float
    pitch_rad: float
    position_std_m: float
    grade_rad: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., arc_length_m: _Optional[float] = ..., speed_mps: _Optional[float] = ..., acceleration_mps2: _Optional[float] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., height_ellipsoid_m: _Optional[float] = ..., yaw_rad: _Optional[float] = ..., yaw_rate_radps: _Optional[float] = ..., standing: _Optional[bool] = ..., roll_rad: _Optional[float] = ..., pitch_rad: _Optional[float] = ..., position_std_m: _Optional[float] = ..., grade_rad: _Optional[float] = ...) -> None: ...

class Landmark(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "name", "line", "direction", "chainage_m", "chainage_std_m", "probability")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    LINE_FIELD_NUMBER: _ClassVar[int]
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    CHAINAGE_M_FIELD_NUMBER: _ClassVar[int]
    CHAINAGE_STD_M_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    name: str
    line: str
    direction: str
    chainage_m: float
    chainage_std_m: float
    probability: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., name: _Optional[str] = ..., line: _Optional[str] = ..., direction: _Optional[str] = ..., chainage_m: _Optional[float] = ..., chainage_std_m: _Optional[float] = ..., probability: _Optional[float] = ...) -> None: ...
