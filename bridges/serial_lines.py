"""Serial lines apart from opening them: under which name a device is found, what the kernel says.

A device that is unplugged and plugged in again may come back under another name (`/dev/ttyACM1`
instead of `ttyACM0`), and another device under its old one. udev's links below `/dev/serial` say
which is which: `by-id` by maker and serial number, `by-path` by the socket. What they called a
device when it was opened is what it is looked for by, when it was lost.
"""

from __future__ import annotations

import errno
import os
import select
from pathlib import Path

from tramstream.errors import DeviceError

LINKS = (Path("/dev/serial/by-id"), Path("/dev/serial/by-path"))
"""Folders of udev's links, the one to be believed first."""
READ_LIMIT = 65536

_AWAY = ("there is no device behind this name", "plug it in or correct {field}")
_FORBIDDEN = ("no permission", "add this user to the group dialout (usermod -aG dialout)")
_BUSY = ("another program uses it", "stop that one (fuser shows which)")
_NO_ANSWER = ("it does not answer", "it is being plugged in or out, or broken: check its cable")
_CURES = {
    errno.ENOENT: ("there is no such device", "plug it in or correct {field}"),
    **dict.fromkeys((errno.ENXIO, errno.ENODEV), _AWAY),
    **dict.fromkeys((errno.EACCES, errno.EPERM), _FORBIDDEN),
    **dict.fromkeys((errno.EBUSY, errno.EAGAIN), _BUSY),
    **dict.fromkeys((errno.EIO, errno.EPIPE, errno.EPROTO, errno.ETIMEDOUT), _NO_ANSWER),
}


class SerialName:
    """Where a device is that was configured under one name.

    Parameters
    ----------
    configured : str
        Path of the configuration.
    """

    def __init__(self, configured: str) -> None:
        self.configured = configured
        self.place = configured
        """Path that it was found under last."""
        self._known: list[list[Path]] = []
        """Of the device that was opened last, a list for each folder."""

    def find(self) -> str:
        """Path to open now: the configured one, unless it is known that the device has another.

        What any of its links calls so is the device: of two adapters without a serial number only
        the socket tells which is which.
        """
        self.place = self.configured
        here = os.path.realpath(self.configured)
        found = [
            {os.path.realpath(link) for link in links if link.exists()} for links in self._known
        ]
        elsewhere = [there for there in found if there]
        if elsewhere and not any(here in there for there in elsewhere):
            self.place = min(elsewhere[0])
        return self.place

    def opened(self) -> None:
        """Note by which links the device that was opened is known."""
        here = os.path.realpath(self.place)
        self._known = [_links_to(here, folder) for folder in LINKS]


def _links_to(path: str, folder: Path) -> list[Path]:
    try:
        return [link for link in sorted(folder.iterdir()) if os.path.realpath(link) == path]
    except OSError:  # no udev, no serial device: no links
        return []


def refusal(path: str, field: str, error: Exception) -> DeviceError:
    """What the kernel says of a line that cannot be opened, in one sentence with the cure.

    Parameters
    ----------
    field : str
        Path of the configuration that names the line.
    """
    number = error.errno if isinstance(error, OSError) else None
    if number is None and error.args and isinstance(error.args[0], int):
        number = error.args[0]  # termios.error is no OSError
    unknown = (f"it cannot be set up as a serial line ({error})", "")
    reason, cure = _CURES.get(number or 0, unknown)
    return DeviceError(f"{path}: {reason}", cure=cure.format(field=field))


def wait(descriptor: int, timeout_s: float) -> bool:
    """Whether something happens within the time: bytes, or the end."""
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(max(1, int(timeout_s * 1000))))


def drain(descriptor: int, device: str) -> bytes:
    """Everything that waits, at most `READ_LIMIT`, after `wait` said that there is something.

    Raises
    ------
    DeviceError
        If there is nothing: the other end is gone.
    """
    parts: list[bytes] = []
    size = 0
    failure: OSError | None = None
    while size < READ_LIMIT:
        try:
            part = os.read(descriptor, READ_LIMIT - size)
        except BlockingIOError:
            break
        except OSError as error:
            failure = error
            break
        if not part:
            break
        parts.append(part)
        size += len(part)
    if not parts:
        raise DeviceError(
            f"{device}: the device was unplugged or hung up", cure="check its cable and power"
        ) from failure
    return b"".join(parts)
