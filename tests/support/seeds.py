"""Seeds of simulated rides: a few in every run of the suite, the rest as a study.

    pytest -m study tests/processors        # the rest, among other long things

A limit that holds for the few is the same for the rest: more seeds find what is rare.
"""

from __future__ import annotations

from typing import Any

import pytest


def seeds(few: int, of: int, first: int = 1) -> list[Any]:
    """Parameters `first`, … for `of` seeds, all behind the first `few` marked as a study."""
    return [
        pytest.param(seed, marks=() if number < few else pytest.mark.study)
        for number, seed in enumerate(range(first, first + of))
    ]
