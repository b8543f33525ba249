from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
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

class MotionState(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "mode", "latitude_deg", "longitude_deg", "height_ellipsoid_m", "speed_mps", "acceleration_mps2", "roll_rad", "pitch_rad", "yaw_rad", "yaw_rate_radps", "standing", "along_std_m", "across_std_m", "up_std_m", "speed_std_mps", "yaw_std_rad", "protection_along_m", "protection_across_m", "covariance", "innovations", "level_error_rad", "level_std_rad")
    class Mode(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        STARTING: _ClassVar[MotionState.Mode]
        HEADING_UNKNOWN: _ClassVar[MotionState.Mode]
        TRACKING: _ClassVar[MotionState.Mode]
        DEAD_RECKONING: _ClassVar[MotionState.Mode]
    STARTING: MotionState.Mode
    HEADING_UNKNOWN: MotionState.Mode
    TRACKING: MotionState.Mode
    DEAD_RECKONING: MotionState.Mode
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    MODE_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_ELLIPSOID_M_FIELD_NUMBER: _ClassVar[int]
    SPEED_MPS_FIELD_NUMBER: _ClassVar[int]
    ACCELERATION_MPS2_FIELD_NUMBER: _ClassVar[int]
    ROLL_RAD_FIELD_NUMBER: _ClassVar[int]
    PITCH_RAD_FIELD_NUMBER: _ClassVar[int]
    YAW_RAD_FIELD_NUMBER: _ClassVar[int]
    YAW_RATE_RADPS_FIELD_NUMBER: _ClassVar[int]
    STANDING_FIELD_NUMBER: _ClassVar[int]
    ALONG_STD_M_FIELD_NUMBER: _ClassVar[int]
    ACROSS_STD_M_FIELD_NUMBER: _ClassVar[int]
    UP_STD_M_FIELD_NUMBER: _ClassVar[int]
    SPEED_STD_MPS_FIELD_NUMBER: _ClassVar[int]
    YAW_STD_RAD_FIELD_NUMBER: _ClassVar[int]
    PROTECTION_ALONG_M_FIELD_NUMBER: _ClassVar[int]
    PROTECTION_ACROSS_M_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    INNOVATIONS_FIELD_NUMBER: _ClassVar[int]
    LEVEL_ERROR_RAD_FIELD_NUMBER: _ClassVar[int]
    LEVEL_STD_RAD_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    mode: MotionState.Mode
    latitude_deg: float
    longitude_deg: float
    height_ellipsoid_m: float
    speed_mps: float
    acceleration_mps2: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    yaw_rate_radps: float
    standing: bool
    along_std_m: float
    across_std_m: float
    up_std_m: float
    speed_std_mps: float
    yaw_std_rad: float
    protection_along_m: float
    protection_across_m: float
    covariance: _containers.RepeatedScalarFieldContainer[float]
    innovations: _containers.RepeatedCompositeFieldContainer[Innovation]
    level_error_rad: float
    level_std_rad: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., mode: _Optional[_Union[MotionState.Mode, str]] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., height_ellipsoid_m: _Optional[float] = ..., speed_mps: _Optional[float] = ..., acceleration_mps2: _Optional[float] = ..., roll_rad: _Optional[float] = ..., pitch_rad: _Optional[float] = ..., yaw_rad: _Optional[float] = ..., yaw_rate_radps: _Optional[float] = ..., standing: _Optional[bool] = ..., along_std_m: _Optional[float] = ..., across_std_m: _Optional[float] = ..., up_std_m: _Optional[float] = ..., speed_std_mps: _Optional[float] = ..., yaw_std_rad: _Optional[float] = ..., protection_along_m: _Optional[float] = ..., protection_across_m: _Optional[float] = ..., covariance: _Optional[_Iterable[float]] = ..., innovations: _Optional[_Iterable[_Union[Innovation, _Mapping]]] = ..., level_error_rad: _Optional[float] = ..., level_std_rad: _Optional[float] = ...) -> None: ...

