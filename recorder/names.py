"""Names of the parts of a record, in an order that no clock can spoil.

A part is `<vehicle>_b<boot>-<number>_<start, UTC>.mcap`: the boots of the computer counted, and the
parts of each boot. A computer without a clock of its own begins every boot in 1970; its newest
record then has the oldest start, so the start is for people only. It is corrected as soon as
somebody knows the time (`UtcOffset`): in the name of the part being written when it is finished,
and in those of the same boot that were finished before.

The boots are counted in a file of the folder, so that a folder which somebody has emptied goes on
counting; without that file counting goes on behind the highest number that stands in a name.
"""

from __future__ import annotations

import json
import os
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from tramstream.clock import S
from tramstream.events.kinds import Event
from tramstream.recorder.events import PART_RENAMED
from tramstream.recorder.file.storage import DISK, MODE, Storage

BOOT_FILE = ".boot"
UTC_OFFSET = "utc_offset_ns"
"""Entry of a part's metadata: UTC minus the vehicle clock, where that is a minute or more."""
KEEP = ".keep"
"""A file of this ending beside a record (`<name>.mcap.keep`) protects it."""
EARLIEST_UTC_NS = 1_767_225_600 * S
"""2026-01-01: this software is younger, so a clock that reads less is wrong."""
WORTH_CORRECTING_NS = 60 * S
"""A start in a name that is less wrong than this stays."""
_NAME = re.compile(r"^(.+)_b(\d{4,})-(\d{4,})_(\d{8}T\d{6}Z)\.mcap(\.active)?$")
_OLD_NAME = re.compile(r"^(.+)_(\d{8}T\d{6}Z)_(\d{2,})\.mcap(\.active)?$")
"""As this software named parts before it counted boots."""
_STAMP = "%Y%m%dT%H%M%SZ"


class PartName(NamedTuple):
    """What the name of a part says; in the order in which parts were written.

    `start` is as in the name: of older software it comes before the number, for it was the order.
    """

    boot: int
    old_start: str
    number: int
    start: str
    vehicle: str


def parse(name: str) -> PartName | None:
    """What `name` says, finished or not; None if it is not the name of a recorder's part."""
    match = _NAME.match(name)
    if match:
        return PartName(int(match[2]), "", int(match[3]), match[4], match[1])
    match = _OLD_NAME.match(name)
    return PartName(0, match[2], int(match[3]), match[2], match[1]) if match else None


class UtcOffset:
    """UTC minus the vehicle clock, by whoever knows it best: a receiver, else the host's clock."""

    def __init__(self) -> None:
        self._receiver_ns: int | None = None
        self._host_ns: int | None = None

    def learn(self, utc_ns: int, clock_ns: int) -> None:
        """A receiver says that it was `utc_ns` when the vehicle clock read `clock_ns`."""
        if utc_ns >= EARLIEST_UTC_NS:
            self._receiver_ns = utc_ns - clock_ns

    def see_host(self, utc_ns: int, clock_ns: int) -> None:
        """The host's clock says so; it counts while no receiver does, if it can be right."""
        if utc_ns >= EARLIEST_UTC_NS:
            self._host_ns = utc_ns - clock_ns

    @property
    def ns(self) -> int | None:
        """The offset; None while nobody knows what time it is."""
        return self._host_ns if self._receiver_ns is None else self._receiver_ns


class PartNames:
    """Gives the parts of one boot and vehicle their names.

    Parameters
    ----------
    directory : Path
        The folder of records; it exists.
    vehicle : str
    boot_id : str
        The kernel's identifier of this boot.
    offset : UtcOffset
        What is known of the time; it may become known later.
    """

    def __init__(self, directory: Path, vehicle: str, boot_id: str, offset: UtcOffset) -> None:
        self.directory = directory
        self.vehicle = vehicle
        self.offset = offset
        known = [name for path in directory.iterdir() if (name := parse(path.name))]
        self.boot = _boot(directory, boot_id, max((name.boot for name in known), default=0))
        self._number = max((name.number for name in known if name.boot == self.boot), default=0)

    def next(self, begun_ns: int) -> Path:
        """The name of the next part, begun at `begun_ns` of the vehicle clock."""
        self._number += 1
        return self._path(self._number, begun_ns + (self.offset.ns or 0))

    def corrected(self, path: Path, begun_ns: int) -> Path:
        """The name of a part that is about to be finished, with what is known of the time now."""
        name = parse(path.name)
        offset_ns = self.offset.ns
        if name is None or offset_ns is None:
            return path
        start_ns = begun_ns + offset_ns
        wrong = abs(start_ns - _ns(name.start)) >= WORTH_CORRECTING_NS
        return self._path(name.number, start_ns) if wrong else path

    def correct_finished(self, storage: Storage = DISK) -> list[Event]:
        """Correct the names of finished parts of this boot whose start cannot be.

        Returns an event for each. Their stamps are those of the vehicle clock, which has not
        stepped since.

        Raises
        ------
        OSError
            If the disk refuses; what is not done yet may be tried again.
        """
        events: list[Event] = []
        offset_ns = self.offset.ns
        if offset_ns is None:
            return events
        for path in sorted(self.directory.glob("*.mcap")):
            name = parse(path.name)
            ours = name is not None and (name.boot, name.vehicle) == (self.boot, self.vehicle)
            if name is None or not ours or _ns(name.start) >= EARLIEST_UTC_NS:
                continue
            target = self._path(name.number, _ns(name.start) + offset_ns)
            keep = path.with_name(path.name + KEEP)
            if keep.exists():
                storage.rename(keep, target.with_name(target.name + KEEP))
            storage.rename(path, target)
            events.append(PART_RENAMED(part=path.name, to=target.name))
        if events:
            storage.sync_directory(self.directory)
        return events

    def _path(self, number: int, start_ns: int) -> Path:
        start = datetime.fromtimestamp(start_ns // S, UTC)
        return self.directory / (
            f"{self.vehicle}_b{self.boot:04d}-{number:04d}_{start:{_STAMP}}.mcap"
        )


def _ns(start: str) -> int:
    return int(datetime.strptime(start, _STAMP).replace(tzinfo=UTC).timestamp()) * S


def _boot(directory: Path, boot_id: str, highest: int) -> int:
    """The number of this boot; kept in the folder.

    A folder that cannot be written keeps nothing: then the number is one that is not taken.
    """
    path = directory / BOOT_FILE
    try:
        known = json.loads(path.read_text())
        number, same = int(known["number"]), known["boot_id"] == boot_id
    except (OSError, ValueError, KeyError, TypeError):
        number, same = 0, False
    if same and number >= highest:
        return number
    number = max(number, highest) + 1
    temporary = path.with_suffix(".new")
    text = json.dumps({"boot_id": boot_id, "number": number})
    try:
        fd = os.open(temporary, os.O_CREAT | os.O_TRUNC | os.O_WRONLY | os.O_CLOEXEC, MODE)
        try:
            os.write(fd, text.encode())
            os.fsync(fd)
        finally:
            os.close(fd)
        os.replace(temporary, path)
        DISK.sync_directory(directory)
    except OSError:
        return number  # the disk's trouble is told by what is written next
    return number
