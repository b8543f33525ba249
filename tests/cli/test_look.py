"""list, echo, hz, bw: keys as people write them, figures, records, and the live bus."""

from __future__ import annotations

import json
import random
import signal
import statistics
import subprocess
import sys
from importlib.metadata import entry_points
from itertools import pairwise

import pytest
from live import HANG_S, command, environment, finished, short_folder
from looking import START_NS, VEHICLE, busy_bus, envelope, fix, tramstream, write_fixes

from tramstream import keys
from tramstream.cli.monitor import readable, source
from tramstream.cli.monitor.source import Wanted, read_key
from tramstream.cli.terminal.plain import to_dict
from tramstream.clock import S
from tramstream.errors import ConfigError
from tramstream.monitor.stats import KeyStats, Sequence, Stats
from tramstream.proto.raw_pb2 import RawBytes
from tramstream.recorder.file.writer import RecordFile

MS = S // 1000
HEAVY = ("numpy", "zenoh", "google.protobuf", "mcap", "can", "cantools", "msgspec")


# Keys ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("raw/gnss/fix", Wanted("", "raw/gnss/fix")),
        ("/raw/gnss/fix/", Wanted("", "raw/gnss/fix")),
        ("raw/**", Wanted("", "raw/**")),
        ("tram/12/raw/*/bytes", Wanted("12", "raw/*/bytes")),
        ("tram/*/raw/gnss/fix", Wanted("*", "raw/gnss/fix")),
        ("tram/12", Wanted("12", "**")),
        ("tram/**", Wanted("*", "**")),
    ],
)
def test_key_is_read_as_written(text, wanted):
    assert read_key(text) == wanted


@pytest.mark.parametrize("text", ["", "raw//fix", "raw/gn*/fix", "raw/gnss/fix?", "raw/#", "a b"])
def test_what_cannot_be_a_key_is_refused(text):
    with pytest.raises(ConfigError, match="is no key"):
        read_key(text)


def test_vehicle_option_and_full_key_must_agree():
    assert read_key("tram/12/raw/gnss/fix", "12").vehicle == "12"
    with pytest.raises(ConfigError, match="vehicle 12, --vehicle says 13"):
        read_key("tram/12/raw/gnss/fix", "13")


@pytest.mark.parametrize("pattern", ["**", "raw/**", "*/imu/*", "health/any/loss", "health/*/log"])
def test_expression_that_meets_a_defined_key_is_known(pattern):
    assert source.is_defined(pattern)


@pytest.mark.parametrize(
    "pattern", ["raw/gnss/fixes", "raw/gnss", "raw", "health/a/b/loss", "x/**"]
)
def test_expression_that_meets_no_defined_key_is_unknown(pattern):
    assert not source.is_defined(pattern)


def test_sentence_for_unknown_key_names_what_was_meant():
    assert "raw/gnss/fix" in source.nothing_at("raw/gns/fix", source.defined_paths())
    assert "est/**" in source.nothing_at("est", source.defined_paths())


# Figures ------------------------------------------------------------------------------------------
def arrivals(seed: int, count: int) -> list[int]:
    chance = random.Random(seed)
    times = [START_NS]
    for _ in range(count - 1):
        times.append(times[-1] + chance.randrange(5 * MS, 40 * MS))
    return times


def test_total_figures_agree_with_the_statistics_module():
    times = arrivals(1, 300)
    stats = KeyStats(keys.GNSS_FIX.on(VEHICLE))
    sizes = [len(fix(number).SerializeToString()) for number in range(300)]
    for number, time_ns in enumerate(times):
        stats.add(envelope(keys.GNSS_FIX, fix(number), time_ns, number))
    periods = [(after - before) / S for before, after in pairwise(times)]
    total = stats.total()
    assert total.count == 300
    assert total.rate_hz == pytest.approx(1 / statistics.mean(periods))
    assert total.period_min_s == min(periods)
    assert total.period_max_s == max(periods)
    assert total.period_std_s == pytest.approx(statistics.pstdev(periods))
    assert (total.size_min_bytes, total.size_max_bytes) == (min(sizes), max(sizes))
    assert total.bytes_per_s == pytest.approx(total.rate_hz * statistics.mean(sizes))
    now_ns = times[-1]
    whole = KeyStats(keys.GNSS_FIX.on(VEHICLE), window_s=1e3)
    for number, time_ns in enumerate(times):
        whole.add(envelope(keys.GNSS_FIX, fix(number), time_ns, number))
    assert whole.recent(now_ns).period_std_s == pytest.approx(total.period_std_s)
    assert whole.recent(now_ns).rate_hz == pytest.approx(total.rate_hz)


