"""The vehicle of the endurance study: a captured minute, again and again, on pseudo terminals.

The receiver's minute is repeated for an hour with its times moved on (`moved_times`), as of a
receiver that is on; then the hour comes again, and its times jump back by one, as of a receiver
that is played from a file. Where the vehicle was goes back with every minute: it leaps, and the
filter has to bear it. Of a car's CAN bus each n-th frame of each identifier comes, as many as are
told. No IMU was captured that speaks our frames: a simulated one stands still.

The whole vehicle lives `pace` times as fast: the clock that its processes share runs so
(`VehicleClock.rate`), and with it the devices, all stamps and all timers. What the machine makes
(scheduling, the bus, the disk) does not live faster, so that 50 ms of it are a second to the
vehicle: the fusion horizon lies further back than on a vehicle, and silence is told later.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

from tramstream.bridges.gnss import ubx
from tramstream.bridges.gnss.framer import UBX, Frame, Framer
from tramstream.bridges.odometer import candump
from tramstream.bridges.odometer.frames import CanFrame
from tramstream.bridges.simulators.captures import GnssLog
from tramstream.bridges.simulators.moved_times import moved
from tramstream.clock import S
from tramstream.errors import ConfigError

NAME = "endurance"
RECEIVER = Path("ubx/zed-f9r-drive.ubx")
BUS = Path("can/rav4_minute.candump")
DBC = Path("can/toyota_2017.dbc")
DEVICE = "imu"
"""Of the pseudo terminals; all are there while something is played."""
HOUR = "hour.ubx"
PATIENCE_S = 120.0
"""A busy machine needs long to start the vehicle."""
MINUTE_S = 60
REPETITIONS = 60
"""Of the minute, until the receiver's times jump back."""
HORIZON_S, SILENCE_S = 20.0, 10.0
"""A second of the machine, and half of one, at twenty times its pace."""


@dataclass(frozen=True)
class Case:
    """What is played, how long, and how fast."""

    receiver: Path
    """Capture of a receiver; its first minute is played."""
    bus: Path
    """A minute of candump."""
    dbc: Path
    hours: float = 24.0
    """Of the vehicle's time."""
    pace: float = 20.0
    """The vehicle's seconds a second."""
    can_hz: float = 50.0
    """Frames of the bus a second of the vehicle's time, at most."""
    imu_hz: float = 50.0
    frames_hz: float = 5.0
    """Of the resampler, and so of the filter."""
    part_s: float = 300.0
    """A file of the record, the vehicle's time."""

    @property
    def duration_s(self) -> float:
        """Of the vehicle's time."""
        return 3600.0 * self.hours


def prepare(case: Case, folder: Path) -> Path:
    """Write what is played and the configuration into `folder`; the configuration's path.

    Raises
    ------
    ConfigError
        If a capture cannot be read, or no epoch, no frame is in it.
    """
    minute = first_minute(case.receiver)
    hour = b"".join(moved(minute, n * MINUTE_S) for n in range(REPETITIONS))
    (folder / HOUR).write_bytes(hour)
    (folder / "minute.candump").write_text(thinned(case.bus, case.can_hz))
    config = folder / "endurance.toml"
    config.write_text(configuration(case, folder))
    return config


def frames_before(capture: bytes) -> dict[int, int]:
    """Frames of a receiver's capture before each epoch, by its time of week, ms."""
    log = GnssLog.cut(capture)
    starts = accumulate((frames for _, _, frames in log.epochs), initial=0)
    times = [itow for _, data, _ in log.epochs if (itow := _itow_ms(data)) is not None]
    return dict(zip(times, starts, strict=False)) if len(times) == len(log.epochs) else {}


def _itow_ms(epoch: bytes) -> int | None:
    """Time of week of the first message of an epoch that tells it."""
    framer = Framer()
    for item in framer.feed(epoch) + framer.flush():
        message = ubx.decode(item) if isinstance(item, Frame) and item.protocol == UBX else None
        if isinstance(message, ubx.UbxMessage) and "iTOW" in message.fields:
            return int(message.fields["iTOW"])
    return None


def first_minute(path: Path) -> bytes:
    """Bytes of the first minute of a receiver's capture; a shorter one is repeated to fill it.

    Raises
    ------
    ConfigError
        If the file cannot be read, or tells no time.
    """
    log = GnssLog.load(path)
    if not log.length_ns:
        raise ConfigError(f"{path}: no frame of this capture tells the time")
    length_s = max(round(log.length_ns / S), 1)
    whole = b"".join(data for at_ns, data, _ in log.epochs if at_ns < MINUTE_S * S)
    rest = MINUTE_S // length_s
    return b"".join([whole, *(moved(whole, n * length_s) for n in range(1, rest))])


def thinned(path: Path, most_hz: float) -> str:
    """Each n-th frame of each identifier of a candump log, no more than `most_hz` a second.

    Raises
    ------
    ConfigError
        If the file cannot be read, or holds no frames.
    """
    try:
        lines = path.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError as error:
        raise ConfigError(f"{path}: cannot read the capture ({error.strerror})") from error
    frames = [frame for frame in map(candump.parse_line, lines) if isinstance(frame, CanFrame)]
    if not frames:
        raise ConfigError(f"{path}: no frame is in this capture")
    lasts_s = max((frames[-1].stamp_ns - frames[0].stamp_ns) / S, 1.0)
    every = max(1, math.ceil(len(frames) / lasts_s / most_hz))
    seen: Counter[int] = Counter()
    kept = []
    for line in lines:
        frame = candump.parse_line(line)
        if isinstance(frame, CanFrame):
            seen[frame.id] += 1
            if seen[frame.id] % every == 0:
                kept.append(line)
    return "\n".join(kept) + "\n"


def configuration(case: Case, folder: Path) -> str:
    """The vehicle's configuration: like docs/captures.toml, with fewer readings a second."""
    wheels = "".join(
        f'{name} = {{ message = "WHEEL_SPEEDS", signal = "WHEEL_SPEED_{short}", kind = "speed", '
        "scale = 0.2777777777777778 }\n"
        for name, short in (
            ("front_left", "FL"), ("front_right", "FR"), ("rear_left", "RL"), ("rear_right", "RR")
        )
    )  # fmt: skip
    factor = max(1, round(case.imu_hz / case.frames_hz))
    return f"""\
vehicle = "{NAME}"

[bus]
runtime_dir = "{folder}/run"

[gnss]
device = "{folder}/gnss"

[imu]
device = "{folder}/imu"
rate_hz = {case.imu_hz:g}
batch = {factor}

[resampler]
factor = {factor}
horizon_lag_s = {HORIZON_S:g}
imu_silence_s = {SILENCE_S:g}

[odometer]
interface = "slcan"
channel = "{folder}/can"
dbc = {json.dumps(str(case.dbc.absolute()))}

[odometer.wheels]
{wheels}
[recorder]
directory = "{folder}/records"
split_s = {case.part_s:g}

[simulators.gnss]
kind = "gnss_file"
patience_s = {PATIENCE_S:g}
lasts_s = {case.duration_s:g}
link = "{folder}/gnss"
file = "{folder}/{HOUR}"
loop = true

[simulators.odometer]
kind = "can_file"
link = "{folder}/can"
file = "{folder}/minute.candump"
loop = true

[simulators.imu]
kind = "imu_still"
link = "{folder}/{DEVICE}"
seed = 1
"""
