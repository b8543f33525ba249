"""The simulated receiver: truth in its fixes, its times and its delays, read by pyubx2."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from functools import cache
from itertools import takewhile
from typing import Any

import numpy as np
import pytest
import pyubx2

from tramstream.bridges.gnss.framer import Frame, Framer
from tramstream.bridges.simulators.receiver import GnssDevice, gnss_stream
from tramstream.bridges.simulators.streams import NO_FAULTS, Cable, Chunk, Faults
from tramstream.clock import S
from tramstream.lines.line import built_in_line
from tramstream.simulation.receiver import GPS_MINUS_UNIX_S, GnssErrors
from tramstream.simulation.ride import Ride

START_NS = 1_790_000_000 * S + 123_456_789
MINUTE_S = 60.0


@cache
def ride() -> Ride:
    return Ride(built_in_line())


def until(stream: Iterator[Chunk], end_s: float = MINUTE_S) -> list[Chunk]:
    return list(takewhile(lambda chunk: chunk.due_ns < START_NS + end_s * S, stream))


def gnss_chunks(
    seed: int = 1, faults: Faults = NO_FAULTS, device: GnssDevice | None = None
) -> list[Chunk]:
    return until(gnss_stream(ride(), np.random.default_rng(seed), START_NS, device, faults))


def joined(chunks: list[Chunk]) -> bytes:
    return b"".join(chunk.data for chunk in chunks)


def total(chunks: list[Chunk], of: str) -> Counter[str]:
    counter: Counter[str] = Counter()
    for chunk in chunks:
        counter.update(getattr(chunk, of))
    return counter


def test_same_seed_gives_the_same_chunks_and_another_seed_others() -> None:
    assert gnss_chunks(seed=5, faults=Faults()) == gnss_chunks(seed=5, faults=Faults())
    assert joined(gnss_chunks(seed=5)) != joined(gnss_chunks(seed=6))


def test_chunks_are_in_the_order_of_their_due_times() -> None:
    due = [chunk.due_ns for chunk in gnss_chunks(faults=Faults())]
    assert due == sorted(due)
    assert due[0] >= START_NS


def parsed(data: bytes) -> list[Any]:
    """Messages as pyubx2 reads them, an authority from outside."""
    return [pyubx2.UBXReader.parse(f.raw) for f in Framer().feed(data) if isinstance(f, Frame)]


def test_gnss_fixes_are_the_truth_within_their_errors() -> None:
    lever = (2.0, 0.5, 3.0)
    device = GnssDevice(p_va_v=lever)
    messages = [m for m in parsed(joined(gnss_chunks(device=device))) if m.identity == "NAV-PVT"]
    assert len(messages) in (299, 300)
    level = ride().line.level
    errors = []
    for pvt in messages:
        gps_ns = _gps_ns(pvt)
        time_s = np.array([(gps_ns - GPS_MINUS_UNIX_S * S + 37_500_000 - START_NS) / S])
        motion = ride().motion(time_s)
        yaw = motion.yaw_rad[0]
        antenna = ride().position_l(time_s)[0] + [
            math.cos(yaw) * lever[0] - math.sin(yaw) * lever[1],
            math.sin(yaw) * lever[0] + math.cos(yaw) * lever[1],
            lever[2],
        ]
        p_l = level.from_geodetic([math.radians(pvt.lat), math.radians(pvt.lon), pvt.height / 1000])
        errors.append(p_l - antenna)
        turning = motion.yaw_rate_radps[0] * math.hypot(lever[0], lever[1])
        speed = math.hypot(pvt.velN, pvt.velE) / 1000
        assert speed == pytest.approx(motion.speed_mps[0], abs=5 * 0.05 + turning)
    sigma = np.array([0.5, 0.5, 1.0])
    assert np.all(np.abs(errors) < 5 * sigma)
    steps = np.diff(errors, axis=0)  # 0.95/s: steps of σ √(2 (1 − φ)), rounding 11 mm and 1 mm
    expected = sigma * math.sqrt(2 * (1 - 0.95**0.2))
    np.testing.assert_allclose(np.std(steps, axis=0), expected, rtol=0.25)


def _gps_ns(pvt: Any) -> int:
    utc = np.datetime64(
        f"{pvt.year:04}-{pvt.month:02}-{pvt.day:02}T{pvt.hour:02}:{pvt.min:02}:{pvt.second:02}"
    )
    return int(utc.astype(np.int64)) * S + int(pvt.nano) + GPS_MINUS_UNIX_S * S


def test_gnss_times_agree_with_each_other_and_lie_on_whole_periods() -> None:
    messages = parsed(joined(gnss_chunks()))
    week = next(m.week for m in messages if m.identity == "NAV-TIMEGPS")
    for message in messages:
        assert round(message.iTOW) % 200 == 0
        if message.identity == "NAV-PVT":
            assert _gps_ns(message) == (week * 604_800_000 + message.iTOW) * 1_000_000
        if message.identity == "NAV-TIMEGPS":
            assert (message.week, message.leapS) == (week, 18)
    assert {m.identity for m in messages} == {
        "NAV-PVT", "NAV-COV", "NAV-TIMEGPS", "NAV-TIMELS", "NAV-SAT", "NAV-EOE",
    }  # fmt: skip


def test_gnss_epochs_come_late_by_receiver_delay_and_line_time() -> None:
    device = GnssDevice()
    framer = Framer()
    for chunk in gnss_chunks(device=device):
        for frame in framer.feed(chunk.data):
            assert isinstance(frame, Frame)
            itow_ms = int.from_bytes(frame.payload[:4], "little")
            if frame.name == "NAV-PVT":
                now_ms = (chunk.due_ns - 37_500_000 + GPS_MINUS_UNIX_S * S) / 1e6 % 604_800_000
                line_ms = 100 * 10 / device.baud_rate * 1e3
                late_ms = now_ms - itow_ms - device.delay_s * 1e3
                assert line_ms <= late_ms < line_ms + device.jitter_s * 1e3 + 1.0


@pytest.mark.parametrize("rate_hz", [1, 2, 5, 10])
def test_gnss_rate_is_the_one_asked_for(rate_hz: int) -> None:
    device = GnssDevice(rate_hz=rate_hz)
    fixes = total(gnss_chunks(device=device), "counts")["fixes"]
    assert fixes == pytest.approx(MINUTE_S * rate_hz, abs=1)


def test_gnss_faults_are_a_bad_checksum_and_a_pulled_plug() -> None:
    chunks = gnss_chunks(faults=Faults())
    assert total(chunks, "faults") == {"checksums_spoilt": 1, "unplugged": 1}
    cable = [(c.due_ns - START_NS) / S for c in chunks if c.cable is not Cable.AS_BEFORE]
    assert cable == [30.0, 33.0]
    items = Framer().feed(joined(chunks))
    rejected = [item.reason for item in items if not isinstance(item, Frame)]
    assert rejected == ["UBX checksum"]
    names = Counter(item.name for item in items if isinstance(item, Frame))
    assert names["NAV-PVT"] == total(chunks, "counts")["fixes"] == names["NAV-EOE"] - 1


def test_gnss_accuracies_are_those_of_the_errors() -> None:
    device = GnssDevice(errors=GnssErrors(horizontal_std_m=0.3, vertical_std_m=0.7))
    messages = parsed(joined(gnss_chunks(device=device)))
    pvt = next(m for m in messages if m.identity == "NAV-PVT")
    cov = next(m for m in messages if m.identity == "NAV-COV")
    assert pvt.hAcc / 1000 == pytest.approx(0.3 * math.sqrt(2), abs=0.001)
    assert pvt.vAcc / 1000 == pytest.approx(0.7)
    assert [cov.posCovNN, cov.posCovEE, cov.posCovDD] == pytest.approx([0.09, 0.09, 0.49])
