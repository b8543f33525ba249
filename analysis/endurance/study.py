"""A captured minute played through a running vehicle for a day: does memory grow, is a word lost?

The vehicle is `tramstream run` with all its processes, its recorder included; what is played, and
how fast, says `endurance_vehicle`. Its memory is read from the kernel every few seconds. Parts of
its record are read as they are finished (`endurance_books`) and then deleted, as by somebody who
fetches them, so that the disk does not fill.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import NamedTuple

from tramstream.analysis.endurance.books import Books
from tramstream.analysis.endurance.vehicle import DEVICE, HOUR, Case, frames_before, prepare
from tramstream.clock import VehicleClock
from tramstream.config_file import load
from tramstream.errors import NodeError, RecordError
from tramstream.recorder.reader import open_record
from tramstream.supervision import usage

LOOK_S = 0.5
SAMPLES = 500
"""Of the memory, over the whole run."""
LEAST_SAMPLE_S = 2.0
EIGHTH = 1 / 8
WINDOW = 1 / 16
"""Part of the run over which the median of the memory is taken."""
SETTLE_S = 10.0
"""So long bridges have for what was on their lines at the end."""
END_S = 180.0
"""So long the vehicle may need to end in order, on a machine with much else to do."""
DONE, MESSAGES_LOST = 0, 3


class Sample(NamedTuple):
    """Memory at an instant of the run."""

    hours: float
    """Of the vehicle's time, since the first sample."""
    pss_mb: dict[str, float]
    """By node; pages that are shared are shared out."""
    disk_bytes: int


@dataclass
class Found:
    """What the run came to."""

    books: Books = field(default_factory=Books)
    samples: list[Sample] = field(default_factory=list)
    parts: int = 0
    """Files of the record."""
    record_bytes: int = 0
    elapsed_s: float = 0.0
    status: int = 0
    """Exit status of the vehicle."""

    def memory(self) -> dict[str, tuple[float, float]]:
        """By node: MiB at an eighth of the run and at its end, medians over a sixteenth of it."""
        if not self.samples:
            return {}
        end = self.samples[-1].hours
        early = self._median(end * EIGHTH, end * (EIGHTH + WINDOW))
        late = self._median(end * (1 - WINDOW), end)
        return {name: (early[name], late[name]) for name in early if name in late}

    def _median(self, begin: float, end: float) -> dict[str, float]:
        chosen = [each.pss_mb for each in self.samples if begin <= each.hours <= end]
        names = {name for each in chosen for name in each}
        return {
            name: median(each[name] for each in chosen if name in each) for name in sorted(names)
        }

    @property
    def most_disk_bytes(self) -> int:
        return max((each.disk_bytes for each in self.samples), default=0)


def study(
    case: Case,
    folder: Path,
    stopped: Callable[[], bool] = lambda: False,
    tell: Callable[[Found], None] = lambda found: None,
) -> Found:
    """Run the vehicle in `folder` until all has been played, or `stopped`.

    `tell` is called with what is known so far after each file of the record.

    Raises
    ------
    ConfigError
        If what is to be played cannot be read.
    NodeError
        If the vehicle ends before its time.
    """
    config = prepare(case, folder)
    vehicle = load(config)
    VehicleClock.shared(vehicle.runtime_dir, case.pace)  # whoever comes first says how it runs
    command = [sys.executable, "-P", "-m", "tramstream.cli.main", "run", str(config)]
    found = Found(Books(frames_before=frames_before((folder / HOUR).read_bytes())))
    log = folder / "run.log"
    with log.open("wb") as out:
        program = subprocess.Popen(command, stdout=out, stderr=out)
    try:
        _watch(program, case, folder, found, stopped, tell)
    finally:
        with suppress(ProcessLookupError):
            program.send_signal(signal.SIGINT)
        found.status = program.wait(END_S)
    _take(sorted((folder / "records").glob("*.mcap*")), found)
    tell(found)
    if found.status not in (DONE, MESSAGES_LOST) and not stopped():
        last = log.read_text(errors="replace").strip().splitlines()[-1:]
        raise NodeError(
            f"the vehicle ended with status {found.status}: {''.join(last)}; see {log}",
            found.status,
        )
    return found


def _watch(
    program: subprocess.Popen[bytes],
    case: Case,
    folder: Path,
    found: Found,
    stopped: Callable[[], bool],
    tell: Callable[[Found], None],
) -> None:
    """Read memory and finished parts until the devices have been silent for a while."""
    records, link = folder / "records", folder / DEVICE
    begin_s = due_s = silent_s = 0.0
    every_s = max(LEAST_SAMPLE_S, case.duration_s / case.pace / SAMPLES)
    while program.poll() is None and not stopped():
        time.sleep(LOOK_S)
        now_s = time.monotonic()
        if found.samples and not link.is_symlink():  # pulled out: all has been played
            silent_s += LOOK_S
            if silent_s > SETTLE_S:
                return
        if not begin_s:
            if not (any(records.glob("*.mcap*")) and link.is_symlink()):
                continue
            begin_s = due_s = now_s
        found.elapsed_s = now_s - begin_s
        if now_s >= due_s:
            due_s = now_s + every_s
            found.samples.append(_sample(program.pid, records, found.elapsed_s * case.pace / 3600))
        finished = sorted(records.glob("*.mcap"))[:-1]  # the name of the last may still change
        if finished:
            _take(finished, found)
            tell(found)


def _sample(root: int, records: Path, hours: float) -> Sample:
    memory: dict[str, float] = {}
    for pid in usage.tree(root):
        with suppress(OSError, KeyError):  # it has ended since
            name = usage.role(pid, root)
            memory[name] = memory.get(name, 0.0) + usage.memory_mb(pid)["Pss"]
    return Sample(hours, memory, sum(_sizes(records.glob("*.mcap*"))))


def _sizes(paths: Iterable[Path]) -> list[int]:
    sizes = []
    for path in paths:
        with suppress(OSError):  # renamed since
            sizes.append(path.stat().st_size)
    return sizes


def _take(paths: list[Path], found: Found) -> None:
    """Add parts to the books, and delete them."""
    for path in paths:
        with open_record(path) as record:
            found.books.take(record)
            if record.damaged:
                raise RecordError(record.damaged)
            found.record_bytes += record.size_bytes
        found.parts += 1
        path.unlink()