class Parameter(_message.Message):
    __slots__ = ("name", "value", "std", "unit")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    STD_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    name: str
    value: float
    std: float
    unit: str
    def __init__(self, name: _Optional[str] = ..., value: _Optional[float] = ..., std: _Optional[float] = ..., unit: _Optional[str] = ...) -> None: ...

class FilterParameters(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "model", "parameters")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    PARAMETERS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    model: str
    parameters: _containers.RepeatedCompositeFieldContainer[Parameter]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., model: _Optional[str] = ..., parameters: _Optional[_Iterable[_Union[Parameter, _Mapping]]] = ...) -> None: ...

class MapAlternative(_message.Message):
    __slots__ = ("edge", "run", "chainage_m", "probability")
    EDGE_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    CHAINAGE_M_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    edge: str
    run: int
    chainage_m: float
    probability: float
    def __init__(self, edge: _Optional[str] = ..., run: _Optional[int] = ..., chainage_m: _Optional[float] = ..., probability: _Optional[float] = ...) -> None: ...

class LineReference(_message.Message):
    __slots__ = ("line", "direction", "chainage_m")
    LINE_FIELD_NUMBER: _ClassVar[int]
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    CHAINAGE_M_FIELD_NUMBER: _ClassVar[int]
    line: str
    direction: str
    chainage_m: float
    def __init__(self, line: _Optional[str] = ..., direction: _Optional[str] = ..., chainage_m: _Optional[float] = ...) -> None: ...

class MapMatch(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "state", "edge", "run", "chainage_m", "chainage_std_m", "probability", "off_probability", "side", "standing", "direction_known", "latitude_deg", "longitude_deg", "alternatives", "references")
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        STARTING: _ClassVar[MapMatch.State]
        ON_TRACK: _ClassVar[MapMatch.State]
        OFF_MAP: _ClassVar[MapMatch.State]
    STARTING: MapMatch.State
    ON_TRACK: MapMatch.State
    OFF_MAP: MapMatch.State
    class Side(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        SINGLE: _ClassVar[MapMatch.Side]
        RIGHT: _ClassVar[MapMatch.Side]
        LEFT: _ClassVar[MapMatch.Side]
        MIDDLE: _ClassVar[MapMatch.Side]
    SINGLE: MapMatch.Side
    RIGHT: MapMatch.Side
    LEFT: MapMatch.Side
    MIDDLE: MapMatch.Side
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    EDGE_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    CHAINAGE_M_FIELD_NUMBER: _ClassVar[int]
    CHAINAGE_STD_M_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    OFF_PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    SIDE_FIELD_NUMBER: _ClassVar[int]
    STANDING_FIELD_NUMBER: _ClassVar[int]
    DIRECTION_KNOWN_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    ALTERNATIVES_FIELD_NUMBER: _ClassVar[int]
    REFERENCES_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    state: MapMatch.State
    edge: str
    run: int
    chainage_m: float
    chainage_std_m: float
    probability: float
    off_probability: float
    side: MapMatch.Side
    standing: bool
    direction_known: bool
    latitude_deg: float
    longitude_deg: float
    alternatives: _containers.RepeatedCompositeFieldContainer[MapAlternative]
    references: _containers.RepeatedCompositeFieldContainer[LineReference]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., state: _Optional[_Union[MapMatch.State, str]] = ..., edge: _Optional[str] = ..., run: _Optional[int] = ..., chainage_m: _Optional[float] = ..., chainage_std_m: _Optional[float] = ..., probability: _Optional[float] = ..., off_probability: _Optional[float] = ..., side: _Optional[_Union[MapMatch.Side, str]] = ..., standing: _Optional[bool] = ..., direction_known: _Optional[bool] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., alternatives: _Optional[_Iterable[_Union[MapAlternative, _Mapping]]] = ..., references: _Optional[_Iterable[_Union[LineReference, _Mapping]]] = ...) -> None: ...

