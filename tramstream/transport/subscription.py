"""An open subscription of the bus."""

from __future__ import annotations

from collections.abc import Callable


class Subscription:
    """What `Bus.subscribe` gives.

    Parameters
    ----------
    close : callable
        Ends it.
    """

    def __init__(self, close: Callable[[], None]) -> None:
        self._close: Callable[[], None] | None = close

    def close(self) -> None:
        """End it; may be called twice."""
        close, self._close = self._close, None
        if close is not None:
            close()
