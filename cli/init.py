"""`tramstream init [DIR]`: a vehicle configuration to start from, with every field explained."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

CONFIG_NAME = "tram.toml"
DBC_NAME = "tram.dbc"


def init(
    folder: Annotated[
        Path, typer.Argument(metavar="[DIR]", help="Where to write tram.toml and tram.dbc.")
    ] = Path(),
    force: Annotated[
        bool, typer.Option("--force", help="Overwrite a tram.toml that is there already.")
    ] = False,
) -> None:
    """Write a commented vehicle configuration, and the DBC that it names as an example.

    A DBC that is there already is never touched.
    """
    from importlib.resources import files

    from tramstream.cli.terminal.session import say
    from tramstream.errors import ConfigError

    config, dbc = folder / CONFIG_NAME, folder / DBC_NAME
    if config.exists() and not force:
        raise ConfigError(
            f"{config}: exists already; name another folder, or say --force to overwrite it"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        config.write_text(TEMPLATE)
        say(f"{config}: written; all fields are in it, those with a # in front have that default")
        if dbc.exists():
            say(f"{dbc}: kept as it is")
        else:
            dbc.write_bytes((files("tramstream") / "data" / DBC_NAME).read_bytes())
            say(f"{dbc}: written; it is the simulated tram's: put your vehicle's in its place")
    except OSError as error:
        raise ConfigError(
            f"{folder}: cannot be written ({error.strerror}); name a folder that you may write"
        ) from error
    ports = sorted(Path("/dev/serial/by-id").glob("*"))
    if ports:
        say("serial devices here, for gnss.device and imu.device:")
        for port in ports:
            say(f"  {port}")
    say(f"next: change vehicle, devices and wheels in it, then `tramstream doctor {config}`")


TEMPLATE = """\
# Configuration of one vehicle.
#
# Change first: vehicle, gnss.device, imu.device, odometer.channel, odometer.dbc, odometer.wheels.
# Then run `tramstream doctor tram.toml`, which checks all of it, and `tramstream run tram.toml`.
#
# Lines that begin with `#name =` show a default; take the # away to change it. A field that does
# not exist is refused. Units stand in the names: _m, _s, _hz, _mps … Paths are relative to this
# file. A section that is left out ([gnss], [imu] or [odometer]) leaves the device out.

# Name of the vehicle in all keys (tram/<vehicle>/…) and file names: letters, digits, _ . -
vehicle = "tram-1"

[bus]
# Folder of the bus' Unix socket, the clock file and the processors' memory; private to one user.
# Empty: TRAMSTREAM_RUNTIME_DIR, else /run/tramstream for root, else the user's own runtime folder.
# A path longer than 90 characters does not fit a socket.
#runtime_dir = ""


# Devices ------------------------------------------------------------------------------------------

[gnss]
# A u-blox receiver, or any that speaks NMEA, on a serial line. Names under /dev/serial/by-id stay
# the same whatever is plugged in first; /dev/ttyACM0 does not.
device = "/dev/serial/by-id/usb-u-blox_AG_-_www.u-blox.com_u-blox_GNSS_receiver-if00"
# As the receiver is set; over USB any number will do.
#baud_rate = 460800
# From the epoch until the first byte leaves the receiver, when it is fastest. Real receivers take
# 0.10 to 0.22 s; it cannot be observed without a time pulse.
#receiver_delay_s = 0.1
# Antenna from the vehicle's origin: forward, left, up.
#lever_arm_m = [0.0, 0.0, 0.0]
# A fix that the receiver itself thinks worse than this is recorded but not used.
#max_accuracy_m = 100.0
# How well receiver_delay_s is known; the filter estimates the rest.
#delay_std_s = 0.02
# Neighbouring fixes share their error: its correlation time while the antenna moves, and its least
# deviation on each axis, whatever the receiver says.
#error_tau_s = 20.0
#error_floor_m = 0.005

[imu]
# An ADIS16465 behind a microcontroller on a serial line (docs/imu-framing.md).
device = "/dev/serial/by-id/usb-tramstream_imu-if00"
#baud_rate = 2000000
# ADIS16465-1, -2 or -3: the range of the gyroscopes, 125, 500 or 2000 °/s.
#model = "ADIS16465-1"
#rate_hz = 2000.0
# Samples in a message: one message for each window of the resampler.
#batch = 20
# The case from the vehicle's origin: forward, left, up.
#lever_arm_m = [0.0, 0.0, 0.0]
# How the case is turned: roll, pitch, yaw that take vehicle components into the sensor's axes, and
# how well that is known on each axis; the filter estimates the rest.
#mounting_deg = [0.0, 0.0, 0.0]
#mounting_std_deg = 1.0
# How well its stamps are known: a delay found between fixes and IMU is shared by this.
#delay_std_s = 0.002
# Noise of the sensor: white, and the walk of its bias; then the bias when it is switched on.
#gyro_noise_radps_rthz = 0.00011344
#gyro_walk_radps2_rthz = 0.00007563
#gyro_bias_std_radps = 0.01
#gyro_aliasing = 0.0  # about a third where vibration is faster than the readings (docs/accuracy.md)
#accel_noise_mps2_rthz = 0.00022563
#accel_walk_mps3_rthz = 0.0000353
#accel_bias_std_mps2 = 0.15

[odometer]
# Wheels, doors and motor force from a CAN bus, through any interface of python-can: socketcan,
# slcan (then the channel is a serial device), virtual, udp_multicast …
#interface = "socketcan"
channel = "can0"
# Of a socketcan interface the system sets it: ip link set can0 up type can bitrate 500000
#bitrate = 500000
# Describes the frames of the vehicle bus. The example is the simulated tram's.
dbc = "tram.dbc"
# No frame for so long: the interface is looked at and opened again.
#silence_s = 2.0

