"""Machine code of the kernels: kept, found again, and made anew when what it is made of changes.

A package of two rooms with two kernels stands in for ours (`small`): the same mechanism, a second
to compile.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import networks
import numpy as np
import pytest
from live import finished

from tramstream import keys
from tramstream.config import Map
from tramstream.errors import MachineCodeError
from tramstream.estimation.kalman import sound
from tramstream.graph import Graph
from tramstream.live.registry import make_processors
from tramstream.machine import compilation, kernels, machine_code
from tramstream.simulation import scenario
from tramstream.simulation.simulation import Simulation

WARM_START = """
import sys
import numba
from numba.core import event
from tramstream.processors.warm_up import compile_all
with event.install_recorder("numba:compile") as recorder:
    if sys.argv[1:]:
        from test_machine_code import ride
        ride(sys.argv[1])
    else:
        compile_all()
    numba.njit(lambda: 0)()  # what is compiled is seen
print([each.data["dispatcher"].__name__ for _, each in recorder.buffer if each.is_start])
"""
HERE = (Path(__file__).parent, Path(networks.__file__).parent)
RIDE_S = 75.0
"""Over the switch."""


def ride(network: str) -> None:
    """Go over a switch, through all that runs on a vehicle, with a map."""
    path = networks.switch().path("stem", "branch")
    simulation = Simulation(path, scenario.load("city"), 1, RIDE_S)
    vehicle = msgspec.structs.replace(simulation.vehicle, map=Map(network=network))
    graph = Graph(make_processors(vehicle))
    runs = set()
    for sent in simulation.samples():
        for said in graph.step(sent):
            if said.key is keys.MAP_MATCH:
                runs.add(said.message.run)
    assert {networks.switch().run("stem"), networks.switch().run("branch")} <= runs


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty cache of machine code."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    machine_code.folder.cache_clear()
    yield machine_code.folder()
    machine_code.folder.cache_clear()


ALGEBRA = """
from tramstream.machine.kernels import compiled
from small.units import GRAVITY

@compiled
def fall(t):
    '''Way fallen.'''
    return 0.5 * GRAVITY * t * t

@compiled
def other(t):
    return t + 1.0
"""
MOTION = """
from tramstream.machine.kernels import compiled
from small.algebra import fall

@compiled
def go(t):
    return fall(t) + 2.0 * t
"""
USE = """
from small.algebra import other
from small.motion import go
print(go(2.0), other(2.0))
"""


def small(folder: Path) -> Path:
    """A package whose `go` calls `fall`, which has a constant of a third module."""
    (folder / "small").mkdir(parents=True)
    for name, text in (
        ("__init__", ""),
        ("units", "GRAVITY = 10.0\nUNUSED = 1.0\n"),
        ("algebra", ALGEBRA),
        ("motion", MOTION),
    ):
        (folder / "small" / f"{name}.py").write_text(text)
    return folder


def edit(file: Path, old: str, new: str) -> None:
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    for each in (file.parent / "__pycache__").glob("*.pyc"):
        each.unlink()  # Python itself looks at the time of a file, in whole seconds


def use(folder: Path) -> str:
    """What the package computes, in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = finished([sys.executable, "-c", USE], check=True, env=environment)
    return done.stdout.strip()


def made(cache: Path, before: set[str]) -> set[str]:
    """Kernels whose files are new."""
    names = {each.name for each in cache.glob("*.nbc")} - before
    return {each.partition("-")[0].rpartition(".")[2] for each in names}


def names(cache: Path) -> set[str]:
    return {each.name for each in cache.glob("*.nbc")}


@pytest.mark.live
def test_warm_start_does_not_compile() -> None:
    compilation.ensure(print)
    done = finished([sys.executable, "-c", WARM_START], check=True)
    assert done.stdout.strip() == "['<lambda>']"


@pytest.mark.live
def test_warm_start_with_a_map_does_not_compile(tmp_path: Path) -> None:
    """A network of several tracks, out of a file, and all processors."""
    compilation.ensure(print)
    network = tmp_path / "switch.tracks"
    networks.switch().network.save(network)
    done = finished(
        [sys.executable, "-c", WARM_START, str(network)],
        check=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, HERE))},
    )
    assert done.stdout.strip() == "['<lambda>']"


