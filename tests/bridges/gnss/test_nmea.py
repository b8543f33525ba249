"""NMEA sentences to fixes."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pynmeagps import NMEAReader

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


# What a receiver does not say ---------------------------------------------------------------------
POSITION = "4404.13387,N,12118.85628,W"


def fixes_of(*sentences: str) -> list[GnssFix]:
    """Fixes of a whole stream, the last epoch included."""
    assembler = EpochAssembler()
    epochs: list[Epoch] = []
    for number, text in enumerate(sentences):
        sentence = parse(frame(text))
        assert not isinstance(sentence, Rejected), text
        epochs += assembler.feed(sentence, number, len(text))
    return [fix_of(epoch, MAX_ACCURACY_M) for epoch in epochs + assembler.flush()]


def place_of(fix: GnssFix) -> tuple[float, float]:
    return fix.latitude_deg, fix.longitude_deg


PLACE = pytest.approx((44 + 4.13387 / 60, -(121 + 18.85628 / 60)), abs=1e-9)


@pytest.mark.parametrize(
    "sentences",
    [
        [f"GNRMC,0009{s:02d}.00,A,{POSITION},0.029,77.1,100117,,,A" for s in range(3)],
        [f"GPRMC,0009{s:02d},A,{POSITION},0.029,77.1,100117,,E" for s in range(3)],
        [f"GNGLL,{POSITION},0009{s:02d}.00,A,A" for s in range(3)],
        [f"GPGLL,{POSITION},0009{s:02d},A" for s in range(3)],
        [f"GNGNS,0009{s:02d}.00,{POSITION},AN,12,1.0,1144.8,-21.4,,,V" for s in range(3)],
    ],
    ids=["RMC", "RMC of NMEA 2.0", "GLL", "GLL of NMEA 2.0", "GNS"],
)
def test_each_sentence_with_a_position_makes_a_fix_alone(sentences: list[str]) -> None:
    fixes = fixes_of(*sentences)
    assert len(fixes) == 3
    assert all(fix.valid for fix in fixes)
    assert [place_of(fix) for fix in fixes] == [PLACE] * 3


def test_gll_makes_the_epochs_that_have_nothing_else() -> None:
    """As chart plotters send: RMC in odd seconds, GLL in even ones."""
    fixes = fixes_of(
        f"INRMC,000901,A,{POSITION},5.2,77.3,100117,,",
        f"INGLL,{POSITION},000902,A",
        f"INRMC,000903,A,{POSITION},5.2,77.3,100117,,",
        f"INGLL,{POSITION},000903,A",
    )
    assert len(fixes) == 3
    assert [fix.speed_mps > 0 for fix in fixes] == [True, False, True]


def test_position_of_rmc_counts_only_where_gga_has_none() -> None:
    rmc = "GNRMC,000941.00,A,1000.0,N,02000.0,E,0.029,77.1,100117,,,A"
    gga = f"GNGGA,000941.00,{POSITION},1,12,1.01,1144.8,M,-21.4,M,,"
    assert [place_of(fix) for fix in fixes_of(rmc, gga)] == [PLACE]
    assert [place_of(fix) for fix in fixes_of(gga, rmc)] == [PLACE]


def test_height_above_the_ellipsoid_needs_the_separation() -> None:
    (fix,) = fixes_of(f"GNGGA,000941.00,{POSITION},1,12,1.01,1144.8,M,,M,,")
    assert fix.valid
    assert fix.fix_type == GnssFix.FIX_3D
    assert fix.height_msl_m == 1144.8
    assert not fix.HasField("height_ellipsoid_m")


def test_fix_without_altitude_is_one_of_two_dimensions() -> None:
    (fix,) = fixes_of(f"GNGGA,000941.00,{POSITION},1,12,1.01,,M,-21.4,M,,")
    assert fix.valid
    assert fix.fix_type == GnssFix.FIX_2D
    assert not fix.HasField("height_ellipsoid_m")
    assert not fix.HasField("height_msl_m")
    assert fix.vertical_std_m == 0.0


@pytest.mark.parametrize("dilution", ["", "0", "0.0", "0.01", "0.2"])
def test_dilution_that_cannot_be_states_no_deviation(dilution: str) -> None:
    (fix,) = fixes_of(f"GNGGA,000941.00,{POSITION},1,12,{dilution},1144.8,M,-21.4,M,,")
    assert fix.valid
    assert fix.horizontal_std_m == fix.vertical_std_m == 0.0  # not stated


def test_deviations_of_zero_are_none() -> None:
    gga = f"GNGGA,000941.00,{POSITION},1,12,1.01,1144.8,M,-21.4,M,,"
    fix = fixes_of(gga, "GNGST,000941.00,0,0,0,0,0.0,0.0,0.0")[0]
    assert fix.horizontal_std_m == pytest.approx(1.01 * RANGE_STD_M)


@pytest.mark.parametrize("quality", [0, 1, 4])
def test_place_at_zero_zero_is_none(quality: int) -> None:
    (fix,) = fixes_of(f"GPGGA,235951.952,0000.0000,N,00000.0000,E,{quality},00,,0.0,M,0.0,M,,0000")
    assert fix.invalid_llh
    assert not fix.valid
    (fix,) = fixes_of(f"GPGGA,235951.952,0000.0000,N,00001.0000,E,{quality},05,1,0.0,M,0.0,M,,")
    assert not fix.invalid_llh  # on the equator, off Gabon
    assert fix.valid == (quality > 0)


def test_what_is_said_before_the_first_fix_is_understood_and_makes_none() -> None:
    cold = ("GNRMC,,V,,,,,,,,,,N,V", "GNGGA,,,,,,0,00,99.99,,,,,,", "GNGLL,,,,,,V,N",
            "GNGSA,A,1,,,,,,,,,,,,,99.99,99.99,99.99,1", "GNVTG,,,,,,,,,N", "GNZDA,,,,,00,00",
            "GNGST,,,,,,,,", "GNGNS,,,,,,NN,00,99.99,,,,,,V")  # fmt: skip
    assert fixes_of(*cold) == []
    assert len(fixes_of(*cold, *second(41))) == 1


@pytest.mark.parametrize("date", ["060180", "050180", "220899", "311294", "000000", "2208-1"])
def test_date_of_a_receiver_without_a_fix_is_none(date: str) -> None:
    """Clocks that begin in 1980, weeks that begin in 1999, firmware that has lost the century."""
    epochs = epochs_of(
        f"GPRMC,000012.00,V,,,,,,,{date},,,N", "GPGGA,000012.00,,,,,0,00,99.99,,,,,,",
        f"GPRMC,000013.00,V,,,,,,,{date},,,N", f"GPRMC,120000.00,A,{POSITION},0,0,040124,,,A",
        f"GPRMC,120001.00,A,{POSITION},0,0,040124,,,A",
    )  # fmt: skip
    assert [epoch.date for epoch in epochs[:2]] == [0, 0]
    assert epochs[2].utc_ns == 1_704_369_600_000_000_000  # 2024-01-04T12:00:00Z


@pytest.mark.parametrize("date", ["060180", "311294", "000000"])
def test_date_before_gps_was_complete_is_none_whoever_says_it(date: str) -> None:
    (first, *_) = epochs_of(
        *(f"GPRMC,12000{s}.00,A,{POSITION},0,0,{date},,,A" for s in range(2))
    )  # fmt: skip
    assert first.date == 0


def test_times_of_day_count_on_where_no_date_is_told() -> None:
    gga = f"{POSITION},1,12,1.01,1144.8,M,-21.4,M,,"
    times = ("235958.00", "235959.50", "000001.00", "000002.00")
    epochs = epochs_of(*(f"GNGGA,{time},{gga}" for time in times))
    assert [epoch.date for epoch in epochs] == [0] * 4
    assert [(b.utc_ns - a.utc_ns) / 1e9 for a, b in itertools.pairwise(epochs)] == [1.5, 1.5, 1.0]
    assert min(epoch.utc_ns for epoch in epochs) > 0


def test_date_sentence_of_another_time_makes_no_epoch_of_its_own() -> None:
    """As a receiver of 2007 that sends ZDA two seconds ahead."""
    stream = [
        text
        for s in range(21, 25)
        for text in (
            f"GPGGA,1932{s}.00,{POSITION},1,04,1.7,-30.40,M,-13.9,M,,",
            f"GPRMC,1932{s}.00,A,{POSITION},00.1,201.8,231207,01,W,A",
            f"GPZDA,1932{s + 2}.00,23,12,2007,00,00",
        )
    ]
    epochs = epochs_of(*stream)
    assert [epoch.time_of_day_ns // 10**9 % 60 for epoch in epochs] == [21, 22, 23, 24]


def test_date_that_comes_ahead_of_the_position_of_its_epoch_is_its_date() -> None:
    zda, gga = "GNZDA,000941.00,10,01,2017,00,00", f"GNGGA,000941.00,{POSITION},1,12,1.0,1,M,2,M,,"
    gst = "GNGST,000941.00,32,0.5,0.4,12,0.03,0.04,0.12"
    assembler = EpochAssembler()
    for text in (zda, gst):
        sentence = parse(frame(text))
        assert not isinstance(sentence, Rejected)
        assert assembler.feed(sentence, 0, 0) == []
    moved = copied(assembler)
    sentence = parse(frame(gga))
    assert not isinstance(sentence, Rejected)
    moved.feed(sentence, 5, 0)
    (epoch,) = moved.flush()
    assert epoch.utc_ns == 1_484_006_981_000_000_000
    assert epoch.std_m == [0.03, 0.04, 0.12]


@pytest.mark.parametrize(
    "sentence",
    [
        "GPZDA,120000.00,999999999999,03,2022,00,00", "GPZDA,120000.00,31,02,2022,00,00",
        "GPZDA,120000.00,1,1,99999,00,00", f"GPGGA,120000.00,{POSITION},1,12,{'9' * 400},1,M,1,M,,",
        f"GPGGA,120000.00,{'1' * 400},N,12118.85628,W,1,12,1,1,M,1,M,,",
        "GPGGA,120000.00,4460.0,N,12118.8,W,1,12,1,1,M,1,M,,",
        "GPGGA,120000.00,4404.1,E,12118.8,W,1,12,1,1,M,1,M,,",
        "GPGGA,120000.00,nan,N,12118.8,W,1,12,1,1,M,1,M,,",
        "GPGGA,1e5,4404.1,N,12118.8,W,1,12,1,1,M,1,M,,",
    ],
)  # fmt: skip
def test_sentence_that_holds_what_cannot_be_is_rejected(sentence: str) -> None:
    assert parse(frame(sentence)) == Rejected("NMEA not understood", 0, len(frame(sentence).raw))


@pytest.mark.parametrize(
    ("letter", "mode", "valid"),
    [
        ("A", GnssFix.AUTONOMOUS, True), ("D", GnssFix.DIFFERENTIAL, True),
        ("R", GnssFix.RTK_FIXED, True), ("F", GnssFix.RTK_FLOAT, True),
        ("P", GnssFix.PRECISE, True), ("E", GnssFix.ESTIMATED, False),
        ("M", GnssFix.MANUAL, False), ("S", GnssFix.SIMULATED, False),
        ("N", GnssFix.NOT_VALID, False),
    ],
)  # fmt: skip
def test_mode_indicator_is_told_and_heeded(letter: str, mode: Any, valid: bool) -> None:
    (fix,) = fixes_of(f"GNRMC,000941.00,A,{POSITION},0.029,77.1,100117,,,{letter},V")
    assert (fix.faa_mode, fix.valid) == (mode, valid)


def test_age_of_corrections_and_their_station_are_told() -> None:
    (fix,) = fixes_of(f"GNGGA,000941.00,{POSITION},4,12,0.6,1144.8,M,-21.4,M,1.2,0123")
    assert fix.correction_age_s == 1.2
    assert fix.reference_station == 123
    (fix,) = fixes_of(f"GNGGA,000941.00,{POSITION},1,12,0.6,1144.8,M,-21.4,M,,0000")
    assert not fix.HasField("correction_age_s")
    assert not fix.HasField("reference_station")


@pytest.mark.parametrize("seed", range(3))
def test_sentences_are_read_as_pynmeagps_reads_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(100):
        angle = rng.uniform([-90, -180], [90, 180])
        degrees, minutes = np.divmod(np.abs(angle) * 60, 60)
        latitude = f"{int(degrees[0]):02d}{minutes[0]:08.5f},{'NS'[int(angle[0] < 0)]}"
        longitude = f"{int(degrees[1]):03d}{minutes[1]:08.5f},{'EW'[int(angle[1] < 0)]}"
        if "60.00000" in latitude + longitude:
            continue
        text = (
            f"GNGGA,1159{rng.uniform(0, 59.9):05.2f},{latitude},{longitude},1,12,1.5,-3.1,M,44,M,,"
        )
        ours, theirs = parse(frame(text)), NMEAReader.parse(nmea_frame(text))
        assert not isinstance(ours, Rejected)
        assert theirs is not None
        read = [ours.values[name] for name in ("latitude_deg", "longitude_deg", "altitude_m")]
        assert read == pytest.approx([theirs.lat, theirs.lon, theirs.alt], abs=1e-9)
        assert ours.time_ns is not None
        told = theirs.time
        seconds = told.hour * 3600 + told.minute * 60 + told.second + told.microsecond / 1e6
        assert ours.time_ns / 1e9 == pytest.approx(seconds, abs=1e-6)
