"""The devices: serial lines and CAN. Nothing else in tramstream opens one.

A port opens, reads what there is, notes the arrival on the vehicle clock, and closes. It knows no
message of the device. Whatever happens to a device becomes a `DeviceError` with one sentence; the
loop (`tramstream.live.ports.PortReader`) then opens it again.
"""

from __future__ import annotations

import os
import socket
import termios
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import serial

from tramstream import keys
from tramstream.bridges import serial_lines
from tramstream.bridges.imu.folding import fold
from tramstream.bridges.odometer import socketcan
from tramstream.bridges.odometer.frames import (
    ERROR,
    EXTENDED,
    FD,
    REMOTE,
    CanFrame,
    SlcanLines,
    host_overflow,
    pack,
)
from tramstream.bridges.serial_lines import SerialName
from tramstream.clock import S, VehicleClock
from tramstream.config import Odometer, Vehicle
from tramstream.errors import ConfigError, DeviceError
from tramstream.keys import Key
from tramstream.live.ports import Port
from tramstream.proto.raw_pb2 import CanFrames, RawBytes

WAIT_S = 0.2
"""A read blocks no longer than this, so that the loop notices when it shall stop."""
IMU_GATHER_S = 0.005
GNSS_GATHER_S = 0.002
"""Short: what the fastest read waits goes straight into the stamps of all fixes."""
CAN_GATHER_S = 0.02
FRAME_LIMIT = 4096
PTY_FOLDER = "/dev/pts/"

_GONE = (OSError, termios.error)
"""What the kernel says about a device that is no longer there; closing one says it again."""


class SerialPort(Port):
    """A serial line, 8N1 without flow control, held exclusively.

    After the first byte the port waits for `gather_s` and takes what has come by then: a burst of
    bytes costs one wake-up instead of many.
    """

    def __init__(
        self,
        key: Key,
        path: str,
        baud_rate: int,
        clock: VehicleClock,
        gather_s: float = IMU_GATHER_S,
        fold: Callable[[RawBytes], RawBytes] = lambda message: message,
    ) -> None:
        self.key = key
        self.device = path
        self.baud_rate = baud_rate
        self.gather_s = gather_s
        self._clock = clock
        self._fold = fold
        self._name = SerialName(path)
        self._line: Any = None

    @property
    def place(self) -> str:
        return self._name.place

    def open(self) -> None:
        """Open the line; what the kernel kept from before is thrown away, it has no arrival.

        Raises
        ------
        DeviceError
            One sentence with path and cure.
        """
        self.close()
        field = f"$.{self.key.source}.device"
        self._line = _open_line(self._name.find(), self.baud_rate, field)
        self._name.opened()

    def read(self) -> RawBytes | None:
        """Bytes that came, stamped when they were read; None after `WAIT_S` without one.

        Raises
        ------
        DeviceError
            If the line is gone.
        """
        if self._line is None:
            raise DeviceError(f"{self.device}: read before it was opened")
        descriptor = self._line.fileno()
        if not serial_lines.wait(descriptor, WAIT_S):
            return None
        time.sleep(self.gather_s)
        data = serial_lines.drain(descriptor, self.device)
        return RawBytes(stamp_ns=self._clock.now_ns(), device=self.device, data=data)

    def join(self, reads: Sequence[RawBytes]) -> RawBytes:
        return self._fold(super().join(reads))

    def close(self) -> None:
        line, self._line = self._line, None
        if line is not None:
            with suppress(*_GONE):
                line.close()


