"""Fixtures of all tests."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from prague import Prague

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of real recordings; skips, naming the folder, where it is absent."""
    chosen = os.environ.get("TRAMSTREAM_DATA")
    folder = Path(chosen) if chosen else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder}; set TRAMSTREAM_DATA to their folder")
    return folder


@pytest.fixture(scope="session")
def prague(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Prague:
    """Prague's network; building it takes 5 s."""
    from prague import built

    return built(data_dir / "maps" / "prague", tmp_path_factory.mktemp("prague") / "prague.net")
