"""Records whose times jump, whose sources are on different clocks, and what is written of them."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import pytest
from mcap.records import ChunkIndex
from record_rides import fix, wheels
from scripted import START_NS, VEHICLE

from tramstream import config_file, keys
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.errors import RecordError
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry, RawBytes, TruthState
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import PAUSE_NS, Entry, open_record
from tramstream.recorder.reprocess.order import AFTER_NS, SYNTHETIC_TICK_NS
from tramstream.recorder.reprocess.run import Wishes, rerun

CONFIG = Vehicle(vehicle=VEHICLE, processors=("resampler", "distance"))
YEARS_NS = 44 * 365 * 86_400 * S
FIXES, WHEELS = keys.GNSS_FIX, keys.ODO_WHEELS
Message = GnssFix | Odometry | RawBytes | TruthState
Sent = tuple[keys.Key, Message]


def ride(seconds: int = 10, after_ns: int = 0) -> list[Sent]:
    """Fixes and wheels of so long a ride, all of it later by `after_ns`."""
    sent: list[Sent] = []
    for step in range(0, 100 * seconds, 20):
        for key, message in ((WHEELS, wheels(step)), (FIXES, fix(step))):
            message.stamp_ns += after_ns
            sent.append((key, message))
    return sent


def written(path: Path, sent: list[Sent], flush_every: int = 0) -> Path:
    """A record as an import makes it: each message came when it was true."""
    metadata = {config_file.RECORD_ENTRY: config_file.to_json(CONFIG)}
    with RecordFile(path, VEHICLE, metadata) as record:
        numbers: defaultdict[str, int] = defaultdict(int)
        for number, (key, message) in enumerate(sorted(sent, key=lambda one: one[1].stamp_ns), 1):
            numbers[key.path] += 1
            message.sequence = numbers[key.path]
            at_ns = message.stamp_ns
            payload = message.SerializeToString()
            record.append(key.on(VEHICLE), key, payload, at_ns, at_ns, message.sequence)
            if flush_every and number % flush_every == 0:
                record.flush()
    return path


def outputs(path: Path) -> dict[str, list[Entry]]:
    found: defaultdict[str, list[Entry]] = defaultdict(list)
    with open_record(path) as record:
        for entry in record.messages():
            found[keys.split(entry.topic)[1]].append(entry)
    return found


# A jump ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("apart_ns", [2 * PAUSE_NS, 86_400 * S, YEARS_NS])
def test_time_passes_only_where_there_are_data(tmp_path: Path, apart_ns: int) -> None:
    sent = ride() + ride(after_ns=apart_ns)
    result = rerun(written(tmp_path / "a.mcap", sent), tmp_path / "o.mcap", None)
    made = outputs(tmp_path / "o.mcap")
    assert result.duration_s + result.paused_s == pytest.approx(apart_ns / S + 10, abs=0.5)
    assert 20 < result.duration_s < 60
    assert len(made[keys.SYNC_FRAME.path]) <= result.duration_s * S / SYNTHETIC_TICK_NS + 20


def test_nothing_before_or_after_a_jump_is_lost(tmp_path: Path) -> None:
    sent = ride() + ride(after_ns=YEARS_NS)
    rerun(written(tmp_path / "a.mcap", sent), tmp_path / "o.mcap", None)
    made = outputs(tmp_path / "o.mcap")
    frames = [keys.SYNC_FRAME.type.FromString(e.payload) for e in made[keys.SYNC_FRAME.path]]
    assert sum(len(frame.gnss) + len(frame.odometry) for frame in frames) == len(sent)
    assert not made[keys.SYNC_LATE.path]


def test_silence_before_a_jump_is_noticed(tmp_path: Path) -> None:
    """Ticks go on for ten seconds after the last message."""
    sent = ride() + ride(after_ns=YEARS_NS)
    rerun(written(tmp_path / "a.mcap", sent), tmp_path / "o.mcap", None)
    last_ns = max(message.stamp_ns for _, message in ride())
    stamps = [entry.log_ns for entry in outputs(tmp_path / "o.mcap")[keys.SYNC_FRAME.path]]
    quiet = [at_ns for at_ns in stamps if last_ns < at_ns < last_ns + YEARS_NS // 2]
    assert len(quiet) == pytest.approx(AFTER_NS / SYNTHETIC_TICK_NS, abs=5)


def test_gap_that_is_no_pause_is_ticked_through(tmp_path: Path) -> None:
    sent = ride() + ride(after_ns=PAUSE_NS - S)
    result = rerun(written(tmp_path / "a.mcap", sent), tmp_path / "o.mcap", None)
    stamps = [entry.log_ns for entry in outputs(tmp_path / "o.mcap")[keys.SYNC_FRAME.path]]
    steps = {after - before for before, after in pairwise(stamps[5:])}
    assert steps == {SYNTHETIC_TICK_NS}
    assert result.paused_s == 0.0


# Clocks ------------------------------------------------------------------------------------------
def of(key: keys.Key, after_ns: int = 0, seconds: int = 10) -> list[Sent]:
    return [one for one in ride(seconds, after_ns) if one[0] is key]


@pytest.mark.parametrize("flush_every", [0, 7])
def test_sources_that_share_no_instant_are_refused_with_both_times(
    tmp_path: Path, flush_every: int
) -> None:
    """However they are spread over chunks; nothing is left that blocks the next run."""
    sent = of(FIXES, YEARS_NS) + of(WHEELS)
    path = written(tmp_path / "a.mcap", sent, flush_every)
    with pytest.raises(RecordError, match="share no instant") as refused:
        rerun(path, tmp_path / "o.mcap", None)
    for part in (FIXES.path, WHEELS.path, "2023-", "2067-", "--offset-s"):
        assert part in str(refused.value)
    assert [each.name for each in tmp_path.iterdir()] == ["a.mcap"]


def test_sources_one_after_the_other_are_on_one_clock(tmp_path: Path) -> None:
    sent = of(FIXES) + of(WHEELS, 60 * S)
    assert rerun(written(tmp_path / "a.mcap", sent), tmp_path / "o.mcap", None).outputs


def test_source_that_jumps_and_meets_the_other_again_is_not_refused(tmp_path: Path) -> None:
    sent = of(FIXES) + of(FIXES, YEARS_NS) + of(WHEELS, YEARS_NS)
    assert rerun(written(tmp_path / "a.mcap", sent), tmp_path / "o.mcap", None).outputs


# What is written ---------------------------------------------------------------------------------
def test_outputs_stand_at_their_own_stamp(tmp_path: Path) -> None:
    rerun(written(tmp_path / "a.mcap", ride()), tmp_path / "o.mcap", None)
    made = outputs(tmp_path / "o.mcap")
    assert made[keys.EST_DISTANCE.path]
    for path, entries in made.items():
        key = keys.find(path)
        assert key is not None
        for entry in entries:
            assert key.type.FromString(entry.payload).stamp_ns == entry.log_ns == entry.publish_ns


def test_inputs_truth_and_estimate_go_into_one_file(tmp_path: Path) -> None:
    """Devices' bytes do not: decoders have made messages of them."""
    truth: list[Sent] = [
        (keys.TRUTH_STATE, TruthState(stamp_ns=START_NS + number * S, speed_mps=1.0))
        for number in range(10)
    ]
    raw: list[Sent] = [(keys.GNSS_BYTES, RawBytes(stamp_ns=START_NS, data=b"bytes"))]
    source = written(tmp_path / "a.mcap", ride() + truth + raw)
    wishes: Wishes = {"with_inputs": True}
    result = rerun(source, tmp_path / "o.mcap", None, **wishes)
    made, sent = outputs(tmp_path / "o.mcap"), outputs(source)
    assert result.copied == len(ride()) + len(truth)
    for path in (FIXES.path, WHEELS.path, keys.TRUTH_STATE.path):
        assert [one[1:5] for one in made[path]] == [one[1:5] for one in sent[path]]
    assert made[keys.EST_DISTANCE.path]
    assert not made[keys.GNSS_BYTES.path]
    rerun(source, tmp_path / "p.mcap", None)
    alone = outputs(tmp_path / "p.mcap")
    assert {path: len(each) for path, each in alone.items()} == {
        path: len(each) for path, each in made.items() if path in alone
    }
    assert not {FIXES.path, WHEELS.path, keys.TRUTH_STATE.path} & set(alone)


