"""`tramstream evaluate` on records made by hand: what was put in is what is printed."""

from __future__ import annotations

import json
import math
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from looking import START_NS, VEHICLE, tramstream

from tramstream import config_file, keys
from tramstream.cli.evaluate import evaluate
from tramstream.clock import S
from tramstream.errors import CheckFailedError, ConfigError, DamagedRecordError, RecordError
from tramstream.geodesy import LocalLevel
from tramstream.keys import Key
from tramstream.proto.estimate_pb2 import DistanceState, GradeState, MotionState
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import TruthState
from tramstream.recorder.file.writer import RecordFile

LEVEL = LocalLevel.at_deg(50.0, 14.0, 250.0)
YAW_RAD, SPEED_MPS, DURATION_S = math.radians(30.0), 10.0, 60.0
FORWARD = np.array([math.cos(YAW_RAD), math.sin(YAW_RAD), 0.0])
LEFT = np.array([-math.sin(YAW_RAD), math.cos(YAW_RAD), 0.0])
UP = np.array([0.0, 0.0, 1.0])
VARIANCES = (0.25, 0.25, 1.0, 0.01, 1e-4, 1e-4, 1e-4)
MM = 1e-3
CONFIG = config_file.parse(
    b"""
vehicle = "4711"
[gnss]
device = "/dev/null"
lever_arm_m = [2.0, 0.0, 3.0]
[ekf]
integrity_risk = 0.01
""",
    "test",
    Path(),
)


@dataclass
class Off:
    """How far states are off, along, across, up, in speed and yaw."""

    along_m: float = 0.0
    across_m: float = 0.0
    up_m: float = 0.0
    speed_mps: float = 0.0
    yaw_rad: float = 0.0


def place(time_s: float, offset: np.ndarray) -> dict[str, float]:
    """Geodetic fields of the tram's place, moved by `offset` in `l`."""
    latitude, longitude, height = LEVEL.to_geodetic(SPEED_MPS * time_s * FORWARD + offset)
    return {
        "latitude_deg": math.degrees(latitude),
        "longitude_deg": math.degrees(longitude),
        "height_ellipsoid_m": height,
    }


def truth_at(time_s: float) -> TruthState:
    known = {"speed_mps": SPEED_MPS, "yaw_rad": YAW_RAD, "roll_rad": 0.0, "pitch_rad": 0.0}
    return TruthState(**place(time_s, 0 * UP), **known)


def state_at(time_s: float, off: Off) -> MotionState:
    offset = off.along_m * FORWARD + off.across_m * LEFT + off.up_m * UP
    rows = [[variance, *[0.0] * (6 - k)] for k, variance in enumerate(VARIANCES)]
    return MotionState(
        **place(time_s, offset),
        mode=MotionState.TRACKING,
        speed_mps=SPEED_MPS + off.speed_mps,
        yaw_rad=YAW_RAD + off.yaw_rad,
        protection_along_m=1.0,
        protection_across_m=2.0,
        covariance=[each for row in rows for each in row],
    )


def slope_at(time_s: float, grade_rad: float) -> GradeState:
    return GradeState(grade_rad=grade_rad, grade_std_rad=0.01, body_pitch_std_rad=0.01)


def fix_at(time_s: float, along_m: float) -> GnssFix:
    course_deg = 90.0 - math.degrees(YAW_RAD)
    offset = along_m * FORWARD + 3.0 * UP
    return GnssFix(**place(time_s, offset), valid=True, speed_mps=SPEED_MPS, course_deg=course_deg)


def series(key: Key, at: Any, period_s: float, *args: Any) -> list[tuple[Key, float, Any]]:
    times_s = np.arange(0.0, DURATION_S, period_s)
    return [(key, float(time_s), at(time_s, *args)) for time_s in times_s]


def truth() -> list[tuple[Key, float, Any]]:
    return series(keys.TRUTH_STATE, truth_at, 0.1)


def states(off: Off | None = None, key: Key = keys.EST_STATE) -> list[tuple[Key, float, Any]]:
    return series(key, state_at, 0.05, off or Off())


