"""A package of somebody else, installed: its folder is on the path, with its entry points."""

from __future__ import annotations

import os
import shutil
import tomllib
from pathlib import Path

import pytest

COMFORT = Path(__file__).resolve().parent.parent / "foreign" / "comfort"


def install(source: Path, site: Path) -> Path:
    """Lay out the modules of `source` and what pip writes beside them; gives the folder."""
    project = tomllib.loads((source / "pyproject.toml").read_text())["project"]
    site.mkdir(parents=True, exist_ok=True)
    for module in source.glob("*.py"):
        shutil.copy(module, site)
    facts = site / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    facts.mkdir()
    head = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    (facts / "METADATA").write_text(head)
    lines = [
        line
        for group, points in project["entry-points"].items()
        for line in (f"[{group}]", *(f"{name} = {target}" for name, target in points.items()))
    ]
    (facts / "entry_points.txt").write_text("\n".join(lines) + "\n")
    return site


def put_on_path(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have this process, and those that it starts, find the package."""
    monkeypatch.syspath_prepend(str(site))
    before = os.environ.get("PYTHONPATH")
    monkeypatch.setenv("PYTHONPATH", f"{site}:{before}" if before else str(site))
