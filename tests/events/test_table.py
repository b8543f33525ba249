"""Every kind of ours is declared once, raised somewhere, explained; nobody parses sentences."""

from __future__ import annotations

import ast
import importlib
import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from tramstream.analysis.report import events_page
from tramstream.events import Kind
from tramstream.events.kinds import DEBUG, INFO

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("tramstream", "bridges", "processors", "recorder", "analysis", "cli")
SOURCES = {
    str(path.relative_to(ROOT)): path.read_text()
    for folder in FOLDERS
    for path in sorted((ROOT / folder).rglob("*.py"))
    if not path.name.endswith("_pb2.py")
}
TREES = {path: ast.parse(text) for path, text in SOURCES.items()}
TABLES = {table.__name__: events_page.kinds(table) for table in events_page.TABLES}
KINDS = [
    pytest.param(name, kind, id=kind.name)
    for declared in TABLES.values()
    for name, kind in declared.items()
]


def module_of(path: str) -> str:
    """`tramstream.recorder.node` of `recorder/node.py`."""
    dotted = path.removesuffix(".py").replace("/", ".")
    return dotted if dotted.startswith("tramstream.") else f"tramstream.{dotted}"


def test_kinds_are_declared_in_the_tables_of_their_rooms_and_nowhere_else() -> None:
    declaring = {
        module_of(path)
        for path, text in SOURCES.items()
        if re.search(r"^\w+ = (events\.)?define\($", text, re.MULTILINE)
        and path != "tramstream/keys.py"
    }
    assert declaring == set(TABLES)
    assert all(TABLES.values())
    assert all(importlib.import_module(name) for name in TABLES)


def test_no_two_kinds_have_one_name() -> None:
    names = Counter(kind.name for kinds in TABLES.values() for kind in kinds.values())
    assert [name for name, count in names.items() if count > 1] == []


@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_kind_is_raised_by_product_code(name: str, kind: Kind) -> None:
    """Its name stands in a module beside the table, as a call or handed on to one."""
    home = next(table for table, kinds in TABLES.items() if kinds.get(name) is kind)
    assert (home, name) in used(), f"nobody raises {kind.name}"


@cache
def used() -> frozenset[tuple[str, str]]:
    """Tables and the names out of them that other modules import and use."""
    found: set[tuple[str, str]] = set()
    for path, tree in TREES.items():
        if path.endswith(("events.py", "events_page.py")):
            continue
        nodes = list(ast.walk(tree))
        named = {node.id for node in nodes if isinstance(node, ast.Name)}
        dotted = [ast.unparse(node) for node in nodes if isinstance(node, ast.Attribute)]
        for node in nodes:
            for alias in node.names if isinstance(node, ast.ImportFrom) else ():
                local = alias.asname or alias.name
                if node.module in TABLES and local in named:
                    found.add((node.module, alias.name))
                table = f"{node.module}.{alias.name}"
                if table in TABLES:
                    kinds = [each for each in dotted if each.startswith(f"{local}.")]
                    found |= {(table, each.removeprefix(f"{local}.")) for each in kinds}
    return frozenset(found)


@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_kind_has_a_cause_and_a_cure_where_one_can_do_something(name: str, kind: Kind) -> None:
    assert kind.cause.endswith("."), "a sentence"
    assert kind.cause[0].isupper()
    assert not kind.cure.endswith(".")
    assert kind.cure or kind.severity in (INFO, DEBUG) or kind.name in HEALS, (
        f"{kind.name}: no cure"
    )