def fixes(along_m: float = 0.0) -> list[tuple[Key, float, Any]]:
    return series(keys.GNSS_FIX, fix_at, 1.0, along_m)


def write(path: Path, *parts: list[tuple[Key, float, Any]], **metadata: str) -> Path:
    sent = sorted((one for part in parts for one in part), key=lambda one: one[1])
    with RecordFile(path, VEHICLE, metadata) as record:
        for number, (key, time_s, message) in enumerate(sent):
            stamp_ns = START_NS + round(time_s * S)
            message.stamp_ns = stamp_ns
            payload = message.SerializeToString()
            record.append(key.on(VEHICLE), key, payload, stamp_ns, stamp_ns, number)
    return path


def judged(
    capsys: pytest.CaptureFixture[str], path: Path, contradicted: bool = False, **options: Any
) -> dict[str, Any]:
    """The one JSON object."""
    with pytest.raises(CheckFailedError) if contradicted else nullcontext():
        evaluate(path, json_=True, **options)
    (line,) = capsys.readouterr().out.splitlines()
    figures = json.loads(line)
    assert all(not isinstance(value, dict | list) for value in figures.values())
    assert figures["contradicted"] == contradicted
    return figures


NORMAL = np.random.default_rng(3).standard_normal(120)
OFF = Off(along_m=0.5, across_m=-0.25, up_m=1.0, speed_mps=0.1, yaw_rad=math.radians(0.5))


# Figures ------------------------------------------------------------------------------------------
def test_errors_put_in_are_the_figures(capsys, tmp_path):
    figures = judged(capsys, write(tmp_path / "a.mcap", truth(), states(OFF), fixes(2.0)))
    expected = {
        "along_mean_m": 0.5,
        "along_rms_m": 0.5,
        "along_std_m": 0.0,
        "across_mean_m": -0.25,
        "across_max_m": 0.25,
        "horizontal_p90_m": math.hypot(0.5, 0.25),
        "up_p99_m": 1.0,
        "speed_p50_mps": 0.1,
        "yaw_rms_deg": 0.5,
        "nees_position_mean": (0.5**2 + 0.25**2) / 0.25,
        "nees_speed_mean": 1.0,
        "gnss_along_mean_m": 2.0,
        "gnss_up_p95_m": 3.0,
        "gnss_yaw_rms_deg": 0.0,
    }
    for name, value in expected.items():
        assert figures[name] == pytest.approx(value, abs=MM), name
    assert figures["judged"] == figures["states"] - figures["without_truth"] == 1199
    assert figures["distance_m"] == pytest.approx(SPEED_MPS * figures["duration_s"], rel=0.01)
    assert figures["first_state_after_s"] == figures["tracking_after_s"] == 0.0
    assert not figures["at_truth_stamps"]


def test_table_holds_estimate_and_gnss(capsys, tmp_path):
    evaluate(write(tmp_path / "a.mcap", truth(), states(OFF), fixes(2.0)))
    text = capsys.readouterr().out
    (along,) = (line for line in text.splitlines() if line.startswith("along"))
    label, unit, of, mean, std, *sizes, _ = along.split()
    assert (label, unit, of, mean, std) == ("along", "m", "state", "0.500", "0.000")
    assert sizes == ["0.500"] * 6
    assert "raw GNSS" in text
    assert "NEES of state" in text
    assert "1199 states judged, left out: 1 without truth" in text


def on_a_slope(grade_rad: float) -> list[tuple[Key, float, Any]]:
    """The truth of a rigid body on an even slope."""
    known = truth()
    for _, _, message in known:
        message.grade_rad, message.pitch_rad = grade_rad, -grade_rad
    return known


