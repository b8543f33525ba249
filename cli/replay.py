"""`tramstream replay FILE`: publish a record on the bus again."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from tramstream.transport.bus import Bus, ZenohBus


def replay(
    file: Annotated[Path, typer.Argument(help="Record, or a folder with the parts of one.")],
    rate: Annotated[
        float, typer.Option(help="Times real time; 0 is as fast as possible without loss.", min=0.0)
    ] = 1.0,
    start_s: Annotated[float, typer.Option("--start-s", help="Seconds to skip.", min=0.0)] = 0.0,
    duration_s: Annotated[
        float,
        typer.Option("--duration-s", help="Seconds of the record to play; 0 is all.", min=0.0),
    ] = 0.0,
    keys_: Annotated[str, typer.Option("--keys", help="Only keys in this expression.")] = "**",
    exclude: Annotated[str, typer.Option(help="Leave out keys in this expression.")] = "",
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    start_paused: Annotated[
        bool, typer.Option("--start-paused", help="Wait for the space bar.")
    ] = False,
    as_: Annotated[
        str,
        typer.Option("--as", help="Vehicle to publish as; default: the recorded one + -replay."),
    ] = "",
    onto_live: Annotated[
        bool, typer.Option("--onto-live", help="Publish even where live nodes use the keys.")
    ] = False,
    json_: Annotated[
        bool, typer.Option("--json", help="Print one JSON object at the end.")
    ] = False,
) -> None:
    """Play a record on the bus; stamps inside the messages stay as recorded.

    Keys: space pauses and goes on. Key expressions are those of zenoh, relative to the vehicle:
    raw/**, est/*/state.
    """
    import json
    from contextlib import ExitStack

    from tramstream import keys
    from tramstream.cli.terminal.keyboard import Keyboard
    from tramstream.cli.terminal.session import say, stop_on_signals
    from tramstream.clock import S
    from tramstream.errors import DamagedRecordError
    from tramstream.private import default_runtime_dir
    from tramstream.recorder.reader import open_record
    from tramstream.recorder.replay import Replay
    from tramstream.transport.descriptions import tell

    def match(topic: str) -> bool:
        path = keys.split(topic)[1] or topic
        return keys.matches(keys_, path) and not (exclude and keys.matches(exclude, path))

    stop = stop_on_signals()
    with ExitStack() as stack:
        record = stack.enter_context(open_record(file))
        vehicle = as_ or f"{record.vehicle or 'record'}-replay"
        bus = stack.enter_context(replay_bus(default_runtime_dir(), say))
        refuse_live(bus, vehicle, onto_live)
        start_ns = record.start_ns + int(start_s * S)
        end_ns = start_ns + int(duration_s * S) if duration_s else None
        playing = Replay(record, bus, vehicle, rate, match, start_ns, end_ns, loop, start_paused)
        say(f"{file}: {(record.end_ns - start_ns) / S:.1f} s as {keys.full(vehicle, '**')}")
        keyboard = stack.enter_context(Keyboard())
        bus.announce(keys.alive(vehicle, "replay"))
        tell(bus, record.types())

        def each() -> None:
            if keyboard.pressed() == " ":
                playing.paused = not playing.paused
                at_s = max(0, playing.position_ns - record.start_ns) / S
                say(f"{'paused' if playing.paused else 'going on'} at {at_s:.1f} s")

        playing.run(stop, each)
        figures = {
            "file": str(file),
            "vehicle": vehicle,
            "published": playing.published,
            "skipped_s": playing.skipped_ns / S,
            "damaged": record.damaged,
        }
        damaged = record.damaged
    print(json.dumps(figures)) if json_ else say(f"{playing.published} messages published")
    if playing.skipped_ns:
        say(f"{file}: pauses of more than a minute, {playing.skipped_ns / S:.0f} s, were left out")
    if damaged:
        raise DamagedRecordError(f"{damaged}; what could be proved right was replayed")


def replay_bus(runtime_dir: Path, say: Callable[[str], None]) -> closing[ZenohBus]:
    """A patient session: on the bus that is there, else as the router of a new one."""
    from tramstream.clock import VehicleClock
    from tramstream.transport import buses
    from tramstream.transport.bus import ZenohBus, router_listens

    clock = VehicleClock.shared(runtime_dir)
    if router_listens(runtime_dir):
        return closing(ZenohBus.connect(runtime_dir, clock, patient=True))
    say(f"no bus in {runtime_dir} yet; this replay is its router")
    bus = ZenohBus.route(runtime_dir, clock, patient=True)
    buses.note(runtime_dir)
    return closing(bus)


def refuse_live(bus: Bus, vehicle: str, onto_live: bool) -> None:
    """Raise ConfigError if nodes of a running vehicle publish under `vehicle`."""
    from tramstream import keys
    from tramstream.errors import ConfigError

    live = bus.alive(keys.alive(vehicle, "*"))
    if live and not onto_live:
        nodes = ", ".join(keys.split(token)[1].split("/")[1] for token in live)
        raise ConfigError(
            f"vehicle {vehicle} is live on this bus ({nodes}); choose another name with --as, or "
            "say --onto-live if you mean it"
        )
