from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class JammingState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    JAMMING_UNKNOWN: _ClassVar[JammingState]
    JAMMING_OK: _ClassVar[JammingState]
    JAMMING_WARNING: _ClassVar[JammingState]
    JAMMING_CRITICAL: _ClassVar[JammingState]

class SpoofingState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SPOOFING_UNKNOWN: _ClassVar[SpoofingState]
    SPOOFING_NONE: _ClassVar[SpoofingState]
    SPOOFING_INDICATED: _ClassVar[SpoofingState]
    SPOOFING_AFFIRMED: _ClassVar[SpoofingState]
JAMMING_UNKNOWN: JammingState
JAMMING_OK: JammingState
JAMMING_WARNING: JammingState
JAMMING_CRITICAL: JammingState
SPOOFING_UNKNOWN: SpoofingState
SPOOFING_NONE: SpoofingState
SPOOFING_INDICATED: SpoofingState
SPOOFING_AFFIRMED: SpoofingState

class GnssFix(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "source", "itow_ms", "gps_time_ns", "fix_type", "valid", "differential", "carrier", "satellites_used", "latitude_deg", "longitude_deg", "height_ellipsoid_m", "height_msl_m", "horizontal_std_m", "vertical_std_m", "vel_n_mps", "vel_e_mps", "vel_d_mps", "speed_mps", "speed_std_mps", "course_deg", "course_std_deg", "pdop", "heading_vehicle_deg", "utc_ns", "invalid_llh", "faa_mode", "correction_age_s", "reference_station", "jamming", "spoofing")
    class FaaMode(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        NOT_TOLD: _ClassVar[GnssFix.FaaMode]
        AUTONOMOUS: _ClassVar[GnssFix.FaaMode]
        DIFFERENTIAL: _ClassVar[GnssFix.FaaMode]
        ESTIMATED: _ClassVar[GnssFix.FaaMode]
        MANUAL: _ClassVar[GnssFix.FaaMode]
        NOT_VALID: _ClassVar[GnssFix.FaaMode]
        PRECISE: _ClassVar[GnssFix.FaaMode]
        RTK_FIXED: _ClassVar[GnssFix.FaaMode]
        RTK_FLOAT: _ClassVar[GnssFix.FaaMode]
        SIMULATED: _ClassVar[GnssFix.FaaMode]
    NOT_TOLD: GnssFix.FaaMode
    AUTONOMOUS: GnssFix.FaaMode
    DIFFERENTIAL: GnssFix.FaaMode
    ESTIMATED: GnssFix.FaaMode
    MANUAL: GnssFix.FaaMode
    NOT_VALID: GnssFix.FaaMode
    PRECISE: GnssFix.FaaMode
    RTK_FIXED: GnssFix.FaaMode
    RTK_FLOAT: GnssFix.FaaMode
    SIMULATED: GnssFix.FaaMode
    class FixType(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        NO_FIX: _ClassVar[GnssFix.FixType]
        DEAD_RECKONING: _ClassVar[GnssFix.FixType]
        FIX_2D: _ClassVar[GnssFix.FixType]
        FIX_3D: _ClassVar[GnssFix.FixType]
        GNSS_AND_DEAD_RECKONING: _ClassVar[GnssFix.FixType]
        TIME_ONLY: _ClassVar[GnssFix.FixType]
    NO_FIX: GnssFix.FixType
    DEAD_RECKONING: GnssFix.FixType
    FIX_2D: GnssFix.FixType
    FIX_3D: GnssFix.FixType
    GNSS_AND_DEAD_RECKONING: GnssFix.FixType
    TIME_ONLY: GnssFix.FixType
    class Carrier(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        NONE: _ClassVar[GnssFix.Carrier]
        FLOAT: _ClassVar[GnssFix.Carrier]
        FIXED: _ClassVar[GnssFix.Carrier]
    NONE: GnssFix.Carrier
    FLOAT: GnssFix.Carrier
    FIXED: GnssFix.Carrier
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    ITOW_MS_FIELD_NUMBER: _ClassVar[int]
    GPS_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    FIX_TYPE_FIELD_NUMBER: _ClassVar[int]
    VALID_FIELD_NUMBER: _ClassVar[int]
    DIFFERENTIAL_FIELD_NUMBER: _ClassVar[int]
    CARRIER_FIELD_NUMBER: _ClassVar[int]
    SATELLITES_USED_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_ELLIPSOID_M_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_MSL_M_FIELD_NUMBER: _ClassVar[int]
    HORIZONTAL_STD_M_FIELD_NUMBER: _ClassVar[int]
    VERTICAL_STD_M_FIELD_NUMBER: _ClassVar[int]
    VEL_N_MPS_FIELD_NUMBER: _ClassVar[int]
    VEL_E_MPS_FIELD_NUMBER: _ClassVar[int]
    VEL_D_MPS_FIELD_NUMBER: _ClassVar[int]
    SPEED_MPS_FIELD_NUMBER: _ClassVar[int]
    SPEED_STD_MPS_FIELD_NUMBER: _ClassVar[int]
    COURSE_DEG_FIELD_NUMBER: _ClassVar[int]
    COURSE_STD_DEG_FIELD_NUMBER: _ClassVar[int]
    PDOP_FIELD_NUMBER: _ClassVar[int]
    HEADING_VEHICLE_DEG_FIELD_NUMBER: _ClassVar[int]
    UTC_NS_FIELD_NUMBER: _ClassVar[int]
    INVALID_LLH_FIELD_NUMBER: _ClassVar[int]
    FAA_MODE_FIELD_NUMBER: _ClassVar[int]
    CORRECTION_AGE_S_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_STATION_FIELD_NUMBER: _ClassVar[int]
    JAMMING_FIELD_NUMBER: _ClassVar[int]
    SPOOFING_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    source: str
    itow_ms: int
    gps_time_ns: int
    fix_type: GnssFix.FixType
    valid: bool
    differential: bool
    carrier: GnssFix.Carrier
    satellites_used: int
    latitude_deg: float
    longitude_deg: float
    height_ellipsoid_m: float
    height_msl_m: float
    horizontal_std_m: float
    vertical_std_m: float
    vel_n_mps: float
    vel_e_mps: float
    vel_d_mps: float
    speed_mps: float
    speed_std_mps: float
    course_deg: float
    course_std_deg: float
    pdop: float
    heading_vehicle_deg: float
    utc_ns: int
    invalid_llh: bool
    faa_mode: GnssFix.FaaMode
    correction_age_s: float
    reference_station: int
    jamming: JammingState
    spoofing: SpoofingState
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., source: _Optional[str] = ..., itow_ms: _Optional[int] = ..., gps_time_ns: _Optional[int] = ..., fix_type: _Optional[_Union[GnssFix.FixType, str]] = ..., valid: _Optional[bool] = ..., differential: _Optional[bool] = ..., carrier: _Optional[_Union[GnssFix.Carrier, str]] = ..., satellites_used: _Optional[int] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., height_ellipsoid_m: _Optional[float] = ..., height_msl_m: _Optional[float] = ..., horizontal_std_m: _Optional[float] = ..., vertical_std_m: _Optional[float] = ..., vel_n_mps: _Optional[float] = ..., vel_e_mps: _Optional[float] = ..., vel_d_mps: _Optional[float] = ..., speed_mps: _Optional[float] = ..., speed_std_mps: _Optional[float] = ..., course_deg: _Optional[float] = ..., course_std_deg: _Optional[float] = ..., pdop: _Optional[float] = ..., heading_vehicle_deg: _Optional[float] = ..., utc_ns: _Optional[int] = ..., invalid_llh: _Optional[bool] = ..., faa_mode: _Optional[_Union[GnssFix.FaaMode, str]] = ..., correction_age_s: _Optional[float] = ..., reference_station: _Optional[int] = ..., jamming: _Optional[_Union[JammingState, str]] = ..., spoofing: _Optional[_Union[SpoofingState, str]] = ...) -> None: ...

class GnssCovariance(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "itow_ms", "position_valid", "velocity_valid", "position_m2", "velocity_m2ps2")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    ITOW_MS_FIELD_NUMBER: _ClassVar[int]
    POSITION_VALID_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_VALID_FIELD_NUMBER: _ClassVar[int]
    POSITION_M2_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_M2PS2_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    itow_ms: int
    position_valid: bool
    velocity_valid: bool
    position_m2: _containers.RepeatedScalarFieldContainer[float]
    velocity_m2ps2: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., itow_ms: _Optional[int] = ..., position_valid: _Optional[bool] = ..., velocity_valid: _Optional[bool] = ..., position_m2: _Optional[_Iterable[float]] = ..., velocity_m2ps2: _Optional[_Iterable[float]] = ...) -> None: ...

class GnssPosition(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "source", "itow_ms", "valid", "latitude_deg", "longitude_deg", "height_ellipsoid_m", "height_msl_m", "horizontal_std_m", "vertical_std_m")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    ITOW_MS_FIELD_NUMBER: _ClassVar[int]
    VALID_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_ELLIPSOID_M_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_MSL_M_FIELD_NUMBER: _ClassVar[int]
    HORIZONTAL_STD_M_FIELD_NUMBER: _ClassVar[int]
    VERTICAL_STD_M_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    source: str
    itow_ms: int
    valid: bool
    latitude_deg: float
    longitude_deg: float
    height_ellipsoid_m: float
    height_msl_m: float
    horizontal_std_m: float
    vertical_std_m: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., source: _Optional[str] = ..., itow_ms: _Optional[int] = ..., valid: _Optional[bool] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., height_ellipsoid_m: _Optional[float] = ..., height_msl_m: _Optional[float] = ..., horizontal_std_m: _Optional[float] = ..., vertical_std_m: _Optional[float] = ...) -> None: ...

