"""A torn record into replay and reprocess: what is proved right is used, and the status is 3."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from live import command, environment, finished, short_folder
from looking import tramstream
from msgspec.structs import replace
from record_rides import CONFIG, fix, wheels
from record_samples import traffic, write

from tramstream import config_file, keys
from tramstream.errors import MachineCodeError
from tramstream.machine import compilation
from tramstream.recorder.file.writer import RecordFile


def torn(path: Path) -> Path:
    """The first six tenths of a record, as a power cut leaves them."""
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10])
    return path


@pytest.mark.live
def test_torn_record_is_replayed_as_far_as_it_goes(tmp_path: Path) -> None:
    path = torn(write(tmp_path / "a.mcap", traffic(400), flush_every=20))
    with short_folder() as folder:
        words = command("replay", path, "--rate", 0, "--json")
        done = finished(words, env=environment(folder))
    assert done.returncode == 3, done.stderr
    figures = json.loads(done.stdout)
    assert 0 < figures["published"] < 400
    assert "damaged" in figures["damaged"]
    assert "what could be proved right was replayed" in done.stderr


@pytest.mark.parametrize("compiles", [True, False])
def test_torn_record_is_reprocessed_as_far_as_it_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compiles: bool
) -> None:
    """Also where filters cannot be compiled beforehand: what is needed is compiled on the way."""

    def ensure(say: Callable[[str], None]) -> None:
        if not compiles:
            raise MachineCodeError("the filters could not be compiled")

    monkeypatch.setattr(compilation, "ensure", ensure)
    path = tmp_path / "a.mcap"
    quick = replace(CONFIG, processors=("resampler", "distance"))
    metadata = {config_file.RECORD_ENTRY: config_file.to_json(quick)}
    with RecordFile(path, CONFIG.vehicle, metadata) as record:
        for step in range(0, 2000, 10):
            for key, message in ((keys.ODO_WHEELS, wheels(step)), (keys.GNSS_FIX, fix(step))):
                at_ns, payload = message.stamp_ns, message.SerializeToString()
                record.append(key.on(CONFIG.vehicle), key, payload, at_ns, at_ns, step)
            record.flush()
    done = tramstream("reprocess", torn(path), "-o", tmp_path / "o.mcap", "--json")
    assert ("could not be compiled" in done.stderr) is not compiles
    assert done.returncode == 3, done.stderr
    figures = json.loads(done.stdout)
    assert figures["outputs"] > 0
    assert "damaged" in figures["damaged"]
    assert "what could be proved right was reprocessed" in done.stderr
