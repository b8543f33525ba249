"""What a receiver said of jamming and spoofing lately, by whatever message it says so."""

from __future__ import annotations

from dataclasses import dataclass, field

from tramstream.bridges.gnss.events import JAMMED, SPOOFED
from tramstream.bridges.gnss.state_messages import JAMMING_STATES, SPOOFING_STATES
from tramstream.clock import S
from tramstream.events.kinds import Event
from tramstream.proto.gnss_pb2 import (
    JAMMING_UNKNOWN,
    JAMMING_WARNING,
    SPOOFING_INDICATED,
    SPOOFING_UNKNOWN,
    GnssFix,
    GnssInterference,
    JammingState,
    SpoofingState,
)

FRESH_NS = 10 * S
"""What was said longer ago is not known any more; receivers say it once a second or every few."""


@dataclass
class Said:
    """What one kind of message said last."""

    arrival_ns: int
    jamming: int
    spoofing: int
    indicator: int
    """Of continuous waves, 0 to 255."""


@dataclass
class Interference:
    """By the message that tells it. It is its own memory."""

    _said: dict[str, Said] = field(default_factory=dict)

    def take(self, message: GnssInterference, arrival_ns: int) -> bool:
        """Remember what a message says; whether it says anything."""
        indicator = max((part.jamming_indicator for part in message.parts), default=0)
        said = Said(arrival_ns, message.jamming, message.spoofing, indicator)
        self._said[message.source] = said
        return bool(message.parts) or any(
            message.HasField(name) for name in ("jamming_detection", "spoofing_detection")
        )

    def mark(self, fix: GnssFix, arrival_ns: int) -> None:
        """Write the worst of what is known into a fix."""
        fresh = self._fresh(arrival_ns).values()
        jamming = max((each.jamming for each in fresh), default=JAMMING_UNKNOWN)
        spoofing = max((each.spoofing for each in fresh), default=SPOOFING_UNKNOWN)
        fix.jamming = JAMMING_STATES[jamming]
        fix.spoofing = SPOOFING_STATES[spoofing]

    def troubles(self, arrival_ns: int) -> list[Event]:
        """What is wrong now in the receiver's own words, the worst first."""
        found: list[Event] = []
        fresh = sorted(self._fresh(arrival_ns).items(), key=lambda each: -each[1].jamming)
        for name, said in fresh:
            if said.spoofing >= SPOOFING_INDICATED:
                found.append(SPOOFED(state=_word(SpoofingState.Name, said.spoofing), told_by=name))
        for name, said in fresh:
            if said.jamming >= JAMMING_WARNING:
                state = _word(JammingState.Name, said.jamming)
                found.append(JAMMED(state=state, told_by=name, indicator=said.indicator))
        return found

    def _fresh(self, arrival_ns: int) -> dict[str, Said]:
        return {
            name: said
            for name, said in self._said.items()
            if abs(arrival_ns - said.arrival_ns) <= FRESH_NS
        }


def _word(name_of: object, value: int) -> str:
    """`warning` of JAMMING_WARNING."""
    assert callable(name_of)
    return str(name_of(value)).partition("_")[2].lower()
