"""Signals of a DBC, read out of CAN frames one by one.

cantools reads the DBC and says where each signal lies. Its own decoding takes all signals of a
message and gives physical values only; a bridge wants one or two, needs the raw value of a counter,
and cannot use an exception for each short frame. Tests hold the results to cantools, bit for bit.
"""

from __future__ import annotations

import difflib
import re
import struct
from pathlib import Path
from typing import Any, Literal

import cantools
from cantools.database.errors import Error as CantoolsError

from tramstream.errors import ConfigError
from tramstream.input_file import read_limited

EXTENDED_ID = 0x80000000
"""Set in a frame key whose identifier has 29 bits, as in a DBC."""
_MESSAGE_BYTES = 1785
"""What J1939's transport protocol carries; a frame has 8, of CAN FD 64."""
_PAGES = 100_000
_LIMIT_BYTES = 16_000_000
"""All of J1939 is 5 MB."""
_MESSAGE = re.compile(rb"\s*BO_\s+\d+\s+(\w+)\s*:\s*(\d+)")
_SIGNAL = re.compile(rb"\s*SG_\s+(\w+)\s*\w*\s*:\s*(\d+)\|(\d+)@")
_RANGE = re.compile(rb"(\d+)\s*-\s*(\d+)")
FLOATS = {16: ">e", 32: ">f", 64: ">d"}


