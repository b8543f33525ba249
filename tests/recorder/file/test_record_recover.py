"""Cut anywhere, damaged anywhere: what is whole comes back, and nothing that is not true."""

from __future__ import annotations

import itertools
import os
import random
from contextlib import suppress

import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from record_samples import VEHICLE, active, append, plain, read, traffic, write

from tramstream.errors import RecordError
from tramstream.recorder.file import repair as repair_module
from tramstream.recorder.file.chunk import read_guard
from tramstream.recorder.file.layout import GUARD_MAGIC
from tramstream.recorder.file.recover import recover
from tramstream.recorder.file.repair import REDO, repair
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import open_record


def check_clean(path, messages):
    """Any tool reads the file, every checksum holds, and it has these messages."""
    with path.open("rb") as file:
        count = sum(
            type(record).__name__ == "Message"
            for record in StreamReader(file, validate_crcs=True).records
        )
    assert count == len(messages)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) == len(messages)
        assert reader.get_summary().statistics.message_count == len(messages)
    assert sorted(read(path)) == sorted(messages)
    with open_record(path) as record:
        assert not record.damaged


def whole_before(data: bytes, cut: int) -> int:
    """Messages of the last chunk in blocks that end before `cut`, by the guard."""
    place = data.rfind(GUARD_MAGIC)
    guard = read_guard(data[place:])
    begin = data.index(guard.head, place + 100) + len(guard.head)
    ends = itertools.accumulate((size for size, _ in guard.blocks), initial=begin)
    return max((index for index, end in enumerate(ends) if end <= cut), default=0)


def test_cut_at_every_byte_of_the_last_chunk_yields_every_whole_message(tmp_path):
    sent = traffic(165)
    path = active(tmp_path / "a.mcap", sent, 120)
    data, messages = path.read_bytes(), plain(sent)
    earlier = 120
    last = data.rfind(GUARD_MAGIC) - 9
    cut_file = tmp_path / "cut.mcap.active"
    seen, blocks_seen = [], set()
    for cut in range(last, len(data) + 1):
        cut_file.write_bytes(data[:cut])
        found = read(cut_file)
        assert found[:earlier] == messages[:earlier]
        assert found == messages[: len(found)]
        seen.append(len(found))
        blocks = whole_before(data, cut)
        blocks_seen.add(blocks)
        assert (len(found) > earlier) == (blocks > 0)
    assert seen == sorted(seen)
    assert seen[-1] == len(sent)
    # each further block gives its messages at once: no fewer steps than blocks with messages
    assert len(set(seen)) >= len(blocks_seen) - 1
    gains = [after - before for before, after in itertools.pairwise(seen)]
    assert max(gains) <= 20


def test_cut_anywhere_is_repaired_to_a_clean_record(tmp_path):
    sent = traffic(200)
    data = active(tmp_path / "a.mcap", sent, 60).read_bytes()
    finished = write(tmp_path / "b.mcap", sent, 60).read_bytes()
    for number, cut in enumerate(
        [*range(300, len(data), 211), *range(len(data), len(finished), 61)]
    ):
        source = tmp_path / f"{number}.mcap.active"
        source.write_bytes((data if cut <= len(data) else finished)[:cut])
        before = read(source)
        recovery = repair(source)
        if recovery.target is None:
            assert not before
            assert not source.exists()
            continue
        assert recovery.messages == len(before)
        check_clean(recovery.target, before)


def flips(size: int):
    """Offsets over the whole file, dense at its ends."""
    return [*range(400), *range(400, size - 700, 31), *range(size - 700, size)]


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flip")
    sent = traffic(150)
    return sent, write(folder / "a.mcap", sent, 25, metadata={"config": "x"}).read_bytes()


