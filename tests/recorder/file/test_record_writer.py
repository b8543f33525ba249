"""Writing: what is appended is read back, by us and by anybody, and nothing else is in the file."""

from __future__ import annotations

import errno
import sys
from pathlib import Path

import pytest
from disks import Watched, refusing
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from live import HANG_S, finished
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from record_samples import MS, START_NS, VEHICLE, Sent, append, plain, read, traffic, write

from tramstream import keys
from tramstream.errors import RecordError
from tramstream.proto.health_pb2 import NodeHealth
from tramstream.recorder.file.sink import Worker
from tramstream.recorder.file.writer import MAX_MESSAGE_BYTES, RecordFile, host_metadata
from tramstream.recorder.reader import open_record

CHOICES = (keys.IMU_BATCH, keys.GNSS_FIX, keys.GNSS_LOCATION, keys.HEARTBEAT.at("imu"))


@st.composite
def anything(draw):
    """Messages with arbitrary payloads, times and numbers."""
    return [
        Sent(
            draw(st.sampled_from(CHOICES)),
            draw(st.binary(max_size=3000)),
            draw(st.integers(0, 2**63 - 1)),
            draw(st.integers(0, 2**63 - 1)),
            draw(st.integers(0, 2**34)),
        )
        for _ in range(draw(st.integers(0, 40)))
    ]


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(sent=anything(), every=st.integers(0, 7), chunk_bytes=st.sampled_from([100, 4000, 1 << 20]))
def test_written_messages_read_back_equal(tmp_path, sent, every, chunk_bytes):
    path = tmp_path / "a.mcap"
    path.unlink(missing_ok=True)
    write(path, sent, every, chunk_bytes=chunk_bytes)
    ids: dict[str, int] = {}
    for one in sent:
        ids.setdefault(one.topic, len(ids) + 1)
    stored = [one._replace(sequence=one.sequence & 0xFFFFFFFF) for one in sent]
    stored.sort(key=lambda one: (one.log_ns, ids[one.topic], one.sequence))
    assert read(path) == plain(stored)


def test_mcap_library_agrees_and_every_checksum_holds(tmp_path):
    path = write(tmp_path / "a.mcap", traffic(500), 60)
    with path.open("rb") as file:
        theirs = [
            (channel.topic, message.data, message.log_time, message.publish_time, message.sequence)
            for _, channel, message in make_reader(file, validate_crcs=True).iter_messages()
        ]
    assert theirs == read(path)
    with path.open("rb") as file:
        records = list(StreamReader(file, validate_crcs=True).records)
    assert sum(type(record).__name__ == "Message" for record in records) == 500
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary.statistics.message_count == 500
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) == 9
    assert {channel.topic for channel in summary.channels.values()} == {
        key.on(VEHICLE) for key in (keys.IMU_BATCH, keys.GNSS_FIX, keys.IMU_BYTES)
    }


def test_message_indexes_lead_to_their_messages(tmp_path):
    path = write(tmp_path / "a.mcap", traffic(200), 60)
    for topic in (keys.GNSS_FIX.on(VEHICLE), keys.IMU_BYTES.on(VEHICLE)):
        with path.open("rb") as file:
            found = [m.sequence for _, _, m in make_reader(file).iter_messages(topics=[topic])]
            assert found == [one.sequence for one in traffic(200) if one.topic == topic]


def test_any_tool_decodes_every_channel_without_tramstream(tmp_path):
    path = tmp_path / "a.mcap"
    with RecordFile(path, VEHICLE) as record:
        for number, key in enumerate(keys.ALL):
            record.append(key.on(VEHICLE), key, key.type().SerializeToString(), number, number, 1)
    program = """
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("tramstream", "foxglove_schemas_protobuf"):
            raise ImportError("blocked: " + name)
sys.meta_path.insert(0, Refuse())
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, decoder_factories=[DecoderFactory()])
    print(sum(m is not None for _, _, _, m in reader.iter_decoded_messages()))
assert not any(name.startswith("tramstream") for name in sys.modules)
"""
    done = finished([sys.executable, "-I", "-c", program, str(path)], check=True)
    assert int(done.stdout) == len(keys.ALL)


def test_equal_appends_give_equal_bytes(tmp_path):
    first = write(tmp_path / "a.mcap", traffic(300), 50).read_bytes()
    assert write(tmp_path / "b.mcap", traffic(300), 50).read_bytes() == first
    live = RecordFile(tmp_path / "c.mcap", VEHICLE, worker=Worker())
    for number, one in enumerate(traffic(300), 1):
        live.append(one.topic, one.key, one.payload, one.log_ns, one.publish_ns, one.sequence)
        if number % 50 == 0:
            live.flush()
    live.close()
    assert live._sink._worker.close(HANG_S)
    assert live.finished
    assert (tmp_path / "c.mcap").read_bytes() == first


def test_metadata_says_who_wrote_what(tmp_path):
    path = write(tmp_path / "a.mcap", traffic(3), metadata={**host_metadata(), "config": "x = 1"})
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "tramstream"
        (metadata,) = reader.iter_metadata()
    assert metadata.name == "tramstream"
    assert metadata.metadata["schema_version"] == str(keys.SCHEMA_VERSION)
    assert metadata.metadata["vehicle"] == VEHICLE
    assert metadata.metadata["config"] == "x = 1"
    assert metadata.metadata["boot_id"]
    assert metadata.metadata["host"]


def test_record_without_messages_is_a_record(tmp_path):
    path = write(tmp_path / "a.mcap", [])
    with open_record(path) as record:
        assert (record.message_count, record.start_ns, list(record.messages())) == (0, 0, [])