def test_edit_compiles_only_what_it_can_change(tmp_path: Path, cache: Path) -> None:
    folder = small(tmp_path)
    assert use(folder) == "24.0 3.0"
    assert made(cache, set()) == {"fall", "go", "other"}
    for file, old, new, result, expected in (
        ("motion", "2.0 * t", "3.0 * t", "26.0 3.0", {"go"}),
        ("algebra", "t + 1.0", "t + 2.0", "26.0 4.0", {"other"}),
        ("algebra", "0.5 * GRAVITY", "1.0 * GRAVITY", "46.0 4.0", {"fall", "go"}),
        ("units", "10.0", "9.0", "42.0 4.0", {"fall", "go"}),
        ("units", "UNUSED = 1.0", "UNUSED = 2.0", "42.0 4.0", set()),
        ("algebra", "Way fallen.", "How far it\n    falls.", "42.0 4.0", set()),
        ("units", "9.0", "10.0", "46.0 4.0", set()),  # as before
    ):
        before = names(cache)
        edit(folder / "small" / f"{file}.py", old, new)
        assert use(folder) == result, (file, new)
        assert made(cache, before) == expected, (file, new)


def test_two_checkouts_share_their_code(tmp_path: Path, cache: Path) -> None:
    here, there = small(tmp_path / "here"), small(tmp_path / "there")
    use(here)
    before = names(cache)
    assert use(there) == "24.0 3.0"
    assert names(cache) == before
    edit(there / "small" / "motion.py", "2.0", "3.0")
    use(there)
    assert made(cache, before) == {"go"}
    now = names(cache)
    assert use(here) == "24.0 3.0"
    assert names(cache) == now


@pytest.mark.parametrize("damage", [b"", b"\0" * 4096])
def test_file_that_a_power_cut_has_torn_is_made_anew(
    tmp_path: Path, cache: Path, damage: bytes
) -> None:
    folder = small(tmp_path)
    use(folder)
    whole = {each: each.stat().st_size for each in cache.glob("*.nbc")}
    for each in whole:
        each.write_bytes(damage)
    assert use(folder) == "24.0 3.0"
    assert {each: each.stat().st_size for each in cache.glob("*.nbc")} == whole


def test_two_processes_do_not_compile_the_same(tmp_path: Path, cache: Path) -> None:
    folder = small(tmp_path)
    program = (
        "from numba.core import event\n"
        "with event.install_recorder('numba:compile') as recorder:\n"
        f"    {USE.strip().replace(chr(10), chr(10) + '    ')}\n"
        "print(len([each for _, each in recorder.buffer if each.is_start]))"
    )
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    running = [
        subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment)
        for _ in range(2)
    ]
    said = [process.communicate(timeout=300)[0].decode().split() for process in running]
    assert [each[:2] for each in said] == [["24.0", "3.0"]] * 2
    assert sum(int(each[2]) for each in said) == 3


def test_compiled_kernels_are_for_their_user_alone(tmp_path: Path, cache: Path) -> None:
    before = os.umask(0)
    try:
        use(small(tmp_path))
    finally:
        os.umask(before)
    assert {each.stat().st_mode & 0o777 for each in cache.iterdir()} == {0o600}


def test_kernel_is_digested_by_all_that_it_reaches_or_refused() -> None:
    """Each of ours can be; a list, whose content may change, is no constant."""
    script = Path(networks.__file__).parent / "every_kernel.py"
    done = finished([sys.executable, str(script)], check=True)
    assert int(done.stdout) > 100


# The compilation as a whole ----------------------------------------------------------------------
def compiler(folder: Path, body: str) -> list[str]:
    """A program in the place of the warm-up's."""
    path = folder / "compiler.py"
    path.write_text(
        f"import os, signal, sys, time\nfrom tramstream.machine import machine_code\n{body}"
    )
    return [sys.executable, str(path)]


WHOLE = "machine_code.mark_complete([])\n"


def test_bound_kernel_computes_the_same_and_takes_no_other_types() -> None:
    x, P = np.zeros(2), np.eye(2)
    code = kernels.bound(sound, x, P)
    assert code(x, P) is sound(x, P) is True
    assert code(np.full(2, np.nan), P) is False
    with pytest.raises(TypeError):
        code(x.astype(np.float32), P)
    with pytest.raises(TypeError):
        code(x)  # type: ignore[call-arg]


