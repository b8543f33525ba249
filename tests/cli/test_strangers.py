"""What a stranger wrote into a record or a name, on the terminal and in a spreadsheet."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from looking import START_NS, VEHICLE, tramstream
from mcap.writer import Writer

from tramstream import keys
from tramstream.clock import S
from tramstream.recorder.file.writer import RecordFile

HOSTILE = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202e\x7f"
"""Window title, clear screen, a C1 sequence, a turn of the reading direction, DEL."""
FORBIDDEN = set(HOSTILE) - set("]0;ownedJ231m[")


def harmless(text: str) -> bool:
    return not FORBIDDEN & set(text)


@pytest.fixture
def record(tmp_path: Path) -> Path:
    """A log text that is hostile, and one that is a formula."""
    path = tmp_path / "a.mcap"
    key = keys.LOG.at("gnss")
    with RecordFile(path, VEHICLE) as written:
        for number, text in enumerate((HOSTILE, '=HYPERLINK("http://x")', "-1+1", "two\nlines")):
            message = Log(name="gnss", message=text)
            stamp_ns = START_NS + number * S
            payload = message.SerializeToString()
            written.append(key.on(VEHICLE), key, payload, stamp_ns, stamp_ns, number)
    return path


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A record of somebody else whose topics and schema are hostile."""
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(f"T{HOSTILE}", "json", b"{}")
        for topic in (f"/{HOSTILE}", "/a b", "/a_b", "/\x00", "/" + "é" * 400, "/[red]x"):
            channel = writer.register_channel(topic, "json", schema)
            writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    return path


def test_log_texts_and_foreign_keys_are_printed_without_escapes(
    record: Path, foreign: Path
) -> None:
    for arguments in (
        ("echo", "**", "--file", record),
        ("echo", "**", "--file", record, "--json"),
        ("echo", "**", "--file", foreign),
        ("echo", "**", "--file", foreign, "--json"),
        ("list", "**", "--file", foreign),
        ("list", "**", "--file", foreign, "--json"),
        ("hz", "**", "--file", foreign),
        ("bw", "**", "--file", foreign),
        ("info", foreign),
        ("echo", "raw/none", "--file", foreign),
    ):
        done = tramstream(*arguments)
        assert harmless(done.stdout), arguments
        assert harmless(done.stderr), arguments
        assert "Traceback" not in done.stderr, arguments
    assert "\\x1b[2J" in tramstream("echo", "**", "--file", record).stdout
    lines = tramstream("echo", "**", "--file", record, "--json").stdout.splitlines()
    assert json.loads(lines[0])["message"]["message"] == HOSTILE
    assert "[red]x" in tramstream("info", foreign).stdout


def test_the_name_of_a_file_in_an_error_does_no_harm(tmp_path: Path) -> None:
    done = tramstream("info", tmp_path / f"no{HOSTILE}.mcap")
    assert done.returncode == 2
    assert harmless(done.stderr)
    assert "\\x1b[2J" in done.stderr


def test_cells_that_are_formulas_are_made_harmless_in_a_table(record: Path, tmp_path: Path) -> None:
    out = tmp_path / "log.csv"
    assert tramstream("export", record, "--csv", out).returncode == 0
    with out.open(newline="") as file:
        texts = [row["message"] for row in csv.DictReader(file)]
    assert texts == [HOSTILE, '\'=HYPERLINK("http://x")', "'-1+1", "two\nlines"]
