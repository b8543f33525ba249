"""Names and order of parts on a computer that begins every boot in 1970."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from disks import Watched
from record_samples import VEHICLE, Sent, plain, traffic

from tramstream import keys
from tramstream.clock import GPS_EPOCH_UNIX_S, S, VehicleClock
from tramstream.config import Recorder
from tramstream.proto.gnss_pb2 import GnssTime
from tramstream.recorder.describe import describe
from tramstream.recorder.file.sink import Worker
from tramstream.recorder.names import BOOT_FILE, PartNames, UtcOffset, parse
from tramstream.recorder.reader import open_record
from tramstream.recorder.recording import Recording
from tramstream.recorder.space import FreeSpace
from tramstream.transport.bus import LocalBus

NOON_NS = 1_796_040_000 * S
"""2026-11-30T12:00:00 UTC: when the third boot of these tests began, whatever its clock said."""


class Boot:
    """A computer without a battery, from switching it on to switching it off."""

    def __init__(self, folder: Path, boot_id: str, knows: bool = False) -> None:
        self.ns = 5 * S
        self.knows = knows
        clock = VehicleClock(monotonic_ns=lambda: self.ns, utc_ns=self.utc_ns)
        self.recording = Recording(
            folder,
            VEHICLE,
            Recorder(split_s=10.0, free_space_floor_bytes=0),
            clock,
            {"boot_id": boot_id},
            Worker(threaded=False, storage=Watched()),
        )
        self.recording.start()
        self.sent: list[Sent] = []

    def utc_ns(self) -> int:
        """The host's clock: 1970 until somebody sets it."""
        return self.ns + (NOON_NS if self.knows else 0)

    def ride(self, parts: int) -> None:
        for _ in range(parts):
            for one in traffic(20, start_ns=self.ns):
                self.sent.append(one)
                self.recording.append(
                    one.topic, one.key, one.payload, one.log_ns, one.publish_ns, one.sequence
                )
            self.ns += 10 * S
            self.recording.flush()

    def off(self) -> None:
        assert self.recording.close()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("*.mcap*"))


def test_parts_are_counted_by_boot_whatever_the_clock_says(tmp_path):
    for boot in ("first", "second"):
        one = Boot(tmp_path, boot)
        one.ride(2)
        one.off()
    assert names(tmp_path) == [
        "4711_b0001-0001_19700101T000005Z.mcap",
        "4711_b0001-0002_19700101T000015Z.mcap",
        "4711_b0002-0001_19700101T000005Z.mcap",
        "4711_b0002-0002_19700101T000015Z.mcap",
    ]


def test_recorder_that_is_started_again_goes_on_counting_in_its_boot(tmp_path):
    for _ in range(2):
        one = Boot(tmp_path, "same")
        one.ride(1)
        one.off()
    assert [parse(name)[:3] for name in names(tmp_path)] == [(1, "", 1), (1, "", 2)]


@pytest.mark.parametrize("garbage", [b"", b"{", b"[]", b'{"number": "x"}', b"\xff\x00", None])
def test_count_of_boots_survives_the_loss_of_its_file(tmp_path, garbage):
    (tmp_path / "4711_b0041-0007_19700101T000005Z.mcap").write_bytes(b"old")
    if garbage is not None:
        (tmp_path / BOOT_FILE).write_bytes(garbage)
    assert PartNames(tmp_path, VEHICLE, "now", UtcOffset()).boot == 42
    assert PartNames(tmp_path, VEHICLE, "now", UtcOffset()).boot == 42
    assert json.loads((tmp_path / BOOT_FILE).read_text()) == {"boot_id": "now", "number": 42}


def test_emptied_folder_goes_on_counting_boots(tmp_path):
    assert PartNames(tmp_path, VEHICLE, "first", UtcOffset()).boot == 1
    assert PartNames(tmp_path, VEHICLE, "second", UtcOffset()).boot == 2


