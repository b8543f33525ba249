"""One TOML file per vehicle, one frozen struct per node, unknown fields refused.

Defaults live here, each with its source. Units stand in field names and are SI inside.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

LARGEST = 1e9
"""No length, time, rate or scale of a vehicle is larger; as seconds, 64 bits of nanoseconds hold
it."""
Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Meta(gt=0, le=LARGEST)]
NotNegative = Annotated[float, Meta(ge=0, le=LARGEST)]
Count = Annotated[int, Meta(ge=1, le=1_000_000_000)]
VehicleId = Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Vector = tuple[Number, Number, Number]


class Struct(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every section."""


class Bus(Struct, frozen=True, kw_only=True):
    """Where the nodes of this vehicle meet."""

    runtime_dir: str = ""
    """Folder of the bus' Unix socket, the clock file and the processors' snapshot. Empty: chosen
    by `default_runtime_dir`."""


class Gnss(Struct, frozen=True, kw_only=True):
    """A u-blox receiver (or any NMEA receiver) on a serial line."""

    device: str
    baud_rate: Count = 460800
    receiver_delay_s: NotNegative = 0.1
    """From the epoch until the first byte leaves the receiver when it is fastest; 0.10 to 0.22 s
    observed with real receivers. Not observable without a time pulse."""
    lever_arm_m: Vector = (0.0, 0.0, 0.0)
    """Antenna from the vehicle's origin, p_va_v."""
    max_accuracy_m: Positive = 100.0
    """A fix whose receiver says worse than this is published but not valid."""
    delay_std_s: NotNegative = 0.02
    """How well `receiver_delay_s` is known; the filter estimates the rest."""
    error_tau_s: Positive = 20.0
    """Correlation time of a fix's error while the antenna moves: 0.95 a second (docs/theory.md,
    section 3.4). Standing, the error only walks."""
    error_floor_m: Positive = 0.005
    """Least deviation of a fix on each axis, whatever the receiver says."""


class Imu(Struct, frozen=True, kw_only=True):
    """An ADIS16465 behind a microcontroller on a serial line (docs/imu-framing.md)."""

    device: str
    baud_rate: Count = 2_000_000
    model: Literal["ADIS16465-1", "ADIS16465-2", "ADIS16465-3"] = "ADIS16465-1"
    rate_hz: Annotated[float, Meta(gt=0, le=20_000)] = 2000.0
    batch: Annotated[int, Meta(ge=1, le=200)] = 20
    """Samples per message: one message a window of the resampler."""
    lever_arm_m: Vector = (0.0, 0.0, 0.0)
    """The case from the vehicle's origin, p_vb_v."""
    mounting_deg: Vector = (0.0, 0.0, 0.0)
    """Ψ = roll, pitch, yaw of the case: C_bv turns vehicle components into sensor axes
    (docs/theory.md, section 1.2)."""
    mounting_std_deg: NotNegative = 1.0
    """How well `mounting_deg` is known on each axis; the filter estimates the rest."""
    delay_std_s: NotNegative = 0.002
    """How well its stamps are known: the part of a found delay between fixes and IMU that is the
    IMU's, against `gnss.delay_std_s`."""
    gyro_noise_radps_rthz: Positive = 0.00011344
    """N of the ADIS16465 in kaspar2023 (docs/theory.md, section 3.9), as are the next three."""
    gyro_walk_radps2_rthz: Positive = 0.00007563
    """K: random walk of the bias."""
    gyro_aliasing: NotNegative = 0.0
    """Part of what neighbouring readings of a rate differ by that is noise to the angle: vibration
    faster than the readings resolve. None where the IMU averages fast samples; about a third for
    one that is read at 100 Hz in a car (docs/accuracy.md)."""
    accel_noise_mps2_rthz: Positive = 0.00022563
    accel_walk_mps3_rthz: Positive = 0.0000353
    """B of docs/theory.md, section 3.9 walked within a second; its K is far below."""
    gyro_bias_std_radps: Positive = 0.01
    """Turn-on bias; 0.3 °/s in docs/theory.md, section 3.9."""
    accel_bias_std_mps2: Positive = 0.15
    """Turn-on bias; 0.1 m/s² in docs/theory.md, section 3.9."""


