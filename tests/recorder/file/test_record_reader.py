"""Reading: order, selection, parts, foreign files, and one clear sentence for what is no record."""

from __future__ import annotations

import random

import pytest
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import CompressionType, Writer
from record_samples import MS, START_NS, VEHICLE, active, append, plain, read, traffic, write

from tramstream import keys
from tramstream.errors import RecordError
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.recorder.file.writer import RecordFile
from tramstream.recorder.reader import open_record


def test_selection_by_key_and_time_equals_filtering(tmp_path):
    sent = traffic(500)
    path = write(tmp_path / "a.mcap", sent, 60)
    start, end = sent[100].log_ns, sent[400].log_ns
    with open_record(path) as record:
        found = record.messages(lambda topic: topic.endswith("fix"), start, end)
        assert plain(found) == plain(one for one in sent[100:400] if one.key is keys.GNSS_FIX)
        assert plain(record.messages(start_ns=end)) == plain(sent[400:])
        assert list(record.messages(lambda topic: False)) == []


def test_reading_twice_gives_the_same(tmp_path):
    with open_record(write(tmp_path / "a.mcap", traffic(200), 60)) as record:
        assert list(record.messages()) == list(record.messages())


def test_overlapping_chunks_are_merged_in_order(tmp_path):
    chance = random.Random(3)
    sent = [
        one._replace(log_ns=one.log_ns + chance.randrange(0, 400) * MS) for one in traffic(1000)
    ]
    with open_record(write(tmp_path / "a.mcap", sent, 25)) as record:
        found = list(record.messages())
    assert len(found) == 1000
    order = [(entry.log_ns, entry.channel_id, entry.sequence) for entry in found]
    assert order == sorted(order)


def test_decode_gives_our_own_types(tmp_path):
    with open_record(write(tmp_path / "a.mcap", traffic(50))) as record:
        fix = record.decode(next(record.messages(lambda topic: topic.endswith("/fix"))))
        assert isinstance(fix, GnssFix)
        assert fix.latitude_deg == pytest.approx(50.00001)
        assert record.channels[keys.GNSS_FIX.on(VEHICLE)].count == 1


def test_unfinished_record_is_read_up_to_its_last_flush(tmp_path):
    path = active(tmp_path / "a.mcap", traffic(300), 60)
    assert read(path) == plain(traffic(300))
    with open_record(path) as record:
        assert record.message_count == 300
        assert not record.damaged
        assert record.end_ns == traffic(300)[-1].log_ns


def test_parts_are_put_in_order_by_session_and_number(tmp_path):
    sent = traffic(300)
    names = ["x.mcap", "c.mcap", "m.mcap"]
    for number, name in enumerate(names, 1):
        metadata = {"session": "s", "part": str(number)}
        write(tmp_path / name, sent[(number - 1) * 100 : number * 100], 30, metadata=metadata)
    for paths in (tmp_path, [tmp_path / name for name in sorted(names)]):
        with open_record(paths) as record:
            assert [path.name for path in record.paths] == names
            assert plain(record.messages()) == plain(sent)


def test_channel_ids_count_over_parts_that_number_them_differently(tmp_path):
    sent = traffic(100)
    write(tmp_path / "a.mcap", sent[:50])
    write(tmp_path / "b.mcap", sent[:49:-1])
    with open_record(tmp_path) as record:
        found = list(record.messages())
        assert {entry.channel_id for entry in found} == {1, 2, 3}
        assert len({(entry.topic, entry.channel_id) for entry in found}) == 3


def test_other_schema_version_is_refused_with_its_cure(tmp_path):
    path = write(
        tmp_path / "a.mcap",
        traffic(3),
        metadata={"schema_version": "99", "software": "tramstream 9.9"},
    )
    with pytest.raises(RecordError) as refusal:
        open_record(path)
    for part in (str(path), "99", str(keys.SCHEMA_VERSION), "tramstream 9.9"):
        assert part in str(refusal.value)
    with open_record(path, any_schema=True) as record:
        assert record.schema_version == 99


def test_records_of_two_vehicles_are_refused(tmp_path):
    write(tmp_path / "a.mcap", traffic(3))
    RecordFile(tmp_path / "b.mcap", "other").close()
    with pytest.raises(RecordError, match="name the files of one"):
        open_record(tmp_path)


@pytest.mark.parametrize("content", [b"", b"hello", bytes(5000), b"\x89PNG\r\n" * 100])
def test_what_is_no_record_gets_one_sentence(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordError, match=r"a\.mcap"):
        open_record(path)


def test_absent_file_and_empty_folder_are_refused(tmp_path):
    with pytest.raises(RecordError, match="check the name"):
        open_record(tmp_path / "none.mcap")
    with pytest.raises(RecordError, match="holds no record"):
        open_record(tmp_path)


def foreign_class():
    """A message type that nobody has told us about."""
    field = FieldDescriptorProto(
        name="speed_mps", number=1, type="TYPE_DOUBLE", label="LABEL_OPTIONAL"
    )
    file = FileDescriptorProto(name="far.proto", package="far", syntax="proto3")
    file.message_type.append(DescriptorProto(name="Away", field=[field]))
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("far.Away")), file


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("cut", [0, 200])
def test_foreign_file_is_read_and_decoded_by_its_own_description(
    tmp_path, compression, chunked, cut
):
    class_, file = foreign_class()
    files = class_.DESCRIPTOR.file
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    path = tmp_path / "a.mcap"
    with path.open("wb") as out:
        writer = Writer(out, compression=compression, use_chunking=chunked, chunk_size=1000)
        writer.start()
        schema = writer.register_schema(
            "far.Away", "protobuf", FileDescriptorSet(file=[file]).SerializeToString()
        )
        channel = writer.register_channel("/away", "protobuf", schema)
        for number in range(200):
            payload = class_(speed_mps=number).SerializeToString()
            writer.add_message(channel, START_NS + number, payload, START_NS + number, number)
        writer.finish()
    path.write_bytes(path.read_bytes()[: path.stat().st_size - cut])
    with open_record(path) as record:
        assert record.schema_version is None
        assert record.vehicle == ""
        found = [record.decode(entry).speed_mps for entry in record.messages()]
    assert found == list(range(200))
    assert files.package == "far"


def test_record_that_is_being_written_is_not_called_damaged(tmp_path):
    record = RecordFile(tmp_path / "a.mcap", VEHICLE)
    append(record, traffic(100), 30)
    record.flush()
    path = tmp_path / "a.mcap.active"
    with path.open("ab") as file:
        file.write(b"\x90half a gua")
    with open_record(path) as reading:
        assert not reading.damaged
        assert reading.message_count == 100
    record.abandon()
    with open_record(path) as reading:
        assert "ends within a record" in reading.damaged