# One section for each wheel (or bogie, or drive); the name is free.
[odometer.wheels.left]
message = "WHEELS"
signal = "PULSES_LEFT"
# pulses: since the last message; counter: free running, wraps; speed: of the wheel's rim.
kind = "pulses"
# Times this the physical value of the DBC is pulses, or m/s (from km/h: 0.2777777777777778).
#scale = 1.0
# A counter wraps after so many bits.
#counter_bits = 16
# left, right or middle; empty: by its name if that is left or right, else the middle.
#side = ""

[odometer.wheels.right]
message = "WHEELS"
signal = "PULSES_RIGHT"
kind = "pulses"
#scale = 1.0
#counter_bits = 16
#side = ""

# 1 while a door is open. Leave it out if the bus does not tell.
[odometer.doors_open]
message = "DOORS"
signal = "DOORS_OPEN"
#scale = 1.0

# Force of motors and brakes in newtons, positive forward. Leave it out if the bus does not tell.
[odometer.motor_force_n]
message = "DRIVE"
signal = "MOTOR_FORCE"
#scale = 1.0

[wheels]
# What the readings mean. A wheel of 0.3 m radius with 2048 pulses a turn: 2π · 0.3 / 2048.
#m_per_pulse = 0.00092038845
# Between left and right wheel.
#track_m = 1.435
# How well m_per_pulse, or a wheel's speed, is known: tyres wear by 4 to 5 %. The filter learns it.
#scale_std = 0.03
# From the instant that a reading describes until its arrival, how well that is known (the filter
# learns the rest), and how much it jitters.
#delay_s = 0.0
#delay_std_s = 0.003
#stamp_std_s = 0.002
# Of a wheel that gives a speed, and of the vehicle bus' own yaw-rate sensor.
#speed_std_mps = 0.05
#yaw_rate_std_radps = 0.01


# Processors ---------------------------------------------------------------------------------------

[resampler]
# Inertial samples that become one of the ordered stream: 2000 Hz / 20 = 100 Hz.
#factor = 20
# mean: of `factor` samples. lowpass: a decimating FIR filter with the cutoff below.
#method = "mean"
#cutoff_hz = 16.0
# Longest gap that is bridged and marked; 20 samples are 10 ms at 2000 Hz.
#max_bridge_samples = 20
# The ordered stream runs so far behind the newest inertial sample. Whatever comes later (a GNSS fix
# that took longer) is counted and not used.
#horizon_lag_s = 0.3
# Without inertial samples for so long, time alone moves the stream on.
#imu_silence_s = 0.5

[distance]
# Travelled distance and speed.
# How much the speed may change: trams brake with about 1 m/s² in service.
#acceleration_std_mps2 = 1.0
# A measurement further away than so many standard deviations is refused, and counted.
#gate_sigma = 5.0

[ekf]
# The localisation filter. tram: ours; kaspar2023: the 25 states of that work, to compare.
#model = "tram"
# Share of time that the true error may exceed the published protection level.
#integrity_risk = 0.001
# How a wheel creeps (deviation after a metre of way), what of the specific force along the track is
# no motion (the body's pitching, vibration), and what across is neither curve nor cant.
#wheel_creep_m_rtm = 0.0002
#force_std_mps2_rthz = 0.003
#sway_std_mps2_rthz = 0.002
# The same along z, which watches over the pitch on a road; 0: the vertical force is not used.
#vertical_std_mps2_rthz = 0.0
# Way to the side and upwards after a second, which walks; none to the side on rails.
#side_slip_std_m_rts = 0.0
#heave_std_m_rts = 0.002
# The origin before the point that does not slip sideways (a bogie, a rear axle), and how well that
# is known; the filter learns the rest.
#pivot_m = 0.0
#pivot_std_m = 0.0
# Without an IMU: how the speed and the track's tilt may change.
#acceleration_std_mps2_rthz = 0.7
#tilt_std_rad_rts = 0.005

#[map]
# Track network that `tramstream map build` wrote: the matcher then says on which track the vehicle
# is, and the filter is put onto it. Without this section localisation goes on without a map.
#network = "network.tracks"
# How far the mapped tracks lie beside the rails, and over what length they do so alike.
#std_m = 0.5
#correlation_m = 30.0


# Record -------------------------------------------------------------------------------------------

[recorder]
# About 400 MB an hour with all three devices.
#directory = "records"
# A new file after so long, or so much.
#split_s = 300.0
#split_bytes = 1000000000
# Written to disk for good this often: what a power cut takes is younger (0.5 at most).
#flush_s = 0.25
# With less free space than this the oldest record is deleted, unless it is protected.
#free_space_floor_bytes = 500000000
# Keys that are not recorded, relative to tram/<vehicle>/: "raw/gnss/satellites", "raw/*/bytes" …
#exclude = []


# Simulated devices --------------------------------------------------------------------------------
#
# For trying things without hardware. A ride speaks for all three devices on pseudo terminals at
# <link>.gnss, <link>.imu and <link>.can; name those as gnss.device, imu.device and odometer.channel
# (with odometer.interface = "slcan"). Other kinds: gnss_file, can_file (captured bytes at their own
# pace, again and again with loop), imu_still (an IMU at rest); these appear at <link> itself.
#
#[simulators.ride]
#kind = "ride"
#link = "/tmp/ride"
#file = ""
#seed = 0
#loop = false
"""
