"""Files of strangers that claim what nobody has: one sentence, little memory, little time."""

from __future__ import annotations

import json
import struct
import zipfile
from pathlib import Path

import networks
import numpy as np
import pytest
from children import measured

from tramstream.errors import ConfigError
from tramstream.tracks import check, network

MORE_MB = 200
IMPORTS = """
from pathlib import Path
from tramstream import config_file
from tramstream.analysis.tables import mapping
from tramstream.lines import geojson, traces
from tramstream.live import snapshots
from tramstream.mapping import elevation, extract, line_requests
from tramstream.tracks import network
from tramstream.bridges.odometer.dbc import Database
path = Path(sys.argv[1])
"""


BOMB_BYTES = 1 << 28
"""Unpacked it would take more memory than `refused` allows."""


def refused(work: str, path: Path) -> str:
    """The sentence with which a file is refused."""
    more_mb, _, said = measured(IMPORTS, work, path)
    kind, _, sentence = said.partition(": ")
    assert kind == "ConfigError", said
    assert str(path) in sentence
    assert more_mb < MORE_MB
    return sentence


def head(shape: str, kind: str = "<f8") -> bytes:
    """The begin of a `.npy` file."""
    text = f"{{'descr': {kind!r}, 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


# Networks -----------------------------------------------------------------------------------------
def rewritten(path: Path, change: dict[str, bytes], kind: int = zipfile.ZIP_DEFLATED) -> Path:
    """A network's file in which some entries are others."""
    networks.switch().network.save(path)
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", kind) as archive:
        for name, data in {**entries, **change}.items():
            archive.writestr(name, data)
    return path


@pytest.mark.parametrize(
    "change",
    [
        {"east.npy": head("(17179869184,)")},
        {"east.npy": head("(" * 3000)},
        {"east.npy": head("(1,)", "|O") + bytes(8)},
        {"east.npy": head("(4611686018427387904, 4)", "|V0")},
        {"east.npy": bytes(BOMB_BYTES)},
        {"names.json": b"[" * 1_000_000},
        {"names.json": b" " * BOMB_BYTES},
        {"more.npy": head("(0,)")},
    ],
    ids=["128 GiB", "brackets", "objects", "nothing", "zeros", "nested", "blanks", "other"],
)
def test_network_that_claims_more_than_it_has_is_refused(
    tmp_path: Path, change: dict[str, bytes]
) -> None:
    path = rewritten(tmp_path / "a.tracks", change)
    assert "is no track network, or a damaged one" in refused("network.load(path)", path)


def test_network_that_is_packed_in_a_way_that_takes_memory_is_refused(tmp_path: Path) -> None:
    path = rewritten(tmp_path / "a.tracks", {}, zipfile.ZIP_LZMA)
    assert "is no track network" in refused("network.load(path)", path)


@pytest.mark.parametrize("name", sorted(check.KINDS))
def test_network_whose_numbers_point_beyond_what_it_has_is_refused(
    tmp_path: Path, name: str
) -> None:
    """Compiled code would read from there."""
    good = getattr(networks.switch().network, name)
    wrong = [good[:-1], np.append(good, good[-1:]), np.zeros(len(good), np.int16), good[None]]
    if name in ("starts", "following_starts", "following", "from_node", "to_node"):
        wrong += [good + np.int32(10_000), good - np.int32(100), good[::-1].copy()]
    if name == "following":  # any order is one
        wrong.pop()
    if name in ("from_node", "to_node"):
        wrong.pop()
    arrays = {each: getattr(networks.switch().network, each) for each in check.KINDS}
    assert check.doubt_of(arrays) == ""
    for array in wrong:
        assert check.doubt_of({**arrays, name: array}) != ""


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("stops", [["name", 99, 1.0]]),
        ("ways", [[-1, 0.0, 1.0, 1, {}]]),
        ("lines", [["7", "0", "a", "b", [0, 99], 0.0, 1.0, []]]),
        ("latitude_rad", "north"),
        ("node_std_m", None),
        ("unknown", 1),
    ],
)
def test_network_whose_names_are_of_tracks_that_are_not_there_is_refused(
    tmp_path: Path, field: str, value: object
) -> None:
    path = tmp_path / "a.tracks"
    networks.switch().network.save(path)
    with zipfile.ZipFile(path) as archive:
        names = json.loads(archive.read("names.json"))
    rewritten(path, {"names.json": json.dumps({**names, field: value}).encode()})
    with pytest.raises(ConfigError, match="is no track network, or a damaged one"):
        network.load(path)


