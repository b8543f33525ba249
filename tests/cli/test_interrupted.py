"""Ctrl-C, SIGTERM and a closed terminal: no trace, and nothing that blocks the next run.

The signal comes from within the program, at a place that the test chooses: no timing decides.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from live import environment, finished
from record_samples import traffic, write

from tramstream.cli.terminal.session import make_room
from tramstream.errors import ConfigError
from tramstream.recorder.file.writer import RecordFile

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
NMEA = (
    b"$GPRMC,120000.00,A,5004.5300,N,01426.2680,E,1.0,0.0,090324,,,A*7D\r\n"
    b"$GPGGA,120000.00,5004.5300,N,01426.2680,E,1,09,0.9,200.0,M,45.0,M,,*54\r\n"
) * 3
KILL = "os.kill(os.getpid(), {})"
WHILE_WRITING = """
import os, sys
from tramstream.recorder.file.writer import RecordFile
append = RecordFile.append
def ended(self, *sent):
    append(self, *sent)
    {kill}
RecordFile.append = ended
"""
WHILE_IMPORTING = """
import os, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "typer":
            {kill}
sys.meta_path.insert(0, Finder())
"""
COMPILING = """
import os, sys
from functools import partial
from tramstream.machine import compilation
child = "import os, time; open(os.environ['PIDS'], 'a').write(f'{os.getpid()} '); time.sleep(600)"
wait, calls = compilation._pause, []
def pause(stop):
    calls.append(1)
    if len(calls) == 3:
        {kill}
    wait(stop)
compilation._pause = pause
compilation.ensure = partial(compilation.ensure, compiler=[sys.executable, "-c", child])
"""
RUN = "\nfrom tramstream.cli.start import main\nsys.argv[0] = 'tramstream'\nmain()\n"


def ended_by(
    number: int, where: str, folder: Path, *arguments: object, **more: str
) -> subprocess.CompletedProcess[str]:
    """Run a verb that gets a signal where `where` says."""
    code = where.replace("{kill}", KILL.format(number)) + RUN
    words = [sys.executable, "-P", "-c", code, *map(str, arguments)]
    return finished(words, env=environment(folder, **more))


@pytest.fixture
def receiver(tmp_path: Path) -> Path:
    path = tmp_path / "a.nmea"
    path.write_bytes(NMEA)
    return path


@pytest.mark.live
@pytest.mark.parametrize("number", SIGNALS, ids=lambda number: number.name)
@pytest.mark.parametrize("where", [WHILE_WRITING, WHILE_IMPORTING], ids=["writing", "importing"])
def test_verb_that_is_ended_leaves_no_trace(
    receiver: Path, tmp_path: Path, where: str, number: signal.Signals
) -> None:
    out = tmp_path / "o.mcap"
    done = ended_by(number, where, tmp_path, "import", "--nmea", receiver, "-o", out)
    assert done.returncode == 128 + number
    assert (done.stdout, done.stderr) == ("", "")
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a.nmea"]


@pytest.mark.live
@pytest.mark.parametrize("number", SIGNALS, ids=lambda number: number.name)
def test_compilation_ends_with_whoever_waits_for_it(tmp_path: Path, number: signal.Signals) -> None:
    source, out, pids = write(tmp_path / "a.mcap", traffic(9)), tmp_path / "o.mcap", tmp_path / "p"
    more = {"PIDS": str(pids), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    done = ended_by(number, COMPILING, tmp_path, "reprocess", source, "-o", out, **more)
    assert done.returncode == 128 + number
    assert "compiling the filters" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.glob("o.mcap*"))
    for pid in pids.read_text().split() if pids.exists() else ():
        with pytest.raises(ProcessLookupError):
            os.kill(int(pid), 0)


# What a killed run has left -----------------------------------------------------------------------
def left(path: Path) -> Path:
    """An unfinished file that nobody writes any more."""
    record = RecordFile(path, "tram")
    record.append("tram/x", "bytes", b"x", 1, 1, 1)
    record.flush()
    record.abandon()
    return path.with_name(f"{path.name}.active")


def test_file_of_a_killed_run_is_told_with_both_cures(tmp_path: Path) -> None:
    active = left(tmp_path / "o.mcap")
    with pytest.raises(ConfigError, match=r"--overwrite replaces it, `tramstream recover`"):
        make_room(tmp_path / "o.mcap", [], overwrite=False)
    assert active.exists()


def test_overwrite_means_it(tmp_path: Path) -> None:
    active = left(tmp_path / "o.mcap")
    (tmp_path / "o.mcap").write_bytes(b"older")
    make_room(tmp_path / "o.mcap", [], overwrite=True)
    assert not active.exists()
    assert not (tmp_path / "o.mcap").exists()


def test_file_that_somebody_writes_is_left_alone(tmp_path: Path) -> None:
    record = RecordFile(tmp_path / "o.mcap", "tram")
    record.append("tram/x", "bytes", b"x", 1, 1, 1)
    record.flush()
    with pytest.raises(ConfigError, match="is being written"):
        make_room(tmp_path / "o.mcap", [], overwrite=True)
    record.close()
    assert (tmp_path / "o.mcap").exists()
