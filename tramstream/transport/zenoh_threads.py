"""Threads on which zenoh calls us, and what they do to a process that ends.

They end on their own, some time after their session is closed. Python takes away a thread that
wakes while the interpreter ends, and zenoh's code cannot bear that: the process is aborted ("FATAL:
exception not rethrown"), or hangs. So a program waits for them before it ends, and if one stays, it
leaves without taking the interpreter down.
"""

from __future__ import annotations

import threading
import time

NAMES = ("pyo3-closure", "zenoh-close")
"""Parts of their names: one for each callback, started by zenoh's binding, and the one on which
`ZenohBus.close` closes a session."""


def ended(timeout_s: float) -> bool:
    """Whether all of them have ended; waits for them for so long."""
    end_s = time.monotonic() + timeout_s
    threads = [
        thread for thread in threading.enumerate() if any(name in thread.name for name in NAMES)
    ]
    for thread in threads:
        thread.join(max(0.0, end_s - time.monotonic()))
    return not any(thread.is_alive() for thread in threads)
