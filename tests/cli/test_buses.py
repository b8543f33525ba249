"""Which bus a verb looks at, where this user has none, one or several."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from live import short_folder

from tramstream import keys, private
from tramstream.cli.terminal import session
from tramstream.clock import VehicleClock
from tramstream.errors import BusError
from tramstream.transport import buses
from tramstream.transport.bus import ZenohBus


@pytest.fixture
def home(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The user's own folder, empty."""
    with short_folder() as folder:
        monkeypatch.delenv(private.RUNTIME_DIR, raising=False)
        monkeypatch.setattr(private, "own_runtime_dir", lambda: folder)
        yield folder


@contextmanager
def routed(vehicle: str, folder: Path | None = None) -> Iterator[Path]:
    """A bus with one node of a vehicle, noted as `run`, `demo` and `replay` note theirs."""
    with ExitStack() as stack:
        folder = folder or stack.enter_context(short_folder())
        bus = ZenohBus.route(folder, VehicleClock.shared(folder))
        stack.callback(bus.close)
        bus.announce(keys.alive(vehicle, "imu"))
        buses.note(folder)
        yield folder


def seen(vehicle: str = "") -> list[str]:
    """Vehicles on the bus that a verb looks at."""
    with session.client(vehicle) as bus:
        return sorted({keys.split(token)[0] for token in bus.alive(keys.alive("*", "*"))})


def test_bus_anywhere_is_found_and_forgotten_when_it_is_gone(home: Path) -> None:
    with routed("demo") as folder:
        assert buses.listening() == [folder]
        assert seen() == ["demo"]
        assert seen("demo") == ["demo"]
    assert buses.listening() == []
    assert list((home / buses.FOLDER).iterdir()) == []
    with pytest.raises(BusError, match="no bus"):
        seen()


def test_of_several_buses_that_with_the_vehicle_is_taken(home: Path) -> None:
    with routed("tram-1", home), routed("demo") as other:
        assert buses.listening() == [home, other]
        assert seen("demo") == ["demo"]
        assert seen("tram-1") == ["tram-1"]
        with pytest.raises(BusError, match=r"several buses.*tram-1.*demo.*--vehicle"):
            seen()
        with pytest.raises(BusError, match="tram-9 is on none"):
            seen("tram-9")


def test_who_says_where_the_bus_is_gets_that_one(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with routed("tram-1", home), routed("demo") as other:
        monkeypatch.setenv(private.RUNTIME_DIR, str(other))
        assert seen() == ["demo"]
        assert buses.listening() == [other]


def test_notes_that_others_can_have_put_there_are_not_believed(home: Path) -> None:
    with routed("demo"):
        (home / buses.FOLDER).chmod(0o777)
        assert buses.listening() == []