class GnssAttitude(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "source", "itow_ms", "roll_deg", "pitch_deg", "heading_deg", "roll_std_deg", "pitch_std_deg", "heading_std_deg")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    ITOW_MS_FIELD_NUMBER: _ClassVar[int]
    ROLL_DEG_FIELD_NUMBER: _ClassVar[int]
    PITCH_DEG_FIELD_NUMBER: _ClassVar[int]
    HEADING_DEG_FIELD_NUMBER: _ClassVar[int]
    ROLL_STD_DEG_FIELD_NUMBER: _ClassVar[int]
    PITCH_STD_DEG_FIELD_NUMBER: _ClassVar[int]
    HEADING_STD_DEG_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    source: str
    itow_ms: int
    roll_deg: float
    pitch_deg: float
    heading_deg: float
    roll_std_deg: float
    pitch_std_deg: float
    heading_std_deg: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., source: _Optional[str] = ..., itow_ms: _Optional[int] = ..., roll_deg: _Optional[float] = ..., pitch_deg: _Optional[float] = ..., heading_deg: _Optional[float] = ..., roll_std_deg: _Optional[float] = ..., pitch_std_deg: _Optional[float] = ..., heading_std_deg: _Optional[float] = ...) -> None: ...

class GnssTime(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "source", "itow_ms", "gps_time_ns", "leap_seconds", "accuracy_ns", "next_leap_change", "next_leap_in_s", "utc_ns", "utc_standard")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    ITOW_MS_FIELD_NUMBER: _ClassVar[int]
    GPS_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    LEAP_SECONDS_FIELD_NUMBER: _ClassVar[int]
    ACCURACY_NS_FIELD_NUMBER: _ClassVar[int]
    NEXT_LEAP_CHANGE_FIELD_NUMBER: _ClassVar[int]
    NEXT_LEAP_IN_S_FIELD_NUMBER: _ClassVar[int]
    UTC_NS_FIELD_NUMBER: _ClassVar[int]
    UTC_STANDARD_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    source: str
    itow_ms: int
    gps_time_ns: int
    leap_seconds: int
    accuracy_ns: float
    next_leap_change: int
    next_leap_in_s: int
    utc_ns: int
    utc_standard: int
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., source: _Optional[str] = ..., itow_ms: _Optional[int] = ..., gps_time_ns: _Optional[int] = ..., leap_seconds: _Optional[int] = ..., accuracy_ns: _Optional[float] = ..., next_leap_change: _Optional[int] = ..., next_leap_in_s: _Optional[int] = ..., utc_ns: _Optional[int] = ..., utc_standard: _Optional[int] = ...) -> None: ...