class Field:
    """Where one signal lies in its frame, and what its bits mean.

    `length` is the signal's in bits, `bytes_needed` what a frame must have for it (and for the
    multiplexers above it).
    """

    def __init__(self, signal: Any, selectors: list[tuple[Field, frozenset[int]]]) -> None:
        self.length: int = signal.length
        self.scale: float = signal.scale
        self.offset: float = signal.offset
        self._plain = self.scale == 1 and self.offset == 0
        self._order: Literal["big", "little"] = (
            "big" if signal.byte_order == "big_endian" else "little"
        )
        self._mask = (1 << self.length) - 1
        self._sign = 1 << (self.length - 1) if signal.is_signed and not signal.is_float else 0
        self._float = FLOATS[self.length] if signal.is_float else ""
        self._start: int = signal.start
        if self._order == "big":  # start is the most significant bit; count from the frame's first
            self._start = 8 * (self._start // 8) + 7 - self._start % 8
        self._end = self._start + self.length
        self._selectors = selectors
        self.bytes_needed: int = max(
            [(self._end + 7) // 8, *(f.bytes_needed for f, _ in selectors)]
        )

    def raw(self, data: bytes) -> float | None:
        """Value before scaling; None where a multiplexer says that the signal is not in the frame.

        `data` has `bytes_needed` bytes or more.
        """
        for selector, values in self._selectors:
            if selector.raw(data) not in values:
                return None
        if self._order == "big":
            bits: int = int.from_bytes(data, "big") >> (8 * len(data) - self._end) & self._mask
        else:
            bits = int.from_bytes(data, "little") >> self._start & self._mask
        if self._float:
            value: float = struct.unpack(self._float, bits.to_bytes(self.length // 8, "big"))[0]
            return value
        return bits - ((bits & self._sign) << 1)

    def physical(self, data: bytes) -> float | None:
        """Value in the DBC's unit; see `raw`."""
        value = self.raw(data)
        if value is None or self._plain:
            return value
        return value * self.scale + self.offset


class Database:
    """A DBC file."""

    def __init__(self, path: str, where: str) -> None:
        """Load `path`, which the configuration gave at `where`.

        Raises
        ------
        ConfigError
            If it cannot be read or is no DBC.
        """
        self.path = path
        try:
            _check_bounds(read_limited(Path(path), _LIMIT_BYTES), f"{where}: {path}")
            # Not strict: real DBCs have signals that overlap or stick out; it is checked per frame.
            self._messages: dict[str, Any] = {
                message.name: message
                for message in cantools.database.load_file(path, strict=False).messages
            }
        except OSError as error:
            raise ConfigError(
                f"{where}: cannot read {path} ({error.strerror})",
                cure="give the path of the vehicle's DBC, relative to the configuration",
            ) from error
        except (CantoolsError, ValueError, KeyError, AttributeError, RecursionError) as error:
            raise ConfigError(
                f"{where}: {path} is not a database that cantools can read ({error})"
            ) from error

    def units(self) -> dict[tuple[str, str], str]:
        """Unit of every signal, by message and signal name; empty where the DBC gives none."""
        return {
            (message.name, signal.name): signal.unit or ""
            for message in self._messages.values()
            for signal in message.signals
        }

    def find(self, message_name: str, signal_name: str, where: str) -> tuple[int, Field]:
        """Frame key (`EXTENDED_ID` set for 29 bits) and field of a signal.

        Raises
        ------
        ConfigError
            If there is none; names the path of the field (`where`), the DBC and what is near.
        """
        message = self._messages.get(message_name)
        if message is None:
            raise ConfigError(
                f"{where}.message: {self.path} has no message '{message_name}'"
                + _near(message_name, list(self._messages))
            )
        signals = {signal.name: signal for signal in message.signals}
        if signal_name not in signals:
            raise ConfigError(
                f"{where}.signal: {self.path} has no signal '{signal_name}' in message "
                f"'{message_name}'" + _near(signal_name, list(signals))
            )
        key = message.frame_id | (EXTENDED_ID if message.is_extended_frame else 0)
        return key, _field(signals[signal_name], signals)


def _check_bounds(text: bytes, name: str) -> None:
    """Refuse what cantools would make room for: it does so before anybody can look.

    Raises
    ------
    ConfigError
        If a message is longer than any protocol on CAN carries, a signal longer than that, or a
        multiplexer has more values than there can be pages.
    """
    for line in text.splitlines():
        message, signal = _MESSAGE.match(line), _SIGNAL.match(line)
        if message is not None and _beyond(message[2], _MESSAGE_BYTES):
            raise _too_long(name, "message", message[1], f"{_MESSAGE_BYTES} bytes")
        lengths = signal.groups()[1:] if signal is not None else ()
        if signal is not None and any(_beyond(each, 8 * _MESSAGE_BYTES) for each in lengths):
            raise _too_long(name, "signal", signal[1], f"{8 * _MESSAGE_BYTES} bits")
        if line.lstrip().startswith(b"SG_MUL_VAL_"):
            pages = sum(_pages(*each) for each in _RANGE.findall(line))
            if pages > _PAGES:
                raise _too_long(name, "multiplexer of", line.split()[2], f"{_PAGES} values")


def _beyond(digits: bytes, limit: int) -> bool:
    return len(digits) > 9 or int(digits) > limit


def _pages(first: bytes, last: bytes) -> int:
    return _PAGES + 1 if len(first) > 9 or len(last) > 9 else 1 + int(last) - int(first)


def _too_long(name: str, kind: str, what: bytes, most: str) -> ConfigError:
    text = what.decode("ascii", "replace")[:64]
    return ConfigError(f"{name}: {kind} {text} is longer than {most}", cure="correct the DBC")


def _field(signal: Any, signals: dict[str, Any]) -> Field:
    selectors: list[tuple[Field, frozenset[int]]] = []
    if signal.multiplexer_signal is not None and signal.multiplexer_ids:
        selector = _field(signals[signal.multiplexer_signal], signals)
        selectors.append((selector, frozenset(signal.multiplexer_ids)))
    return Field(signal, selectors)


def _near(name: str, names: list[str]) -> str:
    """Tail of the sentence: names that were meant perhaps."""
    upper = {candidate.upper(): candidate for candidate in names}
    near = difflib.get_close_matches(name.upper(), upper, n=3, cutoff=0.5)
    if near:
        return "; near: " + ", ".join(upper[match] for match in near)
    return "; it has " + (", ".join(sorted(names)[:5]) or "none")
