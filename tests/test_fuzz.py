"""Files of strangers by mutation: no verb traces, memory stays; a minute here, an hour as a study.

    pytest tests/test_fuzz.py                                   # a minute, always the same files
    TRAMSTREAM_FUZZ_S=3600 pytest -m study tests/test_fuzz.py -s   # an hour, other files each time

A finding is kept in the test's folder under the name that is told; `fuzz_kinds.KINDS` says what is
done with it.
"""

from __future__ import annotations

import os
import time
from functools import cache
from pathlib import Path

import pytest
from fuzz_kinds import KINDS
from fuzzing import Kind, run

from tramstream import plugins

SEED = 12
MORE_MB = 200.0
"""No file of some kilobytes may take more."""
STUDY_S = float(os.environ.get("TRAMSTREAM_FUZZ_S", "3600"))


@pytest.fixture(autouse=True)
def nothing_is_installed_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    """To look for what is takes most of the time of a small file."""
    monkeypatch.setattr(plugins, "points", cache(plugins.points))


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_mutated_file_is_used_or_refused_in_one_sentence(kind: Kind, tmp_path: Path) -> None:
    found = run(kind, tmp_path, SEED, cases=kind.cases)
    assert not found.traces, "\n".join(found.traces)
    assert found.cases == kind.cases
    assert found.peak_mb < MORE_MB


@pytest.mark.study
def test_an_hour_of_mutated_files_leaves_no_trace(tmp_path: Path) -> None:
    """The counts a minute and the memory of each kind stand in docs/architecture.md."""
    seed, traces = time.time_ns(), []
    print(f"\nseed {seed}")
    for kind in KINDS:
        folder = tmp_path / kind.name
        folder.mkdir()
        found = run(kind, folder, seed, for_s=STUDY_S / len(KINDS))
        print(
            f"{kind.name:14} {found.cases:7d} files, {found.per_minute:6.0f} a minute, "
            f"{found.peak_mb:+5.0f} MB, slowest {found.slowest_s:.1f} s, {len(found.traces)} traces"
        )
        traces += found.traces
        assert found.peak_mb < MORE_MB, kind.name
    assert not traces, "\n".join(traces)
