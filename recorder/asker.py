"""Asks publishers for what the recorder missed, on a thread of its own: the worker goes on."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue

from tramstream.transport.bus import Bus

ASK_TIMEOUT_S = 1.0
"""A publisher that stands still answers nobody; the others wait no longer for it."""
END_TIMEOUT_S = 2 * ASK_TIMEOUT_S

_Question = tuple[int | None, bytes, Callable[[int], None] | None]
"""Publisher's session (None: everybody), encoded request, who wants to know how many answered."""


class Asker:
    """Puts questions one after the other.

    Parameters
    ----------
    bus : Bus
    deliver : callable
        Gets every answer, on the asker's thread.
    """

    def __init__(self, bus: Bus, deliver: Callable[[bytes], None]) -> None:
        self._bus = bus
        self._deliver = deliver
        self._questions: SimpleQueue[_Question | None] = SimpleQueue()
        self._lock = threading.Lock()
        self._open = 0
        self._thread: threading.Thread | None = None

    @property
    def busy(self) -> bool:
        """Whether questions are on their way."""
        with self._lock:
            return self._open > 0

    def ask(
        self, session: int | None, request: bytes, done: Callable[[int], None] | None = None
    ) -> None:
        """Have a question put; comes back at once.

        `done` gets the number of answers, behind the last of them.
        """
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="recorder-asks", daemon=True)
            self._thread.start()
        with self._lock:
            self._open += 1
        self._questions.put((session, request, done))

    def close(self) -> None:
        """End after the questions that were asked."""
        if self._thread is not None:
            self._questions.put(None)
            self._thread.join(END_TIMEOUT_S)

    def _run(self) -> None:
        while (question := self._questions.get()) is not None:
            session, request, done = question
            answers = 0
            for answer in self._bus.ask_again(request, session, ASK_TIMEOUT_S):
                self._deliver(answer)
                answers += 1
            if done is not None:
                done(answers)
            with self._lock:
                self._open -= 1
