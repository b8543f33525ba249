"""Free-running counters where frames are missing or an ECU starts anew, against the way gone."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from tramstream import keys
from tramstream.bridges.odometer.bridge import NOTE_UNKNOWN, OdometerBridge
from tramstream.bridges.odometer.frames import CanFrame, pack
from tramstream.bridges.odometer.wheels import UNKNOWN_WAY
from tramstream.config import Odometer, Vehicle, Wheel
from tramstream.processor import Sample
from tramstream.proto.raw_pb2 import Odometry

M_PER_PULSE = 0.00092038845
DBC = (
    'VERSION ""\nNS_ :\nBS_:\nBU_: ECU\n'
    'BO_ 256 WHEEL: 8 ECU\n SG_ COUNT : 0|16@1+ (1,0) [0|0] "" ECU\n'
)


def bridge(tmp_path: Path, bits: int) -> OdometerBridge:
    path = tmp_path / "x.dbc"
    path.write_text(DBC)
    wheel = Wheel(message="WHEEL", signal="COUNT", kind="counter", counter_bits=bits)
    odometer = Odometer(channel="can0", dbc=str(path), wheels={"w": wheel})
    return OdometerBridge(Vehicle(vehicle="t", odometer=odometer))


def frames(counts: list[tuple[float, int]], bits: int) -> list[CanFrame]:
    """Frames at seconds with a total of pulses, of which the counter shows the last bits."""
    return [
        CanFrame(
            10**18 + round(time_s * 1e9), "can0", 256, 0,
            (count % (1 << bits)).to_bytes(2, "little") + bytes(6),
        )
        for time_s, count in counts
    ]  # fmt: skip


def run(node: OdometerBridge, sent: list[CanFrame]) -> tuple[list[int], list[int]]:
    """Pulses of the readings, and of the ways between them those that are known."""
    message = pack(sent, "can0")
    out = node.step(Sample(keys.ODO_FRAMES, message, message.stamp_ns, 1))
    readings: list[Odometry] = [each.message for each in out if each.key is keys.ODO_WHEELS]
    pulses = [reading.wheels[0].pulses for reading in readings]
    steps = [after - before for before, after in pairwise(pulses)]
    return pulses, [step for step in steps if step > -UNKNOWN_WAY // 2]


def riding(speed_mps: float, times: list[float]) -> list[tuple[float, int]]:
    return [(time_s, round(speed_mps * time_s / M_PER_PULSE)) for time_s in times]


def every(period_s: float, until_s: float, start_s: float = 0.0) -> list[float]:
    return [start_s + k * period_s for k in range(round((until_s - start_s) / period_s))]


@pytest.mark.parametrize("bits", [12, 16])
@pytest.mark.parametrize("speed_mps", [0.0, 5.0, 15.0, -3.0])
def test_gap_that_the_speed_before_bridges_has_its_way(
    tmp_path: Path, bits: int, speed_mps: float
) -> None:
    """At 15 m/s a counter of 12 bits goes through 80 % of its range in 0.2 s: more than half."""
    times = [*every(0.02, 2.0), *every(0.02, 3.0, 2.2)]
    counts = riding(speed_mps, times)
    node = bridge(tmp_path, bits)
    pulses, known = run(node, frames(counts, bits))
    assert len(known) == len(times) - 1
    assert pulses[-1] == counts[-1][1]
    assert NOTE_UNKNOWN not in node.device_counters()["rejected_by_reason"]


@pytest.mark.parametrize(("bits", "gap_s"), [(12, 1.0), (12, 5.0), (16, 6.0), (16, 60.0)])
@pytest.mark.parametrize("speed_mps", [0.0, 8.0, -2.0, 15.0])
def test_way_over_a_gap_longer_than_half_the_range_is_not_known(
    tmp_path: Path, bits: int, gap_s: float, speed_mps: float
) -> None:
    times = [*every(0.02, 1.0), *every(0.02, 2.0 + gap_s, 1.0 + gap_s)]
    counts = riding(speed_mps, times)
    node = bridge(tmp_path, bits)
    pulses, known = run(node, frames(counts, bits))
    assert len(known) == len(times) - 2
    assert sum(known) == counts[-1][1] - counts[50][1] + counts[49][1]
    assert pulses[50] - pulses[49] == -UNKNOWN_WAY
    assert node.device_counters()["rejected_by_reason"] == {NOTE_UNKNOWN: 1}


@pytest.mark.parametrize("count", [20_000, 33_000, 61_000])
@pytest.mark.parametrize("gap_s", [0.02, 0.6, 1.5])
def test_ecu_that_starts_anew_while_riding_tells_no_way(
    tmp_path: Path, count: int, gap_s: float
) -> None:
    before = [(t, count + n) for t, n in riding(10.0, every(0.02, 2.0))]
    shown = before[-1][1] % 65_536
    after = [(2.0 + gap_s + t, n) for t, n in riding(10.0, every(0.02, 1.0))]
    node = bridge(tmp_path, 16)
    pulses, known = run(node, frames(before + after, 16))
    natural_m = ((0 - shown + 32_768) % 65_536 - 32_768) * M_PER_PULSE
    assert abs(natural_m - 10.0 * gap_s) > 2.0  # else nobody could tell
    assert len(known) == len(before) + len(after) - 2
    assert node.device_counters()["rejected_by_reason"] == {NOTE_UNKNOWN: 1}
    assert pulses[-1] == pulses[len(before)] + after[-1][1]


def test_counter_that_does_not_know_its_speed_is_bridged_over_short_gaps_only(
    tmp_path: Path,
) -> None:
    node = bridge(tmp_path, 16)
    _, known = run(node, frames([(0.0, 100), (0.2, 2000), (5.0, 9000)], 16))
    assert known == [1900]


def test_whoever_reads_pulses_begins_anew_where_the_way_is_not_known(tmp_path: Path) -> None:
    """The fall is faster than any wheel, in any pause in which a path may be counted on."""
    from tramstream.processors.tram_sources.wheels import LONGEST_COUNTED_S, MAX_MPS

    assert UNKNOWN_WAY * M_PER_PULSE > 1000 * MAX_MPS * LONGEST_COUNTED_S
