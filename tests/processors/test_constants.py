"""Every tuned constant of the localisation filters says who set it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
ROOMS = ("tram", "tram_model", "smoothing", "kaspar2023")
MODULES = sorted(each for room in ROOMS for each in (REPOSITORY / "processors" / room).glob("*.py"))
TABLE = (REPOSITORY / "docs" / "theory.md").read_text().partition("## 17 Tuned constants")[2]
SOURCE = re.compile(r"by hand|study|test_|tests/|data sheet|theory\.md")
GIVEN = {
    "STEP_S",
    "MESSAGE_S",
    "READING_S",
    "EARTH_RADIUS_M",
    "MOST_ROWS",
    "ROW_LENGTH",
    "SCALAR_TAIL",
    "BLOCK",
    "TOGETHER",
    "DIRECTIONS",
}
"""Nobody tunes them: rates of the sensors, the Earth, sizes of arrays."""


def constants(path: Path) -> Iterator[tuple[str, str]]:
    """Public numbers of a module, each with the docstring that follows it or its neighbours."""
    names: list[str] = []
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name = node.targets[0].id
            if name.isupper() and not name.startswith("_") and is_number(node.value):
                names.append(name)
            continue
        text = ""
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            text = str(node.value.value)
        for name in names:
            yield name, text
        names = []


def is_number(node: ast.expr) -> bool:
    """Whether it is written as a number, or as a quotient or product of numbers."""
    kinds = (ast.Constant, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop)
    values = [each.value for each in ast.walk(node) if isinstance(each, ast.Constant)]
    written = all(isinstance(each, kinds) for each in ast.walk(node))
    return written and all(isinstance(each, int | float) for each in values)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_every_tuned_constant_says_who_set_it(path: Path) -> None:
    """In its docstring, or in docs/theory.md, section 17."""
    silent = [
        name
        for name, text in constants(path)
        if name not in GIVEN and f"`{name}`" not in TABLE and not SOURCE.search(text)
    ]
    assert not silent


def test_what_counts_as_a_constant() -> None:
    found = dict(constants(REPOSITORY / "processors" / "tram" / "wheels.py"))
    assert {"QUANTISATION", "READMIT_S", "MAX_MPS"} <= found.keys()