def test_slope_of_the_track_is_judged_in_per_cent_beside_the_states(capsys, tmp_path):
    slopes = series(keys.EST_GRADE, slope_at, 0.05, 0.05)
    path = write(tmp_path / "a.mcap", on_a_slope(0.04), states(), slopes)
    figures = judged(capsys, path)
    assert figures["grade_mean_pct"] == pytest.approx(100 * (math.tan(0.05) - math.tan(0.04)))
    assert figures["nees_grade_mean"] == pytest.approx(1.0)
    assert figures["pitch_mean_deg"] == pytest.approx(math.degrees(0.04))
    evaluate(path)
    text = capsys.readouterr().out
    (line,) = (line for line in text.splitlines() if line.startswith("grade %"))
    assert line.split()[2:4] == ["grade", "1.002"]
    assert "NEES of grade" in text
    assert "no slope of the track" not in text


def test_record_without_a_slope_says_that_pitch_is_the_bodys(capsys, tmp_path):
    path = write(tmp_path / "a.mcap", on_a_slope(0.04), states())
    assert judged(capsys, path)["grade_states"] == 0
    evaluate(path)
    assert "pitch is the body's, and no slope of the track" in capsys.readouterr().out


def test_slope_in_a_reprocessed_record_is_judged_by_the_truth_of_its_source(capsys, tmp_path):
    write(tmp_path / "ride.mcap", on_a_slope(0.04), fixes())
    slopes = series(keys.EST_GRADE, slope_at, 0.05, 0.04)
    out = write(tmp_path / "out.mcap", states(), slopes, reprocessed_from="ride.mcap")
    figures = judged(capsys, out)
    assert figures["grade_states"] == len(slopes)
    assert figures["grade_max_pct"] == pytest.approx(0.0, abs=1e-9)


def test_worst_error_is_given_with_its_time(capsys, tmp_path):
    bad = state_at(30.0, Off(across_m=7.0))
    ride = [(k, t, bad if t == 30.0 else m) for k, t, m in states()]
    figures = judged(capsys, write(tmp_path / "a.mcap", truth(), ride))
    assert figures["across_max_m"] == pytest.approx(7.0, abs=MM)
    assert figures["across_max_at_s"] == 30.0
    assert figures["across_p99_m"] < MM


def test_smoothed_estimate_is_judged_beside(capsys, tmp_path):
    smoothed = states(Off(along_m=0.1), keys.EST_SMOOTHED)
    path = write(tmp_path / "a.mcap", truth(), states(OFF), smoothed)
    figures = judged(capsys, path)
    assert figures["along_rms_m"] == pytest.approx(0.5, abs=MM)
    assert figures["smoothed_along_rms_m"] == pytest.approx(0.1, abs=MM)
    alone = judged(capsys, path, estimate=keys.EST_SMOOTHED.path)
    assert alone["along_rms_m"] == pytest.approx(0.1, abs=MM)
    assert "smoothed_along_rms_m" not in alone


def test_lever_arm_and_risk_are_those_of_the_records_configuration(capsys, tmp_path):
    metadata = {config_file.RECORD_ENTRY: config_file.to_json(CONFIG)}
    path = write(tmp_path / "a.mcap", truth(), states(OFF), fixes(2.0), **metadata)
    figures = judged(capsys, path)
    assert figures["gnss_horizontal_max_m"] < MM
    assert figures["gnss_up_max_m"] < MM
    assert figures["integrity_risk"] == 0.01
    assert judged(capsys, write(tmp_path / "b.mcap", truth(), states()))["integrity_risk"] is None


def test_protection_level_is_compared(capsys, tmp_path):
    beyond = [(k, t, state_at(t, Off(along_m=1.5 if t < 6 else 0.0))) for k, t, _ in states()]
    figures = judged(capsys, write(tmp_path / "a.mcap", truth(), beyond))
    assert figures["protection_along_exceeded_share"] == pytest.approx(0.1, abs=0.002)
    assert figures["protection_across_exceeded_share"] == 0.0
    assert figures["protection_across_mean_m"] == 2.0


