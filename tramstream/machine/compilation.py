"""All kernels compiled before a vehicle needs them: by two processes side by side.

Each process goes through all parts of the warm-up (`processors/warm_up.py`), each beginning with
another one. What one has compiled the other loads, and what is being compiled is waited for, so the
work divides itself. What is compiled is kept at once: whoever is killed has lost one kernel, and
one process that lives finishes what two began.

No node is started meanwhile. A filter that compiles in a running vehicle is silent for longer than
the five seconds after which a supervisor takes it for frozen, and its first minute of data is lost.
"""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import IO

from tramstream.errors import MachineCodeError
from tramstream.machine import machine_code

PROCESSES = 2
"""The work has two parts of about equal length; a third process would wait for them."""
POLL_S = 0.1
SAY_AGAIN_S = 10.0
STUCK_S = 300.0
"""A compilation by another process that has made no file for so long is not waited for."""
_COMPILER = "tramstream.processors.warm_up"
Say = Callable[[str], None]


def ensure(
    say: Say,
    compiler: Sequence[str] = (sys.executable, "-m", _COMPILER),
    stop: threading.Event | None = None,
) -> None:
    """See to it that all kernels are compiled; says so when that has to be waited for.

    Parameters
    ----------
    say : callable
        Gets sentences for people.
    compiler : sequence of str
        Program that compiles; is given its number and how many there are.
    stop : threading.Event or None
        Set when somebody wants to end: what is compiled by then is kept.

    Raises
    ------
    MachineCodeError
        If they could not be compiled.
    KeyboardInterrupt
        After `stop`.
    """
    stop = stop or threading.Event()
    here = machine_code.folder()
    for sentence in machine_code.refused():
        say(f"{sentence} (machine code is kept in {here})")
    if machine_code.whole():
        return
    with open(os.open(here / "run", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)) as turn:
        _wait_for_others(turn, say, stop)
        if not machine_code.whole():
            _compile(say, compiler, stop)


def _pause(stop: threading.Event) -> None:
    if stop.wait(POLL_S):
        raise KeyboardInterrupt


def _wait_for_others(turn: IO[str], say: Say, stop: threading.Event) -> None:
    """Wait while another process compiles and gets on; the system frees the lock of a dead one."""
    told, files, since = False, -1, time.monotonic()
    while True:
        try:
            fcntl.flock(turn, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            found = _files()
            if found != files:
                files, since = found, time.monotonic()
            if machine_code.whole() or time.monotonic() - since > STUCK_S:
                return
            if not told:
                told = True
                say("waiting for another tramstream that compiles the filters")
            _pause(stop)
        else:
            return


def _files() -> int:
    return sum(1 for _ in machine_code.folder().glob("*.nbc"))


def _compile(say: Say, compiler: Sequence[str], stop: threading.Event) -> None:
    count = max(1, min(PROCESSES, len(os.sched_getaffinity(0))))
    say("compiling the filters for this machine; once, it takes about half a minute")
    errors = [tempfile.TemporaryFile(mode="w+") for _ in range(count)]  # noqa: SIM115
    running: list[subprocess.Popen[bytes]] = []
    try:
        for number, error in enumerate(errors):
            command = [*compiler, str(number), str(count)]
            running.append(
                subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=error,
                    process_group=0,  # Ctrl-C is for this process, which ends them
                )
            )
        _follow(running, say, stop)
        if not machine_code.whole():
            raise MachineCodeError(_sentence([each.returncode for each in running], errors))
    finally:
        for process in running:
            if process.poll() is None:
                process.kill()  # what it has compiled is kept
                process.wait()
        for error in errors:
            error.close()


def _follow(running: Sequence[subprocess.Popen[bytes]], say: Say, stop: threading.Event) -> None:
    """Wait until one has gone through all kernels, or all have ended; tell how far they are."""
    start = said = time.monotonic()
    before = _files()
    while any(process.poll() is None for process in running):
        if any(process.poll() == 0 for process in running):
            return
        now = time.monotonic()
        if now - said >= SAY_AGAIN_S:
            said = now
            say(f"compiling the filters: {_files() - before} kernels in {now - start:.0f} s")
        _pause(stop)


def _sentence(statuses: Sequence[int | None], errors: Sequence[IO[str]]) -> str:
    """Why the filters are not compiled, and what to do."""
    kept = "what is compiled is kept, and the next start goes on from there"
    for status, error in zip(statuses, errors, strict=True):
        if status is not None and status < 0:
            name = str(-status)
            with suppress(ValueError):
                name = signal.Signals(-status).name
            cause = " (is there memory enough? it takes 0.5 GB each)" if -status == 9 else ""
            return f"compiling the filters was ended by {name}{cause}; {kept}"
        error.seek(0)
        lines = error.read().strip().splitlines()
        if status and lines:
            return f"the filters could not be compiled: {lines[-1]}; {kept}"
    return f"the filters could not be compiled; {kept}"
