"""What the processes of a vehicle use, as the kernel shows it in /proc: time and memory."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


def tree(root: int) -> list[int]:
    """A process and all its descendants."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):  # gone since
                status = (entry / "stat").read_text().rsplit(") ", 1)[1].split()
                parents[int(entry.name)] = int(status[1])
    found = [root]
    for pid in found:
        found += [child for child, parent in parents.items() if parent == pid]
    return found


def role(pid: int, root: int) -> str:
    """A node's name, which it gave itself; the supervisor is `root`.

    The fork server and its tracker are the server.
    """
    if pid == root:
        return "supervisor"
    name = Path(f"/proc/{pid}/comm").read_text().strip()
    return name.removeprefix("tram-") if name.startswith("tram-") else "server"


def cpu_s(pid: int) -> float:
    """Processor time that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_mb(pid: int) -> dict[str, float]:
    """Resident (`Rss`) and proportional (`Pss`) memory, MiB; the latter shares shared pages out."""
    found = {}
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
        name, _, rest = line.partition(":")
        if name in ("Rss", "Pss"):
            found[name] = int(rest.split()[0]) / 1024.0
    return found