def test_skipped_seconds_are_left_out(capsys, tmp_path):
    begin = [(k, t, state_at(t, Off(along_m=9.0 if t < 5 else 0.0))) for k, t, _ in states()]
    path = write(tmp_path / "a.mcap", truth(), begin)
    whole = judged(capsys, path, contradicted=True)
    assert whole["along_max_m"] == pytest.approx(9.0, abs=MM)
    figures = judged(capsys, path, skip_s=5.0)
    assert figures["along_max_m"] < MM
    assert figures["skipped"] == 100


def test_outages_are_grouped(capsys, tmp_path):
    some = [one for one in fixes() if not 20 < one[1] < 40]
    figures = judged(capsys, write(tmp_path / "a.mcap", truth(), states(OFF), some))
    assert figures["outages"] == figures["outages_to_30_s_count"] == 1
    assert figures["outages_to_30_s_along_rms_m"] == pytest.approx(0.5, abs=MM)
    assert figures["outages_to_30_s_distance_mean_m"] == pytest.approx(200.0, abs=0.1)


def test_innovations_of_some_messages_are_judged_by_name(capsys, tmp_path):
    ride = states()
    for number, (_, _, message) in enumerate(ride[::10]):
        message.innovations.add(
            measurement="gnss east",
            value=2.0 * NORMAL[number],
            variance=4.0,
            accepted=number > 11,
        )
    figures = judged(capsys, write(tmp_path / "a.mcap", truth(), ride))
    assert figures["nis_gnss_east_count"] == 120
    assert figures["nis_gnss_east_accepted_share"] == 0.9
    assert figures["nis_gnss_east_mean"] == pytest.approx(np.mean(NORMAL[12:] ** 2))
    assert abs(figures["nis_gnss_east_lag1"]) < 0.3
    assert figures["nis_gnss_east_consistent"]


def test_sparse_truth_without_direction_judges_position_at_its_instants(capsys, tmp_path):
    rtk = [
        (keys.TRUTH_STATE, t + 0.02, TruthState(**place(t + 0.02, 0 * UP), position_std_m=0.02))
        for t in np.arange(0.0, 59.0, 0.25)
    ]
    figures = judged(capsys, write(tmp_path / "a.mcap", rtk, states(OFF)))
    assert figures["at_truth_stamps"]
    assert figures["judged"] == len(rtk)
    assert figures["along_p90_m"] == pytest.approx(0.5 * math.cos(math.radians(0.5)), abs=5 * MM)
    assert figures["speed_rms_mps"] is None
    assert figures["nees_joint_mean"] is None
    variance = 0.25 + 0.02**2
    assert figures["nees_position_mean"] == pytest.approx(0.3125 / variance, abs=MM)


def test_time_until_tracking_is_told(capsys, tmp_path):
    ride = states()
    for _, time_s, message in ride:
        if time_s < 12:
            message.mode = MotionState.HEADING_UNKNOWN if time_s > 4.96 else MotionState.STARTING
    figures = judged(capsys, write(tmp_path / "a.mcap", truth(), ride, fixes()[2:]))
    assert figures["starting"] == 100
    assert figures["heading_unknown"] == 140
    assert figures["first_state_after_s"] == pytest.approx(3.0)
    assert figures["tracking_after_s"] == pytest.approx(10.0)


# Two records --------------------------------------------------------------------------------------
def test_truth_of_another_record(capsys, tmp_path):
    source = write(tmp_path / "source.mcap", truth(), fixes(2.0))
    out = write(tmp_path / "out.mcap", states(OFF))
    figures = judged(capsys, out, truth=str(source))
    assert figures["along_rms_m"] == pytest.approx(0.5, abs=MM)
    assert figures["gnss_along_rms_m"] == pytest.approx(2.0, abs=MM)
    assert str(source) in figures["truth"]


def test_truth_of_the_record_that_was_reprocessed_is_found_beside(capsys, tmp_path):
    write(tmp_path / "source.mcap", truth(), fixes(2.0))
    out = write(tmp_path / "out.mcap", states(OFF), reprocessed_from="source.mcap")
    evaluate(out, json_=True)
    captured = capsys.readouterr()
    assert json.loads(captured.out)["along_rms_m"] == pytest.approx(0.5, abs=MM)
    assert "source.mcap" in captured.err


