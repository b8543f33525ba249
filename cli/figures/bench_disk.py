"""How many bytes recording writes: into the file, and onto the device with all that this takes.

A file system writes more than it is given: blocks that are not full yet, again and again, and its
journal. Only a device of its own shows how much: an image on a loop device, which root may mount.
"""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tramstream.cli.figures.bench_stages import Figure

IMAGE_BYTES = 2_000_000_000
SECTOR_BYTES = 512
"""Of /sys/block/*/stat, whatever the device's own are."""
MAKE = ("mkfs.ext4", "-q", "-E", "lazy_itable_init=0,lazy_journal_init=0")
"""All tables written at once, so that the kernel does not do it during the measurement."""


class Writing(NamedTuple):
    """What had been written at one moment."""

    at_s: float
    file_bytes: int
    device_bytes: int | None

    def since(self, before: Writing) -> list[Figure]:
        """What an hour of it comes to."""
        to_mb_per_hour = 3600.0 / 1e6 / (self.at_s - before.at_s)
        figures = [
            Figure(
                "record_mb_per_hour",
                to_mb_per_hour * (self.file_bytes - before.file_bytes),
                350.0,
                False,
            )
        ]
        if self.device_bytes is not None and before.device_bytes is not None:
            grown = self.device_bytes - before.device_bytes
            figures.append(Figure("device_mb_per_hour", to_mb_per_hour * grown))
        return figures


Written = Callable[[], Writing]


@contextmanager
def own_disk(folder: Path) -> Iterator[Written]:
    """Mount a new ext4 at `folder` where that is allowed; gives what has been written below it."""
    folder.mkdir(parents=True)
    image = folder.with_suffix(".ext4")
    stat = _mount(image, folder) if os.geteuid() == 0 else None

    def written() -> Writing:
        if stat is not None:
            os.sync()  # what the kernel would write some seconds later
        device = None if stat is None else int(stat.read_text().split()[6]) * SECTOR_BYTES
        size = sum(path.stat().st_size for path in folder.glob("*.mcap*"))
        return Writing(time.monotonic(), size, device)

    try:
        yield written
    finally:
        if stat is not None:
            subprocess.run(["umount", str(folder)], check=True)
            image.unlink()


def _mount(image: Path, folder: Path) -> Path | None:
    """Mount a new image; where the kernel counts what is written to it. None if it cannot be."""
    image.touch()
    os.truncate(image, IMAGE_BYTES)
    try:
        subprocess.run([*MAKE, str(image)], check=True, capture_output=True)
        mount = ["mount", "-o", "loop", str(image), str(folder)]
        subprocess.run(mount, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):  # no such program, no loop device, no right
        image.unlink()
        return None
    device = os.stat(folder).st_dev
    return Path(f"/sys/dev/block/{os.major(device)}:{os.minor(device)}/stat")