class TimePulse(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "tow_ms", "week", "tow_sub_ms", "quantisation_ps", "utc_base", "quantisation_valid")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TOW_MS_FIELD_NUMBER: _ClassVar[int]
    WEEK_FIELD_NUMBER: _ClassVar[int]
    TOW_SUB_MS_FIELD_NUMBER: _ClassVar[int]
    QUANTISATION_PS_FIELD_NUMBER: _ClassVar[int]
    UTC_BASE_FIELD_NUMBER: _ClassVar[int]
    QUANTISATION_VALID_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    tow_ms: int
    week: int
    tow_sub_ms: float
    quantisation_ps: int
    utc_base: bool
    quantisation_valid: bool
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., tow_ms: _Optional[int] = ..., week: _Optional[int] = ..., tow_sub_ms: _Optional[float] = ..., quantisation_ps: _Optional[int] = ..., utc_base: _Optional[bool] = ..., quantisation_valid: _Optional[bool] = ...) -> None: ...

class Satellite(_message.Message):
    __slots__ = ("gnss_id", "sv_id", "signal_id", "frequency_id", "cno_dbhz", "elevation_deg", "azimuth_deg", "residual_m", "quality", "used", "health", "flags")
    GNSS_ID_FIELD_NUMBER: _ClassVar[int]
    SV_ID_FIELD_NUMBER: _ClassVar[int]
    SIGNAL_ID_FIELD_NUMBER: _ClassVar[int]
    FREQUENCY_ID_FIELD_NUMBER: _ClassVar[int]
    CNO_DBHZ_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    AZIMUTH_DEG_FIELD_NUMBER: _ClassVar[int]
    RESIDUAL_M_FIELD_NUMBER: _ClassVar[int]
    QUALITY_FIELD_NUMBER: _ClassVar[int]
    USED_FIELD_NUMBER: _ClassVar[int]
    HEALTH_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    gnss_id: int
    sv_id: int
    signal_id: int
    frequency_id: int
    cno_dbhz: int
    elevation_deg: int
    azimuth_deg: int
    residual_m: float
    quality: int
    used: bool
    health: int
    flags: int
    def __init__(self, gnss_id: _Optional[int] = ..., sv_id: _Optional[int] = ..., signal_id: _Optional[int] = ..., frequency_id: _Optional[int] = ..., cno_dbhz: _Optional[int] = ..., elevation_deg: _Optional[int] = ..., azimuth_deg: _Optional[int] = ..., residual_m: _Optional[float] = ..., quality: _Optional[int] = ..., used: _Optional[bool] = ..., health: _Optional[int] = ..., flags: _Optional[int] = ...) -> None: ...

