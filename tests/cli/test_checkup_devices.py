"""Tests of the checks of CAN that need no CAN; `tests/vcan` has a real kernel."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest

from tramstream import keys
from tramstream.bridges.odometer import socketcan
from tramstream.cli.checks import devices
from tramstream.config import Odometer, Wheel
from tramstream.processor import Sample
from tramstream.proto.health_pb2 import Event
from tramstream.proto.raw_pb2 import CanFrames

CONFIG: dict[str, Any] = {
    "channel": "can0",
    "dbc": "",
    "wheels": {"left": Wheel(message="M", signal="S", kind="pulses")},
}


def test_short_queue_is_a_warning_with_its_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    """What Linux 6.1 grants by default holds 555 frames (docs/can.md)."""
    monkeypatch.setattr(socketcan, "granted_bytes", lambda: 212_992)
    (finding,) = devices.check_queue(Odometer(**CONFIG))
    assert finding.state == "warning"
    assert "holds 555 frames" in finding.text
    assert "net.core.rmem_max=8388608" in finding.cure
    assert devices.check_queue(Odometer(interface="virtual", **CONFIG)) == []
    monkeypatch.setattr(socketcan, "granted_bytes", lambda: socketcan.BUFFER_BYTES)
    assert devices.check_queue(Odometer(**CONFIG)) == []


def test_virtual_interface_is_up_though_its_state_is_unknown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, type_, flags in (("can0", "280", "0x40080"), ("lo", "772", "0x9"), ("v", "280", "1")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "type").write_text(f"{type_}\n")
        (tmp_path / name / "flags").write_text(f"{flags}\n")
        (tmp_path / name / "operstate").write_text("unknown\n")
    monkeypatch.setattr(socketcan, "INTERFACES", tmp_path)
    (finding,) = devices.check_can_interfaces()
    assert finding.text == "can0 (down), v (up)"


def test_ip_that_hangs_leaves_the_bit_rate_unjudged(monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(*_: object, **__: object) -> None:
        raise subprocess.TimeoutExpired("ip", 5)

    monkeypatch.setattr(subprocess, "run", hang)
    assert devices.check_bit_rate(Odometer(**CONFIG)) == []


class _Talker:
    """A port that always has something, and a bridge that only complains of it."""

    key = keys.ODO_FRAMES
    device = "can0"

    def open(self) -> None: ...

    def close(self) -> None: ...

    def read(self) -> CanFrames:
        return CanFrames(stamp_ns=1, device="can0", id=[7], flags=[0], offset_ns=[0], data=[b""])

    def step(self, sample: Sample) -> list[Sample]:
        return [Sample(keys.EVENT.at("odometer"), Event(), 1, 1)]

    def device_troubles(self) -> list[object]:
        return []


def test_device_of_which_only_events_are_told_does_not_speak(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As a bus on which no frame is one that the DBC knows: that it is said is no reading."""
    monkeypatch.setattr(devices, "LISTEN_S", 0.1)
    finding = devices._listen("odometer", _Talker(), _Talker())
    assert finding.state == "warning"
    assert "nothing that odometer understands" in finding.text
