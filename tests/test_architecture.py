"""The rules of the house that a machine can read: directions, borders, sizes, packaging."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from live import HANG_S

import tramstream
from tramstream import keys
from tramstream.proto import generate

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PARTS = ("bridges", "processors", "recorder", "analysis", "web", "cli")
"""Folders that are installed below `tramstream`; the library is the folder of that name."""
ALLOWED = {
    "library": {"library"},
    "bridges": {"library", "bridges"},
    "processors": {"library", "processors"},
    "recorder": {"library", "recorder"},
    "analysis": {"library", "bridges", "processors", "recorder", "analysis"},
    "web": {"library", "web"},
    "cli": {"library", *PARTS},
}
"""What may be imported by whom: arrows point inward, and siblings do not know each other."""
FACE = "tramstream/__init__.py"
"""Names for people what stands outside the library, and loads it when it is asked for. All other
modules of the library import only the library."""
MAX_LINES = 400
TABLES = {"bridges/gnss/ubx_layouts.py"}
"""Layouts that mirror a vendor's manual; may be longer."""
PROCESS_MAINS = {"tramstream/supervision/process.py"}
"""The main function of a node's process: tells people why it ends, and with which status."""


def modules() -> dict[str, Path]:
    """Our own modules by path relative to the repository, without generated ones."""
    return {
        str(path.relative_to(ROOT)): path
        for folder in ("tramstream", *PARTS)
        for path in sorted((ROOT / folder).rglob("*.py"))
        if not path.name.endswith("_pb2.py")
    }


MODULES = modules()
TREES = {name: ast.parse(path.read_text()) for name, path in MODULES.items()}


def part_of(name: str) -> str:
    """`bridges` of `bridges/imu/bridge.py`; `library` of the folder tramstream."""
    folder = name.split("/")[0]
    return "library" if folder == "tramstream" else folder


def imports(name: str) -> Iterator[str]:
    """Full names that a module imports, also inside functions and below TYPE_CHECKING."""
    for node in ast.walk(TREES[name]):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}:{node.lineno}: a relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def imported_part(module: str) -> str | None:
    """Which part of ours an import belongs to; None for everybody else's."""
    pieces = module.split(".")
    if pieces[0] in PARTS:
        return f"top level {pieces[0]}"
    if pieces[0] != "tramstream":
        return None
    return pieces[1] if len(pieces) > 1 and pieces[1] in PARTS else "library"


def importers(*wanted: str) -> set[str]:
    """Modules that import one of `wanted` or anything below it."""
    return {
        name
        for name in MODULES
        if any(f"{module}.".startswith(f"{each}.") for module in imports(name) for each in wanted)
    }


def constants(tree: ast.AST) -> Iterator[ast.Constant]:
    """String constants that are no docstrings."""
    docstrings = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in docstrings
        ):
            yield node


# Directions ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", MODULES)
def test_arrows_point_inward_only(name: str) -> None:
    allowed = ALLOWED[part_of(name)] if name != FACE else ALLOWED["analysis"]
    for module in imports(name):
        part = imported_part(module)
        assert part is None or part in allowed, f"{name} imports {module}"


def test_face_of_the_library_imports_nothing_of_ours_before_it_is_asked() -> None:
    """What stands below TYPE_CHECKING is for readers and never runs."""
    tree = TREES[FACE]
    seen = [
        node for node in tree.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node)
    ]
    assert len(seen) == 1
    hidden = {id(node) for node in ast.walk(seen[0])}
    runs = [
        ast.unparse(node)
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom) and id(node) not in hidden
    ]
    assert runs == ["from importlib import import_module", "from typing import TYPE_CHECKING, Any"]


def test_nobody_of_ours_goes_through_the_face() -> None:
    assert importers(*(f"tramstream.{name}" for name in tramstream.__all__)) == set()


def test_nobody_imports_the_parts_by_their_folders() -> None:
    assert importers(*PARTS) == set()


def test_only_the_bus_imports_zenoh() -> None:
    assert importers("zenoh") == {"tramstream/transport/bus.py"}


def test_only_the_recorder_imports_mcap() -> None:
    found = importers("mcap", "mcap_protobuf")
    assert found
    assert {part_of(name) for name in found} == {"recorder"}


def test_only_the_ports_open_serial_lines_and_can() -> None:
    assert importers("serial") == {"bridges/ports.py"}
    openers = {
        name
        for name, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and node.attr in ("Bus", "ThreadSafeBus", "Notifier")
        and isinstance(node.value, ast.Name)
        and node.value.id == "can"
    }
    # A simulator is the other end of the line: it has a bus of its own, not a device.
    assert openers <= {"bridges/ports.py", *(n for n in MODULES if "simulat" in n)}
    assert "bridges/ports.py" in openers


