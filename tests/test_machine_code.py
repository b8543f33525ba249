"""Machine code of the kernels: kept, found again, and made anew when the sources change."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import msgspec
import networks
import pytest
from live import finished

from tramstream import keys, machine_code
from tramstream.config import Map
from tramstream.live.registry import make_processors
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
RIDE_S = 75.0
"""Over the switch."""


def ride(network: str) -> None:
    """Go over a switch, through all that runs on a vehicle, with a map."""
    path = networks.switch().path("stem", "branch")
    simulation = Simulation(path, scenario.load("city"), 1, RIDE_S)
    vehicle = msgspec.structs.replace(simulation.vehicle, map=Map(network=network))
    resampler, *others = sorted(make_processors(vehicle), key=lambda each: each.name != "resampler")
    runs = set()
    for sent in simulation.samples():
        for made in resampler.step(sent) if sent.key in resampler.inputs else ():
            for processor in others:
                for said in processor.step(made) if made.key in processor.inputs else ():
                    if said.key is keys.MAP_MATCH:
                        runs.add(said.message.run)
    assert {networks.switch().run("stem"), networks.switch().run("branch")} <= runs


def interrupt(_: str) -> None:
    raise InterruptedError


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
        env={**os.environ, "PYTHONPATH": str(Path(networks.__file__).parent)},
    )
    assert done.stdout.strip() == "['<lambda>']"


def test_folder_belongs_to_the_state_of_the_sources() -> None:
    machine_code.folder.cache_clear()
    before = machine_code.folder()
    source = Path(machine_code.__file__)
    status = source.stat()
    try:
        os.utime(source, ns=(status.st_atime_ns, status.st_mtime_ns + 1))
        machine_code.folder.cache_clear()
        after = machine_code.folder()
    finally:
        os.utime(source, ns=(status.st_atime_ns, status.st_mtime_ns))
        machine_code.folder.cache_clear()
    assert before != after
    assert before == machine_code.folder()
    after.rmdir()


def test_machine_code_that_is_whole_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    machine_code.folder.cache_clear()
    try:
        machine_code.mark_complete()
        compilation.ensure(pytest.fail)
        torn = machine_code.folder() / "kernel.nbi"
        torn.touch()
        with pytest.raises(InterruptedError):
            compilation.ensure(interrupt)
        machine_code.clear()
        assert not torn.exists()
        machine_code.mark_complete()
        compilation.ensure(pytest.fail)
        for number in range(machine_code.KEPT + 2):
            (tmp_path / "tramstream" / f"old{number}").mkdir()
        machine_code.mark_complete()
        assert len(list((tmp_path / "tramstream").iterdir())) == machine_code.KEPT + 1
        assert machine_code.folder().is_dir()
    finally:
        machine_code.folder.cache_clear()