class GnssSatellites(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "source", "itow_ms", "satellites")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    ITOW_MS_FIELD_NUMBER: _ClassVar[int]
    SATELLITES_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    source: str
    itow_ms: int
    satellites: _containers.RepeatedCompositeFieldContainer[Satellite]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., source: _Optional[str] = ..., itow_ms: _Optional[int] = ..., satellites: _Optional[_Iterable[_Union[Satellite, _Mapping]]] = ...) -> None: ...

class RawMeasurement(_message.Message):
    __slots__ = ("pseudorange_m", "carrier_phase_cycles", "doppler_hz", "gnss_id", "sv_id", "signal_id", "frequency_id", "lock_time_ms", "cno_dbhz", "pseudorange_std_m", "carrier_phase_std_cycles", "doppler_std_hz", "tracking")
    PSEUDORANGE_M_FIELD_NUMBER: _ClassVar[int]
    CARRIER_PHASE_CYCLES_FIELD_NUMBER: _ClassVar[int]
    DOPPLER_HZ_FIELD_NUMBER: _ClassVar[int]
    GNSS_ID_FIELD_NUMBER: _ClassVar[int]
    SV_ID_FIELD_NUMBER: _ClassVar[int]
    SIGNAL_ID_FIELD_NUMBER: _ClassVar[int]
    FREQUENCY_ID_FIELD_NUMBER: _ClassVar[int]
    LOCK_TIME_MS_FIELD_NUMBER: _ClassVar[int]
    CNO_DBHZ_FIELD_NUMBER: _ClassVar[int]
    PSEUDORANGE_STD_M_FIELD_NUMBER: _ClassVar[int]
    CARRIER_PHASE_STD_CYCLES_FIELD_NUMBER: _ClassVar[int]
    DOPPLER_STD_HZ_FIELD_NUMBER: _ClassVar[int]
    TRACKING_FIELD_NUMBER: _ClassVar[int]
    pseudorange_m: float
    carrier_phase_cycles: float
    doppler_hz: float
    gnss_id: int
    sv_id: int
    signal_id: int
    frequency_id: int
    lock_time_ms: int
    cno_dbhz: int
    pseudorange_std_m: float
    carrier_phase_std_cycles: float
    doppler_std_hz: float
    tracking: int
    def __init__(self, pseudorange_m: _Optional[float] = ..., carrier_phase_cycles: _Optional[float] = ..., doppler_hz: _Optional[float] = ..., gnss_id: _Optional[int] = ..., sv_id: _Optional[int] = ..., signal_id: _Optional[int] = ..., frequency_id: _Optional[int] = ..., lock_time_ms: _Optional[int] = ..., cno_dbhz: _Optional[int] = ..., pseudorange_std_m: _Optional[float] = ..., carrier_phase_std_cycles: _Optional[float] = ..., doppler_std_hz: _Optional[float] = ..., tracking: _Optional[int] = ...) -> None: ...

class GnssMeasurements(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "receiver_tow_s", "week", "leap_seconds", "clock_reset", "measurements")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    RECEIVER_TOW_S_FIELD_NUMBER: _ClassVar[int]
    WEEK_FIELD_NUMBER: _ClassVar[int]
    LEAP_SECONDS_FIELD_NUMBER: _ClassVar[int]
    CLOCK_RESET_FIELD_NUMBER: _ClassVar[int]
    MEASUREMENTS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    receiver_tow_s: float
    week: int
    leap_seconds: int
    clock_reset: bool
    measurements: _containers.RepeatedCompositeFieldContainer[RawMeasurement]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., receiver_tow_s: _Optional[float] = ..., week: _Optional[int] = ..., leap_seconds: _Optional[int] = ..., clock_reset: _Optional[bool] = ..., measurements: _Optional[_Iterable[_Union[RawMeasurement, _Mapping]]] = ...) -> None: ...

