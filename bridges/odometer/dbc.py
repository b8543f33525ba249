"""Signals of a DBC, read out of CAN frames one by one.

cantools reads the DBC and says where each signal lies. Its own decoding takes all signals of a
message and gives physical values only; a bridge wants one or two, needs the raw value of a counter,
and cannot use an exception for each short frame. Tests hold the results to cantools, bit for bit.
"""

from __future__ import annotations

import difflib
import math
import re
import struct
from pathlib import Path
from typing import Any, Literal

import cantools
from cantools.database.errors import Error as CantoolsError

from tramstream.bridges.odometer import j1939
from tramstream.bridges.odometer.dbc_text import check_bounds, mark_extended, paged_signals
from tramstream.config import LARGEST
from tramstream.errors import ConfigError
from tramstream.input_file import read_limited

EXTENDED_ID = 0x80000000
"""Set in a frame key whose identifier has 29 bits, as in a DBC."""
_LIMIT_BYTES = 16_000_000
"""All of J1939 is 5 MB."""
LONGEST_BITS = 64
"""A longer signal is a text, as a vehicle's identification number, or a mistake."""
_MOST = 1e100
"""Of a scale or an offset; digits without end are a whole number to Python, and no float."""
FLOATS = {16: ">e", 32: ">f", 64: ">d"}
"""IEEE 754 has no others; a DBC may claim any."""
SHORT = "frame too short"
NO_NUMBER = "not a number"
NAMED_NONE = "named as no value in the DBC"
_NONE_NAME = re.compile(
    r"sna|n\W?/?a|not\W?avail\w*|unavail\w*|invalid\w*|error\w*|undefined|unknown|no\W?signal",
    re.IGNORECASE,
)
"""Names (`VAL_`) of raw values that are none, as the whole name or at its beginning or end."""


