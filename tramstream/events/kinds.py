"""What can happen, each kind declared once by whoever raises it, and what happened: kind and facts.

    FIX_REFUSED = define(
        "tram.fix_refused",
        "a fix does not fit: innovation {innovation_m}, limit {limit_m} ({setting})",
        cause="An outlier of the receiver, or a filter that is wrong.",
        cure="look at the antenna's view of the sky",
        innovation_m=float, limit_m=float, setting=str,
    )
    FIX_REFUSED(innovation_m=41.2, limit_m=12.3, setting="ekf.gate_sigma")

A fact has the type that is declared and the unit in which its name ends; the sentence names facts
in braces and writes units by itself. Texts say which of many it was (a key, a device, a reason),
numbers how much: two events of one kind with equal texts are the same event again.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from types import ModuleType
from typing import Any

from tramstream.events import sentences

Value = float | int | str
TYPES = (float, int, str)
_NAME = re.compile(r"[a-z][a-z0-9_]*\.[a-z][a-z0-9_]*")
_FACT = re.compile(r"[a-z][a-z0-9_]*")


class Severity(IntEnum):
    """How much attention an event deserves; `health.proto` has the same numbers.

    DEBUG is for whoever looks for something: it is recorded and shown, and not said by `run`.
    """

    INFO = 0
    WARNING = 1
    ERROR = 2
    DEBUG = 3


INFO, WARNING, ERROR, DEBUG = Severity


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Kind:
    """One kind of event; called with its facts it gives the event. See `define`."""

    name: str
    sentence: str
    cause: str
    cure: str
    severity: Severity
    facts: Mapping[str, type]

    def __repr__(self) -> str:
        return self.name

    def __call__(self, **facts: Any) -> Event:
        """Make the event.

        Raises
        ------
        TypeError
            If the facts are not those that the kind declares.
        """
        if facts.keys() != self.facts.keys():
            wrong = ", ".join(sorted(facts.keys() ^ self.facts.keys()))
            raise TypeError(f"event {self.name}: its facts are {', '.join(self.facts)}; {wrong}")
        return Event(self, {name: _value(self, name, facts[name]) for name in self.facts})


@dataclass(frozen=True, slots=True)
class Event:
    """What happened; as a text it is the sentence for people."""

    kind: Kind
    facts: Mapping[str, Value] = field(hash=False)

    @property
    def identity(self) -> tuple[str, ...]:
        """Texts among the facts: what is said again, however its numbers have changed."""
        return tuple(value for value in self.facts.values() if isinstance(value, str))

    @property
    def plain(self) -> str:
        """The sentence without the cure, for who shows that apart."""
        return sentences.filled(self.kind.sentence, self._known())

    def __str__(self) -> str:
        return sentences.worded(self.kind.sentence, self.kind.cure, self._known())

    def _known(self) -> sentences.Known:
        return {name: (value, sentences.unit_of(name)) for name, value in self.facts.items()}


def define(
    name: str,
    sentence: str,
    *,
    cause: str = "",
    cure: str = "",
    severity: Severity = WARNING,
    **facts: type,
) -> Kind:
    """Declare a kind of event.

    Parameters
    ----------
    name : str
        `<who>.<what>`, lower case: the package or room that raises it, and what happened.
    sentence : str
        What people read; facts stand in it in braces, `{innovation_m}`, and get their unit there.
    cause : str
        How it comes about, for docs/events.md.
    cure : str
        What to do about it; follows the sentence. May name facts too.
    severity : Severity
    **facts : type
        float, int or str; names end in their unit (`_m`, `_s`, `_bytes`).

    Raises
    ------
    ValueError
        If the name is none, a fact has another type, or a sentence names a fact that is not there.
    """
    if not _NAME.fullmatch(name):
        raise ValueError(f"event {name!r}: must be who.what, of lower case letters and '_'")
    for fact, type_ in facts.items():
        if type_ not in TYPES or not _FACT.fullmatch(fact):
            raise ValueError(f"event {name}: fact {fact} must be float, int or str")
    for named in sentences.names(sentence) | sentences.names(cure):
        if named not in facts:
            raise ValueError(f"event {name}: the sentence names {named}, which is no fact of it")
    return Kind(name, sentence, cause, cure, severity, facts)


def declared(*tables: ModuleType) -> tuple[Kind, ...]:
    """Kinds that modules declare: what a processor raises out of them."""
    return tuple(
        each for table in tables for each in vars(table).values() if isinstance(each, Kind)
    )


def _value(of: Kind, name: str, value: Any) -> Value:
    wanted = of.facts[name]
    if wanted is str:
        # A file or device may be named by bytes that are no text; protobuf takes text only.
        return str(value).encode(errors="backslashreplace").decode()
    if isinstance(value, str | bytes):
        raise TypeError(f"event {of.name}: {name} is a number, not {value!r}")
    made: float | int = wanted(value)
    return made