def test_floor_deletes_what_was_written_first_not_what_says_1970(tmp_path):
    """An old record with the right time, then boots at 1970: the newest says the oldest time."""
    order = [
        "4711_20260801T120000Z_01.mcap",  # by older software
        "4711_20260801T120000Z_02.mcap",
        "4711_20260802T120000Z_01.mcap",
        "4711_b0001-0001_20261128T120000Z.mcap",
        "4711_b0002-0001_19700101T000005Z.mcap",
        "4711_b0002-0002_19700101T000505Z.mcap",
        "4711_b0010-0001_19700101T000003Z.mcap",
    ]
    for name in reversed(order):
        (tmp_path / name).write_bytes(os.urandom(10_000))
    for left in range(len(order), -1, -1):
        assert sorted(names(tmp_path)) == sorted(order[len(order) - left :])
        space = FreeSpace(tmp_path, left * 20_000, lambda folder: 20_000 * (8 - len(names(folder))))
        space.floor_bytes = 20_000 * (8 - left + 1)
        space.check(0)


def test_names_are_corrected_once_the_time_is_known(tmp_path):
    earlier = Boot(tmp_path, "earlier")
    earlier.ride(1)
    earlier.off()
    boot = Boot(tmp_path, "now")
    boot.ride(2)
    (first, second) = [name for name in names(tmp_path) if "b0002" in name]
    (tmp_path / f"{first}.keep").touch()
    boot.knows = True
    boot.ride(1)
    boot.off()
    assert names(tmp_path) == [
        "4711_b0001-0001_19700101T000005Z.mcap",  # nobody will ever know
        "4711_b0002-0001_20261130T120005Z.mcap",
        "4711_b0002-0001_20261130T120005Z.mcap.keep",
        "4711_b0002-0002_20261130T120015Z.mcap",
        "4711_b0002-0003_20261130T120025Z.mcap",
    ]
    with open_record(sorted(tmp_path.glob("4711_b0002*.mcap"))) as record:
        assert plain(record.messages()) == plain(boot.sent)
        assert describe(record).utc_offset_ns == NOON_NS
    assert first != second


def test_latest_part_is_kept_also_under_its_corrected_name(tmp_path):
    boot = Boot(tmp_path, "now")
    boot.ride(2)
    boot.knows = True
    boot.recording.flush()
    boot.recording.space._free_bytes = lambda folder: 0
    boot.recording.space.floor_bytes = 1
    boot.recording.flush()
    assert names(tmp_path) == ["4711_b0001-0002_20261130T120015Z.mcap"]


def test_clock_that_is_right_from_the_start_changes_nothing(tmp_path):
    boot = Boot(tmp_path, "now", knows=True)
    boot.ns = 5 * S
    boot.ride(2)
    boot.off()
    calls = boot.recording._worker.storage.calls
    assert [name for name, _ in calls].count("rename") == 2  # that of each part, when finished


def test_receiver_knows_the_time_better_than_the_host(tmp_path):
    """By the recorder's node: GPS time counts once the receiver knows its leap seconds."""
    from tramstream.recorder.node import RecorderNode

    bus = LocalBus()
    node = RecorderNode(VEHICLE, bus, None, Recorder(directory=str(tmp_path)), {})
    node.recording.utc.see_host(NOON_NS + 3600 * S, 0)
    assert node.recording.utc.ns == NOON_NS + 3600 * S

    def say(**fields) -> None:
        message = GnssTime(stamp_ns=9 * S, **fields)
        bus.publish(keys.GNSS_TIME.on(VEHICLE), message.SerializeToString(), "", 1)
        node.drain()

    bus.subscribe(keys.full(VEHICLE, "**"), node._deliver)
    gps_ns = NOON_NS + 9 * S - (GPS_EPOCH_UNIX_S - 18) * S
    say(gps_time_ns=gps_ns)
    assert node.recording.utc.ns == NOON_NS + 3600 * S
    say(gps_time_ns=gps_ns, leap_seconds=18)
    assert node.recording.utc.ns == NOON_NS
    say(gps_time_ns=0, leap_seconds=18)  # a receiver that begins in 1980
    assert node.recording.utc.ns == NOON_NS


@pytest.mark.parametrize(
    "name",
    ["mine.mcap", "4711_b0001-0001.mcap", "4711_b1-1_19700101T000005Z.mcap", "x.mcap.active", ""],
)
def test_names_of_others_are_not_ours(name):
    assert parse(name) is None
