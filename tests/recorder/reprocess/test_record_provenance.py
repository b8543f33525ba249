"""What is made of a record says of which ride it is, and to which grades its filter was held."""

from __future__ import annotations

from pathlib import Path

from fuzz_kinds import QUICK, records

from tramstream.recorder.identity import ENTRY, digest_of, identity_of
from tramstream.recorder.reader import open_record
from tramstream.recorder.reprocess.run import rerun
from tramstream.tracks.grades import GRADES_ENTRY, NO_GRADES


def ride(folder: Path) -> Path:
    path = folder / "ride.mcap"
    path.write_bytes(records(folder)[0])
    return path


def test_reprocessing_of_reprocessing_is_still_of_the_same_ride(tmp_path: Path) -> None:
    source = ride(tmp_path)
    once, twice = tmp_path / "once.mcap", tmp_path / "twice.mcap"
    rerun(source, once, QUICK, with_inputs=True)
    rerun(once, twice, QUICK)
    for path in (source, once, twice):
        with open_record(path) as record:
            assert identity_of(record) == digest_of([source])
    with open_record(twice) as record:
        assert record.metadata["reprocessed_from"] == "once.mcap"
        assert record.metadata[ENTRY] == digest_of([source])
        assert record.metadata[GRADES_ENTRY] == NO_GRADES


def test_parts_of_a_record_are_one_ride_in_whatever_order_and_place(tmp_path: Path) -> None:
    one, other = ride(tmp_path), tmp_path / "other.mcap"
    other.write_bytes(one.read_bytes()[:-1])
    moved = tmp_path / "moved.mcap"
    moved.write_bytes(one.read_bytes())
    assert digest_of([one, other]) == digest_of([other, moved])
    assert digest_of([one]) != digest_of([other])
