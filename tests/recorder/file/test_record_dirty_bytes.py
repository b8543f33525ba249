"""Any bytes on any key: every reader of a record leaves out what it cannot decode, and counts it.

A ride through the real processors is recorded; then each of its messages is followed by a damaged
copy of itself, or by noise, on its own key. What still decodes holds values that nobody promised.
"""

from __future__ import annotations

import random
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from record_rides import CONFIG, drive, written
from scripted import VEHICLE, Ear, ManualClock, Script, Sender

from tramstream import config_file, keys
from tramstream.analysis.evaluate import demo
from tramstream.analysis.evaluate.source import gather
from tramstream.analysis.report import source as report_source
from tramstream.boundary import Undecodable, decode
from tramstream.cli import echo
from tramstream.cli.monitor import source as look
from tramstream.errors import DamagedRecordError
from tramstream.live import registry
from tramstream.live.host import ProcessorNode
from tramstream.monitor import board, stats
from tramstream.proto.raw_pb2 import TruthState
from tramstream.recorder.describe import describe
from tramstream.recorder.exports.csv_tables import export_csv
from tramstream.recorder.exports.geojson import geojson
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import Record, open_record
from tramstream.recorder.reprocess.run import rerun
from tramstream.transport.bus import LocalBus

STEPS = 150
INPUTS = (keys.IMU_BATCH.path, keys.GNSS_FIX.path, keys.ODO_WHEELS.path)


def damaged(payload: bytes, chance: random.Random) -> bytes:
    """The message with bytes flipped, cut, or other bytes instead."""
    data = bytearray(payload)
    how = chance.randrange(4)
    if how == 0 or not data:
        return chance.randbytes(chance.randrange(1, 40))
    if how == 1:
        return bytes(data[: chance.randrange(len(data))])
    for _ in range(chance.randrange(1, 6)):
        data[chance.randrange(len(data))] = chance.randrange(256)
    return bytes(data)


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clean") / "ride.mcap"
    clock = ManualClock()
    bus = LocalBus(clock)
    sender = Sender(bus)
    with written(path, bus):
        truth = [
            lambda step=step: sender.send(
                keys.TRUTH_STATE, TruthState(stamp_ns=clock.now_ns() + step, latitude_deg=50.0)
            )
            for step in range(10)
        ]
        script = Script(*drive(sender, clock, range(STEPS)), *truth)
        processors = registry.make_processors(CONFIG)
        ProcessorNode(registry.PROCESSORS, VEHICLE, bus, script, processors).run()
    return path


def dirty(clean: Path, out: Path, seed: int, inputs_too: bool = True) -> Counter[str]:
    """Write `clean` with damaged messages between its own; how many of them are none, by topic."""
    chance = random.Random(seed)
    wrong: Counter[str] = Counter()
    with (
        open_record(clean) as record,
        RecordFile(out, VEHICLE, {config_file.RECORD_ENTRY: config_file.to_json(CONFIG)}) as target,
    ):
        for entry in record.messages():
            path = keys.split(entry.topic)[1]
            key = keys.find(path)
            assert key is not None
            stamps = entry.log_ns, entry.publish_ns, entry.sequence
            target.append(entry.topic, key, entry.payload, *stamps)
            payload = damaged(entry.payload, chance)
            undecodable = isinstance(decode(key.type, payload, path), Undecodable)
            if chance.random() < 0.2 and (inputs_too or undecodable):
                wrong[entry.topic] += undecodable
                later = entry.log_ns, entry.publish_ns + 1, entry.sequence
                target.append(entry.topic, key, payload, *later)
    return +wrong


def of(wrong: Counter[str], *paths: str) -> dict[str, int]:
    return {topic: n for topic, n in wrong.items() if not paths or keys.split(topic)[1] in paths}


