"""What the loop asks of a device, and the thread that keeps it open.

`tramstream.bridges.ports` implements `Port` for serial lines and CAN; nothing else opens devices.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Protocol

from tramstream.errors import DeviceError
from tramstream.keys import Key
from tramstream.proto.health_pb2 import DeviceHealth
from tramstream.proto.raw_pb2 import CanFrames, RawBytes

BACKOFF_FIRST_S = 0.1
BACKOFF_MAX_S = 5.0
"""A device that is away is tried at least this often."""
SILENT_S = 3.0
"""Every device of a tram says something more often than this."""


class Port(Protocol):
    """A device that can be opened, read and closed, again and again."""

    key: Key
    """Key of the raw messages that `read` returns."""
    device: str
    """Path or interface, for people."""

    def open(self) -> None:
        """Open the device; `DeviceError` with the cure if that fails."""

    def read(self) -> Any | None:
        """Raw message of what came, stamped with its arrival; None after at most 0.2 s."""

    def close(self) -> None:
        """Close; may be called twice."""


class PortReader:
    """Thread that opens a port, reads it into `deliver`, and opens it again when it is lost."""

    def __init__(self, port: Port, deliver: Callable[[Any], None], stop: threading.Event) -> None:
        self.port = port
        self.state: DeviceHealth.State = DeviceHealth.LOST
        self.text = f"{port.device}: not opened yet"
        self.opened = 0
        self.bytes_received = 0
        self._deliver = deliver
        self._stop = stop
        self._last_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, name=f"port {port.device}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def join(self, timeout_s: float) -> None:
        self._thread.join(timeout_s)

    @property
    def silence_s(self) -> float:
        return time.monotonic() - self._last_s

    def health(self) -> tuple[DeviceHealth.State, str]:
        """State now and one sentence, empty while all is well."""
        if self.state == DeviceHealth.OPEN and self.silence_s > SILENT_S:
            return DeviceHealth.SILENT, (
                f"{self.port.device}: open, but silent for {self.silence_s:.0f} s; check power, "
                "cable and bit rate"
            )
        return self.state, self.text

    def _run(self) -> None:
        backoff_s = BACKOFF_FIRST_S
        while not self._stop.is_set():
            try:
                self.port.open()
                self.opened += 1
                self.state, self.text = DeviceHealth.OPEN, ""
                self._last_s = time.monotonic()
                while not self._stop.is_set():
                    message = self.port.read()
                    if message is not None:
                        self._last_s = time.monotonic()
                        self.bytes_received += size(message)
                        self._deliver(message)
                        backoff_s = BACKOFF_FIRST_S
            except DeviceError as error:
                self.state, self.text = DeviceHealth.LOST, str(error)
            finally:
                self.port.close()
            self._stop.wait(backoff_s)
            backoff_s = min(2 * backoff_s, BACKOFF_MAX_S)


def size(message: RawBytes | CanFrames) -> int:
    """Bytes of device data in a raw message."""
    data = message.data
    return len(data) if isinstance(data, bytes) else sum(len(frame) for frame in data)


def join_reads(reads: list[RawBytes]) -> RawBytes:
    """One message of several consecutive reads; bridges get the same out of it."""
    first = reads[0]
    joined = RawBytes(device=first.device, data=b"".join(read.data for read in reads))
    for read in reads:
        joined.read_length.append(len(read.data))
        joined.read_offset_ns.append(read.stamp_ns - first.stamp_ns)
    joined.stamp_ns = first.stamp_ns
    return joined