def test_file_with_inputs_is_reprocessed_as_the_record_was(tmp_path: Path) -> None:
    source = written(tmp_path / "a.mcap", ride())
    rerun(source, tmp_path / "o.mcap", None, with_inputs=True)
    rerun(tmp_path / "o.mcap", tmp_path / "p.mcap", None, with_inputs=True)
    one, two = outputs(tmp_path / "o.mcap"), outputs(tmp_path / "p.mcap")
    assert {path: [e[1:5] for e in each] for path, each in one.items()} == {
        path: [e[1:5] for e in each] for path, each in two.items()
    }


def test_settings_that_are_others_are_named_with_both_values(tmp_path: Path) -> None:
    config = tmp_path / "other.toml"
    config.write_text(
        f'vehicle = "{VEHICLE}"\nprocessors = ["resampler", "distance"]\n'
        "[distance]\ngate_sigma = 4\n"
    )
    source = written(tmp_path / "a.mcap", ride())
    result = rerun(source, tmp_path / "o.mcap", config)
    assert "$.distance.gate_sigma: 5.0 in the record, 4.0 now" in result.changed
    assert not [text for text in result.changed if "gate" not in text and "directory" not in text]
    assert rerun(source, tmp_path / "p.mcap", None).changed == []


def test_record_that_is_damaged_is_told_and_the_rest_reprocessed(tmp_path: Path) -> None:
    source = written(tmp_path / "a.mcap", ride(), flush_every=10)
    data = source.read_bytes()
    with open_record(source) as record:
        place = record.files[0].chunks[3].place
    assert isinstance(place, ChunkIndex)
    middle = place.chunk_start_offset + place.chunk_length - 9
    for name, damaged in (
        ("cut", data[: len(data) * 6 // 10]),
        ("flipped", data[:middle] + b"\0\0\0\0" + data[middle + 4 :]),
    ):
        torn = tmp_path / f"{name}.mcap"
        torn.write_bytes(damaged)
        result = rerun(torn, tmp_path / f"{name}.out.mcap", None)
        assert "damaged" in result.damaged, name
        assert result.outputs, name
