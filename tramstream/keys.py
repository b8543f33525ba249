"""All keys of the bus: layer, source, quantity, type, rate, clock; written here, nowhere else.

A full key is `tram/<vehicle>/<layer>/<source>/<quantity>`. `Key.path` leaves the first two parts
out; that is how processors and configurations speak of keys. Every stamp is on the *vehicle clock*
(`tramstream.clock`): monotonic, never stepped, in nanoseconds that look like Unix time. What the
stamp marks is the key's `instant`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import Any

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message

from tramstream.proto import estimate_pb2, gnss_pb2, health_pb2, raw_pb2, sync_pb2

ROOT = "tram"
SCHEMA_VERSION = 1
"""Raised whenever a message changes so that an older reader would misread it."""

ANY_SOURCE = "*"
APART = "@"
"""Stands in no key; see `apart`."""


@dataclass(frozen=True, slots=True)
class Key:
    """One key: where it lies, what it carries, how often, and what its stamp marks."""

    layer: str
    source: str
    quantity: str
    type: type[Message]
    rate_hz: float
    instant: str
    doc: str
    path: str = field(init=False)
    encoding: str = field(init=False)
    """The zenoh encoding declared on every put."""

    def __post_init__(self) -> None:
        # Stored, not computed: every message on its way asks for them.
        object.__setattr__(self, "path", f"{self.layer}/{self.source}/{self.quantity}")
        name = self.type.DESCRIPTOR.full_name
        object.__setattr__(self, "encoding", f"application/protobuf;{name}")

    def on(self, vehicle: str) -> str:
        """Full key on `vehicle`."""
        return full(vehicle, self.path)

    def at(self, source: str) -> Key:
        """The same quantity of another source: `HEARTBEAT.at("imu")`."""
        return replace(self, source=source)


def define(path: str, type_: Any, rate_hz: float = 0.0, instant: str = "", doc: str = "") -> Key:
    """Make a key; whoever writes a processor makes its own so, beside the processor.

    Parameters
    ----------
    path : str
        `layer/source/quantity`, without the vehicle.
    type_ : message class
        A protobuf message with `stamp_ns` and `sequence`, or one of Foxglove's with `timestamp`.
    rate_hz : float
        Messages a second; 0 where they come as they come.
    instant : str
        What the stamp marks.
    doc : str
        A few words for `list` and `top`.

    Raises
    ------
    ValueError
        If the path or the type is none; the sentence says what is missing.
    """
    parts = path.split("/")
    if len(parts) != 3 or not all(_PART.fullmatch(part) for part in parts):
        raise ValueError(
            f"key {path!r}: must be layer/source/quantity of letters, digits, '_', '-' and '.'"
        )
    fields = type_.DESCRIPTOR.fields_by_name
    if not ({"stamp_ns", "sequence"} <= set(fields) or "timestamp" in fields):
        raise ValueError(
            f"key {path!r}: {type_.DESCRIPTOR.full_name} has no stamp; give it `int64 stamp_ns` "
            "and `uint64 sequence`, or take a Foxglove type, which has `timestamp`"
        )
    layer, source, quantity = parts
    return Key(layer, source, quantity, type_, rate_hz, instant, doc)


_PART = re.compile(r"\*|[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


# raw: what devices said -----------------------------------------------------------------------
GNSS_BYTES = define("raw/gnss/bytes", raw_pb2.RawBytes, 5, "arrival", "Receiver's bytes as read")
GNSS_FIX = define("raw/gnss/fix", gnss_pb2.GnssFix, 5, "epoch", "Position, velocity, time")
GNSS_HIGH_RATE = define(
    "raw/gnss/high_rate", gnss_pb2.GnssFix, 10, "epoch", "HNR-PVT beside NAV-PVT's fixes"
)
GNSS_LOCATION = define("raw/gnss/location", LocationFix, 5, "epoch", "The same fix for any viewer")
GNSS_COVARIANCE = define(
    "raw/gnss/covariance", gnss_pb2.GnssCovariance, 5, "epoch", "Covariance of the fix, NED"
)
GNSS_POSITION = define(
    "raw/gnss/position", gnss_pb2.GnssPosition, 5, "epoch", "Position alone, high precision"
)
GNSS_ATTITUDE = define(
    "raw/gnss/attitude", gnss_pb2.GnssAttitude, 5, "epoch", "Receiver's own attitude"
)
GNSS_TIME = define("raw/gnss/time", gnss_pb2.GnssTime, 1, "epoch", "GPS time and leap seconds")
GNSS_PULSE = define("raw/gnss/pulse", gnss_pb2.TimePulse, 1, "arrival", "Time of the next pulse")
GNSS_SATELLITES = define(
    "raw/gnss/satellites", gnss_pb2.GnssSatellites, 1, "epoch", "Satellites in view (NAV-SAT)"
)
GNSS_SIGNALS = define(
    "raw/gnss/signals", gnss_pb2.GnssSatellites, 1, "epoch", "Signals in view (NAV-SIG)"
)
GNSS_MEASUREMENTS = define(
    "raw/gnss/measurements", gnss_pb2.GnssMeasurements, 1, "epoch", "Pseudorange, carrier, Doppler"
)
GNSS_SUBFRAME = define("raw/gnss/subframe", gnss_pb2.GnssSubframe, 10, "arrival", "Navigation data")
GNSS_ESF_MEASUREMENTS = define(
    "raw/gnss/esf_measurements", gnss_pb2.EsfMeasurements, 10, "arrival", "Receiver's sensors"
)
GNSS_ESF_STATUS = define(
    "raw/gnss/esf_status", gnss_pb2.EsfStatus, 1, "epoch", "State of the receiver's fusion"
)
GNSS_ESF_INERTIAL = define(
    "raw/gnss/esf_inertial", gnss_pb2.EsfInertial, 10, "epoch", "Receiver's vehicle dynamics"
)
GNSS_ESF_ALIGNMENT = define(
    "raw/gnss/esf_alignment", gnss_pb2.EsfAlignment, 1, "epoch", "Receiver's own mounting angles"
)
GNSS_INTERFERENCE = define(
    "raw/gnss/interference", gnss_pb2.GnssInterference, 1, "arrival", "Jamming, spoofing, antenna"
)
GNSS_PROTECTION = define(
    "raw/gnss/protection", gnss_pb2.GnssProtection, 1, "epoch", "Receiver's protection levels"
)
GNSS_BASELINE = define(
    "raw/gnss/baseline", gnss_pb2.GnssBaseline, 1, "epoch", "From the reference station"
)
GNSS_DILUTION = define(
    "raw/gnss/dilution", gnss_pb2.GnssDilution, 1, "epoch", "Dilution of precision"
)
GNSS_OSCILLATOR = define(
    "raw/gnss/oscillator", gnss_pb2.GnssOscillator, 1, "epoch", "Receiver's own clock"
)
GNSS_CORRECTION = define(
    "raw/gnss/correction", gnss_pb2.GnssCorrection, 1, "arrival", "Corrections, and their use"
)
GNSS_SPECTRUM = define(
    "raw/gnss/spectrum", gnss_pb2.GnssSpectrum, 1, "arrival", "What the radio hears"
)
GNSS_FRAME = define(
    "raw/gnss/frame", gnss_pb2.UbxFrame, 1, "arrival", "UBX without a decoder, whole"
)
IMU_BYTES = define("raw/imu/bytes", raw_pb2.RawBytes, 10, "arrival", "IMU's bytes as read")
IMU_BATCH = define("raw/imu/batch", raw_pb2.ImuBatch, 100, "first sample", "Inertial samples")
ODO_FRAMES = define("raw/odo/frames", raw_pb2.CanFrames, 10, "arrival", "CAN frames as received")
ODO_WHEELS = define("raw/odo/wheels", raw_pb2.Odometry, 50, "arrival", "Wheels, doors, motor force")
LANDMARK = define(
    "raw/landmark/passed", raw_pb2.Landmark, 0, "passing", "A place on a line that is known: beacon"
)
TRUTH_STATE = define(
    "raw/truth/state", raw_pb2.TruthState, 10, "state", "The truth, where it is known"
)

# sync: the ordered stream ------------------------------------------------------------------------
SYNC_IMU = define(
    "sync/imu/mean", sync_pb2.ImuMean, 100, "window centre", "100 Hz inertial mean, now"
)
SYNC_FRAME = define(
    "sync/fusion/frame", sync_pb2.SyncFrame, 100, "horizon", "All in order of stamps"
)
SYNC_GAP = define("sync/imu/gap", sync_pb2.SyncGap, 0, "gap's start", "Inertial samples missing")
SYNC_LATE = define(
    "sync/fusion/late", sync_pb2.LateSample, 0, "late sample", "Came after the horizon"
)
SYNC_TICK = define(
    "sync/clock/tick", sync_pb2.Tick, 10, "event time", "Time passing, what was read"
)
SYNC_SNAPSHOT = define("sync/clock/snapshot", sync_pb2.Snapshot, 0.1, "tick", "Processors' memory")
MEMORY = define(
    "sync/*/memory", sync_pb2.Snapshot, 0, "publication", "What a process of its own began with"
)

# est: what filters say ------------------------------------------------------------------------
EST_DISTANCE = define(
    "est/distance/state", estimate_pb2.DistanceState, 50, "state", "Travelled distance and speed"
)
EST_STATE = define(
    "est/ekf/state", estimate_pb2.MotionState, 100, "horizon", "Localisation filter, all data in"
)
EST_NOW = define(
    "est/ekf/now", estimate_pb2.MotionState, 100, "newest mean", "The same, predicted to now"
)
EST_LOCATION = define("est/ekf/location", LocationFix, 10, "newest mean", "The same for any viewer")
EST_PARAMETERS = define(
    "est/ekf/parameters", estimate_pb2.FilterParameters, 1, "horizon", "Biases, scales, offsets"
)
EST_SMOOTHED = define(
    "est/ekf/smoothed", estimate_pb2.MotionState, 10, "state", "Offline: with the whole ride known"
)

EST_LATE = define(
    "est/ekf/late", sync_pb2.LateSample, 0, "late sample", "Track geometry that came too late"
)
EST_GRADE = define(
    "est/grade/state",
    estimate_pb2.GradeState,
    100,
    "horizon",
    "Slope of the track, apart from the body",
)
EST_STOPPING = define(
    "est/grade/stopping", estimate_pb2.GradeStopping, 2, "horizon", "Distances to stop, slope ahead"
)
EST_GRADE_PARAMETERS = define(
    "est/grade/parameters", estimate_pb2.FilterParameters, 1, "horizon", "Suspension, offset, mass"
)
EST_GRADE_LATE = define(
    "est/grade/late", sync_pb2.LateSample, 0, "late sample", "State or match that came too late"
)
EST_SEGMENT = define(
    "est/segments/event", estimate_pb2.SegmentEvent, 0, "horizon", "Stop, turn, area: what was gone"
)

# map: where on the network ------------------------------------------------------------------------
MAP_MATCH = define(
    "map/matcher/match", estimate_pb2.MapMatch, 100, "horizon", "Track, chainage, probability"
)
MAP_LOCATION = define(
    "map/matcher/location", LocationFix, 10, "horizon", "The place on the track for any viewer"
)

MAP_TRACK = define(
    "map/matcher/track", estimate_pb2.TrackGeometry, 10, "matched state", "The track, for filters"
)
MAP_PLACE = define(
    "map/line/place", estimate_pb2.LinePlace, 2, "horizon", "Line and place by wheels and IMU alone"
)

# health: how the system is doing; one source a node -----------------------------------------------
HEARTBEAT = define(
    "health/*/heartbeat", health_pb2.NodeHealth, 1, "publication", "A process is alive"
)
DEVICE = define(
    "health/*/device", health_pb2.DeviceHealth, 1, "publication", "A device behind a bridge"
)
LOSS = define("health/*/loss", health_pb2.Loss, 0, "publication", "Messages a node never got")
EVENT = define("health/*/event", health_pb2.Event, 0, "event time", "What happened: kind and facts")
LOG = define("health/*/log", Log, 0, "event time", "The same as sentences, for any viewer")
CLOCK = define(
    "health/clock/reference", health_pb2.ClockReference, 0.1, "publication", "Clock and UTC"
)

ALL: tuple[Key, ...] = tuple(value for value in list(globals().values()) if isinstance(value, Key))
_BY_PATH = {key.path: key for key in ALL}
TYPES: dict[str, type[Message]] = {key.type.DESCRIPTOR.full_name: key.type for key in ALL}
"""Our message types by their full name."""


def full(vehicle: str, path: str) -> str:
    """Full key, or key expression, of `path` on `vehicle`."""
    return f"{ROOT}/{vehicle}/{path}"


def alive(vehicle: str, node: str) -> str:
    """Liveliness token of a node: gone within milliseconds when its process dies."""
    return f"{ROOT}/{vehicle}/health/{node}/alive"


def apart(topic: str, session: int) -> str:
    """Where the recorder keeps what a second publisher sends on `topic`."""
    return f"{topic}{APART}{session:08x}"


def published(topic: str) -> str:
    """Where that was published; any other topic as it is."""
    return topic.partition(APART)[0]


def is_apart(topic: str) -> bool:
    """Whether `topic` is such a place: readers show it, and nobody computes with it."""
    return APART in topic


def schema(type_name: str) -> str:
    """Where the router answers with the FileDescriptorSet of a message type."""
    return f"{ROOT}/schema/{type_name}"


def resend(session: int | None = None) -> str:
    """Where a bus session is asked for what it published lately; without one, all sessions."""
    return f"{ROOT}/resend/{ANY_SOURCE if session is None else f'{session:08x}'}"


def farewell(vehicle: str) -> str:
    """Where a publisher that is about to end waits until the recorder has all of it."""
    return f"{ROOT}/{vehicle}/health/recorder/farewell"


def find(path: str) -> Key | None:
    """The key at `path` (`layer/source/quantity`), or None if nobody defined it."""
    key = _BY_PATH.get(path)
    if key is None and path.count("/") == 2:
        layer, source, quantity = path.split("/")
        generic = _BY_PATH.get(f"{layer}/{ANY_SOURCE}/{quantity}")
        if generic is not None and source and ANY_SOURCE not in source:
            key = generic.at(source)
    return key


def split(full: str) -> tuple[str, str]:
    """Split a full key into vehicle and path; both empty if it is not one of ours."""
    parts = full.split("/", 2)
    return (parts[1], parts[2]) if len(parts) == 3 and parts[0] == ROOT else ("", "")


def matches(expression: str, key: str) -> bool:
    """Whether zenoh key expression `expression` (`*` one part, `**` any number) includes `key`."""
    return _match(expression.split("/"), key.split("/"))


def meet(one: str, other: str) -> bool:
    """Whether one of two expressions includes the other."""
    return matches(one, other) or matches(other, one)


def _match(pattern: list[str], parts: list[str]) -> bool:
    """Match word by word; a `**` takes one more where what follows does not fit.

    Only the last `**` need be tried again, so a stranger's expression of many costs at most the
    product of the two lengths.
    """
    at = place = 0
    wild, begun = -1, 0
    while place < len(parts):
        if at < len(pattern) and pattern[at] == "**":
            wild, begun = at, place
            at += 1
        elif at < len(pattern) and pattern[at] in ("*", parts[place]):
            at, place = at + 1, place + 1
        elif wild >= 0:
            begun += 1
            at, place = wild + 1, begun
        else:
            return False
    return all(word == "**" for word in pattern[at:])


def descriptor_set(type_: Any) -> FileDescriptorSet:
    """Everything that is needed to decode a message type without our code."""
    found = FileDescriptorSet()
    seen: set[str] = set()

    def add(file: Any) -> None:
        if file.name in seen:
            return
        seen.add(file.name)
        for dependency in file.dependencies:
            add(dependency)
        file.CopyToProto(found.file.add())

    add(type_.DESCRIPTOR.file)
    return found
