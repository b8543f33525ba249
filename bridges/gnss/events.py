"""What lasts and is wrong with a receiver or its line: kinds of events."""

from __future__ import annotations

from tramstream.events.kinds import define

LINE_RATE = define(
    "gnss.line_rate",
    "{received_bytes} came and no message is among them: they look like a line at another bit rate "
    "than {baud_rate}, {guess}",
    cause="The receiver sends at one bit rate and the port reads at another: every character is "
    "garbage. A device that is no receiver looks alike.",
    cure="set $.gnss.baud_rate to what the receiver is set to; common are 9600, 38400, 115200, "
    "460800",
    received_bytes=int,
    baud_rate=int,
    guess=str,
)
NO_SENTENCE = define(
    "gnss.no_sentence",
    "{received_bytes} of text came and no sentence is among them, {example}",
    cause="Another device is on this line, or one whose sentences have no checksum.",
    cure="see whether $.gnss.device is the receiver",
    received_bytes=int,
    example=str,
)
JAMMED = define(
    "gnss.jammed",
    "the receiver says that it is jammed: {state} ({told_by}), continuous waves {indicator} of 255",
    cause="Something near sends in the band of satellites: a jammer, a modem, a defective antenna.",
    cure="look for what was switched on, and at the antenna's cable",
    state=str,
    told_by=str,
    indicator=int,
)
SPOOFED = define(
    "gnss.spoofed",
    "the receiver says that its signals are not those of satellites: {state} ({told_by})",
    cause="Somebody sends what looks like satellites, or repeats them into a hall.",
    cure="do not believe its place; fixes are left out meanwhile",
    state=str,
    told_by=str,
)