HEALS = {
    "node.fault",  # a bug of ours: nobody on the vehicle can do anything
    "node.faulty",
    "memory.unreadable",
    "supervisor.node_ended",
    "supervisor.node_gone",
    "supervisor.node_frozen",
    "supervisor.bus_dead",
    "supervisor.recorder_deaf",  # `run` says how to see what is missing
    "supervisor.recorder_broken_off",
    "ekf.no_number",
    "tram.first_fixes_wrong",
    "tram.began_elsewhere",
    "tram.set_back",
    "input.not_used",  # stands beside the one that says which
    "memory.taken",
    "memory.of_others",
    "device.not_opened",
    "device.port_failed",  # told as node.fault as well
    "recorder.not_finished",
    "recorder.part_deleted",
    "record.part_rescued",
    "supervisor.ending_others",
    "supervisor.no_answer",
    "supervisor.node_silent",
    "supervisor.not_on_bus",
    "supervisor.does_not_end",
    "node.taken_over",
}
"""What the system does about it is all that is to be done."""


@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_number_is_worded_with_its_unit_or_counts(name: str, kind: Kind) -> None:
    """A number that is in no sentence is one that nobody who reads can see."""
    for fact, type_ in kind.facts.items():
        assert type_ is str or f"{{{fact}}}" in kind.sentence + kind.cure, fact


def test_page_lists_all_kinds_as_the_tables_have_them() -> None:
    assert (ROOT / "docs" / "events.md").read_text() == events_page.page()


# Nobody reads sentences ---------------------------------------------------------------------------
SENTENCES = {"text", "sentence", "cure", "reason", "trouble"}
"""Attributes that hold words for people."""
SEARCHES = {
    *("startswith", "endswith", "partition", "rpartition", "split", "find", "index"),
    *("removeprefix", "removesuffix", "match", "search", "fullmatch", "findall"),
}
WORDS = re.compile(r"[a-z]{2,} [a-z]{2,}|; |^[a-z]+: ")
ALLOWED = {
    "tramstream/mapping/osm.py": "Overpass says in its answer's `remark` that it broke off",
    "tramstream/settings_file.py": "takes the type of a setting out of our own note on it",
    "analysis/report/network_page.py": "a label of the drawing's own",
    "cli/bench.py": "choices of the verb's own",
}


def is_words(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and WORDS.search(node.value) is not None
    )


def is_sentence(node: ast.AST) -> bool:
    """Whether an expression is words for people: `error.reason`, `beat.text`, `str(error)`."""
    if isinstance(node, ast.Attribute):
        return node.attr in SENTENCES
    return (
        isinstance(node, ast.Call)
        and ast.unparse(node.func) == "str"
        and [ast.unparse(each) for each in node.args] in (["error"], ["event"], ["exception"])
    )


def parses_english(node: ast.AST) -> bool:
    """A comparison with words, or a search in a sentence or for words."""
    if isinstance(node, ast.Compare):
        sides = [node.left, *node.comparators]
        searches = any(isinstance(each, ast.In | ast.NotIn) for each in node.ops)
        if any(is_words(each) for each in sides):
            return True
        texts = [each for each in sides if isinstance(each, ast.Constant) and each.value]
        return any(map(is_sentence, sides)) and (searches or bool(texts))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        if node.func.attr not in SEARCHES:
            return False
        return is_sentence(node.func.value) or any(map(is_words, node.args))
    return False


@pytest.mark.parametrize("path", SOURCES)
def test_no_product_code_parses_english(path: str) -> None:
    found = [
        f"{path}:{node.lineno}: {ast.unparse(node)}"
        for node in ast.walk(TREES[path])
        if parses_english(node)
    ]
    assert bool(found) == (path in ALLOWED), found


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("'was left' in line", True),
        ("text, _, cure = str(error).partition('; ')", True),
        ("beat.text == 'silent'", True),
        ("'x' in error.reason", True),
        ("run.text.startswith('imu')", True),
        ("path.startswith('raw/')", False),
        ("beat.text", False),
        ("name == 'ekf'", False),
        ("event.kind is FAULT", False),
    ],
)
def test_what_parsing_english_is(code: str, found: bool) -> None:
    assert any(parses_english(node) for node in ast.walk(ast.parse(code))) == found
