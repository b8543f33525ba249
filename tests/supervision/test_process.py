"""The hold that a supervisor has on a node's process."""

from __future__ import annotations

import os
import signal
import subprocess

from live import HANG_S, SLEEP

from tramstream.supervision.process import Running


def test_process_of_another_parent_is_waited_for_signalled_and_seen_to_end() -> None:
    with subprocess.Popen(SLEEP) as child:
        running = Running(child.pid)
        assert not running.ended()
        assert not running.ended(0.01)
        running.send(signal.SIGTERM)
        assert running.ended(HANG_S)
        assert child.wait(HANG_S) == -signal.SIGTERM
        assert running.ended()
        assert running.status() is None  # only its parent knows
        running.send(signal.SIGKILL)  # nobody is hit
        running.close()
        running.close()


def test_stopped_process_takes_no_sigterm_but_sigkill() -> None:
    with subprocess.Popen(SLEEP) as child:
        running = Running(child.pid)
        running.send(signal.SIGSTOP)
        os.waitid(os.P_PID, child.pid, os.WSTOPPED)
        running.send(signal.SIGTERM)
        assert not running.ended(0.1)
        running.send(signal.SIGKILL)
        assert running.ended(HANG_S)
        running.close()


def test_process_that_has_ended_before_it_was_held_has_ended() -> None:
    child = subprocess.Popen(["true"])
    child.wait()
    running = Running(child.pid)
    assert running.ended()
    running.send(signal.SIGTERM)
    running.close()
