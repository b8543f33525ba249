"""A report tells a receiver that is away as an outage."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from report_samples import START_NS, VEHICLE

from tramstream import config_file, keys
from tramstream.analysis.report.compose import compose
from tramstream.analysis.report.source import collect
from tramstream.clock import S
from tramstream.config import Gnss, Vehicle
from tramstream.keys import Key
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.health_pb2 import DeviceHealth
from tramstream.proto.raw_pb2 import Odometry
from tramstream.recorder.file.writer import RecordFile


def unplugged(path: Path, from_s: float, to_s: float, fixes: bool = True) -> Path:
    """A ride of 30 s whose receiver is away for a while, as its bridge says once a second."""
    config = Vehicle(vehicle=VEHICLE, gnss=Gnss(device="/dev/gnss"))
    with RecordFile(path, VEHICLE, {config_file.RECORD_ENTRY: config_file.to_json(config)}) as file:
        for step in range(300):
            stamp_ns, away = START_NS + step * S // 10, from_s <= step / 10 < to_s
            if step % 2 == 0 and fixes and not away:
                sent = keys.GNSS_FIX, GnssFix(stamp_ns=stamp_ns, valid=True, latitude_deg=50)
                append(file, *sent, stamp_ns)
            if step % 10 == 0:
                state = DeviceHealth.LOST if away else DeviceHealth.OPEN
                health = DeviceHealth(stamp_ns=stamp_ns, device="gnss", state=state)
                append(file, keys.DEVICE.at("gnss"), health, stamp_ns)
            odometry = Odometry(stamp_ns=stamp_ns)
            append(file, keys.ODO_WHEELS, odometry, stamp_ns)
    return path


def append(file: RecordFile, key: Key, message: Any, stamp_ns: int) -> None:
    payload = message.SerializeToString()
    file.append(key.on(VEHICLE), key, payload, stamp_ns, stamp_ns, 1)


@pytest.mark.parametrize(
    ("from_s", "to_s", "outages"),
    [(10, 13, [(9.8, 13.0)]), (10, 18, [(9.8, 18.0)]), (27, 31, [(26.8, 29.9)]), (40, 41, [])],
)
def test_receiver_that_is_unplugged_is_an_outage_however_short(
    tmp_path: Path, from_s: float, to_s: float, outages: list[tuple[float, float]]
) -> None:
    material = collect(unplugged(tmp_path / "a.mcap", from_s, to_s), "", "", print)
    found = [
        [(each - START_NS) / S for each in pair] for pair in zip(*material.outages, strict=True)
    ]
    assert found == [pytest.approx(each, abs=0.01) for each in outages]


@pytest.mark.parametrize("from_s", [0, 99])
def test_receiver_that_never_gave_a_fix_is_an_outage_of_the_whole_ride(
    tmp_path: Path, from_s: float
) -> None:
    """Unplugged, or there and without a word."""
    path = unplugged(tmp_path / "a.mcap", from_s, 100, fixes=False)
    material = collect(path, "", "", print)
    assert [(each[0] - START_NS) / S for each in material.outages] == pytest.approx([0, 29.9])
    assert "0.0 %" in compose(material)
    assert "of the time with GNSS, 1 outage" in compose(material)