class Signal(Struct, frozen=True, kw_only=True):
    """One signal of the DBC and what it means."""

    message: str
    signal: str
    scale: Number = 1.0
    """Physical value of the DBC times `scale` is pulses, m/s, 0/1 or newtons."""


class Wheel(Struct, frozen=True, kw_only=True):
    """One wheel: pulses since the last message, a free-running counter, or a speed."""

    message: str
    signal: str
    kind: Literal["pulses", "counter", "speed"]
    scale: Number = 1.0
    """To pulses, or to m/s (a DBC in km/h wants 0.2777777777777778)."""
    counter_bits: Annotated[int, Meta(ge=1, le=63)] = 16
    """Where a counter wraps."""
    side: Literal["", "left", "right", "middle"] = ""
    """Where the wheel is; empty: by its name if that is left or right, else the middle."""


class Odometer(Struct, frozen=True, kw_only=True):
    """Wheels, doors and motor force from a CAN bus."""

    interface: str = "socketcan"
    """Any interface of python-can: socketcan, slcan, virtual, udp_multicast, …"""
    channel: str
    bitrate: Count = 500_000
    dbc: str
    wheels: dict[str, Wheel]
    doors_open: Signal | None = None
    motor_force_n: Signal | None = None
    silence_s: Positive = 2.0
    """No frame for so long: the interface is looked at and opened again."""


class Wheels(Struct, frozen=True, kw_only=True):
    """What the wheels' readings mean."""

    m_per_pulse: Positive = 0.00092038845
    """2π·0.3 m / 2048 (docs/theory.md, section 3.5): the reference vehicle's wheel."""
    track_m: Positive = 1.435
    """Between left and right wheel."""
    scale_std: Positive = 0.03
    """How well `m_per_pulse` or a wheel's speed is known: a worn tyre is 4 to 5 % smaller than a
    new one (docs/theory.md, section 3.5: +12 and +16 mm of 300)."""
    delay_s: Number = 0.0
    """From the instant that a reading describes until its arrival."""
    delay_std_s: NotNegative = 0.003
    stamp_std_s: NotNegative = 0.002
    """Jitter of a reading's arrival, on the CAN bus and in the adapter."""
    speed_std_mps: Positive = 0.05
    """Of a wheel that gives a speed instead of pulses."""
    yaw_rate_std_radps: Positive = 0.01
    """Of the vehicle bus' own yaw-rate sensor, where there is one."""


class Resampler(Struct, frozen=True, kw_only=True):
    """2 kHz to 100 Hz, and the order of everything."""

    factor: Annotated[int, Meta(ge=1, le=1000)] = 20
    method: Literal["mean", "lowpass"] = "mean"
    """mean: kaspar2023, averages `factor` samples. lowpass: pusman2017, decimating FIR."""
    cutoff_hz: Positive = 16.0
    """Of the low-pass (pusman2017)."""
    max_bridge_samples: Annotated[int, Meta(ge=0, le=20_000)] = 20
    """Longest gap that is interpolated and marked: 10 ms at 2 kHz."""
    horizon_lag_s: Annotated[float, Meta(ge=0, le=60)] = 0.3
    """The fusion horizon behind the newest inertial sample: the latest GNSS fix that still counts
    (observed delays up to 0.22 s, and reading)."""
    imu_silence_s: Positive = 0.5
    """Without an inertial sample for so long, ticks move the horizon."""


class Distance(Struct, frozen=True, kw_only=True):
    """The travelled-distance filter of konecny2004."""

    acceleration_std_mps2: Positive = 1.0
    """White acceleration between measurements: trams brake with 1 m/s² in service."""
    gate_sigma: Positive = 5.0


