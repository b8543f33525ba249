"""Who runs a vehicle: one file in the runtime folder that its processes know each other by.

The supervisor writes it: itself, its nodes, and how to start a successor. Processes are named by
number and time of start, for numbers are given out again. With the file, the router sees that its
supervisor has vanished and starts the successor, which takes over the nodes that live; a node sees
whether there is anybody to end it.
"""

from __future__ import annotations

import fcntl
import os
import threading
import time
from pathlib import Path

import msgspec

from tramstream.clock import boot_id, make_runtime_dir
from tramstream.errors import BusError

FILE = "supervisor.json"
LOCK_FILE = "supervisor.lock"
REST = "{rest_s}"
"""In a successor's command: stands for the seconds that the run still has; 0 is for ever."""
LEAST_REST_S = 0.1
LOCK_PATIENCE_S = 2.0
"""The router holds the lock while it starts a successor; that one waits for so long."""
LOCK_POLL_S = 0.02
_START_FIELD = 19
"""Counted from the state on, which is the first field behind the name."""
_GONE = ("Z", "X")


class Proc(msgspec.Struct, frozen=True):
    """A process: its number, and its start in the kernel's ticks since boot (proc(5), `stat`)."""

    pid: int
    start_ticks: int

    @classmethod
    def of(cls, pid: int) -> Proc | None:
        """The process that has this number now; None if it has ended, or waits to be reaped."""
        try:
            # The name may hold blanks and brackets; what follows the last bracket may not.
            fields = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(") ")[2]
        except OSError:
            return None
        values = fields.split()
        return None if values[0] in _GONE else cls(pid, int(values[_START_FIELD]))

    @property
    def alive(self) -> bool:
        return self.pid > 0 and Proc.of(self.pid) == self


NOBODY = Proc(0, 0)


class Roster(msgspec.Struct, frozen=True, kw_only=True):
    """What the supervisor writes down."""

    boot: str
    supervisor: Proc = NOBODY
    claimed: bool = False
    """It has begun its work; until then it is a process that the router has started."""
    command: tuple[str, ...] = ()
    """Starts a successor; empty: there is none, the nodes end with their supervisor."""
    ends_s: float = 0.0
    """End of the run on the monotonic clock; 0 is never."""
    ending: bool = False
    """The supervisor is ending the nodes: whoever it does not come to any more ends by himself."""
    configuration: str = ""
    """Digest of the nodes' configuration."""
    lost: int = 0
    """Messages missing in the records of this run so far."""
    nodes: dict[str, Proc] = {}

    def living(self) -> dict[str, Proc]:
        """Nodes that are there."""
        return {name: node for name, node in self.nodes.items() if node.alive}

    def successor(self, now_s: float) -> list[str]:
        """The command for what is left of the run at `now_s` of the monotonic clock."""
        rest_s = max(LEAST_REST_S, self.ends_s - now_s) if self.ends_s else 0.0
        return [f"{rest_s:.3f}" if part == REST else part for part in self.command]


def with_successor(known: Roster, supervisor: Proc) -> Roster:
    """The same once its successor has been started."""
    return msgspec.structs.replace(known, supervisor=supervisor, claimed=False)


def fresh() -> Roster:
    """An empty one of this boot."""
    return Roster(boot=boot_id())


def read(runtime_dir: Path) -> Roster | None:
    """The roster of this boot; None if there is none, or one that cannot be read."""
    try:
        roster = msgspec.json.decode((runtime_dir / FILE).read_bytes(), type=Roster)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError):
        return None
    return roster if roster.boot == boot_id() else None


def write(runtime_dir: Path, roster: Roster) -> None:
    """Replace the file; readers see the whole old one or the whole new one.

    Raises
    ------
    OSError
        If the folder takes no file.
    """
    path = runtime_dir / FILE
    temporary = path.with_suffix(".new")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600)
    with open(descriptor, "wb") as file:
        file.write(msgspec.json.encode(roster))
    os.replace(temporary, path)


def remove(runtime_dir: Path) -> None:
    """Forget who ran the vehicle: all have ended."""
    (runtime_dir / FILE).unlink(missing_ok=True)


def try_lock(runtime_dir: Path) -> int | None:
    """A descriptor that holds the supervisor's place until it is closed; None if it is taken.

    Raises
    ------
    BusError
        If the folder cannot be written.
    """
    make_runtime_dir(runtime_dir)
    path = runtime_dir / LOCK_FILE
    try:
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise BusError(
            f"{path}: cannot be written ({error.strerror})",
            cure="set $.bus.runtime_dir or TRAMSTREAM_RUNTIME_DIR to a folder that you may write",
        ) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        return None
    return lock


def lock(runtime_dir: Path) -> int:
    """Take the supervisor's place; the descriptor holds it until it is closed, or we die.

    Raises
    ------
    BusError
        If somebody else supervises a vehicle in this folder.
    """
    end_s = time.monotonic() + LOCK_PATIENCE_S
    while (held := try_lock(runtime_dir)) is None:
        roster = read(runtime_dir)
        other = roster.supervisor if roster is not None else NOBODY
        if (other.alive and other.pid != os.getpid()) or time.monotonic() > end_s:
            who = f" (process {other.pid}; `kill {other.pid}` ends it)" if other.alive else ""
            raise BusError(
                f"{runtime_dir}: a vehicle is running in this folder already{who}",
                cure="stop the other "
                "`tramstream run` or `demo`, or give this one another $.bus.runtime_dir",
            )
        threading.Event().wait(LOCK_POLL_S)
    return held
