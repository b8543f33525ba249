"""The console script: from here on Ctrl-C, SIGTERM or a closed terminal end it without a trace.

Whoever ends the program may do so while its verbs are still being imported, which takes longer than
anything that is imported here. A verb that ends in order by itself takes the signals over
(`terminal.session.stop_on_signals`).
"""

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


def main(program: Callable[[Ending], NoReturn] | None = None) -> NoReturn:
    """Entry point of the console script; `program` is `cli.main.main`, where that is imported."""
    ending = Ending()
    ending.listen()
    try:
        if program is None:
            from tramstream.cli.main import main as program
        program(ending)
    except KeyboardInterrupt:
        sys.exit(ending.status)
    finally:
        for each in SIGNALS:  # the interpreter's own end takes a moment
            signal.signal(each, signal.SIG_IGN)


if __name__ == "__main__":
    main()
