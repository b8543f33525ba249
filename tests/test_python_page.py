"""docs/python.md is run from top to bottom, and prints what it says that it prints."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
import sysconfig
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest
from live import HANG_S

PAGE = Path(__file__).resolve().parent.parent / "docs" / "python.md"
README = PAGE.parent.parent / "README.md"
BLOCK = re.compile(r"```(\w*)\n(.*?)```", re.DOTALL)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
SHARE, SMALL = 0.1, 0.05
"""How far a figure of the filter may be from the page's: it gets better now and then, and another
processor rounds in another way. Counts, names and shapes are far apart by more."""


def told(text: str) -> tuple[str, list[float]]:
    """A text without its numbers and spaces, and the numbers."""
    return re.sub(r"[\s0-9.-]+", " ", text).strip(), [float(each) for each in NUMBER.findall(text)]


def test_told_tells_texts_apart() -> None:
    assert told("a  1.50 b\n") == told("a 1.5  b")
    assert told("a 1") != told("b 1")
    assert told("a 1") != told("a 2")


def run(blocks: list[tuple[str, str]], namespace: dict[str, Any]) -> list[tuple[str, str]]:
    """Run blocks in turn; what was printed, and what the page says, where it says something."""
    found = []
    printed = ""
    for language, text in blocks:
        if language == "sh":
            path = os.pathsep.join((sysconfig.get_path("scripts"), os.environ["PATH"]))
            command = ["bash", "-euo", "pipefail", "-c", text]
            environment = {**os.environ, "PATH": path}
            subprocess.run(command, check=True, timeout=HANG_S, env=environment)
        elif language == "python":
            with redirect_stdout(io.StringIO()) as out:
                exec(compile(text, str(PAGE), "exec"), namespace)
            printed = out.getvalue()
        else:
            found.append((printed, text))
    return found


def test_page_prints_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas", reason="needs tramstream[test]")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.delitem(sys.modules, "matplotlib.pyplot", raising=False)
    found = run(BLOCK.findall(PAGE.read_text()), {})
    in_readme = [each for each in BLOCK.findall(README.read_text()) if each[0] == "python"]
    assert len(in_readme) == 1
    run(in_readme, {})
    assert len(found) > 8
    if rewritten := os.environ.get("TRAMSTREAM_PAGE"):
        Path(rewritten).write_text("\0".join(printed for printed, _ in found))
    for printed, said in found:
        (words, numbers), (said_words, said_numbers) = told(printed), told(said)
        assert words == said_words, printed
        assert numbers == pytest.approx(said_numbers, rel=SHARE, abs=SMALL), printed
    assert (tmp_path / "speed.png").stat().st_size > 10_000
    assert (tmp_path / "errors.png").stat().st_size > 10_000