class Ekf(Struct, frozen=True, kw_only=True):
    """The localisation filter."""

    model: Literal["tram", "kaspar2023"] = "tram"
    """tram: ours. kaspar2023: the 25 states of the work, for comparison."""
    integrity_risk: Annotated[float, Meta(gt=0, le=0.1)] = 0.001
    """Share of time that the true error may exceed the protection level, along or across."""
    wheel_creep_m_rtm: NotNegative = 0.0002
    """Creep of a rolling wheel: deviation of its path after one metre; it walks."""
    force_std_mps2_rthz: NotNegative = 0.003
    """Specific force along the track that is no motion: the body's pitching, vibration."""
    sway_std_mps2_rthz: NotNegative = 0.002
    """Lateral specific force that is neither curve nor cant."""
    vertical_std_mps2_rthz: NotNegative = 0.0
    """The same along z: the vertical force then watches over the pitch, which pays on a road, where
    jolts deceive the gyroscopes. 0: it is not used."""
    side_slip_std_m_rts: NotNegative = 0.0
    """Way to the side after a second, which walks: none on rails, centimetres on a road."""
    heave_std_m_rts: NotNegative = 0.002
    """The same upwards: springs, and the body's pitch against the track's."""
    pivot_m: Number = 0.0
    """The vehicle's origin before the point that does not slip sideways: a bogie, a rear axle."""
    pivot_std_m: NotNegative = 0.0
    """How well that is known; the filter learns the rest."""
    acceleration_std_mps2_rthz: Positive = 0.7
    """How the speed may change where no accelerometer tells."""
    tilt_std_rad_rts: Positive = 0.005
    """How roll and pitch may change where no gyroscope tells: a grade of 7 % within 200 s."""


class Map(Struct, frozen=True, kw_only=True):
    """The track network."""

    network: str
    """File that `tramstream map build` wrote."""
    std_m: Positive = 0.5
    """Deviation across of the mapped tracks from the rails, beside what the network itself states:
    what whole stretches have in common. σ_map of kaspar2023 (docs/theory.md, section 11.3)."""
    correlation_m: Positive = 30.0
    """Length of such a stretch."""


class Recorder(Struct, frozen=True, kw_only=True):
    """Where and how records are written."""

    directory: str = "records"
    split_s: Positive = 300.0
    split_bytes: Annotated[int, Meta(ge=1, le=1_000_000_000_000)] = 1_000_000_000
    flush_s: Annotated[float, Meta(gt=0, le=0.5)] = 0.25
    """A chunk is closed and synced this often; what a power cut takes is younger than that."""
    free_space_floor_bytes: Annotated[int, Meta(ge=0, le=1_000_000_000_000_000)] = 500_000_000
    """Below this the oldest unprotected record is deleted first."""
    exclude: tuple[str, ...] = ()
    """Key expressions, relative to `tram/<vehicle>/`, that are not recorded."""


class Simulator(Struct, frozen=True, kw_only=True):
    """A device that does not exist: speaks a real device's bytes on a pseudo terminal."""

    kind: Literal["ride", "gnss_file", "can_file", "imu_still"]
    """ride: all three devices on a simulated ride. gnss_file, can_file: captured bytes at their
    own pace. imu_still: an IMU that stands still."""
    link: str = ""
    """Path at which the pseudo terminal appears; a ride appends .gnss, .imu and .can."""
    file: str = ""
    seed: int = 0
    loop: bool = False


Name = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]{0,63}$")]


class Vehicle(Struct, frozen=True, kw_only=True):
    """Everything about one vehicle."""

    vehicle: VehicleId
    processors: tuple[Name, ...] = ("resampler", "ekf", "distance")
    """Which processors run, by the names under which they are registered. What is installed and
    not named here does not run."""
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

    @property
    def runtime_dir(self) -> Path:
        return Path(self.bus.runtime_dir) if self.bus.runtime_dir else default_runtime_dir()


def default_runtime_dir() -> Path:
    """`TRAMSTREAM_RUNTIME_DIR`, else /run/tramstream for root, else a folder of the user's own."""
    chosen = os.environ.get("TRAMSTREAM_RUNTIME_DIR")
    if chosen:
        return Path(chosen)
    if os.geteuid() == 0:
        return Path("/run/tramstream")
    user = os.environ.get("XDG_RUNTIME_DIR")
    return Path(user) / "tramstream" if user else Path(f"/tmp/tramstream-{os.geteuid()}")
