"""How a signal ends the program: everybody cleans up, and the status names the signal."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import NoReturn

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_SHELL = 128
"""What a shell adds to the number of the signal that ended a program."""


class Ending:
    """Raises KeyboardInterrupt at a signal, so that everybody cleans up; remembers which it was."""

    def __init__(self) -> None:
        self.number = int(signal.SIGINT)

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.number = number
        raise KeyboardInterrupt

    def listen(self) -> None:
        """Take the signals, but for one that is to be ignored (`nohup`)."""
        for each in SIGNALS:
            if signal.getsignal(each) != signal.SIG_IGN:
                signal.signal(each, self)

    @property
    def status(self) -> int:
        """What a shell reports for a program that this signal ended."""
        return _SHELL + self.number


def until_ended(program: Callable[[Ending], NoReturn]) -> NoReturn:
    """Run the program, which a signal may end from now on."""
    ending = Ending()
    ending.listen()
    try:
        program(ending)
    except KeyboardInterrupt:
        sys.exit(ending.status)
    finally:
        for each in SIGNALS:  # the interpreter's own end takes a moment
            signal.signal(each, signal.SIG_IGN)