class TrackGeometry(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "edge", "run", "chainage_m", "probability", "latitude_deg", "longitude_deg", "yaw_rad", "curvature_per_m", "grade_rad", "across_variance_m2", "yaw_variance_rad2", "curvature_variance_per_m2", "grade_variance_rad2", "ahead_m", "behind_m")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    EDGE_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    CHAINAGE_M_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    YAW_RAD_FIELD_NUMBER: _ClassVar[int]
    CURVATURE_PER_M_FIELD_NUMBER: _ClassVar[int]
    GRADE_RAD_FIELD_NUMBER: _ClassVar[int]
    ACROSS_VARIANCE_M2_FIELD_NUMBER: _ClassVar[int]
    YAW_VARIANCE_RAD2_FIELD_NUMBER: _ClassVar[int]
    CURVATURE_VARIANCE_PER_M2_FIELD_NUMBER: _ClassVar[int]
    GRADE_VARIANCE_RAD2_FIELD_NUMBER: _ClassVar[int]
    AHEAD_M_FIELD_NUMBER: _ClassVar[int]
    BEHIND_M_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    edge: str
    run: int
    chainage_m: float
    probability: float
    latitude_deg: float
    longitude_deg: float
    yaw_rad: float
    curvature_per_m: float
    grade_rad: float
    across_variance_m2: float
    yaw_variance_rad2: float
    curvature_variance_per_m2: float
    grade_variance_rad2: float
    ahead_m: float
    behind_m: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., edge: _Optional[str] = ..., run: _Optional[int] = ..., chainage_m: _Optional[float] = ..., probability: _Optional[float] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., yaw_rad: _Optional[float] = ..., curvature_per_m: _Optional[float] = ..., grade_rad: _Optional[float] = ..., across_variance_m2: _Optional[float] = ..., yaw_variance_rad2: _Optional[float] = ..., curvature_variance_per_m2: _Optional[float] = ..., grade_variance_rad2: _Optional[float] = ..., ahead_m: _Optional[float] = ..., behind_m: _Optional[float] = ...) -> None: ...

class GradeState(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "grade_rad", "grade_std_rad", "body_pitch_rad", "body_pitch_std_rad", "speed_mps", "edge", "run", "chainage_m", "probability", "inputs", "mass_kg", "mass_std_kg", "rolling_resistance", "rolling_resistance_std", "innovations")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    GRADE_RAD_FIELD_NUMBER: _ClassVar[int]
    GRADE_STD_RAD_FIELD_NUMBER: _ClassVar[int]
    BODY_PITCH_RAD_FIELD_NUMBER: _ClassVar[int]
    BODY_PITCH_STD_RAD_FIELD_NUMBER: _ClassVar[int]
    SPEED_MPS_FIELD_NUMBER: _ClassVar[int]
    EDGE_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    CHAINAGE_M_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    INPUTS_FIELD_NUMBER: _ClassVar[int]
    MASS_KG_FIELD_NUMBER: _ClassVar[int]
    MASS_STD_KG_FIELD_NUMBER: _ClassVar[int]
    ROLLING_RESISTANCE_FIELD_NUMBER: _ClassVar[int]
    ROLLING_RESISTANCE_STD_FIELD_NUMBER: _ClassVar[int]
    INNOVATIONS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    grade_rad: float
    grade_std_rad: float
    body_pitch_rad: float
    body_pitch_std_rad: float
    speed_mps: float
    edge: str
    run: int
    chainage_m: float
    probability: float
    inputs: _containers.RepeatedScalarFieldContainer[str]
    mass_kg: float
    mass_std_kg: float
    rolling_resistance: float
    rolling_resistance_std: float
    innovations: _containers.RepeatedCompositeFieldContainer[Innovation]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., grade_rad: _Optional[float] = ..., grade_std_rad: _Optional[float] = ..., body_pitch_rad: _Optional[float] = ..., body_pitch_std_rad: _Optional[float] = ..., speed_mps: _Optional[float] = ..., edge: _Optional[str] = ..., run: _Optional[int] = ..., chainage_m: _Optional[float] = ..., probability: _Optional[float] = ..., inputs: _Optional[_Iterable[str]] = ..., mass_kg: _Optional[float] = ..., mass_std_kg: _Optional[float] = ..., rolling_resistance: _Optional[float] = ..., rolling_resistance_std: _Optional[float] = ..., innovations: _Optional[_Iterable[_Union[Innovation, _Mapping]]] = ...) -> None: ...

