"""The adapter's side of slcan: CAN frames as lines of text on a serial line.

The host sends commands that end in a carriage return; the adapter answers each with a carriage
return (done) or a bell (refused), some with a letter and digits before. While the channel is open,
a received frame comes as `t`, three digits of identifier (`T` and eight for 29 bits), one digit of
length and the data, all hexadecimal. `r` and `R` are remote frames, without data.

References
----------
LAWICEL AB, CAN232 manual, version 3, "Available CAN232 ASCII commands".
"""

from __future__ import annotations

OK = b"\r"
REFUSED = b"\a"
VERSION = b"V1013\r"
SERIAL_NUMBER = b"NTRAM\r"
STATUS = b"F00\r"

LONGEST_COMMAND = 32
"""`T` with eight bytes has 26 characters; a longer line is noise."""
_SETTINGS = frozenset(b"SsMmWQXUZP")


def encode_frame(
    identifier: int, data: bytes, *, extended: bool = False, remote_length: int | None = None
) -> bytes:
    """Write a frame as the adapter's line; a remote frame where `remote_length` is given."""
    letter = "t" if remote_length is None else "r"
    head = f"{letter.upper()}{identifier:08X}" if extended else f"{letter}{identifier:03X}"
    if remote_length is not None:
        return f"{head}{remote_length}\r".encode()
    return f"{head}{len(data)}{data.hex().upper()}\r".encode()


class SlcanAdapter:
    """What an adapter answers to its host; any split of the host's bytes gives the same answers."""

    def __init__(self) -> None:
        self.channel_open = False
        self.commands_refused = 0
        self._line = b""

    def feed(self, data: bytes) -> bytes:
        """Take the host's bytes, return the answers to the commands that end in them."""
        *commands, self._line = (self._line + data).split(OK)
        self._line = self._line[:LONGEST_COMMAND]
        answers = [self._answer(command) for command in commands]
        self.commands_refused += answers.count(REFUSED)
        return b"".join(answers)

    def _answer(self, command: bytes) -> bytes:
        letter = command[:1]
        if letter in (b"O", b"L"):
            done, self.channel_open = not self.channel_open, True
            return OK if done else REFUSED
        if letter == b"C":
            done, self.channel_open = self.channel_open, False
            return OK if done else REFUSED
        if letter in (b"t", b"r", b"T", b"R"):
            # Nobody else is on this bus: a frame of the host's is sent and forgotten.
            return (b"z" if letter.islower() else b"Z") + OK
        known = {b"": OK, b"V": VERSION, b"N": SERIAL_NUMBER, b"F": STATUS}
        if letter in known:
            return known[letter]
        return OK if letter and letter[0] in _SETTINGS else REFUSED