def test_pseudo_terminals_are_made_by_the_simulators_alone() -> None:
    makers = {
        name
        for name, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and node.attr == "openpty"
    }
    assert makers <= {
        n for n in MODULES if n.startswith("bridges/") and ("simul" in n or "pseudo" in n)
    }


# Rooms --------------------------------------------------------------------------------------------
MOST_MODULES = 20
ROOMS = {name: str(Path(name).parent) for name in MODULES}
"""The folder in which a module stands."""


def ours(name: str) -> set[str]:
    """Our modules that a module imports, by path."""
    return {
        found
        for module in imports(name)
        for piece in (module, module.rpartition(".")[0])
        if (found := path_of(piece)) is not None and found != name
    }


def path_of(module: str) -> str | None:
    """The file of a module of ours."""
    path = module.replace(".", "/") + ".py"
    for each in (path, path.removeprefix("tramstream/")):
        if each in MODULES:
            return each
    return None


def circle(arrows: dict[str, set[str]]) -> list[str]:
    """One circle of a graph, its first name again at the end; empty where there is none."""
    done: set[str] = set()

    def follow(name: str, way: list[str]) -> list[str]:
        if name in way:
            return [*way[way.index(name) :], name]
        if name in done:
            return []
        for each in sorted(arrows.get(name, ())):
            if found := follow(each, [*way, name]):
                return found
        done.add(name)
        return []

    return next((found for name in sorted(arrows) if (found := follow(name, []))), [])


