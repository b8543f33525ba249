"""What the documents say of the code, held to the code."""

from __future__ import annotations

import ast
import io
import re
import tokenize
import tomllib
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from tramstream import keys

REPOSITORY = Path(__file__).resolve().parent.parent
README = (REPOSITORY / "README.md").read_text()


def key_table() -> str:
    """The README's table of keys."""
    lines = ["| key | type | Hz | stamp is the | what |", "|---|---|---:|---|---|"]
    for key in keys.ALL:
        rate = f"{key.rate_hz:g}" if key.rate_hz else "–"
        type_name = key.type.DESCRIPTOR.full_name.removeprefix("tramstream.")
        lines.append(f"| `{key.path}` | `{type_name}` | {rate} | {key.instant} | {key.doc} |")
    return "\n".join(lines)


def test_table_of_keys_is_that_of_the_code() -> None:
    assert key_table() in README, f"README.md wants this table:\n{key_table()}"


def test_every_verb_is_in_the_readme() -> None:
    verbs = {point.name for point in entry_points(group="tramstream.verbs")}
    section = README.split("## The verbs")[1].split("## ")[0]
    named = set(re.findall(r"`([\w-]+)(?: \w+)?`", section))
    assert verbs <= named


def test_links_of_the_documents_lead_somewhere() -> None:
    for document in [REPOSITORY / "README.md", *(REPOSITORY / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", document.read_text()):
            assert (document.parent / target).exists(), f"{document.name}: {target}"


def test_ci_runs_the_readmes_own_test_command() -> None:
    commands = [line for line in README.splitlines() if "-m pytest" in line and "venv" in line]
    assert len(commands) == 1
    assert "grep -m1 -- '-m pytest' README.md" in (REPOSITORY / ".ci" / "run").read_text()


def test_example_configurations_load() -> None:
    from tramstream.config_file import load

    for path in (REPOSITORY / "docs").glob("*.toml"):
        assert load(path).vehicle == tomllib.loads(path.read_text())["vehicle"]


def test_scenarios_of_the_simulation_page_are_some() -> None:
    from tramstream.simulation.scenario import parse

    page = (REPOSITORY / "docs" / "simulation.md").read_text()
    blocks = [each.split("```")[0] for each in page.split("```toml\n")[1:]]
    body, cabs, rails, scenario = (parse(each.encode(), "simulation.md") for each in blocks)
    assert body.body is not None
    assert cabs.driver.turns_back == (5, 3)
    assert rails.track.roughness.felt
    assert scenario.reverse
    assert len(scenario.events) == 2


def test_simulation_page_names_every_kind_of_fault() -> None:
    from tramstream.simulation import event_kinds

    page = (REPOSITORY / "docs" / "simulation.md").read_text()
    kinds = [each for each in vars(event_kinds).values() if isinstance(each, type)]
    faults = [each for each in kinds if issubclass(each, event_kinds.Fault)]
    named = [each.__struct_config__.tag for each in faults if each is not event_kinds.Fault]
    assert len(named) > 10
    assert [each for each in named if f"`{each}`" not in page] == []


# What docstrings, comments and pages cite ---------------------------------------------------------
CODE = [
    path
    for folder in (
        "bridges",
        "cli",
        "processors",
        "recorder",
        "tests",
        "tramstream",
        "analysis",
        "web",
    )
    for path in sorted((REPOSITORY / folder).rglob("*"))
    if path.suffix in {".py", ".toml", ".proto"} and not path.name.endswith("_pb2.py")
]
PAGES = [
    *(REPOSITORY / name for name in ("README.md", "CHANGELOG.md")),
    *sorted((REPOSITORY / "docs").glob("*.md")),
]
OUTSIDE = ("../shared/", "shared/")
"""Recordings that lie beside the repository and are no part of it."""
NUMBER = r"\d+(?:\.\d+)*"
SECTIONS = re.compile(rf"sections? ({NUMBER}(?:(?:, | and | to ){NUMBER})*)")
CITING = re.compile(r"\.md|[a-z](?:19|20)\d\d|\bissue\b")
"""What a module has in it that names a page, a work or an issue."""
OTHERS_SECTION = ("et al., ", "Sokal, ", " its ")
"""What stands before the section of somebody else's work in docs/theory.md."""


@cache
def said(path: Path) -> str:
    """Words of a file that are for people, on one line: docstrings and comments, or a page."""
    text = path.read_text()
    if path.suffix == ".py" and not CITING.search(text):
        return ""  # to take a module apart takes 20 ms
    if path.suffix == ".py":
        words = [
            node.value.value
            for node in ast.walk(ast.parse(text))
            if isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ]
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        words += [each.string[1:] for each in tokens if each.type == tokenize.COMMENT]
    elif path.suffix in {".toml", ".proto"}:
        words = re.findall(r"(?:#|//)(.*)", text)
    else:
        words = [text]
    return " ".join(" ".join(words).split())


def sections_of_the_theory() -> set[str]:
    """Numbers of the headings of docs/theory.md: `## 3 …` and `### 3.2 …`."""
    text = (REPOSITORY / "docs" / "theory.md").read_text()
    return set(re.findall(rf"^##+ ({NUMBER}) ", text, re.MULTILINE))


def cited_sections(path: Path) -> list[str]:
    """Sections of docs/theory.md that a file names."""
    text = said(path)
    if path.name == "theory.md":
        begins = [
            match
            for match in SECTIONS.finditer(text)
            if not text[: match.start()].endswith(OTHERS_SECTION)
        ]
    else:
        text = text.replace("](theory.md)", "").replace("](docs/theory.md)", "")
        begins = list(re.finditer(rf"theory\.md, {SECTIONS.pattern}", text))
    return [number for match in begins for number in re.findall(NUMBER, match[1])]


def test_documents_that_code_and_pages_name_exist() -> None:
    missing = []
    for path in [*CODE, *PAGES]:
        for name in re.findall(r"[\w./-]+\.md\b", said(path)):
            folders = (REPOSITORY, path.parent) if path in PAGES else (REPOSITORY,)
            if not name.startswith(OUTSIDE) and not any((each / name).exists() for each in folders):
                missing.append(f"{path.relative_to(REPOSITORY)}: {name}")
    assert not missing


def test_modules_that_pages_name_exist() -> None:
    missing = [
        f"{path.name}: {name}"
        for path in PAGES
        for name in re.findall(r"\b\w+(?:/\w+)+\.(?:py|toml)\b", said(path))
        if not name.startswith(OUTSIDE) and not (REPOSITORY / name).exists()
    ]
    assert not missing


def test_sections_of_the_theory_that_are_cited_exist() -> None:
    known = sections_of_the_theory()
    cited = {path: cited_sections(path) for path in [*CODE, *PAGES]}
    assert sum(map(len, cited.values())) > 100, "citations are not found any more"
    wrong = [
        f"{path.relative_to(REPOSITORY)}: section {number}"
        for path, numbers in cited.items()
        for number in numbers
        if number not in known
    ]
    assert not wrong


def test_theory_is_cited_by_section() -> None:
    """A citation without a number, or in another form, would be checked by nobody."""
    loose = [
        f"{path.relative_to(REPOSITORY)}: {match[0]}"
        for path in CODE
        for match in re.finditer(r"theory\.md(.{0,12})", said(path))
        if path != Path(__file__) and not re.match(r", sections? \d", match[1])
    ]
    assert not loose


def test_sections_in_the_glossary_exist() -> None:
    rows = (REPOSITORY / "docs" / "glossary.md").read_text().splitlines()
    cells = [row.split("|")[-2] for row in rows if row.startswith("| ") and "theory |" not in row]
    numbers = {number for cell in cells for number in re.findall(NUMBER, cell)}
    assert numbers
    assert numbers <= sections_of_the_theory()


def test_sections_of_the_theory_are_numbered_in_order() -> None:
    text = (REPOSITORY / "docs" / "theory.md").read_text()
    headings = re.findall(rf"^(##+) ({NUMBER}) ", text, re.MULTILINE)
    numbers = [tuple(map(int, number.split("."))) for _, number in headings]
    assert numbers == sorted(set(numbers))
    assert all(len(marks) == 2 + number.count(".") for marks, number in headings)


def test_works_that_code_and_pages_name_are_in_the_references() -> None:
    references = (REPOSITORY / "docs" / "references.md").read_text()
    known = set(re.findall(r"^\| `(\w+)` \|", references, re.MULTILINE))
    assert "kaspar2023" in known
    unknown = [
        f"{path.relative_to(REPOSITORY)}: {name}"
        for path in [*CODE, *PAGES]
        for name in re.findall(r"\b[a-z]{3,}(?:19|20)\d\d\b", said(path))
        if name not in known
    ]
    assert not unknown


def test_no_docstring_cites_an_issue() -> None:
    """Issues are no part of the repository."""
    cited = [
        f"{path.relative_to(REPOSITORY)}: {match}"
        for path in CODE
        for match in re.findall(r"\bissue \d+", said(path))
    ]
    assert not cited
