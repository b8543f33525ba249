"""The endurance study: its books find what is wrong, its minute is whole, a short run is exact."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from live import short_folder
from record_samples import START_NS

from tramstream import keys
from tramstream.analysis.endurance import study as endurance
from tramstream.analysis.endurance import vehicle as endurance_vehicle
from tramstream.analysis.endurance.books import Books, Numbers
from tramstream.analysis.endurance.study import Case, Found, Sample
from tramstream.bridges.gnss import ubx
from tramstream.bridges.gnss.capture import epoch_times
from tramstream.clock import S
from tramstream.config_file import load
from tramstream.errors import ConfigError
from tramstream.proto.health_pb2 import Event, Loss, NodeHealth, StageLedger
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import open_record

DBC = """
VERSION ""
BO_ 170 WHEEL_SPEEDS: 8 XXX
 SG_ WHEEL_SPEED_FR : 7|16@0+ (0.01,-67.67) [0|250] "km/h" XXX
 SG_ WHEEL_SPEED_FL : 23|16@0+ (0.01,-67.67) [0|250] "km/h" XXX
 SG_ WHEEL_SPEED_RR : 39|16@0+ (0.01,-67.67) [0|250] "km/h" XXX
 SG_ WHEEL_SPEED_RL : 55|16@0+ (0.01,-67.67) [0|250] "km/h" XXX
