"""Captures of receivers that say less, otherwise, or what cannot be: what is in their records."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import pytest
from receivers import START_NS, posllh, sol, solution, status, velned

from tramstream import keys
from tramstream.analysis.tables.captures import Imports
from tramstream.bridges.gnss import ubx
from tramstream.bridges.gnss.framer import nmea_frame
from tramstream.clock import S
from tramstream.recorder.reader import open_record

PLACE = "5004.5{:04d},N,01426.26800,E"
SECONDS = 10


class Imported:
    """A capture as a record."""

    def __init__(self, folder: Path, data: bytes) -> None:
        source, self.path = folder / "capture", folder / "o.mcap"
        source.write_bytes(data)
        imports = Imports(None, "", "ADIS16465-1")
        imports.gnss(source)
        result = imports.write(self.path)
        self.device: dict[str, Any] = result["devices"]["gnss"]
        self.raw = b"".join(message.data for message in self.on(keys.GNSS_BYTES))
        self.fixes = self.on(keys.GNSS_FIX)
        self.locations = self.on(keys.GNSS_LOCATION)

    def on(self, key: keys.Key) -> list[Any]:
        with open_record(self.path) as record:
            return [record.decode(e) for e in record.messages(lambda t: t.endswith(key.path))]

    @property
    def steps_s(self) -> list[float]:
        return [(b.stamp_ns - a.stamp_ns) / S for a, b in itertools.pairwise(self.fixes)]


def rmc(second: int) -> str:
    place = PLACE.format(3000 + 10 * second)
    return f"GNRMC,1200{second:02d}.00,A,{place},3.60,90.00,040124,,,A,V"


def gga(second: int, separation: str = "45.0") -> str:
    place = PLACE.format(3000 + 10 * second)
    return f"GNGGA,1200{second:02d}.00,{place},1,09,1.1,200.0,M,{separation},M,,"


def lines(*texts: str, end: bytes = b"\r\n") -> bytes:
    return b"".join(nmea_frame(text).rstrip() + end for text in texts)


def whole(end: bytes = b"\r\n") -> bytes:
    return lines(*(text for k in range(SECONDS) for text in (rmc(k), gga(k))), end=end)


@pytest.mark.parametrize("end", [b"\r\n", b"\n", b"\n\n", b"\r\r\n", b"\r"], ids=repr)
def test_lines_may_end_as_they_like(tmp_path: Path, end: bytes) -> None:
    record = Imported(tmp_path, whole(end))
    assert len(record.fixes) == SECONDS
    assert record.steps_s == pytest.approx([1.0] * (SECONDS - 1), abs=1e-6)
    assert (record.device["frames_rejected"], record.device["bytes_rejected"]) == (0, 0)
    assert record.raw == whole(end)


def test_capture_may_end_right_behind_the_checksum(tmp_path: Path) -> None:
    assert len(Imported(tmp_path, whole().rstrip()).fixes) == SECONDS


@pytest.mark.parametrize("sentence", [rmc, gga], ids=["RMC", "GGA"])
def test_one_sentence_is_enough(tmp_path: Path, sentence: Any) -> None:
    record = Imported(tmp_path, lines(*(sentence(k) for k in range(SECONDS))))
    assert len(record.fixes) == SECONDS
    assert all(fix.valid for fix in record.fixes)
    assert record.fixes[0].latitude_deg == pytest.approx(50 + 4.53 / 60, abs=1e-9)
    assert sum(record.steps_s) == pytest.approx(SECONDS - 1, abs=1e-3)


def test_height_without_the_separation_is_not_above_the_ellipsoid(tmp_path: Path) -> None:
    record = Imported(tmp_path, lines(*(gga(k, "") for k in range(SECONDS))))
    assert [fix.HasField("height_ellipsoid_m") for fix in record.fixes] == [False] * SECONDS
    assert {fix.height_msl_m for fix in record.fixes} == {200.0}
    assert all(math.isnan(location.altitude) for location in record.locations)


def test_what_is_said_before_the_first_fix_is_not_rejected(tmp_path: Path) -> None:
    cold = ["GNRMC,,V,,,,,,,,,,N,V", "GNGGA,,,,,,0,00,99.99,,,,,,",
            "GNGSA,A,1,,,,,,,,,,,,,99.99,99.99,99.99,1"]  # fmt: skip
    record = Imported(tmp_path, lines(*cold * 10) + whole())
    assert record.device["frames_rejected"] == 0
    assert len(record.fixes) == SECONDS


def test_date_that_cannot_be_costs_its_sentence(tmp_path: Path) -> None:
    record = Imported(tmp_path, lines("GPZDA,120000.00,999999999999,03,2022,00,00") + whole())
    assert record.device["rejected_by_reason"] == {"NMEA not understood": 1}
    assert len(record.fixes) == SECONDS
    (tmp_path / "o.mcap").unlink()
    assert Imported(tmp_path, lines("GPZDA,120000.00,99,03,2022,00,00")).fixes == []


def test_clock_that_begins_in_1980_makes_the_ride_no_longer(tmp_path: Path) -> None:
    cold = [f"GPRMC,0000{s}.00,V,,,,,,,060180,,,N" for s in range(12, 20)]
    cold += [f"GPGGA,0000{s}.00,,,,,0,00,99.99,,,,,," for s in range(12, 20)]
    record = Imported(tmp_path, lines(*sorted(cold, key=lambda text: text[6:12])) + whole())
    span_s = (record.fixes[-1].stamp_ns - record.fixes[0].stamp_ns) / S
    assert span_s == pytest.approx(SECONDS - 1, abs=1e-3)
    assert {fix.utc_ns for fix in record.fixes if not fix.valid} == {0}
    assert min(record.steps_s) > 0.0


@pytest.mark.parametrize(
    "makers", [(sol,), (sol, posllh, velned, status), (posllh, velned, status)]
)
def test_receivers_before_nav_pvt_give_fixes(tmp_path: Path, makers: Any) -> None:
    times = [START_NS + k * S // 4 for k in range(20)]
    data = b"".join(maker(gps_ns) for gps_ns in times for maker in makers)
    record = Imported(tmp_path, data)
    assert len(record.fixes) == 20
    assert all(fix.valid for fix in record.fixes)
    if sol in makers:
        assert record.steps_s == pytest.approx([0.25] * 19, abs=1e-6)


def test_navigation_of_u_blox_7_gives_fixes(tmp_path: Path) -> None:
    data = b"".join(solution(START_NS + k * S // 5, "NAV-PVT u-blox 7") for k in range(10))
    record = Imported(tmp_path, data)
    assert len(record.fixes) == 10
    assert record.device["frames_rejected"] == 0


def test_end_that_a_false_header_hides_is_decoded_and_counted(tmp_path: Path) -> None:
    epochs = [solution(START_NS + k * S // 5) for k in range(120)]
    header = b"\xb5\x62\x02\x15" + (8176).to_bytes(2, "little") + bytes(11) + b"\xff" + bytes(4)
    data = b"".join(epochs[:100]) + header + b"".join(epochs[100:])
    record = Imported(tmp_path, data)
    assert len(record.fixes) == 120
    assert record.device["bytes_rejected"] == len(header)
    assert record.raw == data


def test_bytes_are_in_the_record_in_the_order_of_the_file(tmp_path: Path) -> None:
    times = [START_NS + k * S // 5 for k in range(50)]
    data = b"".join(solution(t) for t in [*times, *(t - 40 * S for t in times)])
    record = Imported(tmp_path, data)
    assert record.raw == data
    assert len(record.fixes) == 100
    assert record.steps_s == pytest.approx([0.2] * 99, abs=1e-3)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -1.0])
def test_covariance_that_is_none_is_not_called_known(tmp_path: Path, wrong: float) -> None:
    fields = {"iTOW": START_NS // 10**6 % 604_800_000, "posCovValid": 1, "posCovNN": wrong}
    cov = ubx.encode("NAV-COV", fields | {"posCovEE": 1.0, "posCovDD": 1.0})
    (location,) = Imported(tmp_path, cov + solution(START_NS)).locations
    assert location.position_covariance_type == location.DIAGONAL_KNOWN
    assert all(map(math.isfinite, location.position_covariance))
