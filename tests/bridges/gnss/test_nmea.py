"""NMEA sentences to fixes."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tramstream.bridges.gnss.framer import NMEA, Frame, Framer, Rejected, nmea_frame
from tramstream.bridges.gnss.nmea import (
    RANGE_STD_M,
    Epoch,
    EpochAssembler,
    fix_of,
)
from tramstream.bridges.gnss.nmea_sentences import parse, sentence_type
from tramstream.memory.stage import copied
from tramstream.proto.gnss_pb2 import GnssFix

CENTIMETRE = 0.01
MAX_ACCURACY_M = 100.0


def frame(sentence: str) -> Frame:
    raw = nmea_frame(sentence)
    return Frame(NMEA, 0, raw, len(raw) - 1)


def epochs_of(*sentences: str) -> list[Epoch]:
    """Complete epochs, arrivals being the numbers of the sentences."""
    assembler = EpochAssembler()
    out: list[Epoch] = []
    for number, text in enumerate(sentences):
        sentence = parse(frame(text))
        assert not isinstance(sentence, Rejected)
        out += assembler.feed(sentence, number, len(text))
    return out


def second(s: int, quality: int = 1) -> tuple[str, str, str, str]:
    """One epoch in the order of a u-blox receiver (ublox-8.log)."""
    return (
        f"GNRMC,0009{s:02d}.00,A,4404.13387,N,12118.85628,W,0.029,77.1,100117,,,A",
        "GNVTG,,T,,M,9.99,N,0.053,K,A",
        f"GNGGA,0009{s:02d}.00,4404.13387,N,12118.85628,W,{quality},12,1.01,1144.8,M,-21.4,M,,",
        "GNGSA,A,3,23,09,16,07,26,03,27,22,,,,,1.71,1.01,1.38",
    )


def test_ellipsoidal_height_is_altitude_plus_separation() -> None:
    epoch = epochs_of(*second(41), *second(42))[0]
    fix = fix_of(epoch, MAX_ACCURACY_M)
    # 44° 04.13387' N, 121° 18.85628' W
    assert fix.latitude_deg == pytest.approx(44 + 4.13387 / 60, abs=1e-9)
    assert fix.longitude_deg == pytest.approx(-(121 + 18.85628 / 60), abs=1e-9)
    assert fix.height_msl_m == 1144.8
    assert fix.height_ellipsoid_m == pytest.approx(1123.4, abs=CENTIMETRE)
    assert fix.valid
    assert fix.fix_type == GnssFix.FIX_3D
    assert fix.satellites_used == 12
    assert fix.speed_mps == pytest.approx(0.029 * 1852 / 3600)  # of RMC, not of VTG
    assert fix.course_deg == 77.1
    assert fix.pdop == 1.71
    assert fix.horizontal_std_m == pytest.approx(1.01 * RANGE_STD_M)
    assert fix.vertical_std_m == pytest.approx(1.38 * RANGE_STD_M)
    assert epoch.utc_ns == 1_484_006_981_000_000_000  # 2017-01-10T00:09:41Z


def test_empty_course_is_no_course_to_the_north() -> None:
    rmc, vtg, *others = second(41)
    (fix,) = [
        fix_of(epoch, MAX_ACCURACY_M)
        for epoch in epochs_of(rmc.replace(",77.1,", ",,"), vtg, *others, *second(42))
    ][:1]
    assert fix.speed_mps > 0.0
    assert fix.course_std_deg == 180.0
    assert fix_of(epochs_of(*second(41), *second(42))[0], MAX_ACCURACY_M).course_std_deg == 0.0


def test_epoch_is_complete_with_the_sentence_that_ended_the_one_before() -> None:
    stream = (*second(41), *second(42), *second(43))
    first, *others = epochs_of(*stream)
    assert first.last_arrival_ns == 3
    assert [epoch.last_arrival_ns for epoch in others] == [7, 11]  # not at the next epoch's RMC
    assert [epoch.first_arrival_ns for epoch in others] == [4, 8]


def test_lost_last_sentence_ends_the_epoch_with_the_next() -> None:
    epochs = epochs_of(*second(41), *second(42)[:-1], *second(43), *second(44))
    assert [epoch.time_of_day_ns // 10**9 % 60 for epoch in epochs] == [41, 42, 43, 44]


def test_deviations_come_from_gst_where_there_is_one() -> None:
    stream = (*second(41), "GNGST,000941.00,32,0.5,0.4,12,0.03,0.04,0.12", *second(42))
    fix = fix_of(epochs_of(*stream)[0], MAX_ACCURACY_M)
    assert fix.horizontal_std_m == pytest.approx(0.05)
    assert fix.vertical_std_m == 0.12


@pytest.mark.parametrize(
    ("quality", "fix_type", "carrier", "valid"),
    [
        (0, GnssFix.NO_FIX, GnssFix.NONE, False),
        (1, GnssFix.FIX_3D, GnssFix.NONE, True),
        (4, GnssFix.FIX_3D, GnssFix.FIXED, True),
        (5, GnssFix.FIX_3D, GnssFix.FLOAT, True),
        (6, GnssFix.DEAD_RECKONING, GnssFix.NONE, False),
    ],
)
def test_quality_decides_type_and_validity(
    quality: int, fix_type: Any, carrier: Any, valid: bool
) -> None:
    fix = fix_of(epochs_of(*second(41, quality), *second(42))[0], MAX_ACCURACY_M)
    assert (fix.fix_type, fix.carrier, fix.valid) == (fix_type, carrier, valid)


def test_receiver_without_position_gives_an_invalid_fix() -> None:
    stream = ("GNRMC,000941.00,V,,,,,,,100117,,,N", "GNGGA,000941.00,,,,,0,00,99.99,,,,,,")
    fix = fix_of(epochs_of(*stream, *second(42))[0], MAX_ACCURACY_M)
    assert not fix.valid
    assert fix.invalid_llh
    assert math.isfinite(fix.height_ellipsoid_m)


def test_date_is_kept_and_rolls_over_midnight() -> None:
    gga = "GNGGA,{},4404.13387,N,12118.85628,W,1,12,1.01,1144.8,M,-21.4,M,,"
    epochs = epochs_of(
        "GNRMC,235958.00,A,4404.13387,N,12118.85628,W,0.029,,311216,,,A",
        *(gga.format(time) for time in ("235959.00", "000000.00", "000001.00")),
    )
    midnight_ns = 1_483_228_800 * 10**9  # 2017-01-01T00:00:00Z
    assert [(epoch.utc_ns - midnight_ns) // 10**9 for epoch in epochs] == [-2, -1, 0, 1]


@pytest.mark.parametrize(
    "sentence",
    [
        "GNGGA", "GNGGA,", "GNGGA,,,,,,,,,,,,,,", "GNGGA,000941.00,x,N,y,W,z", "GNRMC,256161.00,A",
        "GNGGA,000960.00,4404.13387,N,12118.85628,W,1,12,1.01,1144.8,M,-21.4,M,,",
        "XXGGA,000941.00", "GGA", "GNGST,a,b,c,d,e,f,g,h",
    ],
)  # fmt: skip
def test_malformed_sentence_is_rejected_and_never_raises(sentence: str) -> None:
    parsed = parse(frame(sentence))
    # A sentence of an unknown kind is whole; it makes no fix.
    assert isinstance(parsed, Rejected) or EpochAssembler().feed(parsed, 0, 0) == []


@settings(max_examples=300)
@given(
    st.sampled_from(["GGA", "GNS", "RMC", "GST", "ZDA", "GSA", "VTG"]),
    st.lists(
        st.one_of(
            st.sampled_from(
                ["000941.00", "000942.50", "", "A", "N", "W", "100117", "nan", "1e999"]
            ),
            st.text(
                st.characters(min_codepoint=0x20, max_codepoint=0x7E, exclude_characters="$*,")
            ),
        ),
        max_size=16,
    ),
)
def test_no_sentence_raises(kind: str, words: list[str]) -> None:
    framer, assembler = Framer(), EpochAssembler()
    sentences = (f"GN{kind},{','.join(words)}", *second(43), *second(44))
    for item in framer.feed(b"".join(map(nmea_frame, sentences))):
        assert isinstance(item, Frame)
        sentence = parse(item)
        if not isinstance(sentence, Rejected):
            for epoch in assembler.feed(sentence, 0, 0):
                fix_of(epoch, MAX_ACCURACY_M).SerializeToString()


def test_proprietary_sentence_has_no_type() -> None:
    assert sentence_type(frame("PUBX,00,1")) == ""
    assert sentence_type(frame("GNGGA,1")) == "GGA"


def test_memory_can_be_moved_anywhere() -> None:
    stream = (*second(41), *second(42), *second(43))
    whole = epochs_of(*stream)
    for moved_at in range(len(stream)):
        assembler = EpochAssembler()
        out: list[Epoch] = []
        for number, text in enumerate(stream):
            if number == moved_at:
                assembler = copied(assembler)
            sentence = parse(frame(text))
            assert not isinstance(sentence, Rejected)
            out += assembler.feed(sentence, number, len(text))
        assert out == whole