class GnssSubframe(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "gnss_id", "sv_id", "signal_id", "frequency_id", "channel", "words")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    GNSS_ID_FIELD_NUMBER: _ClassVar[int]
    SV_ID_FIELD_NUMBER: _ClassVar[int]
    SIGNAL_ID_FIELD_NUMBER: _ClassVar[int]
    FREQUENCY_ID_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    WORDS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    gnss_id: int
    sv_id: int
    signal_id: int
    frequency_id: int
    channel: int
    words: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., gnss_id: _Optional[int] = ..., sv_id: _Optional[int] = ..., signal_id: _Optional[int] = ..., frequency_id: _Optional[int] = ..., channel: _Optional[int] = ..., words: _Optional[_Iterable[int]] = ...) -> None: ...

class EsfMeasurements(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "source", "items")
    class Item(_message.Message):
        __slots__ = ("type", "raw", "value", "unit", "time_tag")
        TYPE_FIELD_NUMBER: _ClassVar[int]
        RAW_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        UNIT_FIELD_NUMBER: _ClassVar[int]
        TIME_TAG_FIELD_NUMBER: _ClassVar[int]
        type: int
        raw: int
        value: float
        unit: str
        time_tag: int
        def __init__(self, type: _Optional[int] = ..., raw: _Optional[int] = ..., value: _Optional[float] = ..., unit: _Optional[str] = ..., time_tag: _Optional[int] = ...) -> None: ...
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    ITEMS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    source: str
    items: _containers.RepeatedCompositeFieldContainer[EsfMeasurements.Item]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., source: _Optional[str] = ..., items: _Optional[_Iterable[_Union[EsfMeasurements.Item, _Mapping]]] = ...) -> None: ...

class EsfSensor(_message.Message):
    __slots__ = ("type", "used", "ready", "calibration", "time_status", "frequency_hz", "faults")
    TYPE_FIELD_NUMBER: _ClassVar[int]
    USED_FIELD_NUMBER: _ClassVar[int]
    READY_FIELD_NUMBER: _ClassVar[int]
    CALIBRATION_FIELD_NUMBER: _ClassVar[int]
    TIME_STATUS_FIELD_NUMBER: _ClassVar[int]
    FREQUENCY_HZ_FIELD_NUMBER: _ClassVar[int]
    FAULTS_FIELD_NUMBER: _ClassVar[int]
    type: int
    used: bool
    ready: bool
    calibration: int
    time_status: int
    frequency_hz: int
    faults: int
    def __init__(self, type: _Optional[int] = ..., used: _Optional[bool] = ..., ready: _Optional[bool] = ..., calibration: _Optional[int] = ..., time_status: _Optional[int] = ..., frequency_hz: _Optional[int] = ..., faults: _Optional[int] = ...) -> None: ...

class EsfStatus(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "itow_ms", "fusion_mode", "sensors")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    ITOW_MS_FIELD_NUMBER: _ClassVar[int]
    FUSION_MODE_FIELD_NUMBER: _ClassVar[int]
    SENSORS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    itow_ms: int
    fusion_mode: int
    sensors: _containers.RepeatedCompositeFieldContainer[EsfSensor]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., itow_ms: _Optional[int] = ..., fusion_mode: _Optional[int] = ..., sensors: _Optional[_Iterable[_Union[EsfSensor, _Mapping]]] = ...) -> None: ...

class EsfInertial(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "source", "itow_ms", "rate_x_degps", "rate_y_degps", "rate_z_degps", "accel_x_mps2", "accel_y_mps2", "accel_z_mps2")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    ITOW_MS_FIELD_NUMBER: _ClassVar[int]
    RATE_X_DEGPS_FIELD_NUMBER: _ClassVar[int]
    RATE_Y_DEGPS_FIELD_NUMBER: _ClassVar[int]
    RATE_Z_DEGPS_FIELD_NUMBER: _ClassVar[int]
    ACCEL_X_MPS2_FIELD_NUMBER: _ClassVar[int]
    ACCEL_Y_MPS2_FIELD_NUMBER: _ClassVar[int]
    ACCEL_Z_MPS2_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    source: str
    itow_ms: int
    rate_x_degps: float
    rate_y_degps: float
    rate_z_degps: float
    accel_x_mps2: float
    accel_y_mps2: float
    accel_z_mps2: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., source: _Optional[str] = ..., itow_ms: _Optional[int] = ..., rate_x_degps: _Optional[float] = ..., rate_y_degps: _Optional[float] = ..., rate_z_degps: _Optional[float] = ..., accel_x_mps2: _Optional[float] = ..., accel_y_mps2: _Optional[float] = ..., accel_z_mps2: _Optional[float] = ...) -> None: ...

