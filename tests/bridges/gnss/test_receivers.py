"""What each generation of receivers gives: docs/receivers.md is held to what comes out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from google.protobuf.message import Message
from receivers import (
    START_NS,
    decoded,
    dop,
    itow_ms,
    on,
    posllh,
    sentences,
    sol,
    solution,
    status,
    timeutc,
    velned,
)

from tramstream import keys
from tramstream.bridges.gnss import ubx
from tramstream.bridges.gnss.clock import WEEK_NS
from tramstream.clock import S
from tramstream.processor import Sample

PAGE = Path(__file__).resolve().parents[3] / "docs" / "receivers.md"
Maker = Callable[[int], bytes]


def nmea(*kinds: str) -> Maker:
    return lambda gps_ns: sentences(gps_ns, *kinds)


def pvt(gps_ns: int) -> bytes:
    return solution(gps_ns)


def pvt_u7(gps_ns: int) -> bytes:
    return solution(gps_ns, "NAV-PVT u-blox 7")


def hnr(gps_ns: int) -> bytes:
    return solution(gps_ns, "HNR-PVT")


def cov(gps_ns: int) -> bytes:
    fields = {"iTOW": itow_ms(gps_ns), "posCovValid": 1}
    return ubx.encode("NAV-COV", fields | {f"posCov{axis}": 1.0 for axis in ("NN", "EE", "DD")})


def timegps(gps_ns: int) -> bytes:
    week = gps_ns // WEEK_NS
    return ubx.encode(
        "NAV-TIMEGPS", {"iTOW": itow_ms(gps_ns), "week": week, "leapS": 18, "valid": 7}
    )


def rxm_raw(gps_ns: int) -> bytes:
    return ubx.encode("RXM-RAW", {"iTOW": itow_ms(gps_ns), "week": gps_ns // WEEK_NS}, [{"sv": 7}])


def rawx(gps_ns: int) -> bytes:
    tow_s = gps_ns % WEEK_NS / 1e9
    return ubx.encode("RXM-RAWX", {"rcvTow": tow_s, "week": gps_ns // WEEK_NS}, [{"svId": 7}])


def hardware(_: int) -> bytes:
    return ubx.encode("MON-HW", {"jamInd": 5, "flags": 1 << 2})


def radio(_: int) -> bytes:
    return ubx.encode("MON-RF", {}, [{"flags": 1}])


def security(_: int) -> bytes:
    return ubx.encode("SEC-SIG", {"sigSecFlags": 0b0011011})


def security_1(_: int) -> bytes:
    return ubx.encode("SEC-SIG version 1", {"jamFlags": 3, "spfFlags": 3})


def protection(gps_ns: int) -> bytes:
    return ubx.encode("NAV-PL", {"iTOW": itow_ms(gps_ns), "plPosValid": 1})


GENERATIONS: dict[str, tuple[Maker, ...]] = {
    "any, NMEA RMC": (nmea("RMC"),),
    "any, NMEA GGA": (nmea("GGA"),),
    "any, NMEA RMC, GGA, GST": (nmea("RMC", "GGA", "GST"),),
    "u-blox 4: NAV-SOL, RXM-RAW": (sol, rxm_raw, timegps),
    "u-blox 5, 6: NAV-SOL, NAV-POSLLH, NAV-VELNED, MON-HW": (sol, posllh, velned, hardware),
    "u-blox 5, 6: NAV-POSLLH, NAV-STATUS, NAV-DOP, NAV-TIMEUTC": (posllh, status, dop, timeutc),
    "u-blox 5, 6: NAV-POSLLH alone": (posllh,),
    "u-blox 7: NAV-PVT (84 bytes)": (pvt_u7, hardware),
    "u-blox 8, M8: NAV-PVT, MON-HW": (pvt, hardware),
    "u-blox M8L, M8U: HNR-PVT alone": (hnr,),
    "u-blox M8T, M8P: NAV-PVT, RXM-RAWX, SEC-SIG version 1": (pvt, rawx, security_1),
    "u-blox 9, F9: NAV-PVT, NAV-COV, RXM-RAWX, MON-RF, SEC-SIG": (pvt, cov, rawx, radio, security),
    "u-blox F9R, F10: NAV-PVT, NAV-PL, MON-RF": (pvt, protection, radio),
}
STATES = {
    keys.GNSS_INTERFERENCE: "jamming, spoofing", keys.GNSS_PROTECTION: "protection levels",
    keys.GNSS_DILUTION: "dilutions",
}  # fmt: skip


def row(name: str, makers: tuple[Maker, ...]) -> str:
    """One line of the page's table, out of what comes of four epochs, the last of them."""
    reads = [b"".join(maker(START_NS + k * S) for maker in makers) for k in range(4)]
    out = decoded(*reads)
    fix = on(out, keys.GNSS_FIX)[-1]
    assert fix.valid, name
    cells = [name, _position(fix), _velocity(fix), _time(fix), _deviations(fix, out)]
    cells.append("yes" if on(out, keys.GNSS_MEASUREMENTS) else "–")
    cells.append(", ".join(word for key, word in STATES.items() if _says(out, key)) or "–")
    return "| " + " | ".join(cells) + " |"


def _says(out: list[Sample], key: keys.Key) -> bool:
    return bool(on(out, key))


def _position(fix: Message) -> str:
    if fix.HasField("height_ellipsoid_m"):
        return "3D"
    return "2D, height above the sea" if fix.HasField("height_msl_m") else "2D"


def _velocity(fix: Message) -> str:
    if fix.HasField("vel_n_mps"):
        return "north, east, down"
    return "speed, course" if fix.speed_mps > 0.0 else "–"  # type: ignore[attr-defined]


def _time(fix: Message) -> str:
    told = [
        word
        for word, known in (("GPS", fix.HasField("gps_time_ns")), ("UTC", fix.utc_ns != 0))  # type: ignore[attr-defined]
        if known
    ]
    return ", ".join(told) or "–"


def _deviations(fix: Message, out: list[Sample]) -> str:
    if on(out, keys.GNSS_COVARIANCE):
        return "covariance"
    if fix.horizontal_std_m == 0.0:  # type: ignore[attr-defined]
        return "–"
    velocity = fix.speed_std_mps > 0.0  # type: ignore[attr-defined]
    return "position, velocity" if velocity else "position"


HEAD = (
    "| receiver and what it sends | position | velocity | time | σ | raw | state |\n"
    "|---|---|---|---|---|---|---|"
)


def test_table_of_generations_is_that_of_what_comes_out() -> None:
    table = "\n".join([HEAD, *(row(name, makers) for name, makers in GENERATIONS.items())])
    assert table in PAGE.read_text(), f"docs/receivers.md wants this table:\n{table}"


@pytest.mark.parametrize("name", GENERATIONS)
def test_every_generation_gives_one_fix_an_epoch_at_its_place(name: str) -> None:
    makers = GENERATIONS[name]
    reads = [b"".join(maker(START_NS + k * S) for maker in makers) for k in range(6)]
    fixes = on(decoded(*reads), keys.GNSS_FIX)
    assert len(fixes) == 6
    for fix in fixes:
        assert fix.valid
        assert abs(fix.latitude_deg - 50.0870001) < 1e-7
        assert abs(fix.longitude_deg - 14.4212349) < 1e-7
    stamps = [fix.stamp_ns for fix in fixes]
    assert stamps == sorted(set(stamps))
