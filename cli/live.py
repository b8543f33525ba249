"""`tramstream live`: a page in the browser that shows a vehicle while it rides, or a record."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tramstream.cli.terminal.options import VehicleOption

if TYPE_CHECKING:
    from tramstream.transport.bus import Bus

POLL_S = 0.2


def live(
    record: Annotated[
        Path | None,
        typer.Argument(help="Record to play, again and again; without one the running vehicle."),
    ] = None,
    vehicle: VehicleOption = "",
    net: Annotated[
        Path | None,
        typer.Option("--net", help="Track network to draw; default: that of the record."),
    ] = None,
    listen: Annotated[
        str, typer.Option("--listen", help="HOST:PORT to serve at; port 0 takes any that is free.")
    ] = "127.0.0.1:8470",
    share: Annotated[
        bool,
        typer.Option(
            "--share", help="Needed beyond loopback: TLS, and a token in the address that is shown."
        ),
    ] = False,
    open_: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
    rate: Annotated[
        float, typer.Option(help="Of a record: times real time.", min=0.1, max=100.0)
    ] = 1.0,
) -> None:
    """Serve one page that shows the vehicle on its tracks, strips over time, devices and events.

    It only looks: nothing is published, and a browser can send nothing. Ctrl-C ends it.
    """
    from contextlib import ExitStack

    from tramstream.cli.terminal import session
    from tramstream.cli.terminal.optional import needs
    from tramstream.cli.terminal.page_beside import ADDRESS

    with needs("live"):
        from tramstream.web import access as ways_in
        from tramstream.web.serve import Page, serving

    address = ways_in.address_of(listen)
    stop = session.stop_on_signals()
    with ExitStack() as stack:
        access = ways_in.granted(address, share)
        tls = stack.enter_context(_certificate(address.host)) if share else None
        network = net if net is not None else _network_of(record)
        drawing = _drawing(network)
        source = _played(record, rate, stop) if record is not None else session.client(vehicle)
        bus = stack.enter_context(source)
        page = Page(bus, session.vehicle_on(bus, vehicle), drawing)
        shown = stack.enter_context(serving(page, address, access, tls))
        session.say(f"{ADDRESS}{shown}")
        if open_:
            import webbrowser

            webbrowser.open(shown)
        while not stop.wait(POLL_S):
            pass


@contextmanager
def _certificate(host: str) -> Iterator[tuple[Path, Path]]:
    """Certificate and key of this run, gone afterwards."""
    import tempfile

    from tramstream.cli.terminal.optional import needs
    from tramstream.cli.terminal.session import say

    with needs("live"):
        from tramstream.web import certificate

    with tempfile.TemporaryDirectory(prefix="tramstream-live-") as folder:
        *paths, fingerprint = certificate.make(Path(folder), host)
        say(f"certificate of this run, SHA-256 {fingerprint}")
        yield paths[0], paths[1]


@contextmanager
def _played(record: Path, rate: float, stop: Any) -> Iterator[Bus]:
    """A bus of its own on which the record is played again and again."""
    import shutil
    import tempfile
    import threading

    from tramstream import keys
    from tramstream.cli.replay import replay_bus
    from tramstream.recorder.reader import open_record
    from tramstream.recorder.replay import Replay
    from tramstream.transport.descriptions import tell

    folder = Path(tempfile.mkdtemp(prefix="tramstream-live-", dir="/tmp"))
    try:
        with open_record(record) as opened, replay_bus(folder, lambda _: None) as bus:
            vehicle = opened.vehicle or "record"
            playing = Replay(opened, bus, vehicle, rate, lambda _: True, loop=True)
            bus.announce(keys.alive(vehicle, "replay"))
            tell(bus, opened.types())
            thread = threading.Thread(
                target=playing.run, args=(stop, lambda: None), name="replay", daemon=True
            )
            thread.start()
            yield bus
            stop.set()
            thread.join()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _network_of(record: Path | None) -> Path | None:
    """The track network that a record's configuration names, if it is still there."""
    import json

    from tramstream.recorder.reader import open_record

    if record is None:
        return None
    with open_record(record) as opened:
        config = json.loads(opened.metadata.get("config") or "{}")
    section = config.get("map") if isinstance(config, dict) else None
    named = section.get("network") if isinstance(section, dict) else None
    path = Path(named) if isinstance(named, str) else None
    return path if path is not None and path.is_file() else None


def _drawing(network: Path | None) -> bytes:
    """The network as the page gets it; `null` without one."""
    if network is None:
        return b"null"
    from tramstream.tracks.network import load
    from tramstream.web.app import encoded
    from tramstream.web.rails import drawing

    return encoded(drawing(load(network)))