def test_machine_code_that_is_whole_is_not_waited_for(tmp_path: Path, cache: Path) -> None:
    (cache / "one.nbc").write_bytes(b"code")
    machine_code.mark_complete(["one.nbc"])
    compilation.ensure(pytest.fail)
    (cache / "one.nbc").write_bytes(b"")  # by a power cut
    said: list[str] = []
    compilation.ensure(said.append, compiler(tmp_path, WHOLE))
    assert "compiling the filters" in said[0]
    compilation.ensure(pytest.fail)


def test_state_is_that_of_the_contents_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    machine_code.state.cache_clear()
    before = machine_code.state()
    source = Path(machine_code.__file__)
    status = source.stat()
    try:
        os.utime(source, ns=(status.st_atime_ns, status.st_mtime_ns + 1))
        machine_code.state.cache_clear()
        assert machine_code.state() == before
    finally:
        os.utime(source, ns=(status.st_atime_ns, status.st_mtime_ns))
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    machine_code.state.cache_clear()
    assert machine_code.state() != before
    machine_code.state.cache_clear()


def test_killed_compilation_is_worded_and_resumed(tmp_path: Path, cache: Path) -> None:
    killed = compiler(
        tmp_path,
        "(machine_code.folder() / f'{sys.argv[1]}.nbc').write_bytes(b'code')\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n",
    )
    with pytest.raises(MachineCodeError, match=r"ended by SIGKILL .*goes on from there") as error:
        compilation.ensure(lambda _: None, killed)
    assert error.value.exit_status == 2
    assert (cache / "0.nbc").read_bytes() == b"code"
    compilation.ensure(lambda _: None, compiler(tmp_path, WHOLE))
    assert (cache / "0.nbc").read_bytes() == b"code"
    compilation.ensure(pytest.fail)


def test_compilation_of_which_one_process_is_killed_is_finished_by_the_other(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    body = f"if sys.argv[1] == '1': os.kill(os.getpid(), signal.SIGKILL)\n{WHOLE}"
    compilation.ensure(lambda _: None, compiler(tmp_path, body))
    assert machine_code.whole()


def test_compilation_that_fails_ends_in_one_sentence(tmp_path: Path, cache: Path) -> None:
    failing = compiler(tmp_path, "raise OSError('no space left on device')\n")
    with pytest.raises(MachineCodeError, match=r"OSError: no space left on device") as error:
        compilation.ensure(lambda _: None, failing)
    assert "\n" not in str(error.value)


def test_kernel_that_was_being_compiled_when_its_process_was_killed_is_compiled_by_the_next(
    tmp_path: Path, cache: Path
) -> None:
    folder = small(tmp_path)
    program = (
        "import time\nfrom tramstream import private\n"
        "def write(path, data): print(path.name, flush=True); time.sleep(600)\n"
        f"private.write = write\n{USE}"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(folder)},
    )
    assert process.stdout is not None
    assert b"fall" in process.stdout.readline()  # compiled, claimed, not kept
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert use(folder) == "24.0 3.0"
    assert made(cache, set()) == {"fall", "go", "other"}


def test_old_code_is_removed_and_what_a_vehicle_lists_is_not(cache: Path) -> None:
    now = time.time()
    day = 86400.0
    for name, age in (("old", 100.0), ("listed", 100.0), ("mid", 20.0), ("young", 0.1)):
        path = cache / f"{name}.nbc"
        path.write_bytes(b"0" * 1000)
        os.utime(path, (now - age * day, now - age * day))
    (cache / "complete-other").write_text("listed.nbc\n")  # another checkout's
    machine_code.prune(machine_code.KEPT_BYTES, machine_code.KEPT_DAYS, now)
    assert names(cache) == {"listed.nbc", "mid.nbc", "young.nbc"}
    machine_code.prune(2500, machine_code.KEPT_DAYS, now)
    assert names(cache) == {"listed.nbc", "young.nbc"}
    machine_code.prune(0, machine_code.KEPT_DAYS, now)
    assert names(cache) == {"listed.nbc", "young.nbc"}  # in use
    old = cache.parent / "0123456789abcdef"  # of a version that kept one folder a state
    old.mkdir()
    os.utime(old, (now - 100 * day,) * 2)
    machine_code.prune(machine_code.KEPT_BYTES, machine_code.KEPT_DAYS, now)
    assert not old.exists()
