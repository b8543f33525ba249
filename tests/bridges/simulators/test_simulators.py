"""Simulated devices on their terminals.

Tests marked `live` run the loop on real pseudo terminals, on a vehicle clock that runs fast, and
wait for conditions. What a pseudo terminal had no room for, because a busy machine did not let the
reader run, is counted by the simulators; the tests allow just that.
"""

from __future__ import annotations

import importlib
import os
import select
import subprocess
import threading
import time
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest
from live import HANG_S, PAUSE_S, until

from tramstream import config, config_file
from tramstream.bridges.gnss import ubx
from tramstream.bridges.gnss.framer import Frame, Framer
from tramstream.bridges.imu.framer import FRAME_LENGTH, AdisFramer
from tramstream.bridges.simulators.devices import run_simulators
from tramstream.bridges.simulators.pseudo_terminal import PseudoTerminal
from tramstream.bridges.simulators.streams import DBC_PATH
from tramstream.clock import S, VehicleClock
from tramstream.errors import ConfigError
from tramstream.lines.line import built_in_line
from tramstream.simulation.ride import Ride

START_NS = 1_790_000_000 * S + 123_456_789


@cache
def ride() -> Ride:
    return Ride(built_in_line())


def capture(times_s: list[float]) -> bytes:
    """A receiver's log with an epoch at each time of a day in 2026, and text ahead of it."""
    data = b"# Name: made up\n# Second line\n"
    for at_s in times_s:
        itow = round((86_400 * 3 + at_s) * 1000)
        gps = {"iTOW": itow, "week": 2425, "leapS": 18, "valid": 7}
        data += ubx.encode("NAV-TIMEGPS", gps) + ubx.encode("NAV-EOE", {"iTOW": itow})
    return data


# Configuration ------------------------------------------------------------------------------------


def vehicle_of(tmp_path: Path, simulators: str, imu_rate_hz: int = 200) -> config.Vehicle:
    text = f"""
    vehicle = "test"
    [gnss]
    device = "./tram.gnss"
    [imu]
    device = "./tram.imu"
    rate_hz = {imu_rate_hz}
    {simulators}
    """
    return config_file.parse(text.encode(), "vehicle.toml", tmp_path)


RIDE = '[simulators.ride]\nkind = "ride"\nlink = "tram"\nseed = 4\n'


@pytest.mark.parametrize(
    ("simulators", "field"),
    [
        ('[simulators.a]\nkind = "ride"\n', r"\$\.simulators\.a\.link"),
        ('[simulators.a]\nkind = "gnss_file"\nlink = "x"\n', r"\$\.simulators\.a\.file"),
        (
            '[simulators.a]\nkind = "can_file"\nlink = "x"\nfile = "absent"\n',
            r"\$\.simulators\.a\.file",
        ),
        (
            '[simulators.a]\nkind = "imu_still"\nlink = "x"\n'
            '[simulators.b]\nkind = "imu_still"\nlink = "x"\n',
            "same link",
        ),
    ],
)
def test_unusable_simulator_is_refused_by_name(tmp_path: Path, simulators: str, field: str) -> None:
    vehicle = vehicle_of(tmp_path, simulators)
    with pytest.raises(ConfigError, match=field):
        run_simulators(vehicle, VehicleClock(START_NS), threading.Event())


def test_file_in_the_way_of_a_link_is_refused_and_kept(tmp_path: Path) -> None:
    (tmp_path / "tram.imu").write_text("mine")
    with pytest.raises(ConfigError, match=r"tram\.imu"):
        run_simulators(vehicle_of(tmp_path, RIDE), VehicleClock(START_NS), threading.Event())
    assert [path.name for path in tmp_path.iterdir()] == ["tram.imu"]
    assert (tmp_path / "tram.imu").read_text() == "mine"


# Live ---------------------------------------------------------------------------------------------


class Running:
    """Simulators in a thread, on a clock that runs fast."""

    def __init__(self, vehicle: config.Vehicle, rate: float) -> None:
        self.clock = VehicleClock(START_NS, rate)
        self.stop = threading.Event()
        self.truths: list[Any] = []
        self.events: list[dict[str, Any]] = []
        self.result: dict[str, dict[str, Any]] = {}
        self._vehicle = vehicle
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        self.result = run_simulators(
            self._vehicle, self.clock, self.stop, self.truths.append, self.events.append
        )

    def __enter__(self) -> Running:
        self._thread.start()
        until(lambda: any(event["event"] == "ready" for event in self.events), "the devices")
        return self

    def __exit__(self, *_: object) -> None:
        self.stop.set()
        self.join()

    def join(self) -> None:
        self._thread.join(HANG_S)
        assert not self._thread.is_alive()

    def faults(self, device: str) -> Counter[str]:
        counter: Counter[str] = Counter()
        for event in self.events:
            if event["event"] == "fault" and event["device"] == device:
                counter.update(event["faults"])
        return counter