class StoppingDistance(_message.Message):
    __slots__ = ("deceleration_mps2", "distance_m", "distance_std_m", "level_m")
    DECELERATION_MPS2_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_STD_M_FIELD_NUMBER: _ClassVar[int]
    LEVEL_M_FIELD_NUMBER: _ClassVar[int]
    deceleration_mps2: float
    distance_m: float
    distance_std_m: float
    level_m: float
    def __init__(self, deceleration_mps2: _Optional[float] = ..., distance_m: _Optional[float] = ..., distance_std_m: _Optional[float] = ..., level_m: _Optional[float] = ...) -> None: ...

class GradeStopping(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "speed_mps", "grade_ahead_rad", "mapped_m", "stops")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SPEED_MPS_FIELD_NUMBER: _ClassVar[int]
    GRADE_AHEAD_RAD_FIELD_NUMBER: _ClassVar[int]
    MAPPED_M_FIELD_NUMBER: _ClassVar[int]
    STOPS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    speed_mps: float
    grade_ahead_rad: float
    mapped_m: float
    stops: _containers.RepeatedCompositeFieldContainer[StoppingDistance]
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., speed_mps: _Optional[float] = ..., grade_ahead_rad: _Optional[float] = ..., mapped_m: _Optional[float] = ..., stops: _Optional[_Iterable[_Union[StoppingDistance, _Mapping]]] = ...) -> None: ...

class SegmentEvent(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "kind", "start_ns", "end_ns", "start_m", "end_m", "distance_m", "distance_std_m", "angle_rad", "angle_std_rad", "radius_m", "radius_std_m", "probability", "name", "backwards", "doors_opened", "inputs", "stop_std_s")
    class Kind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        UNKNOWN: _ClassVar[SegmentEvent.Kind]
        HALT: _ClassVar[SegmentEvent.Kind]
        STOP: _ClassVar[SegmentEvent.Kind]
        TURN: _ClassVar[SegmentEvent.Kind]
        AREA_ENTERED: _ClassVar[SegmentEvent.Kind]
        AREA_LEFT: _ClassVar[SegmentEvent.Kind]
    UNKNOWN: SegmentEvent.Kind
    HALT: SegmentEvent.Kind
    STOP: SegmentEvent.Kind
    TURN: SegmentEvent.Kind
    AREA_ENTERED: SegmentEvent.Kind
    AREA_LEFT: SegmentEvent.Kind
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    START_NS_FIELD_NUMBER: _ClassVar[int]
    END_NS_FIELD_NUMBER: _ClassVar[int]
    START_M_FIELD_NUMBER: _ClassVar[int]
    END_M_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_STD_M_FIELD_NUMBER: _ClassVar[int]
    ANGLE_RAD_FIELD_NUMBER: _ClassVar[int]
    ANGLE_STD_RAD_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    RADIUS_STD_M_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    BACKWARDS_FIELD_NUMBER: _ClassVar[int]
    DOORS_OPENED_FIELD_NUMBER: _ClassVar[int]
    INPUTS_FIELD_NUMBER: _ClassVar[int]
    STOP_STD_S_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    kind: SegmentEvent.Kind
    start_ns: int
    end_ns: int
    start_m: float
    end_m: float
    distance_m: float
    distance_std_m: float
    angle_rad: float
    angle_std_rad: float
    radius_m: float
    radius_std_m: float
    probability: float
    name: str
    backwards: bool
    doors_opened: bool
    inputs: _containers.RepeatedScalarFieldContainer[str]
    stop_std_s: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., kind: _Optional[_Union[SegmentEvent.Kind, str]] = ..., start_ns: _Optional[int] = ..., end_ns: _Optional[int] = ..., start_m: _Optional[float] = ..., end_m: _Optional[float] = ..., distance_m: _Optional[float] = ..., distance_std_m: _Optional[float] = ..., angle_rad: _Optional[float] = ..., angle_std_rad: _Optional[float] = ..., radius_m: _Optional[float] = ..., radius_std_m: _Optional[float] = ..., probability: _Optional[float] = ..., name: _Optional[str] = ..., backwards: _Optional[bool] = ..., doors_opened: _Optional[bool] = ..., inputs: _Optional[_Iterable[str]] = ..., stop_std_s: _Optional[float] = ...) -> None: ...

