"""`import tramstream as ts`: what is public, and what it costs who does not use it."""

from __future__ import annotations

import subprocess
import sys

import pytest
from live import HANG_S

import tramstream as ts


def test_public_names_are_these_sorted() -> None:
    assert ts.__all__ == [
        "Columns",
        "Evaluation",
        "LeftOutWarning",
        "Record",
        "TramstreamError",
        "evaluate",
        "localise",
        "open_record",
        "simulate",
    ]
    assert ts.__all__ == sorted(ts.__all__)


@pytest.mark.parametrize("name", ts.__all__)
def test_public_name_is_at_home_where_the_face_says_and_has_a_docstring(name: str) -> None:
    found = getattr(ts, name)
    assert found.__module__ == ts._PLACES[name]
    assert found.__doc__
    assert name in dir(ts)


def test_places_are_those_of_the_public_names_and_of_the_type_checker() -> None:
    assert sorted(ts._PLACES) == ts.__all__


def test_docstring_tells_units_frames_signs_and_clocks() -> None:
    told = (ts.__doc__ or "").splitlines()
    assert {"Units", "Frames", "Signs", "Clocks", "Covariances"} <= set(told)


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'open_recrod'"):
        _ = ts.open_recrod


def test_import_loads_nothing_of_what_the_face_names() -> None:
    heavy = ("numpy", "numba", "zenoh", "google", "mcap", "msgspec", "tramstream.")
    code = f"import sys, tramstream; print([m for m in sys.modules if m.startswith({heavy!r})])"
    said = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=HANG_S
    )
    assert said.stdout.strip() == "[]"


def test_open_record_loads_no_bus_and_no_compiler() -> None:
    code = (
        "import sys, tramstream; tramstream.open_record; "
        "print([m for m in ('numba', 'zenoh', 'scipy', 'pandas', 'bokeh') if m in sys.modules])"
    )
    said = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=HANG_S
    )
    assert said.stdout.strip() == "[]"
