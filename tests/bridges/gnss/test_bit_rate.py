"""A line at the wrong bit rate, as a port sees it that samples levels at its own rate."""

from __future__ import annotations

import numpy as np
import pytest
from receivers import START_NS, VEHICLE, raw, sentences, solution

from tramstream.bridges.gnss.bridge import GnssBridge
from tramstream.bridges.gnss.events import LINE_RATE, NO_SENTENCE
from tramstream.bridges.gnss.line import ENOUGH_BYTES
from tramstream.clock import S
from tramstream.config import Gnss, Vehicle

RATES = (4800, 9600, 38400, 115200, 460800, 921600)


def line_levels(data: bytes) -> np.ndarray:
    """Levels of a line, one a bit: start bit, eight bits from the lowest on, stop bit."""
    octets = np.frombuffer(data, np.uint8)
    bits = np.ones((len(octets), 10), np.int64)
    bits[:, 0] = 0
    bits[:, 1:9] = octets[:, None] >> np.arange(8) & 1
    return np.pad(bits.ravel(), 20, constant_values=1)


def received(data: bytes, sent_baud: int, read_baud: int) -> bytes:
    """What a UART at `read_baud` makes of it: a falling edge, then samples amid its own bits.

    A missing stop bit is a framing error: the byte is kept, as the kernel does, and the next one
    begins when the line has risen.
    """
    levels = line_levels(data)
    places = np.arange(len(levels))
    next_low, next_high = (
        np.minimum.accumulate(np.where(levels == level, places, len(levels))[::-1])[::-1]
        for level in (0, 1)
    )
    middles = (np.arange(1, 10) + 0.5) / read_baud
    out, at = bytearray(), 0.0
    while (begin := next_low[int(at * sent_baud)]) < len(levels):
        at = max(at, begin / sent_baud)
        samples = ((at + middles) * sent_baud).astype(int)
        if samples[-1] >= len(levels):
            break
        out.append(int(levels[samples[:8]] @ _POWERS))
        at += 9.5 / read_baud
        at = max(at, next_high[int(at * sent_baud)] / sent_baud)
    return bytes(out)


_POWERS = 1 << np.arange(8)


def spoken(protocol: str, epochs: int = 4) -> bytes:
    times = [START_NS + k * S for k in range(epochs)]
    if protocol == "UBX":
        return b"".join(solution(gps_ns, hAcc=900 + k) for k, gps_ns in enumerate(times))
    return b"".join(sentences(gps_ns, "RMC", "GGA", "GST") for gps_ns in times)


def heard(data: bytes, baud_rate: int) -> list:
    vehicle = Vehicle(vehicle="t", gnss=Gnss(device="/dev/null", baud_rate=baud_rate))
    bridge = GnssBridge(vehicle)
    bridge.step(raw(data))
    return bridge.device_troubles()


def test_line_at_its_own_rate_arrives_as_it_was_sent() -> None:
    for protocol in ("UBX", "NMEA"):
        data = spoken(protocol)
        assert received(data, 9600, 9600) == data
        assert heard(data, 9600) == []


@pytest.mark.parametrize("protocol", ["UBX", "NMEA"])
@pytest.mark.parametrize("read", RATES)
@pytest.mark.parametrize("sent", RATES)
def test_wrong_bit_rate_is_named(sent: int, read: int, protocol: str) -> None:
    if sent == read:
        return
    share = max(1, round(sent / read))
    data = received(spoken(protocol, 6 * min(share, 24)), sent, read)
    if len(data) < ENOUGH_BYTES:
        data *= 1 + ENOUGH_BYTES // max(len(data), 1)
    (trouble,) = heard(data, read)
    assert trouble.kind is LINE_RATE
    assert trouble.facts["baud_rate"] == read
    guess = str(trouble.facts["guess"])
    if read >= 2 * sent:
        assert "slower" in guess
    if read in (2 * sent, 4 * sent):
        assert str(sent) in guess


def test_text_of_another_device_is_told_apart() -> None:
    (trouble,) = heard(b"temperature 21.5 C, humidity 40 %\r\n" * 20, 9600)
    assert trouble.kind is NO_SENTENCE
    assert "temperature" in str(trouble.facts["example"])


def test_message_ends_the_trouble_and_few_bytes_make_none() -> None:
    noise = np.random.default_rng(1).bytes(ENOUGH_BYTES - 1).replace(b"$", b"x")
    bridge = GnssBridge(VEHICLE)
    bridge.step(raw(noise))
    assert bridge.device_troubles() == []
    bridge.step(raw(b"\x80"))
    assert [trouble.kind for trouble in bridge.device_troubles()] == [LINE_RATE]
    bridge.step(raw(spoken("UBX")))
    assert bridge.device_troubles() == []