def test_append_and_flush_never_touch_the_disk_on_the_receiving_thread(tmp_path):
    jobs = []
    worker = Worker()
    worker.submit = jobs.append  # nothing runs until the test says so
    record = RecordFile(tmp_path / "a.mcap", VEHICLE, worker=worker, chunk_bytes=4000)
    for one in traffic(300):
        record.append(one.topic, one.key, one.payload, one.log_ns, one.publish_ns, one.sequence)
        record.flush()
    assert list(tmp_path.iterdir()) == []
    assert len(jobs) == 1
    jobs.pop()()
    assert (tmp_path / "a.mcap.active").stat().st_size == record.size
    record.close()
    jobs.pop()()
    assert read(tmp_path / "a.mcap") == plain(traffic(300))


def test_stalled_disk_costs_memory_up_to_the_limit_and_then_counted_messages(tmp_path):
    jobs = []
    worker = Worker()
    worker.submit = jobs.append
    record = RecordFile(tmp_path / "a.mcap", VEHICLE, worker=worker, limit_bytes=20_000)
    sent = traffic(2000)
    for one in sent[:1500]:
        record.append(one.topic, one.key, one.payload, one.log_ns, one.publish_ns, one.sequence)
        record.flush()
    kept = 1500 - record.dropped_count
    assert 0 < kept < 1500
    assert record.state == NodeHealth.FAILED
    losses = {loss.topic: loss for loss in record.take_losses()}
    assert record.take_losses() == []
    for topic, loss in losses.items():
        lost = [one for one in sent[kept:1500] if one.topic == topic]
        assert loss.count == len(lost)
        assert loss.after_publish_ns == lost[0].publish_ns - 1
        assert loss.before_publish_ns == lost[-1].publish_ns + 1
    jobs.pop()()
    record.flush()
    assert record.state == NodeHealth.OK
    append(record, sent[1500:])
    record.close()
    jobs.pop()()
    assert read(tmp_path / "a.mcap") == plain(sent[:kept] + sent[1500:])


def test_existing_file_is_never_written_over(tmp_path):
    path = write(tmp_path / "a.mcap", traffic(3))
    with pytest.raises(RecordError, match="exists already"):
        RecordFile(path, VEHICLE)
    Path(f"{tmp_path}/b.mcap.active").touch()
    with pytest.raises(RecordError, match="exists already"):
        write(tmp_path / "b.mcap", traffic(3))


def test_failed_sync_is_told_and_the_file_is_given_up(tmp_path):
    disk = Watched(refusing("sync", errno.EIO))
    record = RecordFile(tmp_path / "a.mcap", VEHICLE, worker=Worker(threaded=False, storage=disk))
    one = traffic(1)[0]
    record.append(one.topic, one.key, one.payload, one.log_ns, one.publish_ns, one.sequence)
    record.flush()
    assert record.spoiled
    assert record.state == NodeHealth.DEGRADED
    assert record.trouble is not None
    assert record.trouble.facts["advice"] == "replace it"


def test_exception_while_writing_leaves_a_recoverable_file(tmp_path):
    path = tmp_path / "a.mcap"

    def fail():
        with RecordFile(path, VEHICLE) as record:
            append(record, traffic(20))
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert not path.exists()
    assert read(tmp_path / "a.mcap.active") == plain(traffic(20))


def test_message_that_no_reader_would_take_is_counted_and_the_others_are_kept(tmp_path):
    """Somebody publishes 20 MB on one of our keys."""
    record = RecordFile(tmp_path / "a.mcap", VEHICLE, worker=Worker(threaded=False))
    sent = traffic(3)
    append(record, sent[:2])
    huge = bytes(20 << 20)
    record.append(sent[2].topic, sent[2].key, huge, sent[2].log_ns, sent[2].publish_ns, 3)
    append(record, sent[2:])
    record.close()
    (loss,) = record.take_losses()
    assert (loss.topic, loss.count) == (sent[2].topic, 1)
    assert read(tmp_path / "a.mcap") == plain(sent)
    with pytest.raises(RecordError, match=r"21 MB on .* leave the key out"):
        RecordFile(tmp_path / "b.mcap", VEHICLE).append(sent[2].topic, sent[2].key, huge, 1, 1, 1)


@pytest.mark.parametrize("byte", [b"x", b"\0"])
def test_longest_messages_can_be_read_again_however_well_they_compress(tmp_path, byte):
    """A stranger who publishes zeros does not make a record that readers take for a bomb."""
    one = traffic(1)[0]
    sizes = (0, 1_000_000, MAX_MESSAGE_BYTES, 3, 1023, 131_072, 131_073, MAX_MESSAGE_BYTES)
    sent = [one._replace(payload=byte * size, sequence=n) for n, size in enumerate(sizes)]
    path = write(tmp_path / "a.mcap", sent, flush_every=3)
    assert read(path) == plain(sent)
    with path.open("rb") as file:
        found = [message for _, _, message in make_reader(file).iter_messages()]
    assert [message.data for message in found] == [one.payload for one in sent]
    cut = path.with_name("cut.mcap")
    cut.write_bytes(path.read_bytes()[:-2_000_000])
    assert read(cut) == plain(sent[:7])


def test_times_need_not_rise(tmp_path):
    sent = [
        one._replace(log_ns=START_NS + (i * 37 % 100) * MS) for i, one in enumerate(traffic(100))
    ]
    path = write(tmp_path / "a.mcap", sent, 10)
    logs = [entry[2] for entry in read(path)]
    assert logs == sorted(one.log_ns for one in sent)