class Field:
    """Where one signal lies in its frame, and what its bits mean.

    `length` is the signal's in bits, `bytes_needed` what a frame must have for it. Pages of one
    multiplexed message may differ in length: that counts where the page is the signal's.
    """

    def __init__(
        self,
        signal: Any,
        selectors: list[tuple[Field, frozenset[int]]],
        *,
        of_j1939: bool = False,
    ) -> None:
        self.length: int = signal.length
        self.scale = _within_floats(signal.scale)
        self.offset = _within_floats(signal.offset)
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
        self._of_j1939 = of_j1939 and not self._sign and not self._float
        self._none = frozenset(
            value for value, name in (signal.choices or {}).items() if _names_none(str(name))
        )
        self.bytes_needed: int = (self._end + 7) // 8

    def on_page(self, data: bytes) -> bool | None:
        """Whether the multiplexers say that the signal is in the frame; None if it is too short."""
        for selector, values in self._selectors:
            there = selector.on_page(data)
            if not there:
                return there
            if len(data) < selector.bytes_needed:
                return None
            if selector._number(data) not in values:
                return False
        return True

    def raw(self, data: bytes) -> float | None:
        """Value before scaling; None where a multiplexer says that the signal is not in the frame.

        `data` has `bytes_needed` bytes or more.
        """
        return self._number(data) if self.on_page(data) else None

    def physical(self, data: bytes) -> float | None:
        """Value in the DBC's unit; see `raw`."""
        value = self.raw(data)
        return None if value is None else self._scaled(value)

    def read(self, data: bytes, scale: float = 1.0) -> float | str | None:
        """Value in the DBC's unit; why there is none, or None where it is on another page.

        What times `scale` is larger than anything of a vehicle is no number either.
        """
        there = self.on_page(data)
        if there is False:
            return None
        if there is None or len(data) < self.bytes_needed:
            return SHORT
        if self.length > LONGEST_BITS:
            return NO_NUMBER
        raw = self._number(data)
        if not math.isfinite(raw):
            return NO_NUMBER
        if raw in self._none:
            return NAMED_NONE
        reason = j1939.why_no_value(int(raw), self.length) if self._of_j1939 else ""
        if reason:
            return reason
        value = self._scaled(raw)
        return value if abs(value * scale) <= LARGEST else NO_NUMBER

    def read_counter(self, data: bytes) -> int | str | None:
        """A free-running counter before scaling; else as `read`.

        It uses all of its values, so that of those that stand for none in J1939 only the last is
        none: one count in a turn.
        """
        there = self.on_page(data)
        if there is False:
            return None
        if there is None or len(data) < self.bytes_needed:
            return SHORT
        if self.length > LONGEST_BITS:
            return NO_NUMBER
        raw = self._number(data)
        if not math.isfinite(raw):
            return NO_NUMBER
        if raw in self._none or (self._of_j1939 and raw == self._mask):
            return NAMED_NONE if raw in self._none else j1939.NOT_AVAILABLE
        return int(raw)

    def _number(self, data: bytes) -> float:
        if self._order == "big":
            bits: int = int.from_bytes(data, "big") >> (8 * len(data) - self._end) & self._mask
        else:
            bits = int.from_bytes(data, "little") >> self._start & self._mask
        if self._float:
            value: float = struct.unpack(self._float, bits.to_bytes(self.length // 8, "big"))[0]
            return value
        return bits - ((bits & self._sign) << 1)

    def _scaled(self, raw: float) -> float:
        return raw if self._plain else raw * self.scale + self.offset


def _within_floats(number: float) -> float:
    """A number of a DBC; infinity where a reading times it might not fit into a float."""
    return number if abs(number) <= _MOST else math.inf


def _names_none(name: str) -> bool:
    words = re.split(r"[\s_]+", name.strip())
    tails = [name.strip(), words[0], words[-1], " ".join(words[-2:]), " ".join(words[:2])]
    return any(_NONE_NAME.fullmatch(each) for each in tails)


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
            text = read_limited(Path(path), _LIMIT_BYTES)
            check_bounds(text, f"{where}: {path}")
            self._paged = paged_signals(text)
            self._messages: dict[str, Any] = {
                message.name: message for message in _load(path, text).messages
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
        signal = signals[signal_name]
        if (message_name, signal_name) in self._paged and not signal.multiplexer_ids:
            raise ConfigError(
                f"{where}.signal: {self.path} says that '{signal_name}' is on a page of "
                f"'{message_name}', and not which signal tells the page",
                cure="mark the multiplexer of that message with M",
            )
        try:
            found = _field(signal, signals, bool(self.address(message_name)))
        except KeyError:
            raise ConfigError(
                f"{where}.signal: {self.path} says that '{signal_name}' is a number of IEEE 754 "
                f"with {signal.length} bits, or its multiplexer is one; there are 16, 32 and 64",
                cure="correct SIG_VALTYPE_ or the length of the signal",
            ) from None
        return frame_key(message), found

    def address(self, message_name: str) -> j1939.Address | None:
        """Parameter group and sender of a message of J1939; None for any other."""
        message = self._messages[message_name]
        if not message.is_extended_frame:
            return None
        told = message.protocol == "j1939" or j1939.stands_for_any(message.frame_id)
        if told or any(
            j1939.ends_like_a_parameter(each.maximum, each.scale, each.offset, each.length)
            for each in message.signals
            if not each.is_signed and not each.is_float
        ):
            return j1939.address_of(message.frame_id)
        return None

    def senders(self, group: int) -> set[int]:
        """Source addresses from which the DBC knows messages of a group, each of its own."""
        extended = [each for each in self._messages.values() if each.is_extended_frame]
        addresses = [j1939.address_of(each.frame_id) for each in extended]
        return {each.source for each in addresses if each.group == group} - {j1939.ANY_SOURCE}


def frame_key(message: Any) -> int:
    """Identifier of a message, with `EXTENDED_ID` where it has 29 bits."""
    return int(message.frame_id | (EXTENDED_ID if message.is_extended_frame else 0))


def _load(path: str, text: bytes) -> Any:
    """Let cantools read a database; not strict: real ones have signals that overlap or stick out.

    Whether a signal fits is seen frame by frame.
    """
    if Path(path).suffix.lower() != ".dbc":
        return cantools.database.load_file(path, strict=False)
    marked = mark_extended(text).decode("cp1252", "replace")
    return cantools.database.load_string(marked, "dbc", strict=False)


def _field(signal: Any, signals: dict[str, Any], of_j1939: bool = False) -> Field:
    selectors: list[tuple[Field, frozenset[int]]] = []
    if signal.multiplexer_signal is not None and signal.multiplexer_ids:
        selector = _field(signals[signal.multiplexer_signal], signals)
        selectors.append((selector, frozenset(signal.multiplexer_ids)))
    return Field(signal, selectors, of_j1939=of_j1939)


def _near(name: str, names: list[str]) -> str:
    """Tail of the sentence: names that were meant perhaps."""
    upper = {candidate.upper(): candidate for candidate in names}
    near = difflib.get_close_matches(name.upper(), upper, n=3, cutoff=0.5)
    if near:
        return "; near: " + ", ".join(upper[match] for match in near)
    return "; it has " + (", ".join(sorted(names)[:5]) or "none")
