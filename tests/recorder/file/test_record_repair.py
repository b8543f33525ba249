"""The order in which a repair asks the disk, and what it believes of a log that lies there."""

from __future__ import annotations

import stat
import struct
import zlib
from pathlib import Path

import pytest
from disks import Watched
from record_samples import active, read, traffic

from tramstream.recorder.file import repair as repairs
from tramstream.recorder.file.repair import REDO, repair


def torn(folder: Path, messages: int = 60) -> Path:
    """A file whose last chunk is cut."""
    path = active(folder / "a.mcap", traffic(messages), 20)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) - 700])
    return path


def test_nothing_is_changed_before_the_redo_log_is_on_the_disk_for_good(tmp_path: Path) -> None:
    disk, name, log = Watched(), "a.mcap.active", f"a.mcap{REDO}"
    repair(torn(tmp_path), disk)
    asked = [call for call in disk.calls if call not in (("write", log), ("write", name))]
    assert asked == [
        ("unlink", log),
        ("create", log),
        ("sync", log),
        ("sync_directory", ""),
        ("truncate", name),
        ("sync", name),
        ("rename", name),
        ("sync_directory", ""),
        ("unlink", log),
        ("sync_directory", ""),
    ]
    of_log = [index for index, call in enumerate(disk.calls) if call == ("write", log)]
    of_record = [index for index, call in enumerate(disk.calls) if call == ("write", name)]
    assert of_log
    assert of_record
    assert max(of_log) < disk.calls.index(("sync", log))
    assert disk.calls.index(("sync_directory", "")) < min(of_record)
    assert max(of_record) < disk.calls.index(("sync", name))


def test_redo_log_is_nobody_elses_to_write(tmp_path: Path) -> None:
    seen: list[int] = []

    def look(name: str, file: str) -> None:
        if name == "sync" and file.endswith(REDO):
            seen.append(stat.S_IMODE((tmp_path / file).stat().st_mode))

    repair(torn(tmp_path), Watched(look))
    assert len(seen) == 1
    assert seen[0] & ~0o640 == 0


@pytest.mark.parametrize(
    "body",
    [
        b"",
        struct.pack("<Q", 1 << 63),
        struct.pack("<QQQ", 1 << 40, 0, 1 << 40),
        struct.pack("<QQQ", 1 << 62, 1 << 62, 1) + b"x",
        struct.pack("<QQQ", 10, 9, 2) + b"xx",
        struct.pack("<QQQ", 10, 0, 1) + b"xy",
    ],
)
def test_redo_log_whose_lengths_lie_is_not_carried_out(tmp_path: Path, body: bytes) -> None:
    """Its checksum holds: whoever writes a log can write that."""
    path = torn(tmp_path)
    data = repairs._REDO_MAGIC + struct.pack("<I", zlib.crc32(body)) + body
    (tmp_path / f"a.mcap{REDO}").write_bytes(data)
    recovery = repair(path)
    assert recovery.messages >= 40
    assert len(read(tmp_path / "a.mcap")) == recovery.messages
    assert [each.name for each in tmp_path.iterdir()] == ["a.mcap"]


def test_messages_of_many_torn_chunks_go_into_chunks_that_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All damage of a file together is more than one chunk may state."""
    monkeypatch.setattr(repairs, "_LOT_BYTES", 2000)
    path = active(tmp_path / "a.mcap", traffic(400), 20)
    data = bytearray(path.read_bytes())
    place = -1
    while (place := data.find(b"zstd", place + 1)) >= 0:
        (size,) = struct.unpack_from("<Q", data, place + 4)
        data[place + 12 + size - 2] ^= 1  # the last block of each chunk
    path.write_bytes(data)
    recovery = repair(path)
    assert 100 < recovery.messages < 400
    assert len(read(tmp_path / "a.mcap")) == recovery.messages
