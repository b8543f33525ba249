"""What the suite demands of itself: no test decides by the wall clock, and every one can fail."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

TESTS = Path(__file__).resolve().parent
NOTHING_TO_SEE = {
    "transport/test_bus.py: test_close_may_be_called_twice",  # a closed bus answers no question
}
"""Tests that fail by an exception alone, each with the reason."""
Function = ast.FunctionDef | ast.AsyncFunctionDef


def test_examples_have_no_deadline_and_may_be_slow_to_make() -> None:
    assert settings.default is not None
    assert settings.default.deadline is None
    assert HealthCheck.too_slow in settings.default.suppress_health_check
    assert settings(max_examples=1).deadline is None  # what a test sets for itself builds on it


def called(node: ast.AST) -> Iterator[str]:
    """Names of what is called in a node, without the object that it is called of."""
    for each in ast.walk(node):
        if isinstance(each, ast.Call):
            if isinstance(each.func, ast.Name):
                yield each.func.id
            elif isinstance(each.func, ast.Attribute):
                yield each.func.attr


def demands(function: Function) -> bool:
    """Whether a function itself asserts, raises, or lets numpy or pytest do so."""
    return any(isinstance(each, ast.Assert | ast.Raise) for each in ast.walk(function)) or any(
        name.startswith("assert_") or name in ("raises", "fail") for name in called(function)
    )


def without_assertion(trees: dict[str, ast.Module]) -> list[str]:
    """Tests that demand nothing, themselves or by what they call of the suite's own functions.

    A helper is looked for in the test's own module and in those that hold no tests (`support/`).
    """
    functions = {
        path: {each.name: each for each in ast.walk(tree) if isinstance(each, Function)}
        for path, tree in trees.items()
    }
    shared = {
        name: function
        for path, its in functions.items()
        if not Path(path).name.startswith("test_")
        for name, function in its.items()
    }
    found = []
    for path, its in functions.items():
        known = shared | its
        for name in (each for each in its if each.startswith("test_")):
            waiting, met = [name], {name}
            while waiting and not demands(known[waiting[-1]]):
                more = {each for each in called(known[waiting.pop()]) if each in known} - met
                met |= more
                waiting += more
            if not waiting:
                found.append(f"{path}: {name}")
    return found


def test_every_test_can_fail() -> None:
    trees = {
        str(path.relative_to(TESTS)): ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted(TESTS.rglob("*.py"))
    }
    assert len(trees) > 100
    assert set(without_assertion(trees)) == NOTHING_TO_SEE


@pytest.mark.parametrize(
    ("body", "fails"),
    [
        ("print(f())", False),
        ("assert f()", True),
        ("helper(1)", True),
        ("through()", True),
        ("stranger()", False),
        ("np.testing.assert_allclose(f(), 1)", True),
        ("with pytest.raises(ValueError):\n        f()", True),
    ],
)
def test_test_that_can_fail_is_told_from_one_that_cannot(body: str, fails: bool) -> None:
    module = ast.parse(
        f"def helper(x):\n    assert x\ndef through():\n    helper(0)\ndef test_it():\n    {body}\n"
    )
    stranger = ast.parse("def stranger():\n    assert True\n")
    found = without_assertion({"test_a.py": module, "test_b.py": stranger})
    assert (found == []) is fails


def test_no_two_modules_of_tests_have_one_name() -> None:
    """Tests are imported by their name alone: of two, one would not be run."""
    names = Counter(path.name for path in TESTS.rglob("test_*.py"))
    twice = [name for name, count in names.items() if count > 1]
    assert twice == []
