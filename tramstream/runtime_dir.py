"""Where the processes of a vehicle meet: the folder with the bus' socket."""

from __future__ import annotations

import os
from pathlib import Path

RUNTIME_DIR = "TRAMSTREAM_RUNTIME_DIR"
"""Environment variable that names the folder of the bus."""


def default_runtime_dir() -> Path:
    """`TRAMSTREAM_RUNTIME_DIR`, else the user's own folder."""
    chosen = os.environ.get(RUNTIME_DIR)
    return Path(chosen) if chosen else own_runtime_dir()


def own_runtime_dir() -> Path:
    """/run/tramstream for root, else a folder of the user's own."""
    if os.geteuid() == 0:
        return Path("/run/tramstream")
    user = os.environ.get("XDG_RUNTIME_DIR")
    return Path(user) / "tramstream" if user else Path(f"/tmp/tramstream-{os.geteuid()}")
