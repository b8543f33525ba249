"""doctor: each check finds what it is for, names the cure, and raises for nothing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from functools import reduce
from operator import xor
from pathlib import Path
from types import SimpleNamespace

import pytest
from live import HANG_S, short_folder
from looking import VEHICLE, busy_bus, tramstream
from networks import laid, network_of, straight

from tramstream import config, config_file, keys
from tramstream.bridges.ports import SerialPort
from tramstream.bridges.simulators.pseudo_terminal import PseudoTerminal
from tramstream.cli.checks import devices as checkup_devices
from tramstream.cli.checks import machine
from tramstream.cli.checks.machine import State
from tramstream.cli.init import CONFIG_NAME, init
from tramstream.config import MATCHER, Map


def nmea(number: int) -> bytes:
    """Position of one epoch as a receiver says it without UBX."""
    time_ = f"12{number // 60 % 60:02d}{number % 60:02d}.00"
    place = "5005.00000,N,01425.00000,E"
    bodies = (
        f"GNRMC,{time_},A,{place},0.1,,010924,,,A",
        f"GNGGA,{time_},{place},1,09,0.9,200,M,45,M,,",
    )
    return b"".join(f"${body}*{reduce(xor, body.encode()):02X}\r\n".encode() for body in bodies)


@pytest.fixture
def folder():
    with short_folder() as path:
        yield path


@pytest.fixture
def vehicle(tmp_path) -> config.Vehicle:
    init(tmp_path)
    return config_file.load(tmp_path / CONFIG_NAME)


def with_gnss(device: Path, **more) -> config.Vehicle:
    return config.Vehicle(vehicle=VEHICLE, gnss=config.Gnss(device=str(device)), **more)


def recorder(folder: Path, floor_bytes: int = 0) -> config.Recorder:
    return config.Recorder(directory=str(folder), free_space_floor_bytes=floor_bytes)


def only(findings: list[machine.Finding]) -> machine.Finding:
    (finding,) = findings
    return finding


# The machine --------------------------------------------------------------------------------------
def test_packages_in_use_are_as_wanted():
    assert {finding.state for finding in machine.check_python()} == {State.OK}


def test_missing_and_outdated_packages_come_with_the_command_that_helps():
    wanted = ["numpy>=999", "no-such-package>=1", "other; extra == 'test'", "msgspec"]
    found = machine.check_packages(wanted)
    assert [finding.state for finding in found] == [State.FAIL, State.FAIL]
    assert found[0].cure == "pip install 'numpy>=999'"
    assert "is not installed" in found[1].text


def test_runtime_folder_may_be_made(folder):
    finding = only(machine.check_runtime_dir(folder / "run"))
    assert finding.state == State.OK
    assert not (folder / "run").exists()


def test_runtime_folder_with_a_long_name_fails():
    finding = only(machine.check_runtime_dir(Path("/tmp") / ("x" * 120)))
    assert finding.state == State.FAIL
    assert "shorter" in finding.cure


def test_file_in_place_of_a_folder_fails(folder):
    (folder / "file").write_text("")
    assert only(machine.check_runtime_dir(folder / "file")).state == State.FAIL
    assert machine.check_disk(recorder(folder / "file"))[0].state == State.FAIL


def test_disk_below_the_floor_fails_and_nearly_full_warns(folder):
    free = os.statvfs(folder).f_bavail * os.statvfs(folder).f_frsize
    an_hour = int(free - machine.RECORD_BYTES_PER_H)
    states = [
        machine.check_disk(recorder(folder / "records", floor))[0].state
        for floor in (0, an_hour, 2 * free)
    ]
    assert states[1:] == [State.WARNING, State.FAIL]
    assert list(folder.iterdir()) == []


def test_clock_and_processor_give_a_line_each(folder):
    assert only(machine.check_clock(folder)).name == "clock"
    assert "cores free" in only(machine.check_processor()).text


def test_vehicle_clock_is_compared_once_there_is_one(folder):
    machine.VehicleClock.shared(folder)
    assert machine.check_clock(folder)[-1].name == "vehicle clock"


def test_absent_bus_is_no_failure(folder):
    found, alive = machine.check_bus(folder)
    assert only(found).state == State.OK
    assert alive == []


@pytest.mark.live
def test_running_bus_is_named_with_its_nodes():
    with busy_bus() as folder:
        found, alive = machine.check_bus(folder)
    assert f"{VEHICLE}: gnss" in only(found).text
    assert alive == [keys.alive(VEHICLE, "gnss")]


# Devices ------------------------------------------------------------------------------------------
def test_serial_and_can_checks_never_fail():
    found = [*checkup_devices.check_serial(), *checkup_devices.check_can_interfaces()]
    assert State.FAIL not in {finding.state for finding in found}


def test_absent_device_fails_with_a_cure(tmp_path):
    finding = only(checkup_devices.check_device("gnss", with_gnss(tmp_path / "none"), []))
    assert finding.state == State.FAIL
    assert "no such device" in finding.text
    assert finding.cure


def test_file_is_no_serial_device(tmp_path):
    (tmp_path / "file").write_text("")
    finding = only(checkup_devices.check_device("gnss", with_gnss(tmp_path / "file"), []))
    assert finding.state == State.FAIL


def test_device_of_a_running_node_is_left_alone(tmp_path):
    alive = [keys.alive(VEHICLE, "gnss")]
    finding = only(checkup_devices.check_device("gnss", with_gnss(tmp_path / "none"), alive))
    assert finding.state == State.OK
    assert "running node" in finding.text


def test_simulated_device_appears_later(tmp_path):
    simulators = {"ride": config.Simulator(kind="ride", link=str(tmp_path / "ride"))}
    simulated = with_gnss(tmp_path / "ride.gnss", simulators=simulators)
    assert only(checkup_devices.check_device("gnss", simulated, [])).state == State.OK


def test_dbc_without_the_signal_fails(vehicle):
    dbc = Path(vehicle.odometer.dbc)
    dbc.write_text(dbc.read_text().replace("PULSES_LEFT", "PULSES"))
    finding = only(checkup_devices.check_device("odometer", vehicle, []))
    assert finding.state == State.FAIL
    assert "$.odometer.wheels.left.signal" in finding.text


def test_program_that_has_the_device_is_named(tmp_path):
    terminal = PseudoTerminal(tmp_path / "port")
    terminal.open()
    hold = f"f = open({str(tmp_path / 'port')!r}, 'rb', 0); print(1, flush=True); input()"
    holder = subprocess.Popen(
        [sys.executable, "-c", hold], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        assert holder.stdout.readline()
        finding = only(checkup_devices.check_device("gnss", with_gnss(tmp_path / "port"), []))
        assert finding.state == State.FAIL
        assert f"(process {holder.pid})" in finding.text
    finally:
        holder.communicate(b"\n")
        terminal.close()


def listening_lasts(monkeypatch, counted) -> None:
    """Let time of listening pass with reads, so many seconds as each is `counted`, and only so.

    Only a device of which no such read comes is listened to until `HANG_S`.
    """
    read, begin_s = SerialPort.read, time.monotonic()
    passed_s = 0.0

    def read_one(port):
        nonlocal passed_s
        message = read(port)
        passed_s += counted(message)
        return message

    def now_s() -> float:
        return passed_s + (time.monotonic() - begin_s) * checkup_devices.LISTEN_S / HANG_S

    monkeypatch.setattr(SerialPort, "read", read_one)
    monkeypatch.setattr(checkup_devices, "time", SimpleNamespace(monotonic=now_s))


@pytest.mark.live
@pytest.mark.parametrize(
    ("data_of", "counted", "state", "text"),
    [
        (nmea, lambda message: 0.0, State.OK, "speaks: raw/gnss"),
        (
            lambda number: b"\x00\x81" * 50,
            lambda message: 0.0 if message is None else 0.1,
            State.WARNING,
            "another bit rate than 460800",
        ),
        (
            lambda number: b"\x00\x81" if number % 25 == 0 else b"",
            lambda message: 3.0 if message is not None else 0.0,
            State.WARNING,
            "nothing that gnss understands",
        ),
        (
            lambda number: b"",
            lambda message: 1.0 if message is None else 0.0,
            State.WARNING,
            "silent",
        ),
    ],
)
def test_device_is_listened_to(tmp_path, monkeypatch, data_of, counted, state, text):
    listening_lasts(monkeypatch, counted)
    terminal = PseudoTerminal(tmp_path / "port")
    terminal.open()
    stop = threading.Event()

    def speak() -> None:
        number = 0
        while not stop.wait(0.02):
            number += 1
            terminal.write(data_of(number))

    thread = threading.Thread(target=speak)
    thread.start()
    try:
        finding = only(checkup_devices.check_device("gnss", with_gnss(tmp_path / "port"), []))
    finally:
        stop.set()
        thread.join()
        terminal.close()
    assert finding.state == state
    assert text in finding.text


@pytest.mark.parametrize(
    ("info", "states"),
    [
        ({"state": "ERROR-ACTIVE", "bittiming": {"bitrate": 500_000}, "restart_ms": 100}, []),
        ({"state": "ERROR-ACTIVE", "bittiming": {"bitrate": 250_000}}, [State.FAIL]),
        ({"state": "BUS-OFF", "bittiming": {"bitrate": 500_000}}, [State.WARNING]),
        ({"state": "ERROR-ACTIVE", "bittiming": {"bitrate": 500_000}}, [State.WARNING]),
        ({}, []),
    ],
)
def test_can_link_is_judged(vehicle, info, states):
    found = checkup_devices.judge_link(vehicle.odometer, info)
    assert [finding.state for finding in found] == states
    assert all(finding.cure for finding in found)


# The verb -----------------------------------------------------------------------------------------
def test_verb_without_configuration_checks_the_machine(folder):
    done = tramstream("doctor", "--json", runtime_dir=folder)
    found = json.loads(done.stdout)
    assert done.returncode == (0 if found["ok"] else 1)
    names = {check["name"] for check in found["checks"]}
    assert names >= {"python", "packages", "runtime folder", "bus", "clock", "records", "serial"}


def test_verb_fails_for_a_vehicle_without_its_devices(folder, tmp_path):
    init(tmp_path)
    done = tramstream("doctor", tmp_path / CONFIG_NAME, runtime_dir=folder)
    assert done.returncode == 1
    assert "FAIL     gnss" in done.stdout
    assert "→ " in done.stdout


def test_verb_names_the_field_of_a_bad_configuration(folder, tmp_path):
    (tmp_path / "bad.toml").write_text('vehicle = "1"\n[imu]\ndevice = "/dev/x"\nbatch = "many"\n')
    done = tramstream("doctor", tmp_path / "bad.toml", "--json", runtime_dir=folder)
    failed = [check for check in json.loads(done.stdout)["checks"] if check["state"] == "FAIL"]
    assert done.returncode == 1
    assert any("$.imu.batch" in check["text"] for check in failed)


def test_map_that_nobody_matches_with_is_told(tmp_path: Path) -> None:
    network = tmp_path / "line.tracks"
    network_of([laid(straight(50.0))]).save(network)
    settings = Map(network=str(network))
    assert machine.check_map(settings, ("ekf", MATCHER)).state == "ok"
    found = machine.check_map(settings, ("ekf",))
    assert found.state == "warning"
    assert MATCHER in found.text
    assert MATCHER in found.cure
