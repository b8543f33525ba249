"""What `tramstream doctor` says of real CAN interfaces; see `guest_bus`."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from guest_bus import (
    DBC,
    GUEST_ONLY,
    REMOTE_BIT,
    WHEELS_ID,
    Sender,
    remove,
    sh,
    vehicle_of,
)

pytestmark = GUEST_ONLY


# Doctor -------------------------------------------------------------------------------------------
def findings(channel: str, **changes: Any) -> list[tuple[str, str, str]]:
    from tramstream.cli.checks import devices

    found = devices.check_device("odometer", vehicle_of(channel, **changes), [])
    for finding in found:
        print(f"\n{finding.state}: {finding.text} → {finding.cure}", end="")
    assert "has all signals" in found[0].text
    return [(str(finding.state), finding.text, finding.cure) for finding in found[1:]]


def test_doctor_lists_the_interfaces_with_their_state(vcan: None) -> None:
    from tramstream.cli.checks import devices

    sh("ip link set can0 down")
    sh("ip link set can1 up type can bitrate 250000")
    (finding,) = devices.check_can_interfaces()
    assert finding.text == "can0 (down), can1 (up), vcan0 (up)"
    sh("ip link set vcan0 down")
    sh("ip link set can1 down")
    (finding,) = devices.check_can_interfaces()
    assert finding.text == "can0 (down), can1 (down), vcan0 (down)"


@contextmanager
def speaking(id_: int, data: bytes = b"") -> Iterator[None]:
    """Somebody says something twenty times a second, whenever doctor begins to listen."""
    sender, stop = Sender(), threading.Event()

    def speak() -> None:
        while not stop.wait(0.05):
            sender.send(id_, data)

    speaker = threading.Thread(target=speak)
    speaker.start()
    try:
        yield
    finally:
        stop.set()
        speaker.join()


def test_doctor_hears_a_bus_that_speaks(vcan: None) -> None:
    with speaking(WHEELS_ID, bytes(8)):
        ((state, text, _),) = findings("vcan0")
    assert state == "ok"
    assert "vcan0 speaks" in text


def test_doctor_tells_silence_from_frames_that_mean_nothing(vcan: None) -> None:
    ((state, text, _),) = findings("vcan0")
    assert state == "warning"
    assert "silent" in text
    with speaking(0x7 | REMOTE_BIT):  # frames without bytes
        ((state, text, cure),) = findings("vcan0")
    assert state == "warning"
    assert "nothing that odometer understands" in text
    assert "bit rate" in cure


def test_doctor_on_an_interface_that_is_down_or_absent() -> None:
    remove("vcan0")
    sh("ip link add vcan0 type vcan")
    ((state, text, cure),) = findings("vcan0")
    assert (state, cure) == ("FAIL", "sudo ip link set vcan0 up")
    assert "is down" in text
    remove("vcan0")
    ((state, text, _),) = findings("vcan0")
    assert state == "FAIL"
    assert "no such network interface" in text


def test_doctor_compares_the_bit_rate_and_its_cures_work() -> None:
    sh("ip link set can0 down")
    sh("ip link set can0 up type can bitrate 250000 restart-ms 0")
    first = findings("can0")[0]
    assert first[0] == "FAIL"
    assert "runs at 250000 bit/s" in first[1]
    apply(first[2])
    ((state, text, _),) = findings("can0")
    assert state == "warning"
    assert "silent" in text
    sh("ip link set can0 down")
    sh("ip link set can0 up type can bitrate 500000 restart-ms 0")
    first = findings("can0")[0]
    assert first[0] == "warning"
    assert "stays off the bus" in first[1]
    apply(first[2])
    assert "silent" in findings("can0")[0][1]
    sh("ip link set can0 down")


def apply(cure: str) -> None:
    """Do what a cure says."""
    for command in cure.split(";"):
        sh(command.strip().removeprefix("sudo "))


def test_doctor_as_a_program(tmp_path: Path, wire: None) -> None:
    """The whole verb, on a controller that is down."""
    sh("ip link set can0 down")
    path = tmp_path / "t.toml"
    path.write_text(
        f'vehicle = "t"\n[odometer]\nchannel = "can0"\n'
        f'dbc = "{DBC}"\n[odometer.wheels.left]\nmessage = "WHEELS"\nsignal = "PULSES_LEFT"\n'
        'kind = "pulses"\n'
    )
    command = [sys.executable, "-m", "tramstream.cli.main", "doctor", str(path), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stdout + done.stderr
    checks = json.loads(done.stdout)["checks"]
    mine = [check for check in checks if check["name"] in ("CAN", "odometer")]
    assert [check["state"] for check in mine] == ["ok", "ok", "FAIL"], mine
    assert "is down" in mine[-1]["text"]
    assert not done.stderr