def test_source_that_is_gone_is_named(tmp_path):
    out = write(tmp_path / "out.mcap", states(), reprocessed_from="source.mcap")
    with pytest.raises(RecordError, match=r"source\.mcap.*--truth FILE"):
        evaluate(out)


def test_truth_of_the_vehicle_is_not_taken_from_the_estimates_record(capsys, tmp_path):
    """A record that has a truth of its own is still judged by the one that was named."""
    source = write(tmp_path / "source.mcap", truth())
    wrong = [(k, t, truth_at(t + 1.0)) for k, t, _ in truth()]
    out = write(tmp_path / "out.mcap", wrong, states())
    by_its_own = judged(capsys, out, contradicted=True)
    assert by_its_own["along_rms_m"] == pytest.approx(10.0, abs=MM)
    assert judged(capsys, out, truth=str(source))["along_rms_m"] < MM


# What cannot be judged ----------------------------------------------------------------------------
def test_record_without_truth_names_the_cure(tmp_path):
    with pytest.raises(RecordError, match=r"holds no raw/truth/state; .*--truth FILE"):
        evaluate(write(tmp_path / "a.mcap", states()))


def test_record_without_estimate_names_the_cure(tmp_path):
    with pytest.raises(RecordError, match="tramstream reprocess"):
        evaluate(write(tmp_path / "a.mcap", truth()))


def test_record_with_another_estimate_names_it(tmp_path):
    path = write(tmp_path / "a.mcap", truth(), states(key=keys.EST_NOW))
    with pytest.raises(RecordError, match="--estimate: est/ekf/now"):
        evaluate(path)


def test_estimate_of_another_type_is_refused(tmp_path):
    distance = [(keys.EST_DISTANCE, t, DistanceState()) for t in (1.0, 2.0)]
    path = write(tmp_path / "a.mcap", truth(), distance)
    with pytest.raises(RecordError, match=r"tramstream\.DistanceState"):
        evaluate(path, estimate=keys.EST_DISTANCE.path)


def test_truth_of_another_ride_is_told(tmp_path):
    late = [(k, t + 1000.0, m) for k, t, m in states()]
    with pytest.raises(RecordError, match="1200 without truth"):
        evaluate(write(tmp_path / "a.mcap", truth(), late))


def test_truth_that_is_neither_file_nor_key_is_a_usage_error(tmp_path):
    with pytest.raises(ConfigError, match="--truth turth"):
        evaluate(write(tmp_path / "a.mcap", truth(), states()), truth="turth")


def test_configuration_of_another_version_does_not_stop_the_judgement(capsys, tmp_path):
    path = write(tmp_path / "a.mcap", truth(), states(), config='{"vehicle": "4711", "no": 1}')
    evaluate(path, json_=True)
    captured = capsys.readouterr()
    assert json.loads(captured.out)["integrity_risk"] is None
    assert "lever arm" in captured.err


def test_damaged_record_is_judged_and_told(capsys, tmp_path):
    path = write(tmp_path / "a.mcap", truth(), states(OFF))
    whole = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DamagedRecordError):
        evaluate(cut, json_=True)
    assert json.loads(capsys.readouterr().out)["along_rms_m"] == pytest.approx(0.5, abs=MM)


def test_program_ends_with_the_status_of_the_error(tmp_path):
    done = tramstream("evaluate", write(tmp_path / "a.mcap", truth(), states()), "--json")
    assert (done.returncode, len(done.stdout.splitlines())) == (0, 1)
    contradicted = tramstream("evaluate", write(tmp_path / "c.mcap", truth(), states(Off(9.0))))
    assert contradicted.returncode == 1
    (sentence,) = contradicted.stderr.splitlines()
    assert "NEES (joint) is 324, limit 15" in sentence
    assert "$.gnss.error_tau_s" in sentence
    refused = tramstream("evaluate", write(tmp_path / "b.mcap", states()))
    assert refused.returncode == 2
    assert len(refused.stderr.splitlines()) == 1