class EsfAlignment(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "itow_ms", "status", "yaw_deg", "pitch_deg", "roll_deg", "error")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    ITOW_MS_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    YAW_DEG_FIELD_NUMBER: _ClassVar[int]
    PITCH_DEG_FIELD_NUMBER: _ClassVar[int]
    ROLL_DEG_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    itow_ms: int
    status: int
    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    error: int
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., itow_ms: _Optional[int] = ..., status: _Optional[int] = ..., yaw_deg: _Optional[float] = ..., pitch_deg: _Optional[float] = ..., roll_deg: _Optional[float] = ..., error: _Optional[int] = ...) -> None: ...

class UbxFrame(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "message_class", "message_id", "name", "payload")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_CLASS_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    message_class: int
    message_id: int
    name: str
    payload: bytes
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., message_class: _Optional[int] = ..., message_id: _Optional[int] = ..., name: _Optional[str] = ..., payload: _Optional[bytes] = ...) -> None: ...

class GnssInterference(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "source", "jamming", "spoofing", "jamming_detection", "spoofing_detection", "parts", "carriers")
    class RadioPart(_message.Message):
        __slots__ = ("id", "jamming", "noise", "gain", "jamming_indicator", "antenna_status", "antenna_power", "offset_i", "magnitude_i", "offset_q", "magnitude_q")
        ID_FIELD_NUMBER: _ClassVar[int]
        JAMMING_FIELD_NUMBER: _ClassVar[int]
        NOISE_FIELD_NUMBER: _ClassVar[int]
        GAIN_FIELD_NUMBER: _ClassVar[int]
        JAMMING_INDICATOR_FIELD_NUMBER: _ClassVar[int]
        ANTENNA_STATUS_FIELD_NUMBER: _ClassVar[int]
        ANTENNA_POWER_FIELD_NUMBER: _ClassVar[int]
        OFFSET_I_FIELD_NUMBER: _ClassVar[int]
        MAGNITUDE_I_FIELD_NUMBER: _ClassVar[int]
        OFFSET_Q_FIELD_NUMBER: _ClassVar[int]
        MAGNITUDE_Q_FIELD_NUMBER: _ClassVar[int]
        id: int
        jamming: JammingState
        noise: int
        gain: float
        jamming_indicator: int
        antenna_status: int
        antenna_power: int
        offset_i: int
        magnitude_i: int
        offset_q: int
        magnitude_q: int
        def __init__(self, id: _Optional[int] = ..., jamming: _Optional[_Union[JammingState, str]] = ..., noise: _Optional[int] = ..., gain: _Optional[float] = ..., jamming_indicator: _Optional[int] = ..., antenna_status: _Optional[int] = ..., antenna_power: _Optional[int] = ..., offset_i: _Optional[int] = ..., magnitude_i: _Optional[int] = ..., offset_q: _Optional[int] = ..., magnitude_q: _Optional[int] = ...) -> None: ...
    class Carrier(_message.Message):
        __slots__ = ("frequency_hz", "jammed")
        FREQUENCY_HZ_FIELD_NUMBER: _ClassVar[int]
        JAMMED_FIELD_NUMBER: _ClassVar[int]
        frequency_hz: float
        jammed: bool
        def __init__(self, frequency_hz: _Optional[float] = ..., jammed: _Optional[bool] = ...) -> None: ...
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    JAMMING_FIELD_NUMBER: _ClassVar[int]
    SPOOFING_FIELD_NUMBER: _ClassVar[int]
    JAMMING_DETECTION_FIELD_NUMBER: _ClassVar[int]
    SPOOFING_DETECTION_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    CARRIERS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    source: str
    jamming: JammingState
    spoofing: SpoofingState
    jamming_detection: bool
    spoofing_detection: bool
    parts: _containers.RepeatedCompositeFieldContainer[GnssInterference.RadioPart]
    carriers: _containers.RepeatedCompositeFieldContainer[GnssInterference.Carrier]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., source: _Optional[str] = ..., jamming: _Optional[_Union[JammingState, str]] = ..., spoofing: _Optional[_Union[SpoofingState, str]] = ..., jamming_detection: _Optional[bool] = ..., spoofing_detection: _Optional[bool] = ..., parts: _Optional[_Iterable[_Union[GnssInterference.RadioPart, _Mapping]]] = ..., carriers: _Optional[_Iterable[_Union[GnssInterference.Carrier, _Mapping]]] = ...) -> None: ...

