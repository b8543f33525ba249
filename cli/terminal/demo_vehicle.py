"""The vehicle of `tramstream demo`, and of tests and measurements that ride like it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path

from tramstream.config import Vehicle


def configuration(folder: Path, seed: int, more: Iterable[str] = ()) -> str:
    """The demo's vehicle configuration: like a real one, with simulated devices.

    `more` are processors that run beside those of every vehicle.
    """
    processors = [*Vehicle(vehicle="demo").processors, *more]
    dbc = files("tramstream") / "data" / "tram.dbc"
    return f"""\
vehicle = "demo"
processors = {json.dumps(processors)}

[bus]
runtime_dir = "{folder}/run"

[gnss]
device = "{folder}/ride.gnss"

[imu]
device = "{folder}/ride.imu"

[odometer]
interface = "slcan"
channel = "{folder}/ride.can"
dbc = "{dbc}"
wheels.left = {{ message = "WHEELS", signal = "PULSES_LEFT", kind = "pulses" }}
wheels.right = {{ message = "WHEELS", signal = "PULSES_RIGHT", kind = "pulses" }}
doors_open = {{ message = "DOORS", signal = "DOORS_OPEN" }}
motor_force_n = {{ message = "DRIVE", signal = "MOTOR_FORCE" }}

[recorder]
directory = "{folder}/records"
split_s = 1e6

[simulators.ride]
kind = "ride"
link = "{folder}/ride"
seed = {seed}
"""
