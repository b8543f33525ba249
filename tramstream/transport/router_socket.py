"""Where clients of one machine meet the router: a socket, and a lock that says who it is.

Nothing here knows zenoh.
"""

from __future__ import annotations

import fcntl
import os
import socket
from pathlib import Path

from tramstream.errors import BusError

SOCKET_PATH_MAX = 100
"""A Unix socket's path has 108 bytes; zenoh appends to it."""


def socket_path(runtime_dir: Path) -> Path:
    """Where the router of `runtime_dir` listens."""
    path = runtime_dir / "bus.sock"
    if len(os.fsencode(path)) > SOCKET_PATH_MAX:
        raise BusError(
            f"{path}: longer than a Unix socket's path may be ({SOCKET_PATH_MAX} bytes)",
            cure="set $.bus.runtime_dir or TRAMSTREAM_RUNTIME_DIR to a shorter one",
        )
    return path


def lock_router(runtime_dir: Path) -> int:
    """Be the only router of `runtime_dir` until the returned descriptor is closed, or we die.

    Not by looking whether somebody answers on the socket: two that start at once would both find
    nobody, and a frozen router does not answer.
    """
    path = runtime_dir / "router.lock"
    try:
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise BusError(
            f"{path}: cannot be written ({error.strerror})",
            cure="set $.bus.runtime_dir or TRAMSTREAM_RUNTIME_DIR to a folder that you may write",
        ) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        raise BusError(
            f"{socket_path(runtime_dir)}: a router is listening already",
            cure="stop the other "
            "`tramstream run`, `demo` or `replay`, or give this one another $.bus.runtime_dir",
        ) from error
    return lock


def router_listens(runtime_dir: Path) -> bool:
    """Whether something accepts connections on the socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(socket_path(runtime_dir)))
        except OSError:
            return False
    return True
