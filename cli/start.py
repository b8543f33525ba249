"""The console script: from here on Ctrl-C, SIGTERM or a closed terminal end it without a trace.

Whoever ends the program may do so while its verbs are still being imported, which takes longer than
anything that is imported here. A verb that ends in order by itself takes the signals over
(`terminal.session.stop_on_signals`).
"""

from __future__ import annotations

from typing import NoReturn

from tramstream.cli.ending import Ending, until_ended


def main() -> NoReturn:
    """Entry point of the console script."""
    until_ended(_imported)


def _imported(ending: Ending) -> NoReturn:
    from tramstream.cli.main import main as program

    program(ending)


if __name__ == "__main__":
    main()