# Snapshots ----------------------------------------------------------------------------------------
def test_array_of_a_snapshot_that_claims_more_than_it_has_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "array"
    path.write_bytes(head("(17179869184,)") + bytes(16))
    work = (
        "import msgspec; "
        "snapshots.unpack(msgspec.msgpack.encode(msgspec.msgpack.Ext(1, path.read_bytes())))"
    )
    more_mb, _, said = measured(IMPORTS, work, path)
    assert said.startswith("ValueError: an array that claims 137438953472 bytes and has 16")
    assert more_mb < MORE_MB


# Text ---------------------------------------------------------------------------------------------
TEXTS = {
    "deep TOML": ("config_file.load(path)", b'vehicle = "x"\nx = ' + b"[" * 100_000),
    "deep TOML tables": ("config_file.load(path)", b"[" + b"a." * 100_000 + b"a]\n"),
    "TOML of many digits": ("config_file.load(path)", b"x = " + b"9" * 100_000),
    "deep mapping": ("mapping.load(path)", b"x = " + b"{a=" * 100_000),
    "deep lines": ("line_requests.read(path)", b"[" * 1_000_000),
    "deep trace": ("traces.read(path)", b"[" * 1_000_000),
    "deep line": ("geojson.read(str(path))", b"[" * 1_000_000),
    "deep map": ("extract.read([path])", b'{"elements":' + b"[" * 1_000_000),
    "number of a trace": (
        "traces.read(path)",
        b'{"type": "Point", "coordinates": [1' + b"0" * 400 + b", 50]}",
    ),
    "number of a map": (
        "extract.read([path])",
        b'{"elements": [{"type": "node", "id": 1' + b"0" * 400 + b', "lat": 1, "lon": 1}]}',
    ),
    "silence": (
        "config_file.load(path)",
        b'vehicle = "x"\n[odometer]\nchannel = "c"\ndbc = "d"\nsilence_s = 1e308\nwheels = {}\n',
    ),
    "factor": ("config_file.load(path)", b'vehicle = "x"\n[resampler]\nfactor = 1000000000\n'),
    "bridged": (
        "config_file.load(path)",
        b'vehicle = "x"\n[resampler]\nmax_bridge_samples = 1000000000\n',
    ),
    "lag": ("config_file.load(path)", b'vehicle = "x"\n[resampler]\nhorizon_lag_s = 1e9\n'),
}


@pytest.mark.parametrize("name", TEXTS)
def test_text_that_nests_or_counts_beyond_sense_is_refused(tmp_path: Path, name: str) -> None:
    work, text = TEXTS[name]
    path = tmp_path / "a.txt"
    path.write_bytes(text)
    refused(work, path)


@pytest.mark.parametrize(
    "work",
    [
        "config_file.load(path)",
        "mapping.load(path)",
        "line_requests.read(path)",
        "traces.read(path)",
        "extract.read([path])",
        "elevation.read(path)",
        "Database(str(path), '$.odometer.dbc')",
    ],
)
def test_file_without_an_end_is_refused(tmp_path: Path, work: str) -> None:
    path = tmp_path / "N50E014.hgt"
    path.symlink_to("/dev/zero")
    assert "is longer than" in refused(work, path)


# DBC ----------------------------------------------------------------------------------------------
DBC = """VERSION ""
BO_ 170 WHEELS: {length} ECU
 SG_ LEFT {multiplexer}: {start}|{bits}@1+ (0.01,0) [0|250] "km/h" ECU
{more}
"""
GOOD = {"length": "8", "multiplexer": "", "start": "0", "bits": "16", "more": ""}


@pytest.mark.parametrize(
    "change",
    [
        {"length": "4000000000"},
        {"length": "1" * 5000},
        {"bits": "1000000000"},
        {"start": "1000000000"},
        {"bits": "9" * 5000},
        {"multiplexer": "m0", "more": "SG_MUL_VAL_ 170 LEFT PAGE 0-4294967295;"},
        {"multiplexer": "m0", "more": "SG_MUL_VAL_ 170 LEFT PAGE " + "0-90000, " * 9 + "0-90000;"},
    ],
)
def test_dbc_of_messages_and_signals_that_no_bus_carries_is_refused(
    tmp_path: Path, change: dict[str, str]
) -> None:
    path = tmp_path / "a.dbc"
    path.write_text(DBC.format(**{**GOOD, **change}))
    sentence = refused("Database(str(path), '$.odometer.dbc')", path)
    assert "is longer than" in sentence
    assert sentence.endswith("correct the DBC")


def test_dbc_of_a_long_message_is_read(tmp_path: Path) -> None:
    """J1939's transport protocol carries 1785 bytes."""
    path = tmp_path / "a.dbc"
    path.write_text(DBC.format(**{**GOOD, "length": "1785"}))
    assert measured(IMPORTS, "Database(str(path), '$').find('WHEELS', 'LEFT', '$')", path)[2] == (
        "done"
    )