@pytest.mark.parametrize("bit", [0x01, 0xFF])
def test_flipped_byte_costs_one_chunk_at_most_and_never_lies(tmp_path, small, bit):
    sent, data = small
    messages = plain(sent)
    true = set(messages)
    path = tmp_path / "a.mcap"
    worst = 0
    for offset in flips(len(data)):
        damaged = bytearray(data)
        damaged[offset] ^= bit
        path.write_bytes(damaged)
        with open_record(path) as record:
            found = plain(record.messages())
            assert record.vehicle == VEHICLE
            assert record.schema_version == 1
            assert record.metadata["config"] == "x"
        back = set(found)
        assert true.issuperset(back)
        assert len(back) == len(found)
        lost = [number for number, one in enumerate(messages) if one not in back]
        assert len({number // 25 for number in lost}) <= 1
        worst = max(worst, len(lost))
    assert 0 < worst <= 25


def test_flipped_byte_is_recovered_to_a_clean_record(tmp_path, small):
    sent, data = small
    true = set(plain(sent))
    for number, offset in enumerate(range(5, len(data), 151)):
        damaged = bytearray(data)
        damaged[offset] ^= 0x40
        source, target = tmp_path / "a.mcap", tmp_path / f"{number}.mcap"
        source.write_bytes(damaged)
        recovery = recover(source, target)
        found = read(target)
        assert true.issuperset(found)
        assert len(found) == recovery.messages > len(sent) - 26
        check_clean(target, found)
        unfinished = tmp_path / f"r{number}.mcap.active"
        unfinished.write_bytes(damaged)
        again = repair(unfinished)
        assert sorted(read(again.target)) == sorted(found)
        check_clean(again.target, found)


def test_lost_stretch_of_any_length_is_stepped_over(tmp_path, small):
    sent, data = small
    true = set(plain(sent))
    chance = random.Random(5)
    path = tmp_path / "a.mcap"
    for _ in range(60):
        begin = chance.randrange(8, len(data) - 100)
        length = chance.randrange(1, 3000)
        path.write_bytes(data[:begin] + data[begin + length :])
        with open_record(path) as record:
            found = plain(record.messages())
        assert true.issuperset(found)
        assert len(found) >= len(sent) - 25 * (2 + length // 600)


def test_blocks_of_zeros_at_the_end_are_no_messages(tmp_path):
    sent = traffic(200)
    path = active(tmp_path / "a.mcap", sent, 60)
    data = path.read_bytes()
    for kept in range(data.rfind(GUARD_MAGIC), len(data), 41):
        path.write_bytes(data[:kept] + bytes(len(data) - kept))
        found = read(path)
        assert found == plain(sent[: len(found)])
        assert len(found) >= 120


def test_stale_block_of_another_record_is_not_believed(tmp_path):
    older = active(tmp_path / "old.mcap", traffic(120, seed=9), 60).read_bytes()
    record = RecordFile(tmp_path / "a.mcap", VEHICLE, {"session": "new"})
    append(record, traffic(60), 60)
    record.flush()
    record.abandon()
    path = tmp_path / "a.mcap.active"
    own, place = path.read_bytes(), older.rfind(GUARD_MAGIC)
    for begin in range(place - 9, older.index(b"\x04\0\0\0zstd", place + 100), 3):
        path.write_bytes(own + older[begin:])
        assert read(path) == plain(traffic(60))


def test_page_that_the_disk_cannot_read_costs_its_chunk_only(tmp_path, monkeypatch):
    sent = traffic(600)
    path = write(tmp_path / "a.mcap", sent, 60)
    from tramstream.recorder.file.diskfile import Source

    whole = Source._pread

    def failing(self, length, offset):
        if offset < 20480 and offset + length > 16384:
            raise OSError(5, "Input/output error")
        return whole(self, length, offset)

    monkeypatch.setattr(Source, "_pread", failing)
    found = read(path)
    assert 600 - 180 <= len(found) < 600
    assert set(plain(sent)).issuperset(found)


def test_recover_keeps_metadata_schemas_times_and_numbers(tmp_path):
    sent = traffic(300)
    source = active(tmp_path / "a.mcap", sent, 60)
    source.write_bytes(source.read_bytes()[:-1])
    recovery = recover(source, tmp_path / "b.mcap")
    assert read(tmp_path / "b.mcap") == plain(sent)
    with open_record(source) as before, open_record(tmp_path / "b.mcap") as after:
        assert {t: i.schema for t, i in before.channels.items()} == {
            t: i.schema for t, i in after.channels.items()
        }
        assert after.metadata == {**before.metadata, "recovered": recovery.sentence}
        assert after.decode(next(after.messages())).sequence == 1
    assert recovery.messages == 300
    assert not recovery.clean


def test_recover_refuses_what_holds_nothing(tmp_path):
    (tmp_path / "a.mcap").write_bytes(os.urandom(10_000))
    with pytest.raises(RecordError, match="is no record"):
        recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert not list(tmp_path.glob("b*"))


def test_repair_keeps_off_a_file_that_is_being_written(tmp_path):
    record = RecordFile(tmp_path / "a.mcap", VEHICLE)
    append(record, traffic(20))
    record.flush()
    with pytest.raises(RecordError, match="is being written"):
        repair(tmp_path / "a.mcap.active")
    record.close()
    assert read(tmp_path / "a.mcap") == plain(traffic(20))


class KilledError(Exception):
    """Stands for a power cut at one call."""


def test_killed_at_any_write_of_a_repair_it_ends_the_same(tmp_path, monkeypatch):
    """Every system call of the repair is, in turn, the last; a torn write leaves half its bytes."""
    sent = traffic(200)
    data = bytearray(active(tmp_path / "a.mcap", sent, 60).read_bytes())
    data[len(data) // 3] ^= 0xFF
    torn = bytes(data[:-2500])
    expected = read_of(tmp_path / "e.mcap.active", torn)
    for limit in itertools.count(1):
        source = tmp_path / f"{limit}.mcap.active"
        source.write_bytes(torn)
        with monkeypatch.context() as patch:
            calls = dying(patch, limit)
            with suppress(KilledError):
                repair(source)
            finished = calls[0] < limit
        target = tmp_path / f"{limit}.mcap"
        if not target.exists():
            repair(source)
        assert sorted(read(target)) == sorted(expected)
        check_clean(target, expected)
        if finished:
            break
    assert limit > 8
    assert not (tmp_path / f"{limit}.mcap{REDO}").exists()


def read_of(path, data):
    path.write_bytes(data)
    return read(path)


def dying(patch, limit):
    """Let the repair's `limit`-th call that changes the disk fail half way."""
    calls = [0]

    def wrap(name):
        real = getattr(os, name)

        def call(*args, **kwargs):
            calls[0] += 1
            if calls[0] == limit:
                if name in ("write", "pwrite"):
                    real(args[0], bytes(args[1])[: len(args[1]) // 2], *args[2:])
                raise KilledError
            return real(*args, **kwargs)

        return call

    for name in ("write", "pwrite", "ftruncate", "fsync", "rename", "unlink"):
        patch.setattr(repair_module.os, name, wrap(name))
    return calls