class GnssProtection(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "itow_ms", "integrity_risk", "position_valid", "position_frame", "position_m", "position_orient_deg", "velocity_valid", "velocity_frame", "velocity_mps", "velocity_orient_deg", "time_valid", "time_ns", "position_reason")
    class Frame(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        NO_FRAME: _ClassVar[GnssProtection.Frame]
        NORTH_EAST_DOWN: _ClassVar[GnssProtection.Frame]
        ALONG_ACROSS_UP: _ClassVar[GnssProtection.Frame]
        MAJOR_MINOR_UP: _ClassVar[GnssProtection.Frame]
    NO_FRAME: GnssProtection.Frame
    NORTH_EAST_DOWN: GnssProtection.Frame
    ALONG_ACROSS_UP: GnssProtection.Frame
    MAJOR_MINOR_UP: GnssProtection.Frame
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    ITOW_MS_FIELD_NUMBER: _ClassVar[int]
    INTEGRITY_RISK_FIELD_NUMBER: _ClassVar[int]
    POSITION_VALID_FIELD_NUMBER: _ClassVar[int]
    POSITION_FRAME_FIELD_NUMBER: _ClassVar[int]
    POSITION_M_FIELD_NUMBER: _ClassVar[int]
    POSITION_ORIENT_DEG_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_VALID_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_FRAME_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_MPS_FIELD_NUMBER: _ClassVar[int]
    VELOCITY_ORIENT_DEG_FIELD_NUMBER: _ClassVar[int]
    TIME_VALID_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    POSITION_REASON_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    itow_ms: int
    integrity_risk: float
    position_valid: bool
    position_frame: GnssProtection.Frame
    position_m: _containers.RepeatedScalarFieldContainer[float]
    position_orient_deg: float
    velocity_valid: bool
    velocity_frame: GnssProtection.Frame
    velocity_mps: _containers.RepeatedScalarFieldContainer[float]
    velocity_orient_deg: float
    time_valid: bool
    time_ns: float
    position_reason: int
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., itow_ms: _Optional[int] = ..., integrity_risk: _Optional[float] = ..., position_valid: _Optional[bool] = ..., position_frame: _Optional[_Union[GnssProtection.Frame, str]] = ..., position_m: _Optional[_Iterable[float]] = ..., position_orient_deg: _Optional[float] = ..., velocity_valid: _Optional[bool] = ..., velocity_frame: _Optional[_Union[GnssProtection.Frame, str]] = ..., velocity_mps: _Optional[_Iterable[float]] = ..., velocity_orient_deg: _Optional[float] = ..., time_valid: _Optional[bool] = ..., time_ns: _Optional[float] = ..., position_reason: _Optional[int] = ...) -> None: ...

class GnssBaseline(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "itow_ms", "reference_station", "valid", "carrier", "north_m", "east_m", "down_m", "north_std_m", "east_std_m", "down_std_m", "length_m", "length_std_m", "heading_deg", "heading_std_deg", "flags")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    ITOW_MS_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_STATION_FIELD_NUMBER: _ClassVar[int]
    VALID_FIELD_NUMBER: _ClassVar[int]
    CARRIER_FIELD_NUMBER: _ClassVar[int]
    NORTH_M_FIELD_NUMBER: _ClassVar[int]
    EAST_M_FIELD_NUMBER: _ClassVar[int]
    DOWN_M_FIELD_NUMBER: _ClassVar[int]
    NORTH_STD_M_FIELD_NUMBER: _ClassVar[int]
    EAST_STD_M_FIELD_NUMBER: _ClassVar[int]
    DOWN_STD_M_FIELD_NUMBER: _ClassVar[int]
    LENGTH_M_FIELD_NUMBER: _ClassVar[int]
    LENGTH_STD_M_FIELD_NUMBER: _ClassVar[int]
    HEADING_DEG_FIELD_NUMBER: _ClassVar[int]
    HEADING_STD_DEG_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    itow_ms: int
    reference_station: int
    valid: bool
    carrier: GnssFix.Carrier
    north_m: float
    east_m: float
    down_m: float
    north_std_m: float
    east_std_m: float
    down_std_m: float
    length_m: float
    length_std_m: float
    heading_deg: float
    heading_std_deg: float
    flags: int
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., itow_ms: _Optional[int] = ..., reference_station: _Optional[int] = ..., valid: _Optional[bool] = ..., carrier: _Optional[_Union[GnssFix.Carrier, str]] = ..., north_m: _Optional[float] = ..., east_m: _Optional[float] = ..., down_m: _Optional[float] = ..., north_std_m: _Optional[float] = ..., east_std_m: _Optional[float] = ..., down_std_m: _Optional[float] = ..., length_m: _Optional[float] = ..., length_std_m: _Optional[float] = ..., heading_deg: _Optional[float] = ..., heading_std_deg: _Optional[float] = ..., flags: _Optional[int] = ...) -> None: ...

