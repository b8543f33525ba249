"""Events as they travel: `tramstream.Event` to be counted, `foxglove.Log` to be read."""

from __future__ import annotations

from foxglove_schemas_protobuf.Log_pb2 import Log

from tramstream.events import sentences
from tramstream.events.kinds import Event, Severity, Value
from tramstream.proto import health_pb2

_LEVELS = {
    Severity.INFO: Log.Level.INFO,
    Severity.WARNING: Log.Level.WARNING,
    Severity.ERROR: Log.Level.ERROR,
    Severity.DEBUG: Log.Level.DEBUG,
}


def message_of(event: Event, source: str = "", unsaid: int = 0) -> health_pb2.Event:
    """The event as a message; its sentence and cure travel with it."""
    kind = event.kind
    message = health_pb2.Event(
        source=source,
        kind=kind.name,
        severity=int(kind.severity),  # type: ignore[arg-type]
        sentence=kind.sentence,
        cure=kind.cure,
        unsaid=unsaid,
    )
    for name, value in event.facts.items():
        fact = message.facts.add(name=name, unit=sentences.unit_of(name))
        if isinstance(value, str):
            fact.text = value
        elif isinstance(value, int):
            fact.integer = value
        else:
            fact.number = value
    return message


def log_of(message: health_pb2.Event) -> Log:
    """The same for viewers, worded; where code is named, kind and number of the stamped event."""
    return Log(
        level=_LEVELS.get(message.severity, Log.Level.UNKNOWN),  # type: ignore[call-overload]
        message=sentence_of(message),
        name=message.source,
        file=message.kind,
        line=message.sequence & 0xFFFFFFFF,
    )


def sentence_of(message: health_pb2.Event) -> str:
    """What people read of an event, whoever has raised it."""
    known = {fact.name: (_value(fact), fact.unit) for fact in message.facts}
    return sentences.worded(message.sentence, message.cure, known, message.unsaid)


def facts_of(message: health_pb2.Event) -> dict[str, Value]:
    """Facts by name."""
    return {fact.name: _value(fact) for fact in message.facts}


def identity_of(message: health_pb2.Event) -> tuple[str, ...]:
    """Kind and texts: equal for the same event again."""
    texts = [fact.text for fact in message.facts if fact.WhichOneof("value") == "text"]
    return (message.kind, *texts)


def _value(fact: health_pb2.Fact) -> Value:
    value: Value | None = getattr(fact, fact.WhichOneof("value") or "text")
    return "" if value is None else value