"""


def beat(node: str, *stages: tuple[str, str, int, int, int, int], pid: int = 7) -> NodeHealth:
    names = ("stage", "unit", "received", "delivered", "dropped", "pending")
    ledgers = [StageLedger(**dict(zip(names, stage, strict=True))) for stage in stages]
    return NodeHealth(node=node, pid=pid, stages=ledgers)


def told(*messages: NodeHealth) -> Books:
    books = Books()
    for message in messages:
        books.add(keys.HEARTBEAT.at(message.node).on("tram"), message)
    return books


# Books --------------------------------------------------------------------------------------------
def test_stage_that_does_not_add_up_is_found_and_named() -> None:
    books = told(
        beat("gnss", ("queue", "items", 9, 5, 1, 3)), beat("gnss", ("queue", "items", 9, 5, 1, 2))
    )
    assert (books.heartbeats, books.ledgers, books.wrong) == (2, 2, 1)
    assert "gnss queue items: 9 received, 5 delivered" in books.examples[0]


@pytest.mark.parametrize(
    ("received", "exact"), [(99, False), (100, True), (102, True), (103, False)]
)
def test_line_is_exact_where_all_that_was_sent_whole_has_come(received: int, exact: bool) -> None:
    """Two more were cut short: of them as many as there are may have come."""
    simulators = beat(
        "simulators",
        ("imu", "samples", 102, 100, 2, 0),
        ("imu overrun", "samples", 2, 0, 2, 0),
    )
    books = told(simulators, beat("imu", ("imu", "samples", received, received, 0, 0)))
    (line,) = books.lines()
    assert (line.device, line.sent, line.overrun) == ("imu", 100, 2)
    assert line.exact is exact
    assert books.made("imu", "samples") == 102


def test_process_that_was_replaced_is_counted() -> None:
    books = told(beat("gnss", pid=1), beat("gnss", pid=1), beat("gnss", pid=2), beat("imu", pid=3))
    assert dict(books.restarts) == {"gnss": 1}


def part(path: Path, messages: list[tuple[keys.Key, int, Any]]) -> Path:
    with RecordFile(path, "tram") as record:
        for key, sequence, message in messages:
            at_ns = START_NS + sequence * S
            message.sequence = sequence
            payload = message.SerializeToString()
            record.append(key.on("tram"), key, payload, at_ns, at_ns, sequence)
    return path


def test_number_that_is_in_no_part_is_missing_unless_it_is_named_lost(tmp_path: Path) -> None:
    event = keys.EVENT.at("gnss")
    books = Books()
    for name, numbers in (("a", (1, 2, 3)), ("b", (4, 7))):
        messages = [(event, number, Event(kind="gnss.x", source="gnss")) for number in numbers]
        with open_record(part(tmp_path / f"{name}.mcap", messages)) as record:
            books.take(record)
    assert (books.messages, books.topics) == (5, 1)
    assert books.missing == {event.on("tram"): 2}
    assert books.events["gnss", "gnss.x"] == 5
    loss = Loss(consumer="recorder", key=event.on("tram"), count=2, cause=Loss.ABSENT)
    books.add(keys.LOSS.at("recorder").on("tram"), loss)
    assert not books.missing
    assert books.losses["recorder", "ABSENT"] == 2


@pytest.mark.parametrize(
    ("numbers", "gaps", "twice"),
    [
        ((1, 2, 3), 0, 0),
        ((3, 4), 0, 0),
        ((1, 4, 2, 5, 3), 0, 0),
        ((1, 2, 3, 1, 2, 4), 1, 0),
        ((1, 2, 2), 0, 1),
    ],
    ids=("whole", "first is the third", "late", "new process", "twice"),
)
def test_numbers_that_have_not_come_are_known(
    numbers: tuple[int, ...], gaps: int, twice: int
) -> None:
    book = Numbers(numbers[0])
    for number in numbers:
        book.take(number)
    assert (len(book.gaps), book.twice) == (gaps, twice)


def test_loss_that_another_node_told_does_not_excuse_the_record(tmp_path: Path) -> None:
    event = keys.EVENT.at("gnss")
    books = Books()
    with open_record(part(tmp_path / "a.mcap", [(event, n, Event()) for n in (1, 3)])) as record:
        books.take(record)
    loss = Loss(consumer="processors", key=event.on("tram"), count=1)
    books.add(keys.LOSS.at("processors").on("tram"), loss)
    assert books.missing == {event.on("tram"): 1}


def test_memory_is_told_at_an_eighth_and_at_the_end() -> None:
    samples = [Sample(hour / 10, {"gnss": 40.0 + hour}, hour) for hour in range(161)]
    found = Found(samples=samples)
    early, late = found.memory()["gnss"]
    assert 60.0 <= early <= 70.0
    assert 190.0 <= late <= 200.0
    assert found.most_disk_bytes == 160


# What is played -----------------------------------------------------------------------------------
def capture(length_s: int) -> bytes:
    frames = [
        ubx.encode(
            "NAV-PVT",
            {
                "iTOW": 475_200_000 + 1000 * k, "year": 2024, "month": 3, "day": 8, "hour": 12,
                "min": k // 60, "sec": k % 60, "valid": 7, "fixType": 3, "flags": 1, "numSV": 12,
                "lat": 50.0 + 1e-4 * k, "lon": 14.4, "height": 250_000, "hAcc": 900, "vAcc": 1200,
                "velN": 11_000, "sAcc": 300, "pDOP": 1.2,
            },
        )
        for k in range(length_s)
    ]  # fmt: skip
    return b"".join(frames)


def candump(length_s: int = 60) -> str:
    lines = []
    for k in range(100 * length_s):
        at_s = 1000 + k / 100
        lines.append(f"({at_s:.6f}) can0 0AA#1A6F1A6F1A6F1A6F")
        lines.append(f"({at_s + 0.001:.6f}) can0 {0x100 + k % 2:03X}#0102030405060708")
    return "\n".join(lines) + "\n"


def case(folder: Path, receiver_s: int = 90, **more: Any) -> Case:
    (folder / "drive.ubx").write_bytes(capture(receiver_s))
    (folder / "minute.log").write_text(candump())
    (folder / "car.dbc").write_text(DBC)
    return Case(folder / "drive.ubx", folder / "minute.log", folder / "car.dbc", **more)


@pytest.mark.parametrize("length_s", [90, 20])
def test_minute_is_cut_from_a_longer_capture_and_filled_from_a_shorter(
    tmp_path: Path, length_s: int
) -> None:
    (tmp_path / "drive.ubx").write_bytes(capture(length_s))
    minute = endurance_vehicle.first_minute(tmp_path / "drive.ubx")
    told = [gps_ns for _, gps_ns in epoch_times(minute)]
    assert [after - before for before, after in pairwise(told)] == [S] * 59


def test_bus_is_thinned_alike_for_every_identifier(tmp_path: Path) -> None:
    (tmp_path / "minute.log").write_text(candump())
    kept = endurance_vehicle.thinned(tmp_path / "minute.log", 60.0).splitlines()
    shares = {name: sum(f" {name}#" in line for line in kept) for name in ("0AA", "100", "101")}
    assert len(kept) <= 60 * 60
    assert shares == {"0AA": 1500, "100": 750, "101": 750}


def test_capture_without_times_or_frames_is_refused(tmp_path: Path) -> None:
    (tmp_path / "drive.ubx").write_bytes(b"nothing that tells a time")
    with pytest.raises(ConfigError, match="tells the time"):
        endurance_vehicle.first_minute(tmp_path / "drive.ubx")
    with pytest.raises(ConfigError, match="no frame"):
        endurance_vehicle.thinned(tmp_path / "drive.ubx", 50.0)


def test_configuration_names_what_was_written(tmp_path: Path) -> None:
    vehicle = load(endurance_vehicle.prepare(case(tmp_path), tmp_path))
    assert vehicle.imu is not None
    assert vehicle.imu.rate_hz / vehicle.resampler.factor == 5.0
    for simulator in vehicle.simulators.values():
        assert not simulator.file or Path(simulator.file).is_file()


# A run --------------------------------------------------------------------------------------------
@pytest.mark.study
@pytest.mark.live
def test_books_of_a_few_minutes_through_a_running_vehicle_are_exact() -> None:
    """Whatever the machine has else to do: what is lost then is counted."""
    with short_folder() as folder:
        found = endurance.study(case(folder, hours=0.1, pace=10.0, part_s=60.0), folder)
        left = list((folder / "records").glob("*.mcap*"))
    books = found.books
    assert books.exact, (books.examples, books.missing, books.lines())
    assert books.heartbeats > 100
    assert found.parts >= 2
    assert not left
    assert {"supervisor", "gnss", "imu", "odometer", "processors", "recorder"} <= {
        name for sample in found.samples for name in sample.pss_mb
    }
    assert all(line.sent > 0 for line in books.lines())