class CanPort(Port):
    """A CAN bus through any interface of python-can, read in gathers of up to `CAN_GATHER_S`.

    socketcan and slcan are opened by python-can and read here: one wake-up for many frames, losses
    of the host's queue counted (they come as error frames, `canframe.HOST_OVERFLOW`), no exception
    for a garbled line.
    """

    def __init__(self, config: Odometer, clock: VehicleClock) -> None:
        self.key = keys.ODO_FRAMES
        self.device = config.channel
        self._config = config
        self._clock = clock
        self._bus: Any = None
        self._name = SerialName(config.channel)  # with slcan
        self._index = 0  # of the network interface when it was opened
        self._dropped = 0  # the socket's own count
        self._count_drops = partial(int, 0)
        self._failure: OSError | None = None  # comes once only, and before frames that still wait
        self._arrivals = socketcan.Arrivals()
        self._lines = SlcanLines()
        self._heard_s = 0.0
        self._failures: tuple[type[Exception], ...] = _GONE

    @property
    def place(self) -> str:
        return self._name.place

    def open(self) -> None:
        """Open the bus.

        Raises
        ------
        DeviceError
            One sentence with the interface and the cure.
        """
        import can  # heavy: only the process that reads CAN pays for it

        self.close()
        self._failures = (can.CanError, *_GONE)
        if self._config.interface == "socketcan":
            self._index = _interface_index(self._config)
        elif self._config.interface == "slcan":
            # Opened twice: only this way a missing or busy line gets its own sentence.
            _open_line(self._name.find(), 115200, "$.odometer.channel").close()
        try:
            self._bus = can.Bus(**self._options())
            if self._config.interface == "socketcan":
                socketcan.prepare(self._bus.socket)
                self._count_drops = partial(socketcan.drop_count, self._bus.socket)
                self._arrivals = socketcan.Arrivals()
            elif self._config.interface == "slcan":
                self._bus.serialPortOrig.exclusive = True
                self._name.opened()
        except (*self._failures, ValueError, NotImplementedError, ImportError) as error:
            self.close()
            raise DeviceError(
                f"{self.device}: cannot open CAN interface '{self._config.interface}' ({error})",
                cure="check $.odometer.interface, channel and bitrate",
            ) from error
        self._dropped, self._failure, self._lines = 0, None, SlcanLines()
        self._heard_s = time.monotonic()

    def _options(self) -> dict[str, Any]:
        config = self._config
        options: dict[str, Any] = {"interface": config.interface, "channel": config.channel}
        if config.interface == "socketcan":
            return options | {"fd": True}  # bit rate: `ip link`, not ours to set
        if config.interface in ("virtual", "udp_multicast"):
            return options
        if config.interface == "slcan":
            options["channel"] = self.place
            if os.path.realpath(self.place).startswith(PTY_FOLDER):
                options["sleep_after_open"] = 0.0  # python-can waits 2 s for boot loaders otherwise
        return options | {"bitrate": config.bitrate}

    def read(self) -> CanFrames | None:
        """Frames that came, or None after `WAIT_S` without one.

        Raises
        ------
        DeviceError
            If the interface is down, gone or replaced.
        """
        if self._bus is None:
            raise DeviceError(f"{self.device}: read before it was opened")
        try:
            if self._config.interface == "socketcan":
                frames = self._read_socket()
            elif self._config.interface == "slcan":
                frames = self._read_line()
            else:
                frames = self._read_any()
        except self._failures as error:
            raise DeviceError(
                f"{self.device}: the CAN interface is lost ({error})",
                cure="check its cable and power, and whether it is up (ip link)",
            ) from error
        if not frames:
            self._check_silence()
            return None
        self._heard_s = time.monotonic()
        by_reader = self._config.interface == "slcan"
        message: CanFrames = pack(frames, self.device, read_stamps=by_reader)
        return message

    def _read_socket(self) -> list[CanFrame]:
        """Take all that waits in the socket; the kernel stamped each frame when it came.

        When the link goes down, the kernel says so at once, once, and before the frames that it
        still holds: these are read first.
        """
        frames: list[CanFrame] = []
        bus_socket: socket.socket = self._bus.socket
        began_s = time.monotonic()
        if self._failure is None and serial_lines.wait(bus_socket.fileno(), WAIT_S):
            time.sleep(CAN_GATHER_S)
        self._arrivals.look()
        for _ in range(FRAME_LIMIT):
            try:
                octets, ancillary, _, _ = bus_socket.recvmsg(
                    socketcan.FD_SIZE, socketcan.ANCILLARY_SIZE, socket.MSG_DONTWAIT
                )
            except BlockingIOError:
                self._arrivals.empty_since(began_s)
                frames += self._losses_at_the_end()
                break
            except OSError as error:
                self._failure = error
                continue
            stamped_s, dropped = socketcan.read_ancillary(ancillary, self._dropped)
            stamp_ns = self._before_ns(self._arrivals.age_s(stamped_s))
            if dropped != self._dropped:
                lost = (dropped - self._dropped) & 0xFFFFFFFF
                frames.append(host_overflow(stamp_ns, self.device, lost))
                self._dropped = dropped
            frames.append(CanFrame(stamp_ns, self.device, *socketcan.from_struct(octets)))
        if self._failure is not None and not frames:
            raise self._failure
        return frames

    def _losses_at_the_end(self) -> list[CanFrame]:
        """What was lost after the last frame: else only a next one tells, which may never come."""
        lost = (self._count_drops() - self._dropped) & 0xFFFFFFFF
        if not 0 < lost < 1 << 31 or serial_lines.wait(self._bus.socket.fileno(), 0.0):
            return []  # none, or no end yet
        self._dropped = (self._dropped + lost) & 0xFFFFFFFF
        return [host_overflow(self._clock.now_ns(), self.device, lost)]

    def _read_line(self) -> list[CanFrame]:
        """Take the adapter's lines as they come: nobody else notes their arrival."""
        frames: list[CanFrame] = []
        descriptor = self._bus.fileno()
        timeout_s, end_s = WAIT_S, time.monotonic() + WAIT_S
        while timeout_s > 0 and serial_lines.wait(descriptor, timeout_s):
            data = serial_lines.drain(descriptor, self.device)
            stamp_ns = self._clock.now_ns()
            contents = self._lines.feed(data)
            if contents and not frames:
                end_s = time.monotonic() + CAN_GATHER_S
            frames += [CanFrame(stamp_ns, self.device, *content) for content in contents]
            timeout_s = end_s - time.monotonic()
        return frames

    def _read_any(self) -> list[CanFrame]:
        frames: list[CanFrame] = []
        timeout_s, end_s = WAIT_S, 0.0
        while timeout_s > 0 and len(frames) < FRAME_LIMIT:
            message = self._bus.recv(timeout_s)
            if message is None:
                break
            if not frames:
                end_s = time.monotonic() + CAN_GATHER_S
            flags = EXTENDED * bool(message.is_extended_id) | REMOTE * bool(message.is_remote_frame)
            if message.is_error_frame:
                flags = ERROR
            flags |= FD * bool(message.is_fd)
            id_, data = message.arbitration_id, bytes(message.data)
            stamp_ns = self._arrival_ns(message.timestamp)
            frames.append(CanFrame(stamp_ns, self.device, id_, flags, data))
            timeout_s = end_s - time.monotonic()
        return frames

    def _arrival_ns(self, stamped_s: float) -> int:
        """Vehicle time of a frame that python-can stamped with the host's wall clock.

        The wall clock may be set at any moment and some adapters stamp with their own, so only the
        age of a frame is taken from it, and only where it can be one: frames wait for less than a
        second. Anything else counts as having come just now.
        """
        age_s = time.time() - stamped_s
        return self._before_ns(age_s if 0.0 <= age_s < 1.0 else 0.0)

    def _before_ns(self, age_s: float) -> int:
        return self._clock.now_ns() - int(age_s * self._clock.rate * S)

    def _check_silence(self) -> None:
        """After long silence, look whether the interface is still the one that was opened.

        One that was removed and made anew keeps its name, but the old socket stays silent for ever.
        An adapter on a serial line may have started after its port was opened, and not have heard
        that it shall open its channel: it is told again.
        """
        now_s = time.monotonic()
        if now_s - self._heard_s < self._config.silence_s:
            return
        self._heard_s = now_s
        if self._config.interface == "socketcan" and _interface_index(self._config) != self._index:
            raise DeviceError(f"{self.device}: the interface was made anew, and is opened again")
        if self._config.interface == "slcan":
            try:
                self._bus.set_bitrate(self._config.bitrate)
            except self._failures as error:
                raise DeviceError(
                    f"{self.device}: the adapter takes no commands ({error})",
                    cure="check its cable and power",
                ) from error

    def close(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            with suppress(*self._failures):
                bus.shutdown()


def gnss_port(vehicle: Vehicle, clock: VehicleClock) -> SerialPort:
    """Port of the receiver, unopened."""
    gnss = vehicle.gnss
    if gnss is None:
        raise ConfigError("$.gnss: missing", cure="name the receiver's serial line")
    return SerialPort(keys.GNSS_BYTES, gnss.device, gnss.baud_rate, clock, GNSS_GATHER_S)


def imu_port(vehicle: Vehicle, clock: VehicleClock) -> SerialPort:
    """Port of the microcontroller in front of the IMU, unopened."""
    imu = vehicle.imu
    if imu is None:
        raise ConfigError("$.imu: missing", cure="name the IMU's serial line")
    return SerialPort(keys.IMU_BYTES, imu.device, imu.baud_rate, clock, IMU_GATHER_S, fold)


def odometer_port(vehicle: Vehicle, clock: VehicleClock) -> CanPort:
    """Port of the vehicle bus, unopened."""
    if vehicle.odometer is None:
        raise ConfigError("$.odometer: missing", cure="name the CAN interface")
    return CanPort(vehicle.odometer, clock)


def _open_line(path: str, baud_rate: int, field: str) -> Any:
    try:
        return serial.Serial(path, baud_rate, timeout=0, exclusive=True)
    except (*_GONE, ValueError) as error:  # SerialException is an OSError
        raise serial_lines.refusal(path, field, error) from error


def _interface_index(config: Odometer) -> int:
    return socketcan.interface_index(config.channel, config.bitrate)
