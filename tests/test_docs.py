"""What the documents say of the code, held to the code."""

from __future__ import annotations

import re
import tomllib
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
    named = set(re.findall(r"`(\w+)(?: \w+)?`", section))
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


def test_scenario_of_the_simulation_page_is_one() -> None:
    from tramstream.simulation.scenario import parse

    page = (REPOSITORY / "docs" / "simulation.md").read_text()
    scenario = parse(page.split("```toml\n")[1].split("```")[0].encode(), "simulation.md")
    assert scenario.reverse
    assert len(scenario.events) == 2