def test_recent_figures_forget_what_left_the_window():
    stats = KeyStats(keys.GNSS_FIX.on(VEHICLE), window_s=2.0)
    for step in range(100):
        stats.add(envelope(keys.GNSS_FIX, fix(step), START_NS + step * S, step))
    now_ns = START_NS + 99 * S
    for step in range(1, 41):
        stats.add(envelope(keys.GNSS_FIX, fix(step), now_ns + step * S // 20, 99 + step))
    assert stats.recent(now_ns + 2 * S).rate_hz == pytest.approx(20)
    assert stats.total().rate_hz == pytest.approx(139 / 101)


def test_silence_lowers_the_rate_to_zero():
    stats = KeyStats(keys.GNSS_FIX.on(VEHICLE), window_s=10.0)
    for step in range(101):
        stats.add(envelope(keys.GNSS_FIX, fix(step), START_NS + step * S // 10, step))
    last_ns = START_NS + 10 * S
    rates = [stats.rate_hz(last_ns + wait_s * S) for wait_s in range(12)]
    assert rates[0] == pytest.approx(10)
    assert rates == sorted(rates, reverse=True)
    assert rates[-1] == 0


def test_key_slower_than_the_window_still_has_a_rate():
    stats = KeyStats(keys.CLOCK.on(VEHICLE), window_s=5.0)
    for step in range(3):
        stats.add(envelope(keys.CLOCK, b"", START_NS + step * 10 * S, step + 1))
    assert stats.rate_hz(START_NS + 20 * S) == pytest.approx(0.1)


def test_figures_of_nothing_and_of_one_message():
    stats = KeyStats(keys.GNSS_FIX.on(VEHICLE))
    assert stats.total().rate_hz is None
    assert stats.recent(START_NS).count == 0
    assert stats.age_s(START_NS) is None
    stats.add(envelope(keys.GNSS_FIX, fix(1), START_NS))
    assert stats.total().rate_hz is None
    assert stats.rate_hz(START_NS) is None
    assert stats.age_s(START_NS + S) == 1.0


def missing(sequence: Sequence, *seen: tuple[int, int, int]) -> list[int]:
    return [
        sequence.missing(
            envelope(keys.GNSS_FIX, b"", START_NS, number, session, START_NS + publish_ns)
        )
        for number, session, publish_ns in seen
    ]


def test_gap_in_the_sequence_is_a_loss():
    sequence = Sequence()
    assert missing(sequence, (5, 1, 1), (6, 1, 2), (10, 1, 3), (11, 1, 4)) == [0, 0, 3, 0]
    assert (sequence.lost, sequence.disordered) == (3, 0)


def test_publisher_that_starts_anew_loses_nothing():
    by_session, by_time = Sequence(), Sequence()
    assert missing(by_session, (90, 1, 1), (91, 1, 2), (4, 2, 3), (5, 2, 4)) == [0] * 4
    assert missing(by_time, (90, 0, 1), (91, 0, 2), (4, 0, 3), (5, 0, 4)) == [0] * 4


def test_two_publishers_are_counted_each_by_itself():
    sequence = Sequence()
    seen = (1, 1, 1), (90, 2, 2), (2, 1, 3), (92, 2, 4), (5, 1, 5), (93, 2, 6)
    assert missing(sequence, *seen) == [0, 0, 0, 1, 2, 0]
    assert (sequence.lost, sequence.disordered) == (3, 0)


def test_message_out_of_order_is_no_restart():
    sequence = Sequence()
    assert missing(sequence, (1, 1, 1), (3, 1, 3), (2, 1, 2), (4, 1, 4)) == [0, 1, 0, 0]
    assert sequence.disordered == 1


def test_stranger_without_header_is_not_counted():
    sequence = Sequence()
    assert missing(sequence, (0, 0, 1), (0, 0, 2), (0, 0, 3)) == [0] * 3


def test_keys_stand_layer_by_layer():
    stats = Stats()
    for key in (keys.CLOCK, keys.EST_DISTANCE, keys.SYNC_TICK, keys.GNSS_FIX, keys.IMU_BATCH):
        stats.expect(key.on(VEHICLE))
    stats.expect("/foreign")
    layers = [found.path.split("/")[0] for found in stats.in_order()]
    assert layers == ["raw", "raw", "sync", "est", "health", ""]


# Messages as text ---------------------------------------------------------------------------------
def test_time_keeps_its_nanoseconds():
    assert readable.iso(1_700_000_000 * S + 7) == "2023-11-14T22:13:20.000000007Z"


def test_long_fields_are_shortened_unless_full():
    message = RawBytes(device="gnss", data=bytes(100), read_length=range(20))
    short, full = readable.readable(message), readable.readable(message, full=True)
    assert "read_length: [0, 1, 2, 3, 4, 5, 6, 7, … 20 in all]" in short
    assert any(text.startswith("data: 00 00") and text.endswith("… 100 bytes") for text in short)
    assert f"read_length: [{', '.join(map(str, range(20)))}]" in full
    assert f"data: {bytes(100).hex(' ')}" in full


@pytest.mark.parametrize("key", keys.ALL, ids=lambda key: key.path)
def test_every_message_type_is_readable(key):
    assert isinstance(readable.readable(key.type()), list)
    assert readable.stamp_ns(key.type()) == 0


def test_not_a_number_becomes_null_in_json():
    figures = {"a": [float("nan"), 1.5], "b": {"c": float("inf")}, "d": 2**63}
    assert json.loads(source.line(figures)) == {"a": [None, 1.5], "b": {"c": None}, "d": 2**63}


# Records ------------------------------------------------------------------------------------------
def test_echo_of_a_record_gives_every_message(tmp_path):
    path = write_fixes(tmp_path / "a.mcap", [1, 2, 3, 5])
    done = tramstream("echo", "raw/gnss/fix", "--file", path, "--json")
    lines = [json.loads(text) for text in done.stdout.splitlines()]
    assert done.returncode == 0
    assert [found["sequence"] for found in lines] == [1, 2, 3, 5]
    stamp_ns = START_NS + 5 * S // 5
    assert lines[-1] == {
        "key": "raw/gnss/fix",
        "stamp_ns": stamp_ns,
        "publish_ns": stamp_ns,
        "sequence": 5,
        "message": to_dict(fix(5, stamp_ns)),
    }


def test_echo_as_text_tells_what_is_missing_and_ends_after_count(tmp_path):
    path = write_fixes(tmp_path / "a.mcap", [1, 4, 5])
    done = tramstream("echo", f"tram/{VEHICLE}/raw/gnss/fix", "--file", path, "--count", 2)
    assert done.stdout.count("---") == 2
    assert "# 2 messages of raw/gnss/fix are missing here" in done.stdout
    assert "raw/gnss/fix  #4  2026-09-21T" in done.stdout
    assert "source: NAV-PVT" in done.stdout


def test_echo_shows_what_it_cannot_decode(tmp_path):
    with RecordFile(tmp_path / "a.mcap", VEHICLE) as record:
        topic = keys.GNSS_FIX.on(VEHICLE)
        record.append(topic, keys.GNSS_FIX, b"\xff\xff", START_NS, START_NS, 1)
    text = tramstream("echo", "raw/gnss/fix", "--file", tmp_path / "a.mcap")
    assert text.returncode == 0
    assert "cannot be decoded\nff ff\n" in text.stdout
    plain = tramstream("echo", "raw/gnss/fix", "--file", tmp_path / "a.mcap", "--format", "json")
    assert json.loads(plain.stdout)["payload"] == "ffff"


def test_hz_and_bw_of_a_record_are_one_figure(tmp_path):
    path = write_fixes(tmp_path / "a.mcap", [*range(1, 11), *range(13, 21)])
    found = json.loads(tramstream("hz", "raw/**", "--file", path, "--json").stdout)
    assert found["rate_hz"] == pytest.approx(17 / (19 / 5))
    assert (found["count"], found["lost"], found["nominal_hz"]) == (18, 2, 5)
    assert (found["period_min_s"], found["period_max_s"]) == pytest.approx((0.2, 0.6))
    found = json.loads(tramstream("bw", "raw/gnss/fix", "--file", path, "--json").stdout)
    assert found["total_bytes"] == 18 * found["size_mean_bytes"]
    text = tramstream("hz", "raw/gnss/fix", "--file", path).stdout.splitlines()
    assert len(text) == 2
    assert text[1].split()[0] == "raw/gnss/fix"


def test_list_of_a_record_comes_from_its_channels(tmp_path):
    path = write_fixes(tmp_path / "a.mcap", list(range(1, 12)))
    found = json.loads(tramstream("list", "--file", path, "--json").stdout)
    assert found["vehicle"] == VEHICLE
    (row,) = found["keys"]
    assert row["key"] == "raw/gnss/fix"
    assert row["type"] == "tramstream.GnssFix"
    assert row["count"] == 11
    assert "Position, velocity, time" in tramstream("list", "--file", path).stdout


@pytest.mark.parametrize(
    ("key", "sentence"),
    [
        ("raw/gns/fix", "near: raw/gnss/fix"),
        ("raw/imu/batch", "has no messages on raw/imu/batch; it has raw/gnss/fix"),
        ("tram/other/raw/gnss/fix", "of vehicle other"),
    ],
)
def test_key_that_the_record_has_not_is_bad_usage(tmp_path, key, sentence):
    path = write_fixes(tmp_path / "a.mcap", [1, 2])
    done = tramstream("hz", key, "--file", path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert sentence in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_damaged_record_is_shown_as_far_as_it_goes_and_ends_with_3(tmp_path):
    path = write_fixes(tmp_path / "a.mcap", list(range(1, 2000)))
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 64] = bytes(64)
    path.write_bytes(data)
    done = tramstream("hz", "raw/gnss/fix", "--file", path, "--json")
    assert done.returncode == 3
    assert "damaged" in done.stderr
    assert "count" in json.loads(done.stdout)


def test_reader_of_the_output_may_go_away(tmp_path):
    path = write_fixes(tmp_path / "a.mcap", list(range(1, 5000)))
    arguments = command("echo", "**", "--file", str(path))
    echo = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    echo.stdout.readline()
    echo.stdout.close()
    assert echo.stderr.read() == ""
    echo.stderr.close()
    assert echo.wait(HANG_S) == 0


# The program --------------------------------------------------------------------------------------
def test_verbs_import_nothing_heavy():
    verbs = [point.value.split(":")[0] for point in entry_points(group="tramstream.verbs")]
    code = (
        f"import sys, importlib\nfor name in {verbs}: importlib.import_module(name)\n"
        f"print([name for name in {HEAVY} if name in sys.modules])"
    )
    done = finished([sys.executable, "-c", code], check=True)
    assert done.stdout.strip() == "[]"


def test_without_a_bus_one_sentence_says_what_to_start():
    with short_folder() as folder:
        done = tramstream("hz", "raw/gnss/fix", runtime_dir=folder)
    assert done.returncode == 2
    assert "no bus at" in done.stderr
    assert "tramstream run" in done.stderr


# Live ---------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def traffic():
    with busy_bus() as folder:
        yield folder


@pytest.mark.live
def test_live_echo_ends_after_count(traffic):
    done = tramstream("echo", "raw/gnss/fix", "--count", 3, "--json", runtime_dir=traffic)
    lines = [json.loads(text) for text in done.stdout.splitlines()]
    assert done.returncode == 0
    assert len(lines) == 3
    assert lines[2]["sequence"] == lines[0]["sequence"] + 2
    assert lines[0]["message"]["source"] == "NAV-PVT"


@pytest.mark.live
def test_live_hz_and_bw_report_every_second(traffic):
    done = tramstream("hz", "**", "--count", 1, "--json", runtime_dir=traffic)
    found = {row["key"]: row for row in map(json.loads, done.stdout.splitlines())}
    assert set(found) == {"raw/gnss/fix", "health/gnss/heartbeat"}
    assert found["raw/gnss/fix"]["lost"] == 0
    assert found["raw/gnss/fix"]["rate_hz"] > 0
    done = tramstream("bw", "raw/gnss/fix", "--count", 2, runtime_dir=traffic)
    assert done.stdout.splitlines()[0].split()[0] == "key"
    assert [line.split()[0] for line in done.stdout.splitlines()[1:]] == ["raw/gnss/fix"] * 2


@pytest.mark.live
def test_live_list_names_what_comes(traffic):
    done = tramstream("list", "--json", "--listen-s", 1, runtime_dir=traffic)
    found = [row["key"] for row in json.loads(done.stdout)["keys"]]
    assert found == ["raw/gnss/fix", "health/gnss/heartbeat"]


@pytest.mark.live
def test_live_key_that_nothing_comes_on_is_reported_as_such(traffic):
    done = tramstream("hz", "raw/imu/batch", "--count", 1, "--json", runtime_dir=traffic)
    found = json.loads(done.stdout)
    assert (found["count"], found["rate_hz"]) == (0, None)


@pytest.mark.live
def test_live_key_that_nobody_knows_is_bad_usage(traffic):
    done = tramstream("echo", "raw/gnss/fxi", runtime_dir=traffic)
    assert done.returncode == 2
    assert "near: raw/gnss/fix" in done.stderr


@pytest.mark.live
@pytest.mark.parametrize("verb", ["echo", "hz", "bw"])
def test_interrupt_ends_a_stream_cleanly(traffic, verb):
    arguments = command(verb, "raw/gnss/fix", "--format", "json")
    process = subprocess.Popen(
        arguments, env=environment(traffic), stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout.readline().startswith(b"{")
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=HANG_S)
    assert process.returncode == 0
    assert errors == b""
