"""filterpy's filters to build on, imported without what only one of their figures needs.

`filterpy.kalman` takes one function out of `filterpy.stats`, `logpdf`, which brings all of
`scipy.stats`: 1.2 s of the 3.3 s of processor time that loading the localisation filter took
(2026-11-29), paid at every start, restart and worker. Here it is loaded when somebody asks for it:
by the log-likelihood of filterpy's own dense update.

Whoever imports `filterpy.stats` itself gets filterpy's, before or after.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

STATS = "filterpy.stats"


class _Stats(ModuleType):
    """What stands for `filterpy.stats` until something in it is used."""

    def logpdf(self, *arguments: Any, **named: Any) -> Any:
        """Give the logarithm of a normal density: filterpy's own."""
        return importlib.import_module(STATS).logpdf(*arguments, **named)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # the import system's own questions
            raise AttributeError(name)
        return getattr(importlib.import_module(STATS), name)


@contextmanager
def _without_stats() -> Iterator[None]:
    """Let modules that are imported meanwhile find the stand-in for `filterpy.stats`."""
    if STATS in sys.modules:
        yield
        return
    sys.modules[STATS] = _Stats(STATS)
    try:
        yield
    finally:
        del sys.modules[STATS]


with _without_stats():
    from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter

__all__ = ["ExtendedKalmanFilter", "KalmanFilter"]
