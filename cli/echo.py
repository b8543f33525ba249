"""`tramstream echo KEY`: the messages themselves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from tramstream.cli.terminal.options import (
    FileOption,
    Format,
    FormatOption,
    JsonOption,
    KeyArgument,
    VehicleOption,
)

if TYPE_CHECKING:
    from tramstream.cli.monitor.source import Source
    from tramstream.transport.bus import Envelope


def echo(
    key: KeyArgument,
    file: FileOption = None,
    count: Annotated[int, typer.Option("--count", help="Messages to print; 0: all.", min=0)] = 0,
    format_: FormatOption = Format.text,
    json_: JsonOption = False,
    vehicle: VehicleOption = "",
    full: Annotated[
        bool, typer.Option("--full", help="Do not shorten long lists and bytes in text.")
    ] = False,
) -> None:
    """Print messages as they come, or as they stand in a file; json: one object a line."""
    from tramstream.cli.monitor.source import LiveSource, Waiting, look
    from tramstream.cli.terminal.session import say, stop_on_signals
    from tramstream.monitor.stats import Sequence
    from tramstream.shown import shown

    as_json = json_ or format_ is Format.json
    stop = stop_on_signals()
    sequences: dict[str, Sequence] = {}
    printed = 0
    with look(key, file, vehicle) as source:
        waiting = Waiting(source)
        for envelope in source.messages(stop):
            waiting.see(envelope)
            if envelope is None:
                continue
            missing = sequences.setdefault(envelope.topic, Sequence()).missing(envelope)
            if as_json:
                print(_as_json(source, envelope), flush=source.live)
            else:
                if missing:
                    name = source.shown(envelope.topic)
                    print(shown(f"# {missing} messages of {name} are missing here"))
                print(_as_text(source, envelope, full), flush=source.live)
            printed += 1
            if printed == count:
                break
        if isinstance(source, LiveSource) and source.ring.dropped_total:
            say(
                f"{source.ring.dropped_total} messages came faster than they could be printed; "
                "echo fewer keys"
            )


def _as_json(source: Source, envelope: Envelope) -> str:
    from tramstream.cli.monitor.readable import stamp_ns
    from tramstream.cli.monitor.source import line
    from tramstream.cli.terminal.plain import to_dict

    message = source.decode(envelope)
    figures = {
        "key": source.shown(envelope.topic),
        "stamp_ns": None if message is None else stamp_ns(message),
        "publish_ns": envelope.publish_ns,
        "sequence": envelope.sequence,
        "message": None if message is None else to_dict(message),
    }
    if message is None:
        figures |= {"encoding": envelope.encoding, "payload": envelope.payload.hex()}
    return line(figures)


def _as_text(source: Source, envelope: Envelope, full: bool) -> str:
    from tramstream.cli.monitor.readable import SHOWN_BYTES, iso, readable, stamp_ns
    from tramstream.shown import shown

    message = source.decode(envelope)
    name = source.shown(envelope.topic)
    stamp = None if message is None else stamp_ns(message)
    when = f"published {iso(envelope.publish_ns)}" if stamp is None else iso(stamp)
    head = f"{name}  #{envelope.sequence}  {when}"
    if message is None:
        payload = envelope.payload if full else envelope.payload[:SHOWN_BYTES]
        digits = payload.hex(" ") + (" …" if len(payload) < len(envelope.payload) else "")
        what = envelope.encoding or "something without an encoding"
        body = [f"# {len(envelope.payload)} bytes, declared as {what}: cannot be decoded", digits]
    else:
        body = readable(message, full)
    return "\n".join([shown(text) for text in (head, *body)] + ["---"])
