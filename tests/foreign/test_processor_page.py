"""docs/processor.md does what it says: its processor is the one that is tested, its code runs."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from installed import COMFORT, install, put_on_path
from live import finished

PAGE = Path(__file__).resolve().parents[2] / "docs" / "processor.md"
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
PRINTED = re.findall(r"^```\n\n```\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)


def test_processor_of_the_page_is_the_one_that_is_tested() -> None:
    assert BLOCKS[0] == (COMFORT / "comfort.py").read_text()


def test_tests_of_the_page_pass_and_its_notebook_prints_what_it_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put_on_path(install(COMFORT, tmp_path / "site"), monkeypatch)
    _, tests, notebook = BLOCKS
    (tmp_path / "test_comfort_page.py").write_text(tests)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)]
    done = finished(command, cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    assert "6 passed" in done.stdout
    done = finished([sys.executable, "-c", f"{tests}\n{notebook}"], cwd=tmp_path, check=True)
    assert [done.stdout] == PRINTED