class LineAlternative(_message.Message):
    __slots__ = ("line", "direction", "chainage_m", "chainage_std_m", "probability")
    LINE_FIELD_NUMBER: _ClassVar[int]
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    CHAINAGE_M_FIELD_NUMBER: _ClassVar[int]
    CHAINAGE_STD_M_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    line: str
    direction: str
    chainage_m: float
    chainage_std_m: float
    probability: float
    def __init__(self, line: _Optional[str] = ..., direction: _Optional[str] = ..., chainage_m: _Optional[float] = ..., chainage_std_m: _Optional[float] = ..., probability: _Optional[float] = ...) -> None: ...

class LinePlace(_message.Message):
    __slots__ = ("stamp_ns", "sequence", "state", "line", "direction", "chainage_m", "chainage_std_m", "probability", "line_probability", "off_probability", "alternatives", "wheel_scale", "wheel_scale_std", "latitude_deg", "longitude_deg", "reversed", "gone_m")
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        SEARCHING: _ClassVar[LinePlace.State]
        PLACED: _ClassVar[LinePlace.State]
        OFF_LINE: _ClassVar[LinePlace.State]
    SEARCHING: LinePlace.State
    PLACED: LinePlace.State
    OFF_LINE: LinePlace.State
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    LINE_FIELD_NUMBER: _ClassVar[int]
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    CHAINAGE_M_FIELD_NUMBER: _ClassVar[int]
    CHAINAGE_STD_M_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    LINE_PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    OFF_PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    ALTERNATIVES_FIELD_NUMBER: _ClassVar[int]
    WHEEL_SCALE_FIELD_NUMBER: _ClassVar[int]
    WHEEL_SCALE_STD_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    REVERSED_FIELD_NUMBER: _ClassVar[int]
    GONE_M_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    sequence: int
    state: LinePlace.State
    line: str
    direction: str
    chainage_m: float
    chainage_std_m: float
    probability: float
    line_probability: float
    off_probability: float
    alternatives: _containers.RepeatedCompositeFieldContainer[LineAlternative]
    wheel_scale: float
    wheel_scale_std: float
    latitude_deg: float
    longitude_deg: float
    reversed: bool
    gone_m: float
    def __init__(self, stamp_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., state: _Optional[_Union[LinePlace.State, str]] = ..., line: _Optional[str] = ..., direction: _Optional[str] = ..., chainage_m: _Optional[float] = ..., chainage_std_m: _Optional[float] = ..., probability: _Optional[float] = ..., line_probability: _Optional[float] = ..., off_probability: _Optional[float] = ..., alternatives: _Optional[_Iterable[_Union[LineAlternative, _Mapping]]] = ..., wheel_scale: _Optional[float] = ..., wheel_scale_std: _Optional[float] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., reversed: _Optional[bool] = ..., gone_m: _Optional[float] = ...) -> None: ...
