"""The text of a DBC before cantools sees it: what it may claim, and what it leaves unsaid.

cantools makes room for what a DBC claims before anybody can look, refuses identifiers of 29 bits
that lack their mark, and forgets that a signal belongs to a page where no multiplexer is declared.
"""

from __future__ import annotations

import re

from tramstream.errors import ConfigError

_MESSAGE_BYTES = 1785
"""What J1939's transport protocol carries; a frame has 8, of CAN FD 64."""
_PAGES = 100_000
_MESSAGE = re.compile(rb"\s*BO_\s+\d+\s+(\w+)\s*:\s*(\d+)")
_SIGNAL = re.compile(rb"\s*SG_\s+(\w+)\s*(\w*)\s*:\s*(\d+)\|(\d+)@")
_NEGATIVE = re.compile(rb"\s*SG_\s+(\w+)\s*\w*\s*:\s*(?:-|\d+\|-)")
_RANGE = re.compile(rb"(\d+)\s*-\s*(\d+)")
_PAGE = re.compile(rb"m\d+M?")
_IDENTIFIED = re.compile(
    rb"\b(BO_|SG_|BO_TX_BU_|VAL_|SIG_VALTYPE_|SIG_GROUP_|SG_MUL_VAL_)(\s+)(\d+)\b"
)
"""Whatever names a message by its identifier. In a comment the same words may be changed, too: no
signal hangs on it."""
_STANDARD_MASK = 0x7FF
_EXTENDED_MASK = 0x1FFFFFFF
_EXTENDED_BIT = 0x80000000


def check_bounds(text: bytes, name: str) -> None:
    """Refuse what cantools would make room for: it does so before anybody can look.

    Raises
    ------
    ConfigError
        If a message is longer than any protocol on CAN carries, a signal longer than that, or a
        multiplexer has more values than there can be pages; if a place or a length is negative.
    """
    for line in text.splitlines():
        message, signal = _MESSAGE.match(line), _SIGNAL.match(line)
        if message is not None and _beyond(message[2], _MESSAGE_BYTES):
            raise _too_long(name, "message", message[1], f"{_MESSAGE_BYTES} bytes")
        negative = _NEGATIVE.match(line)
        if negative is not None:
            text_ = negative[1].decode("ascii", "replace")[:64]
            raise ConfigError(
                f"{name}: signal {text_} begins before its frame, or has less than no bits",
                cure="correct the DBC",
            )
        lengths = signal.groups()[2:] if signal is not None else ()
        if signal is not None and any(_beyond(each, 8 * _MESSAGE_BYTES) for each in lengths):
            raise _too_long(name, "signal", signal[1], f"{8 * _MESSAGE_BYTES} bits")
        if line.lstrip().startswith(b"SG_MUL_VAL_"):
            pages = sum(_pages(*each) for each in _RANGE.findall(line))
            if pages > _PAGES:
                raise _too_long(name, "multiplexer of", line.split()[2], f"{_PAGES} values")


def mark_extended(text: bytes) -> bytes:
    """Set bit 31 of identifiers that have more than 11 bits and lack it: they have 29 all the same.

    Exporters leave the mark out; no identifier of 11 bits is lost by it.
    """

    def marked(match: re.Match[bytes]) -> bytes:
        digits = match[3]
        id_ = int(digits) if len(digits) <= 10 else 0
        if not _STANDARD_MASK < id_ <= _EXTENDED_MASK:
            return match[0]
        return match[1] + match[2] + str(id_ | _EXTENDED_BIT).encode()

    return _IDENTIFIED.sub(marked, text)


def paged_signals(text: bytes) -> set[tuple[str, str]]:
    """Message and name of each signal that is said to be on a page (`m0`, `m3M`)."""
    found, message = set(), ""
    for line in text.splitlines():
        head, signal = _MESSAGE.match(line), _SIGNAL.match(line)
        if head is not None:
            message = head[1].decode("ascii", "replace")
        elif signal is not None and _PAGE.fullmatch(signal[2]):
            found.add((message, signal[1].decode("ascii", "replace")))
    return found


def _beyond(digits: bytes, limit: int) -> bool:
    return len(digits) > 9 or int(digits) > limit


def _pages(first: bytes, last: bytes) -> int:
    return _PAGES + 1 if len(first) > 9 or len(last) > 9 else 1 + int(last) - int(first)


def _too_long(name: str, kind: str, what: bytes, most: str) -> ConfigError:
    text = what.decode("ascii", "replace")[:64]
    return ConfigError(f"{name}: {kind} {text} is longer than {most}", cure="correct the DBC")