def test_what_a_circle_is() -> None:
    assert circle({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]


def test_modules_import_in_no_circle() -> None:
    assert circle({name: ours(name) for name in MODULES}) == []


def test_rooms_import_in_no_circle() -> None:
    arrows: dict[str, set[str]] = {}
    for name, room in ROOMS.items():
        if name == FACE:  # its arrows out of the library are names; nothing runs along them
            continue
        arrows.setdefault(room, set()).update({ROOMS[each] for each in ours(name)} - {room})
    assert arrows["cli"] >= {"recorder", "tramstream"}
    assert circle(arrows) == []


@pytest.mark.parametrize("room", sorted(set(ROOMS.values())))
def test_room_says_its_purpose_and_is_not_crowded(room: str) -> None:
    door = TREES[f"{room}/__init__.py"]
    assert ast.get_docstring(door), f"{room}/__init__.py says nothing"
    inside = [name for name, each in ROOMS.items() if each == room and "__init__" not in name]
    assert room == "cli" or len(inside) <= MOST_MODULES, f"{room}: {len(inside)} modules"
    assert room.count("/") <= 1, f"{room}: deeper than two levels"


# Borders ------------------------------------------------------------------------------------------
LAYERS = tuple(f"{layer}/" for layer in sorted({key.layer for key in keys.ALL}))


def test_key_literals_stand_in_keys_alone() -> None:
    found = [
        f"{name}:{constant.lineno}: {constant.value!r}"
        for name, tree in TREES.items()
        if name != "tramstream/keys.py"
        for constant in constants(tree)
        if is_key(constant.value)
    ]
    found += [
        f"{name}:{node.lineno}: {ast.unparse(node)}"
        for name, tree in TREES.items()
        if name != "tramstream/keys.py"
        for node in ast.walk(tree)
        if isinstance(node, ast.JoinedStr) and begins_like_a_key(node)
    ]
    assert found == []


def is_key(text: str) -> bool:
    """Whether a string is a key path, a full key or the beginning of one."""
    if text.startswith(f"{keys.ROOT}/"):
        return True
    pieces = text.split("/")
    return text.startswith(LAYERS) and len(pieces) == 3 and " " not in text and "*" not in text


def begins_like_a_key(text: ast.JoinedStr) -> bool:
    """Whether an f-string puts a key together."""
    first = text.values[0] if text.values else None
    if not isinstance(first, ast.Constant) or not isinstance(first.value, str):
        return False
    return first.value.startswith((*LAYERS, f"{keys.ROOT}/")) and " " not in first.value


def test_what_a_key_literal_is() -> None:
    assert is_key("raw/gnss/fix")
    assert is_key("tram/x/raw/**")
    assert not is_key("health/*/log")  # a sentence for people may name a family of keys
    assert not is_key("raw bytes/s")


@pytest.mark.parametrize("name", [n for n in MODULES if not n.startswith("cli/")])
def test_below_the_command_line_nobody_prints_or_exits(name: str) -> None:
    if name in PROCESS_MAINS:
        return
    for node in ast.walk(TREES[name]):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            assert called not in ("print", "sys.exit", "exit", "quit", "os._exit"), (
                f"{name}:{node.lineno}: {called}"
            )


# Sizes --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", MODULES)
def test_module_fits_in_four_hundred_lines(name: str) -> None:
    lines = len(MODULES[name].read_text().splitlines())
    assert lines <= MAX_LINES or name in TABLES, f"{name}: {lines} lines"


LONGEST_FUNCTION = 60


@pytest.mark.parametrize("name", MODULES)
def test_function_fits_in_sixty_lines(name: str) -> None:
    """Docstrings apart: a table of arguments is no code. Options of a verb are its docstring."""
    long = {
        f"{node.name}: {lines}"
        for node in ast.walk(TREES[name])
        if isinstance(node, ast.FunctionDef) and (lines := length_of(node)) > LONGEST_FUNCTION
    }
    assert not long, f"{name}: {long}"


def length_of(function: ast.FunctionDef) -> int:
    """Lines of a function's body without its docstring, and of nothing else."""
    body = function.body[1:] if ast.get_docstring(function) else function.body
    if not body:
        return 0
    return (body[-1].end_lineno or 0) - body[0].lineno + 1


def test_nothing_is_a_drawer_for_everything() -> None:
    assert not {path.stem for path in MODULES.values()} & {"utils", "helpers", "common", "misc"}


# Packaging ----------------------------------------------------------------------------------------
def folder_of(package: str) -> Path:
    part = package.removeprefix("tramstream.").split(".")[0]
    path = package.replace(".", "/")
    return ROOT / (path.removeprefix("tramstream/") if part in PARTS else path)


def test_every_package_is_listed_and_exists() -> None:
    listed = PROJECT["tool"]["setuptools"]["packages"]
    for package in listed:
        assert (folder_of(package) / "__init__.py").is_file(), package
    folders = {path.parent for path in MODULES.values()}
    assert folders == {folder_of(package) for package in listed}


def test_every_entry_point_names_a_module_of_ours() -> None:
    for group, points in PROJECT["project"]["entry-points"].items():
        for name, target in points.items():
            module = target.split(":")[0]
            package, _, stem = module.rpartition(".")
            assert (folder_of(package) / f"{stem}.py").is_file(), f"{group}: {name} = {target}"


OWN_BYTES = {
    "processors/grade/said.py",
    "recorder/reprocess/parallel.py",
    "recorder/reader.py",
    "tramstream/boundary.py",
    "tramstream/estimation/published.py",
    "tramstream/memory/kinds.py",
    "tramstream/transport/resend.py",
    "tramstream/live/snapshots.py",
}
"""Decode what the same program encoded (memory, pipes, caches), or are the boundary themselves."""


@pytest.mark.parametrize("name", MODULES)
def test_bytes_of_strangers_are_decoded_at_the_boundary_only(name: str) -> None:
    calls = {"FromString", "ParseFromString", "MergeFromString"}
    found = [
        node.lineno
        for node in ast.walk(TREES[name])
        if isinstance(node, ast.Attribute) and node.attr in calls
    ]
    assert not found or name in OWN_BYTES, f"{name}:{found[0]}: use tramstream.boundary.decode"


OWN_MEMORY = {
    "processors/kaspar2023/localiser.py",
    "processors/localisation/processor.py",
    "processors/tram/localiser.py",
}
"""The models' localisers, whose memory is another dataclass for each, and who asks them for it."""


@pytest.mark.parametrize("name", [each for each in MODULES if each.startswith("processors/")])
def test_stages_take_no_memory_apart_field_by_field(name: str) -> None:
    """It is one dataclass, which `tramstream.memory.stage` copies; see docs/architecture.md."""
    found = [
        node.lineno
        for node in ast.walk(TREES[name])
        if isinstance(node, ast.FunctionDef) and node.name in {"snapshot", "restore"}
    ]
    assert not found or name in OWN_MEMORY, f"{name}:{found[0]}: declare a dataclass"


def test_generated_code_is_that_of_the_proto_files(tmp_path: Path) -> None:
    made = generate.generate(tmp_path)
    assert {path.name for path in made} == {
        path.name for path in generate.HERE.glob("*_pb2.py*") if path.suffix in (".py", ".pyi")
    }
    for path in made:
        assert path.read_bytes() == (generate.HERE / path.name).read_bytes(), path.name


@pytest.mark.live
def test_wheel_holds_tramstream_and_nothing_else(tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    copy.mkdir()
    # A copy: building in place would leave its traces among the sources.
    listing = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    for name in listing.splitlines():
        source, target = ROOT / name, copy / name
        if source.is_file():
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(source.read_bytes())
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-q"]
    subprocess.run([*command, "-w", str(tmp_path), str(copy)], check=True, timeout=HANG_S)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"tramstream"}
    for package in PROJECT["tool"]["setuptools"]["packages"]:
        assert f"{package.replace('.', '/')}/__init__.py" in names
    for path in (ROOT / "analysis" / "report").glob("*.[cj]s*"):
        assert f"tramstream/{path.relative_to(ROOT)}" in names
    assert "tramstream/py.typed" in names
    for path in (ROOT / "tramstream" / "data").rglob("*.*"):
        assert str(path.relative_to(ROOT)) in names
    for path in generate.HERE.glob("*.proto"):
        assert f"tramstream/proto/{path.name}" in names
