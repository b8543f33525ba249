"""What the loop asks of a device, and the thread that keeps it open.

`tramstream.bridges.ports` implements `Port` for serial lines and CAN; nothing else opens devices.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

from tramstream.errors import DeviceError
from tramstream.events.kinds import Event
from tramstream.keys import Key
from tramstream.live.events import DEVICE_AWAY, DEVICE_NOT_OPENED, DEVICE_SILENT, PORT_FAILED
from tramstream.proto.health_pb2 import DeviceHealth
from tramstream.proto.raw_pb2 import CanFrames, RawBytes

BACKOFF_FIRST_S = 0.1
BACKOFF_MAX_S = 5.0
"""A device that is away is tried at least this often."""
SILENT_S = 3.0
"""Every device of a tram says something more often than this."""


Raw = TypeVar("Raw", RawBytes, CanFrames)


class Port(Protocol):
    """A device that can be opened, read and closed, again and again."""

    key: Key
    """Key of the raw messages that `read` returns."""
    device: str
    """Path or interface, for people."""

    @property
    def place(self) -> str:
        """Where it was found when it was opened last: it may come back under another path."""
        return self.device

    def open(self) -> None:
        """Open the device; `DeviceError` with the cure if that fails."""

    def read(self) -> Any | None:
        """Raw message of what came, stamped with its arrival; None after at most 0.2 s."""

    def close(self) -> None:
        """Close; may be called twice."""

    def join(self, reads: Sequence[Any]) -> Any:
        """One message of several consecutive reads, as it is published.

        A port may fold its device's bytes, so that they take less room in a record.
        """
        return join_reads(reads)


class PortReader:
    """Thread that opens a port, reads it into `deliver`, and opens it again when it is lost.

    Any exception but a `DeviceError` is a bug in the port: it is delivered like a message, for the
    loop to tell, and the port is opened again all the same.
    """

    def __init__(
        self,
        port: Port,
        deliver: Callable[[Any], None],
        stop: threading.Event,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.port = port
        self.state: DeviceHealth.State = DeviceHealth.LOST
        self.trouble: Event | None = DEVICE_NOT_OPENED(device=port.device)
        self.opened = 0
        self.bytes_received = 0
        self._deliver = deliver
        self._stop = stop
        self._backoff_s = BACKOFF_FIRST_S
        self._monotonic_s = monotonic_s
        self._last_s = monotonic_s()
        self._thread = threading.Thread(target=self._run, name=f"port {port.device}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def join(self, timeout_s: float) -> None:
        """Wait for the thread to end; at once if it was never started."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)

    @property
    def place(self) -> str:
        """Where the device is, as far as the port tells."""
        return getattr(self.port, "place", self.port.device)

    @property
    def silence_s(self) -> float:
        return self._monotonic_s() - self._last_s

    def health(self) -> tuple[DeviceHealth.State, Event | None]:
        """State now and what is wrong, None while all is well."""
        device, silence_s = self.port.device, self.silence_s
        if self.state == DeviceHealth.OPEN and silence_s > SILENT_S:
            silent = DEVICE_SILENT(device=device, silence_s=round(silence_s), limit_s=SILENT_S)
            return DeviceHealth.SILENT, silent
        return self.state, self.trouble

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self._read_until_lost()
            except DeviceError as error:
                away = DEVICE_AWAY(device=self.port.device, reason=error.reason, advice=error.cure)
                self.state, self.trouble = DeviceHealth.LOST, away
            except Exception as error:  # noqa: BLE001  the boundary of a thread: told, not hidden
                failed = PORT_FAILED(device=self.port.device, error=repr(error))
                self.state, self.trouble = DeviceHealth.LOST, failed
                self._deliver(error)
            self._stop.wait(self._backoff_s)
            self._backoff_s = min(2 * self._backoff_s, BACKOFF_MAX_S)

    def _read_until_lost(self) -> None:
        try:
            self.port.open()
            self.opened += 1
            self._last_s = self._monotonic_s()
            self.state, self.trouble = DeviceHealth.OPEN, None
            while not self._stop.is_set():
                message = self.port.read()
                if message is not None:
                    self._last_s = self._monotonic_s()
                    self.bytes_received += size(message)
                    self._deliver(message)
                    self._backoff_s = BACKOFF_FIRST_S
        finally:
            self.port.close()


def size(message: RawBytes | CanFrames) -> int:
    """Bytes of device data in a raw message."""
    data = message.data
    return len(data) if isinstance(data, bytes) else sum(len(frame) for frame in data)


def join_reads(reads: Sequence[Raw]) -> Raw:
    """One message of several consecutive reads; bridges get the same out of it."""
    first = reads[0]
    if isinstance(first, CanFrames):
        frames = CanFrames(
            stamp_ns=first.stamp_ns, device=first.device, read_stamps=first.read_stamps
        )
        for read in reads:
            # Never negative: a stamp of the kernel's may lie before that of the read before.
            later_ns = max(0, read.stamp_ns - first.stamp_ns)
            frames.offset_ns.extend([later_ns + offset_ns for offset_ns in read.offset_ns])
            frames.id.extend(read.id)
            frames.flags.extend(read.flags)
            frames.data.extend(read.data)
        return frames
    joined = RawBytes(device=first.device, data=b"".join(read.data for read in reads))
    for read in reads:
        joined.read_length.append(len(read.data))
        joined.read_offset_ns.append(read.stamp_ns - first.stamp_ns)
    joined.stamp_ns = first.stamp_ns
    return joined
