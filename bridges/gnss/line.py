"""What the bytes of a line look like in which no message is found: whose, and at which bit rate.

A port that reads faster than the device sends sees each bit several times: within a character,
levels last for two bits and more. One that reads slower sees what cannot be told from noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tramstream.bridges.gnss.events import LINE_RATE, NO_SENTENCE
from tramstream.events.kinds import Event

ENOUGH_BYTES = 256
"""So many without a whole message are no accident: an epoch of short sentences is shorter."""
KEPT_BYTES = 2048
_TEXT_SHARE = 0.9
"""Of printable characters and line ends in what is text; noise has 0.38."""
_SINGLE_SHARE = 0.15
"""Of levels that last for one bit where none should; data at their own rate have a half."""
_EXAMPLE = 40
_RATES = (4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)


@dataclass
class LineMemory:
    """What came since the last whole message."""

    size: int = 0
    data: bytes = b""
    """The first of it."""

    def note(self, data: bytes, understood: bool) -> None:
        """Take note of a read, and whether a message ended in it."""
        if understood:
            self.size, self.data = 0, b""
            return
        self.size += len(data)
        if len(self.data) < KEPT_BYTES:
            self.data += data[: KEPT_BYTES - len(self.data)]


def judge(memory: LineMemory, baud_rate: int) -> Event | None:
    """What is wrong with the line, if anything is."""
    if memory.size < ENOUGH_BYTES:
        return None
    octets = np.frombuffer(memory.data, np.uint8)
    printable = ((octets >= 0x20) & (octets < 0x7F)) | (octets == 0x0D) | (octets == 0x0A)
    if printable.mean() >= _TEXT_SHARE:
        start = memory.data[:_EXAMPLE].decode("ascii", "replace")
        return NO_SENTENCE(received_bytes=memory.size, example=repr(start))
    return LINE_RATE(
        received_bytes=memory.size, baud_rate=baud_rate, guess=_guess(octets, baud_rate)
    )


def _guess(octets: np.ndarray, baud_rate: int) -> str:
    """Whether the device is slower, and by how much."""
    lengths = levels(octets)
    singles = (lengths == 1).mean() if len(lengths) else 0.0
    if singles >= _SINGLE_SHARE:
        return "the device may be faster"
    if not len(lengths):
        return f"the device is slower than {baud_rate // 8}"
    times = float(np.percentile(lengths, 25))
    nearest = min(_RATES, key=lambda rate: abs(np.log(rate * times / baud_rate)))
    return f"the device is slower, perhaps {nearest}"


def levels(octets: np.ndarray) -> np.ndarray:
    """How many bits each level lasts that begins and ends within a character.

    A character is its start bit (0) and eight bits, the lowest first. Its stop bit is not kept by
    who reads it, and where the rate is wrong it need not be 1.
    """
    bits = octets[:, None].astype(np.uint16) << 1 >> np.arange(9) & 1
    lengths = []
    for row in bits:
        edges = np.flatnonzero(np.diff(row))
        lengths += np.diff(edges).tolist()
    return np.array(lengths, dtype=np.int64)
