"""One TOML file per vehicle, one frozen struct per node, unknown fields refused.

Defaults live here, each with its source. Units stand in field names and are SI inside.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from tramstream import keys, mounting
from tramstream.calibrated import Calibrated
from tramstream.private import default_runtime_dir

LARGEST = 1e9
"""No length, time, rate or scale of a vehicle is larger; as seconds, 64 bits of nanoseconds hold
it."""
Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Meta(gt=0, le=LARGEST)]
NotNegative = Annotated[float, Meta(ge=0, le=LARGEST)]
Count = Annotated[int, Meta(ge=1, le=1_000_000_000)]
VehicleId = Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Vector = tuple[Number, Number, Number]
FilePath = Annotated[str, Meta(extra={"file": True})]
"""A file that a section names, relative to the configuration's; the loader makes it absolute."""
Three = Annotated[tuple[NotNegative, ...], Meta(min_length=3, max_length=3)]


class Struct(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every section."""


class Bus(Struct, frozen=True, kw_only=True):
    """Where the nodes of this vehicle meet."""

    runtime_dir: str = ""
    """Folder of the bus' Unix socket, the clock file and the processors' memory; private to one
    user. Empty: TRAMSTREAM_RUNTIME_DIR, else /run/tramstream for root, else the user's own runtime
    folder. A path longer than 90 characters does not fit a socket."""


class Gnss(Struct, frozen=True, kw_only=True):
    """A u-blox receiver, or any that speaks NMEA, on a serial line."""

    device: str
    """Serial device of the receiver. Names under /dev/serial/by-id stay the same whatever is
    plugged in first; /dev/ttyACM0 does not."""
    baud_rate: Count = 460800
    """Bits a second, as the receiver is set; over USB any number will do."""
    receiver_delay_s: NotNegative = 0.1
    """Seconds from the epoch until the first byte leaves the receiver when it is fastest. Real
    receivers took 0.10 to 0.22 s; it cannot be observed without a time pulse."""
    lever_arm_m: Vector = (0.0, 0.0, 0.0)
    """Antenna from the vehicle's origin, p_va_v: forward, left, up."""
    max_accuracy_m: Positive = 100.0
    """A fix that the receiver itself says is worse than this is recorded but not used."""
    delay_std_s: NotNegative = 0.02
    """How well `receiver_delay_s` is known; the filter estimates the rest."""
    error_tau_s: Positive = 20.0
    """Neighbouring fixes share their error: its correlation time while the antenna moves, 0.95 a
    second (docs/theory.md, section 3.4). Standing, the error only walks."""
    error_floor_m: Positive = 0.005
    """Least deviation of a fix on each axis, whatever the receiver says."""


class Imu(Struct, frozen=True, kw_only=True):
    """An ADIS16465 behind a microcontroller on a serial line (docs/imu-framing.md)."""

    device: str
    """Serial device of the microcontroller; as `gnss.device`."""
    baud_rate: Count = 2_000_000
    """Bits a second, as the microcontroller is set; over USB any number will do."""
    model: Literal["ADIS16465-1", "ADIS16465-2", "ADIS16465-3"] = "ADIS16465-1"
    """The range of the gyroscopes: 125, 500 or 2000 °/s."""
    rate_hz: Annotated[float, Meta(gt=0, le=20_000)] = 2000.0
    """Samples a second that the sensor gives."""
    batch: Annotated[int, Meta(ge=1, le=200)] = 20
    """Samples in a message: one message for each window of the resampler."""
    lever_arm_m: Vector = (0.0, 0.0, 0.0)
    """IMU case from the vehicle's origin, p_vb_v: forward, left, up."""
    mounting_deg: Vector = (0.0, 0.0, 0.0)
    """How the case is turned, Ψ = roll, pitch, yaw: C_bv takes vehicle components into the
    sensor's axes (docs/theory.md, section 1.2)."""
    mounting_q_bv: Annotated[tuple[Number, ...], Meta(max_length=4)] = ()
    """Instead of `mounting_deg`, the same turn as a quaternion, w x y z: C_bv without loss."""
    mounting_std_deg: NotNegative | Three = 1.0
    """How well that is known, about x y z of the vehicle or one for all; the filter learns it."""
    delay_std_s: NotNegative = 0.002
    """How well the stamps are known; a delay found between fixes and IMU is shared out by this and
    `gnss.delay_std_s`."""
    gyro_noise_radps_rthz: Positive = 0.00011344
    """White noise N of the gyroscopes. It and the three noises below are kaspar2023's of the
    ADIS16465 (docs/theory.md, section 3.9)."""
    gyro_walk_radps2_rthz: Positive = 0.00007563
    """Random walk K of the gyroscopes' bias."""
    gyro_aliasing: NotNegative = 0.0
    """Part of what neighbouring readings of a rate differ by that is noise to the angle: vibration
    faster than the readings resolve. None where the IMU averages fast samples; about a third for
    one that is read at 100 Hz in a car (docs/accuracy.md)."""
    accel_noise_mps2_rthz: Positive = 0.00022563
    """White noise N of the accelerometers."""
    accel_aliasing: NotNegative = 0.0
    """As `gyro_aliasing`, of the specific force and the speed."""
    accel_walk_mps3_rthz: Positive = 0.0000353
    """Random walk of the accelerometers' bias: B walked within a second; K is far below."""
    gyro_bias_std_radps: Positive = 0.01
    """Bias of the gyroscopes when switched on; 0.3 °/s in docs/theory.md, section 3.9."""
    accel_bias_std_mps2: Positive = 0.15
    """Bias of the accelerometers when switched on; 0.1 m/s² in docs/theory.md, section 3.9."""

    def __post_init__(self) -> None:
        if self.mounting_deg != (0.0, 0.0, 0.0):
            mounting.check(self.mounting_deg, self.mounting_q_bv)


class Signal(Struct, frozen=True, kw_only=True):
    """One signal of the DBC and what it means."""

    message: str
    """Name of the message in the DBC."""
    signal: str
    """Name of the signal in that message."""
    scale: Number = 1.0
    """The DBC's physical value times `scale` is 0 or 1, or newtons."""


class Wheel(Struct, frozen=True, kw_only=True):
    """One wheel as the DBC has it."""

    message: str
    """Name of the message in the DBC."""
    signal: str
    """Name of the signal in that message."""
    kind: Literal["pulses", "counter", "speed"]
    """pulses: since the last message; counter: free running, wraps; speed: of the wheel's rim."""
    scale: Number = 1.0
    """The DBC's physical value times `scale` is pulses, or m/s (from km/h: 0.2777777777777778)."""
    counter_bits: Annotated[int, Meta(ge=1, le=63)] = 16
    """A counter wraps after so many bits."""
    side: Literal["", "left", "right", "middle"] = ""
    """Where the wheel is. Empty: by its name if that is left or right, else the middle."""


class Odometer(Struct, frozen=True, kw_only=True):
    """Wheels, doors and motor force from a CAN bus."""

    interface: str = "socketcan"
    """Any interface of python-can: socketcan, slcan, virtual, udp_multicast …"""
    channel: str
    """Name of the CAN interface; with slcan, a serial device."""
    bitrate: Count = 500_000
    """Bits a second. Of a socketcan interface the system sets it:
    `ip link set can0 up type can bitrate 500000`."""
    dbc: str
    """File that describes the frames of the vehicle bus."""
    wheels: dict[str, Wheel]
    """One section for each wheel (or bogie, or drive); the name is free."""
    doors_open: Signal | None = None
    """1 while a door is open. Leave it out if the bus does not tell."""
    motor_force_n: Signal | None = None
    """Newtons of motors and brakes, positive forward. Leave it out if the bus does not tell."""
    silence_s: Positive = 2.0
    """Without a frame for so long, the interface is looked at and opened again."""


class WheelConstant(Struct, frozen=True, kw_only=True):
    """What one wheel's readings mean, where it is known better than for all."""

    m_per_pulse: Positive = 0.00092038845
    """As `wheels.m_per_pulse`."""
    scale_std: Positive = 0.03
    """As `wheels.scale_std`."""


class Wheels(Struct, frozen=True, kw_only=True):
    """What the wheels' readings mean."""

    m_per_pulse: Positive = 0.00092038845
    """Way of a pulse. The reference vehicle's wheel has 0.3 m radius and 2048 pulses a turn:
    `2π · 0.3 / 2048` (docs/theory.md, section 3.5)."""
    track_m: Positive = 1.435
    """Distance between left and right wheel."""
    bogie: Literal["", "front", "rear"] = ""
    """Which bogie they are on, where `ekf.bogie_distance_m` is given: it turns into a curve before
    the body does, or after. Empty: they stand for both."""
    scale_std: Positive = 0.03
    """How well the above, or a wheel's speed, is known, as a part of it (a worn tyre: 0.05)."""
    each: dict[str, WheelConstant] = {}
    """Constants of single wheels, by their names: what is stated here goes before the two above."""
    delay_s: Number = 0.0
    """Time from the instant that a reading describes until its arrival."""
    delay_std_s: NotNegative = 0.003
    """How well `delay_s` is known; the filter learns the rest."""
    stamp_std_s: NotNegative = 0.002
    """Jitter of a reading's arrival, on the CAN bus and in the adapter."""
    speed_std_mps: Positive = 0.05
    """Deviation of a wheel that gives a speed instead of pulses."""
    yaw_rate_std_radps: Positive = 0.01
    """Deviation of the vehicle bus' own yaw-rate sensor, where there is one."""


class Resampler(Struct, frozen=True, kw_only=True):
    """Inertial samples averaged, and everything put in order."""

    factor: Annotated[int, Meta(ge=1, le=1000)] = 20
    """Inertial samples that become one of the ordered stream: 2000 Hz / 20 = 100 Hz."""
    method: Literal["mean", "lowpass"] = "mean"
    """mean: of `factor` samples, as kaspar2023. lowpass: a decimating FIR filter, as pusman2017."""
    cutoff_hz: Positive = 16.0
    """Cutoff of the low-pass (pusman2017)."""
    max_bridge_samples: Annotated[int, Meta(ge=0, le=20_000)] = 20
    """Longest gap that is interpolated and marked; 20 samples are 10 ms at 2000 Hz."""
    horizon_lag_s: Annotated[float, Meta(ge=0, le=60)] = 0.3
    """The ordered stream ends (the fusion horizon) so far behind the newest inertial sample. What
    comes later is counted and not used; GNSS fixes took up to 0.22 s, and reading."""
    imu_silence_s: Positive = 0.5
    """Without inertial samples for so long, time alone (ticks) moves the stream on."""


class Distance(Struct, frozen=True, kw_only=True):
    """Travelled distance and speed: the filter of konecny2004."""

    acceleration_std_mps2: Positive = 1.0
    """How much the speed may change, as white acceleration between measurements: trams brake with
    about 1 m/s² in service."""
    gate_sigma: Positive = 5.0
    """A measurement further away than so many standard deviations is refused, and counted."""


class Ekf(Struct, frozen=True, kw_only=True):
    """The localisation filter."""

    model: Literal["tram", "kaspar2023"] = "tram"
    """tram: ours. kaspar2023: the 25 states of that work, to compare."""
    integrity_risk: Annotated[float, Meta(gt=0, le=0.1)] = 0.001
    """Share of time that the true error may exceed the protection level, along or across."""
    wheel_creep_m_rtm: NotNegative = 0.0002
    """How a rolling wheel creeps: deviation of its path after a metre of way; it walks."""
    force_std_mps2_rthz: NotNegative = 0.003
    """Specific force along the track that is no motion: the body's pitching, vibration."""
    sway_std_mps2_rthz: NotNegative = 0.002
    """Specific force across the track that is neither curve nor cant."""
    vertical_std_mps2_rthz: NotNegative = 0.0
    """Vertical specific force that is no motion: the force then watches over the pitch, which pays
    on a road, where jolts deceive the gyroscopes. 0: it is not used."""
    side_slip_std_m_rts: NotNegative = 0.0
    """Way to the side after a second, which walks: none on rails, centimetres on a road."""
    heave_std_m_rts: NotNegative = 0.002
    """Way upwards after a second, which walks: springs, the body's pitch against the track's."""
    pivot_m: Number = 0.0
    """The vehicle's origin before the point that does not slip sideways: a rear axle, or midway
    between two bogies."""
    bogie_distance_m: Annotated[float, Meta(ge=0, le=30)] = 0.0
    """From the pivot of one bogie to that of the other: the body lies along the chord of the rail
    between them, and midway it is inside of a curve. 0: its axis follows the rail."""
    pivot_std_m: Annotated[float, Meta(ge=-1)] = -1.0
    """How well `pivot_m` is known; the filter learns the rest. -1: exactly, where `pivot_m` or
    `bogie_distance_m` is given; else by 3 m where there is an IMU, and curves tell."""
    acceleration_std_mps2_rthz: Positive = 0.7
    """How the speed may change where no accelerometer tells."""
    tilt_std_rad_rts: Positive = 0.005
    """How roll and pitch may change where no gyroscope tells: a grade of 7 % within 200 s."""
    track: Literal["with_map", "always", "never"] = "with_map"
    """Whether the filter takes what map/matcher/track tells it of the track: "with_map" where this
    file has a section [map], "always" also where somebody else's matcher says it."""
    track_delay_s: Annotated[float, Meta(ge=0.02, le=2.0)] = 0.2
    """Track geometry of an instant is used at the first step so long after it, wherever the matcher
    runs: more than the longest batch and the bus take. What comes later is counted and not used."""


class Map(Struct, frozen=True, kw_only=True):
    """The map matcher's track network, onto which the filter is put; without this section there is
    no map."""

    network: str
    """File that `tramstream map build` wrote."""
    std_m: Positive = 0.5
    """How far whole stretches of the mapped tracks lie beside the rails (deviation across), beyond
    what the network itself states: σ_map of kaspar2023 (docs/theory.md, section 11.3)."""
    correlation_m: Positive = 30.0
    """Length of track over which `std_m` is one and the same error."""
    shift_over_std: Annotated[float, Meta(ge=0, le=1000)] = 2.0
    """How far the map may lie beside the rails as a whole, alike for kilometres (deviation east and
    north), in times `std_m`: aerial images are a few decimetres off, in bad places a metre or two
    (docs/theory.md, section 6.11). 0: it does not."""
    source: Annotated[str, Meta(pattern=r"^[^/*]+/[^/*]+/[^/*]+$")] = keys.EST_STATE.path
    """Key of what is matched: the state of any localiser, or "raw/gnss/fix", the receiver's own
    fixes."""


class Recorder(Struct, frozen=True, kw_only=True):
    """Where and how records are written: about 410 MB an hour with all three devices
    (measured: `record_mb_per_hour` of `tramstream bench`)."""

    directory: str = "records"
    """Folder of the records."""
    split_s: Positive = 300.0
    """A new file begins after so long."""
    split_bytes: Annotated[int, Meta(ge=1, le=1_000_000_000_000)] = 1_000_000_000
    """A new file begins after so much."""
    flush_s: Annotated[float, Meta(gt=0, le=0.5)] = 0.25
    """A chunk is closed and synced this often: what a power cut takes is younger than that."""
    free_space_floor_bytes: Annotated[int, Meta(ge=0, le=1_000_000_000_000_000)] = 500_000_000
    """With less free space than this the oldest record is deleted, unless it is protected."""
    exclude: tuple[str, ...] = ()
    """Key expressions, relative to tram/<vehicle>/, that are not recorded: "raw/gnss/satellites",
    "raw/*/bytes" …"""


class Simulator(Struct, frozen=True, kw_only=True):
    """A device to try things without hardware: speaks a real one's bytes on a pseudo terminal."""

    kind: Literal["ride", "gnss_file", "can_file", "imu_still"]
    """ride: all three devices on a simulated ride. gnss_file, can_file: captured bytes at their own
    pace. imu_still: an IMU at rest."""
    link: str = ""
    """Path at which the pseudo terminal appears. A ride has three: <link>.gnss, <link>.imu and
    <link>.can; name those as gnss.device, imu.device and odometer.channel (with
    `odometer.interface = "slcan"`)."""
    file: str = ""
    """Captured bytes of gnss_file or can_file."""
    seed: int = 0
    """Seed of the devices' noise: the same bytes for the same seed."""
    loop: bool = False
    """Whether captured bytes come again and again."""
    lasts_s: NotNegative = 0.0
    """After so long all simulated devices are pulled out; 0: when what they play has ended."""
    patience_s: NotNegative = 0.0
    """For so long at most all simulators are silent, until somebody has opened their devices."""


Name = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
MATCHER = "map_matcher"
"""Name of the processor that [map] is for."""


class Vehicle(Struct, frozen=True, kw_only=True):
    """Everything about one vehicle."""

    vehicle: VehicleId
    """Name of the vehicle in all keys (tram/<vehicle>/…) and file names: letters, digits, _ . -"""
    processors: tuple[Name, ...] = ("resampler", "ekf", MATCHER, "distance", "configuration_check")
    """Which processors run, by the names under which they are registered. What is installed and
    not named here does not run; nor does the map matcher without a section [map]."""
    separate: tuple[Name, ...] = ()
    """Processors that get a process of their own; all others share one."""
    bus: Bus = Bus()
    gnss: Gnss | None = None
    imu: Imu | None = None
    odometer: Odometer | None = None
    wheels: Wheels = Wheels()
    resampler: Resampler = Resampler()
    distance: Distance = Distance()
    ekf: Ekf = Ekf()
    map: Map | None = None
    recorder: Recorder = Recorder()
    simulators: dict[str, Simulator] = {}
    sections: dict[str, dict[str, Any]] = {}
    """Settings of processors and bridges of other packages, by name. In the file each is a section
    of that name; the loader checks it against the `Settings` of its class."""
    calibration: str = ""
    """File with fields of [imu], [wheels] and [gnss] that `tramstream allan` and its like found."""
    calibrated: Calibrated | None = None
    """Which settings come from a calibration; the loader writes it."""

    @property
    def running(self) -> tuple[str, ...]:
        """The processors that run: those that are named, but for a map matcher without a map."""
        return tuple(each for each in self.processors if each != MATCHER or self.map is not None)

    @property
    def runtime_dir(self) -> Path:
        return Path(self.bus.runtime_dir) if self.bus.runtime_dir else default_runtime_dir()


def takes_track(vehicle: Vehicle) -> bool:
    """Whether the localisation filter takes what a map matcher tells it of the track."""
    track = vehicle.ekf.track
    return track == "always" or (track == "with_map" and vehicle.map is not None)


def map_shift_std_m(vehicle: Vehicle) -> float:
    """How far the localisation filter takes its map to be beside the rails as a whole, m."""
    if vehicle.map is None or not takes_track(vehicle):
        return 0.0
    return vehicle.map.shift_over_std * vehicle.map.std_m