class GnssOscillator(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "itow_ms", "bias_ns", "drift_nsps", "time_std_ns", "drift_std_psps")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    ITOW_MS_FIELD_NUMBER: _ClassVar[int]
    BIAS_NS_FIELD_NUMBER: _ClassVar[int]
    DRIFT_NSPS_FIELD_NUMBER: _ClassVar[int]
    TIME_STD_NS_FIELD_NUMBER: _ClassVar[int]
    DRIFT_STD_PSPS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    itow_ms: int
    bias_ns: float
    drift_nsps: float
    time_std_ns: float
    drift_std_psps: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., itow_ms: _Optional[int] = ..., bias_ns: _Optional[float] = ..., drift_nsps: _Optional[float] = ..., time_std_ns: _Optional[float] = ..., drift_std_psps: _Optional[float] = ...) -> None: ...

class GnssSpectrum(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "bands")
    class Band(_message.Message):
        __slots__ = ("level", "span_hz", "resolution_hz", "centre_hz", "gain_db")
        LEVEL_FIELD_NUMBER: _ClassVar[int]
        SPAN_HZ_FIELD_NUMBER: _ClassVar[int]
        RESOLUTION_HZ_FIELD_NUMBER: _ClassVar[int]
        CENTRE_HZ_FIELD_NUMBER: _ClassVar[int]
        GAIN_DB_FIELD_NUMBER: _ClassVar[int]
        level: bytes
        span_hz: float
        resolution_hz: float
        centre_hz: float
        gain_db: int
        def __init__(self, level: _Optional[bytes] = ..., span_hz: _Optional[float] = ..., resolution_hz: _Optional[float] = ..., centre_hz: _Optional[float] = ..., gain_db: _Optional[int] = ...) -> None: ...
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    BANDS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    bands: _containers.RepeatedCompositeFieldContainer[GnssSpectrum.Band]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., bands: _Optional[_Iterable[_Union[GnssSpectrum.Band, _Mapping]]] = ...) -> None: ...

class GnssCorrection(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "source", "protocol", "message_type", "message_subtype", "station", "damaged", "use", "ebno_db")
    class Use(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        USE_UNKNOWN: _ClassVar[GnssCorrection.Use]
        NOT_USED: _ClassVar[GnssCorrection.Use]
        USED: _ClassVar[GnssCorrection.Use]
    USE_UNKNOWN: GnssCorrection.Use
    NOT_USED: GnssCorrection.Use
    USED: GnssCorrection.Use
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_TYPE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_SUBTYPE_FIELD_NUMBER: _ClassVar[int]
    STATION_FIELD_NUMBER: _ClassVar[int]
    DAMAGED_FIELD_NUMBER: _ClassVar[int]
    USE_FIELD_NUMBER: _ClassVar[int]
    EBNO_DB_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    source: str
    protocol: int
    message_type: int
    message_subtype: int
    station: int
    damaged: bool
    use: GnssCorrection.Use
    ebno_db: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., source: _Optional[str] = ..., protocol: _Optional[int] = ..., message_type: _Optional[int] = ..., message_subtype: _Optional[int] = ..., station: _Optional[int] = ..., damaged: _Optional[bool] = ..., use: _Optional[_Union[GnssCorrection.Use, str]] = ..., ebno_db: _Optional[float] = ...) -> None: ...

class GnssDilution(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "itow_ms", "geometric", "position", "time", "vertical", "horizontal", "north", "east")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    ITOW_MS_FIELD_NUMBER: _ClassVar[int]
    GEOMETRIC_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    VERTICAL_FIELD_NUMBER: _ClassVar[int]
    HORIZONTAL_FIELD_NUMBER: _ClassVar[int]
    NORTH_FIELD_NUMBER: _ClassVar[int]
    EAST_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    itow_ms: int
    geometric: float
    position: float
    time: float
    vertical: float
    horizontal: float
    north: float
    east: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., itow_ms: _Optional[int] = ..., geometric: _Optional[float] = ..., position: _Optional[float] = ..., time: _Optional[float] = ..., vertical: _Optional[float] = ..., horizontal: _Optional[float] = ..., north: _Optional[float] = ..., east: _Optional[float] = ...) -> None: ...
