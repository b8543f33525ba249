"""Files that people name."""

from __future__ import annotations

from pathlib import Path

import pytest

from tramstream.errors import ConfigError
from tramstream.input_file import read_bytes


def test_file_is_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"\0\r\n\xff")
    assert read_bytes(path) == b"\0\r\n\xff"


@pytest.mark.parametrize(("name", "why"), [("none", "No such file"), ("", "Is a directory")])
def test_what_cannot_be_read_is_named_with_the_reason(tmp_path: Path, name: str, why: str) -> None:
    with pytest.raises(ConfigError, match=rf"^{tmp_path / name}: cannot be read \({why}"):
        read_bytes(tmp_path / name)