class Reader:
    """A program that reads a serial line and leaves all as it finds it."""

    def __init__(self, link: Path) -> None:
        self._link = link

    def __enter__(self) -> Reader:
        self._fd = os.open(self._link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._fd)

    def read(self) -> bytes:
        """What has come; empty once the line has hung up."""
        ready, _, _ = select.select([self._fd], [], [], HANG_S)
        assert ready, "nothing came"
        try:
            return os.read(self._fd, 4096)
        except OSError:
            return b""


@pytest.mark.live
def test_devices_of_a_ride_appear_and_are_gone_afterwards(tmp_path: Path) -> None:
    with Running(vehicle_of(tmp_path, RIDE), rate=10) as running:
        ready = running.events[0]
        assert ready["links"] == {
            f"ride.{suffix}": str(tmp_path / f"tram.{suffix}") for suffix in ("gnss", "imu", "can")
        }
        for link in ready["links"].values():
            assert os.readlink(link).startswith("/dev/pts/")
        until(lambda: len(running.truths) > 30, "the truth of three seconds")
    assert list(tmp_path.iterdir()) == []
    stamps = [truth.stamp_ns for truth in running.truths]
    assert np.all(np.diff(stamps) == S // 10)
    for truth in running.truths:
        expected = ride().truth((truth.stamp_ns - stamps[0]) / S, truth.stamp_ns)
        assert truth == expected


@pytest.mark.live
def test_imu_reader_gets_every_sample_though_it_opens_twice(tmp_path: Path) -> None:
    framer = AdisFramer()
    numbers: list[int] = []
    with Running(vehicle_of(tmp_path, RIDE), rate=4) as running:
        for target in (400, 1200):
            with Reader(tmp_path / "tram.imu") as line:
                while len(numbers) < target:
                    numbers += framer.feed(line.read()).frames["sequence"].tolist()
    assert numbers == sorted(set(numbers))
    assert numbers[0] == 0
    overrun = running.result["ride.imu"]["overrun"]
    missing = numbers[-1] + 1 - len(numbers)
    assert missing <= overrun.get("samples", 0)  # of a write that was cut, some did come
    assert overrun or framer.rejected_by_reason == {}


@pytest.mark.live
def test_python_can_opens_the_bus_and_hears_all_the_pulses(tmp_path: Path) -> None:
    database: Any = cantools.database.load_file(DBC_PATH)
    pulses: Counter[str] = Counter()
    importlib.import_module("can.interfaces.slcan")  # before the clock runs towards the departure
    with Running(vehicle_of(tmp_path, RIDE), rate=2) as running:
        options = {"channel": str(tmp_path / "tram.can"), "bitrate": 500_000}
        with can.Bus(interface="slcan", sleep_after_open=0.0, **options) as bus:
            first = None
            while pulses["LEFT"] < 5000:
                message = bus.recv(HANG_S)
                assert message is not None
                if message.arbitration_id == 0x110:
                    wheels = database.decode_message(0x110, message.data)
                    first = wheels["COUNTER"] if first is None else first
                    pulses["LEFT"] += wheels["PULSES_LEFT"]
                    pulses["RIGHT"] += wheels["PULSES_RIGHT"]
    tally = running.result["ride.can"]
    assert tally["sent"]["pulses_left"] >= pulses["LEFT"]
    assert tally["unheard"].get("pulses_left", 0) == 0  # nothing is lost before the departure


@pytest.mark.live
def test_pulled_receiver_hangs_up_and_comes_back(tmp_path: Path) -> None:
    link = tmp_path / "tram.gnss"
    names: Counter[str] = Counter()
    with Running(vehicle_of(tmp_path, RIDE), rate=25) as running:
        framer = Framer()
        with Reader(link) as line:
            while data := line.read():
                names.update(_names(framer, data))
        before = names["NAV-PVT"]
        until(lambda: running.faults("ride.gnss")["unplugged"], "the cable to be pulled")
        until(link.exists, "the receiver to come back")
        names.clear()
        framer = Framer()
        with Reader(link) as line:
            while names["NAV-PVT"] < 20:
                names.update(_names(framer, line.read()))
    tally = running.result["ride.gnss"]
    assert 0 < before <= tally["sent"]["fixes"]  # less what was in the line when it was cut
    assert tally["unplugged"]["fixes"] in (14, 15, 16)  # three seconds
    assert tally["faults"]["unplugged"] == 1
    assert tally["faults"].get("checksums_spoilt") == 1 or tally["bytes_overrun"]


def _names(framer: Framer, data: bytes) -> list[str]:
    return [item.name for item in framer.feed(data) if isinstance(item, Frame)]


@pytest.mark.live
def test_absent_reader_blocks_nobody_and_its_bytes_are_counted(tmp_path: Path) -> None:
    with Running(vehicle_of(tmp_path, RIDE, imu_rate_hz=2000), rate=4) as running:
        until(
            lambda: any(
                event["event"] == "progress" and event["devices"]["ride.imu"]["overrun"]
                for event in list(running.events)
            ),
            "samples that found no room",
        )
        reached = len(running.truths)
        until(lambda: len(running.truths) > reached + 5, "the ride to go on")
    tally = running.result["ride.imu"]
    assert tally["bytes_overrun"] > 0
    produced = tally["sent"]["samples"] + tally["overrun"]["samples"]
    assert tally["bytes_sent"] + tally["bytes_overrun"] == produced * FRAME_LENGTH


@pytest.mark.live
def test_simulators_end_with_their_files(tmp_path: Path) -> None:
    data = capture([0.0, 0.5, 1.0])
    (tmp_path / "capture.ubx").write_bytes(data)
    (tmp_path / "bus.candump").write_text("(1.0) can0 001#\n(2.0) can0 002#11\n")
    simulators = (
        '[simulators.receiver]\nkind = "gnss_file"\nlink = "rx"\nfile = "capture.ubx"\n'
        '[simulators.bus]\nkind = "can_file"\nlink = "bus"\nfile = "bus.candump"\n'
    )
    with Running(vehicle_of(tmp_path, simulators), rate=1) as running:
        heard = b""
        with Reader(tmp_path / "rx") as line:
            while not heard.endswith(data[-20:]):
                heard += line.read()
        running.join()
    assert data.endswith(heard)
    assert running.result["receiver"]["sent"] == {"frames": 6, "epochs": 3}
    assert running.result["bus"]["unheard"]["frames"] == 2  # nobody opened the channel
    assert running.truths == []


@pytest.mark.live
def test_terminal_drops_what_has_no_room_instead_of_waiting(tmp_path: Path) -> None:
    terminal = PseudoTerminal(tmp_path / "line")
    terminal.open()
    try:
        sent = sum(terminal.write(b"\x55" * 1000) for _ in range(100))
        assert 0 < sent < 100_000
        assert terminal.bytes_sent + terminal.bytes_overrun == 100_000
        assert terminal.read() == b""
    finally:
        terminal.close()
    assert not terminal.is_open
    assert not (tmp_path / "line").is_symlink()


STILL = '[simulators.imu]\nkind = "imu_still"\nlink = "tram.imu"\nseed = 1\n'


@pytest.mark.live
def test_patient_devices_say_nothing_before_another_process_has_opened_them(
    tmp_path: Path,
) -> None:
    """The first byte they ever send is what it reads first, however late it comes."""
    link = tmp_path / "tram.imu"
    with Running(vehicle_of(tmp_path, STILL + "patience_s = 1e6\n"), rate=100) as running:
        with Reader(link):  # of the same process: it may be the simulator's own
            time.sleep(10 * PAUSE_S)
        assert [event["event"] for event in running.events] == ["ready"]
        opened_ns = running.clock.now_ns()
        host = subprocess.Popen([*HOST, str(link)], stdout=subprocess.PIPE)
        try:
            assert host.stdout is not None
            heard = host.stdout.read(10 * FRAME_LENGTH)
        finally:
            host.kill()
            host.communicate()
    assert AdisFramer().feed(heard).frames["sequence"].tolist() == list(range(10))
    assert next(e for e in running.events if e["event"] == "progress")["stamp_ns"] > opened_ns


HOST = (
    "python3",
    "-c",
    "import os, sys\n"
    "line = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)\n"
    "while True: os.write(1, os.read(line, 4096))\n",
)
"""Opens a line and passes on what comes."""


@pytest.mark.live
def test_devices_are_pulled_out_when_their_time_is_over(tmp_path: Path) -> None:
    with Running(vehicle_of(tmp_path, STILL + "lasts_s = 2.0\n"), rate=10) as running:
        running.join()
    assert not (tmp_path / "tram.imu").is_symlink()
    tally = running.result["imu"]
    made = tally["sent"].get("samples", 0) + tally["overrun"].get("samples", 0)
    assert 399 <= made <= 401  # 200 a second; the device's clock is a little fast
