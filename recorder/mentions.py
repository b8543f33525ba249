"""Sentences that strangers may cause any number of times: some are said, the others are counted."""

from __future__ import annotations

from collections.abc import Callable

SENTENCES = 20
"""About keys of strangers; what follows is counted, and the count told."""


class Mentions:
    """Says the first sentences, and of all others how many they were.

    Parameters
    ----------
    say : callable
        Takes one sentence for people.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._said = self._unsaid = self._told = 0

    def mention(self, sentence: str) -> None:
        """Say a sentence while there is room for it."""
        if self._said < SENTENCES:
            self._said += 1
            self._say(sentence)
        else:
            self._unsaid += 1

    def tell_unsaid(self) -> None:
        """Say how many were not said, if there are more than the last time."""
        if self._unsaid > self._told:
            self._told = self._unsaid
            self._say(f"{self._unsaid} more sentences about keys of strangers were not said")
