"""A serial line that ends in this program: a pseudo terminal behind a symbolic link.

The other end is opened like any serial port. This side never blocks: what the reader has not made
room for is dropped, as a UART without flow control does, and counted.
"""

from __future__ import annotations

import fcntl
import os
import sys
import termios
import tty
from contextlib import suppress
from pathlib import Path

from tramstream.errors import ConfigError, DeviceError

READ_SIZE = 4096


class PseudoTerminal:
    """The device's side of a serial line that appears at `link`.

    The far end is held open here too, so that readers may come, go and come again, and so that
    bytes written before the first of them wait in the kernel's buffer (about 18 kB).
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self.bytes_sent = 0
        self.bytes_overrun = 0
        self._device_fd = -1
        self._far_fd = -1

    @property
    def is_open(self) -> bool:
        return self._device_fd >= 0

    def fileno(self) -> int:
        return self._device_fd

    @property
    def waiting(self) -> int:
        """Bytes that no reader has fetched yet; the kernel shows at most 4095 of them."""
        if not self.is_open:
            return 0
        return int.from_bytes(fcntl.ioctl(self._far_fd, termios.FIONREAD, bytes(4)), sys.byteorder)

    def has_host(self) -> bool:
        """Whether another process has the far end open, as far as this user may look."""
        if not self.is_open:
            return False
        far, own = os.ttyname(self._far_fd), str(os.getpid())
        for process in Path("/proc").iterdir():
            if process.name.isdigit() and process.name != own:
                with suppress(OSError):  # it has ended, or is another user's
                    if any(os.readlink(each) == far for each in (process / "fd").iterdir()):
                        return True
        return False

    def open(self) -> None:
        """Plug the device in.

        Raises
        ------
        ConfigError
            If something that is no symbolic link is in the way, or the folder cannot be written.
        DeviceError
            If the kernel has no pseudo terminal left.
        """
        if self.is_open:
            return
        try:
            self._device_fd, self._far_fd = os.openpty()
        except OSError as error:
            raise DeviceError(f"no pseudo terminal for {self.link}: {error.strerror}") from error
        tty.setraw(self._far_fd)
        os.set_blocking(self._device_fd, False)
        try:
            self._point_link(os.ttyname(self._far_fd))
        except OSError as error:
            self.close()
            raise ConfigError(
                f"{self.link}: cannot make a simulated device here ({error.strerror}); choose "
                "another $.simulators.*.link"
            ) from error

    def close(self) -> None:
        """Pull the device out: readers see the line hang up, the link is gone."""
        if not self.is_open:
            return
        if self.link.is_symlink() and os.readlink(self.link) == os.ttyname(self._far_fd):
            self.link.unlink()
        os.close(self._device_fd)
        os.close(self._far_fd)
        self._device_fd = self._far_fd = -1

    def write(self, data: bytes) -> int:
        """Send; return how many bytes found room."""
        try:
            sent = os.write(self._device_fd, data)
        except BlockingIOError:
            sent = 0
        self.bytes_sent += sent
        self.bytes_overrun += len(data) - sent
        return sent

    def read(self) -> bytes:
        """Take what the host has sent; empty if nothing."""
        try:
            return os.read(self._device_fd, READ_SIZE)
        except BlockingIOError:
            return b""

    def _point_link(self, target: str) -> None:
        self.link.parent.mkdir(parents=True, exist_ok=True)
        if self.link.exists() and not self.link.is_symlink():
            raise FileExistsError(None, "a file is in the way")
        fresh = self.link.with_name(f"{self.link.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(target)
        fresh.replace(self.link)