@pytest.mark.parametrize("seed", range(3))
def test_tables_and_tracks_leave_out_what_is_none(clean: Path, tmp_path: Path, seed: int) -> None:
    wrong = dirty(clean, tmp_path / "d.mcap", seed)
    assert sum(wrong.values()) > 50
    with open_record(tmp_path / "d.mcap") as record:
        export_csv(record, tmp_path / "tables")
        assert record.undecodable == dict(wrong)
        rows = sum(
            len(path.read_text().splitlines()) - 1 for path in (tmp_path / "tables").iterdir()
        )
        assert rows >= record.message_count - sum(wrong.values())
        geojson(record)
        assert "cannot be decoded were left out" in record.left_out


@pytest.mark.parametrize("seed", range(3))
def test_report_and_figures_are_made_of_the_others(clean: Path, tmp_path: Path, seed: int) -> None:
    from tramstream.cli.report import report

    path = tmp_path / "d.mcap"
    wrong = dirty(clean, path, seed)
    with pytest.raises(DamagedRecordError, match="were left out"):
        report(path, out=tmp_path / "r.html", truth="", estimate="", overwrite=True)
    assert (tmp_path / "r.html").stat().st_size > 10_000
    material = report_source.collect(path, "", "", print)
    assert str(wrong[keys.EST_STATE.on(VEHICLE)]) in material.left_out
    found = gather(path, "", "", print)
    assert "were left out" in found.left_out
    demo.summarise(path)
    with open_record(path) as record:
        describe(record)
        lost = of(wrong, keys.LOSS.at(registry.PROCESSORS).path)
        assert record.undecodable == lost


@pytest.mark.parametrize("seed", range(3))
def test_lookers_show_the_bytes(clean: Path, tmp_path: Path, seed: int) -> None:
    wrong = dirty(clean, tmp_path / "d.mcap", seed)
    with look.look("**", tmp_path / "d.mcap") as source:
        seen = stats.Stats()
        shown = 0
        for envelope in source.messages(threading.Event()):
            assert envelope is not None
            echo._as_json(source, envelope)
            shown += "cannot be decoded" in echo._as_text(source, envelope, full=True)
            seen.add(envelope)
            board.board(seen, VEHICLE, envelope.arrival_ns)
        assert shown >= sum(wrong.values())


def test_reprocessing_leaves_out_what_was_left_out_live(clean: Path, tmp_path: Path) -> None:
    wrong = dirty(clean, tmp_path / "d.mcap", 6, inputs_too=False)
    inputs = of(wrong, *INPUTS)
    assert len(inputs) == 3
    results = [
        rerun(path, tmp_path / f"{path.stem}.out", None) for path in (clean, tmp_path / "d.mcap")
    ]
    assert results[0].outputs == results[1].outputs
    for path, count in results[1].undecodable.items():
        assert wrong[keys.full(VEHICLE, path)] == count
    assert set(results[1].undecodable) >= set(INPUTS)


def test_record_on_the_bus_again_harms_nobody(clean: Path, tmp_path: Path) -> None:
    """The same bytes, live, through the real processors: counted exactly, and no exception."""
    wrong = dirty(clean, tmp_path / "d.mcap", 2, inputs_too=False)
    clock = ManualClock()
    bus = LocalBus(clock)
    sender, ear = Sender(bus), Ear(bus)

    def steps(record: Record) -> list[Callable[[], None]]:
        found: list[Callable[[], None]] = []
        for entry in record.messages():
            key = keys.find(keys.split(entry.topic)[1])
            if key is not None and key.layer in ("raw", "health"):
                found.append(lambda key=key, data=entry.payload: sender.send_bytes(key, data))
                if key is keys.IMU_BATCH:
                    found.append(lambda: clock.advance(0.01))
        return found

    with open_record(tmp_path / "d.mcap") as record:
        script = Script(*steps(record))
        processors = registry.make_processors(CONFIG)
        node = ProcessorNode(registry.PROCESSORS, VEHICLE, bus, script, processors)
        node.run()
    assert node.faults == 0
    assert node.refusals.count == sum(of(wrong, *INPUTS).values())
    assert len(ear.heard(keys.EST_STATE)) > STEPS - 50
