"""Scenario files: the built-in ones say what docs/theory.md, section 3.9 says, and bad ones are
refused."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from msgspec.structs import replace

from tramstream.errors import ConfigError
from tramstream.lines.line import built_in_line
from tramstream.simulation import scenario
from tramstream.simulation.ride import Ride
from tramstream.simulation.scenario import GnssJump, Slide, Tunnel, load, names, parse, stated_std_m
from tramstream.simulation.simulation import Simulation


def test_every_work_has_its_scenario_and_city_matching_and_trams_are_ours() -> None:
    assert names() == [
        "chladek2023", "city", "kaspar2023", "konecny2004", "matching", "melenovsky2023",
        "pusman2017", "still", "tram", "tram_articulated",
    ]  # fmt: skip


def test_kaspar2023_is_the_table_of_the_work() -> None:
    # docs/theory.md, section 3.9
    chosen = load("kaspar2023")
    driver = chosen.driver
    assert (driver.speed_mps, driver.acceleration_mps2) == (15.0, 0.5)
    assert (driver.jerk_mps3, driver.lateral_mps2) == (0.2, 0.1)
    assert chosen.imu is not None
    assert chosen.gnss is not None
    assert chosen.wheels is not None
    scales, errors = chosen.imu.scales, chosen.imu.errors
    assert (scales.accel_range_mps2, scales.accel_mps2) == (100.0, 100 / 2**16)
    assert (scales.gyro_range_radps, scales.gyro_radps) == (2.181661, 3.3289e-5)
    assert errors.accel_bias_mps2 == (0.1, 0.1, 0.1)
    assert errors.gyro_bias_radps == (0.0052359, 0.0052359, 0.0052359)
    assert errors.accel_noise_mps2_rthz == 0.00022563
    assert errors.accel_instability_mps2 == 0.000035316
    assert errors.accel_walk_mps3_rthz == 9e-7
    assert errors.gyro_noise_radps_rthz == 0.00011344
    assert errors.gyro_instability_radps == 0.000029088
    assert errors.gyro_walk_radps2_rthz == 0.000075630
    assert errors.accel_scale_per_degc == errors.gyro_scale_per_degc == 1e-4
    assert errors.temperature_degc == 25.0
    gnss = chosen.gnss
    assert (gnss.rate_hz, gnss.velocity) == (1.0, False)
    assert stated_std_m(gnss) == (0.5, 1.0)
    assert (gnss.errors.decay, gnss.errors.white_horizontal_std_m) == (0.95, 0.0)
    axle = chosen.wheels.axle
    assert (chosen.wheels.rate_hz, axle.pulses_per_turn, axle.radius_m) == (50.0, 2048, 0.3)
    assert (axle.radius_error_m, axle.track_m) == ((0.012, 0.016), 1.435)
    assert not chosen.track.cant


def test_kaspar2023_takes_67_minutes_on_the_built_in_line() -> None:
    ride = Ride(built_in_line(), load("kaspar2023").driver)
    assert ride.duration_s / 60 == pytest.approx(67.0, abs=0.5)
    assert ride.duration_s * 100 == pytest.approx(400_000, rel=0.01)


def test_melenovsky2023_is_the_scenario_of_the_work() -> None:
    # docs/theory.md, section 3.9
    chosen = load("melenovsky2023")
    assert chosen.imu is not None
    assert chosen.gnss is not None
    assert chosen.imu.misalignment_deg == (30.0, 60.0, 90.0)
    errors = chosen.imu.errors
    assert (errors.accel_noise_mps2_rthz, errors.accel_walk_mps3_rthz) == (0.2, 9e-4)
    assert (errors.gyro_noise_radps_rthz, errors.gyro_walk_radps2_rthz) == (2e-3, 5e-5)
    assert stated_std_m(chosen.gnss) == (1.8, 2.2)
    assert (chosen.gnss.rate_hz, chosen.gnss.errors.velocity_std_mps) == (10.0, 0.5)


def test_matching_is_the_scenario_of_the_issue() -> None:
    # docs/accuracy.md, *Which track*: σ 2.5 m correlated, jumps to 30 m, stops of 20 to 60 s
    chosen = load("matching")
    driver, gnss = chosen.driver, chosen.gnss
    assert (driver.dwell_s, driver.dwell_max_s) == (20.0, 60.0)
    assert gnss is not None
    assert (gnss.errors.horizontal_std_m, gnss.errors.decay) == (2.5, 0.95)
    assert gnss.jump_max_m == 30.0
    assert stated_std_m(gnss)[0] < gnss.errors.horizontal_std_m
    assert chosen.imu is not None
    assert (chosen.imu.rate_hz, chosen.imu.batch) == (100.0, 10)
    city = load("city").imu
    assert city is not None
    assert chosen.imu.errors == city.errors


def test_stated_deviation_is_that_of_the_errors_unless_it_is_given() -> None:
    text = b"[gnss.errors]\nhorizontal_std_m = 0.3\nwhite_horizontal_std_m = 0.4"
    gnss = parse(text, "x").gnss
    assert gnss is not None
    assert stated_std_m(gnss) == pytest.approx((0.5, 1.0))
    given = parse(b"[gnss]\nstated_horizontal_std_m = 2.0", "x").gnss
    assert given is not None
    assert stated_std_m(given) == (2.0, 1.0)


def test_events_are_told_apart_by_their_kind() -> None:
    events = parse(
        b"""
        [[events]]
        kind = "gnss_jump"
        stop = 3
        east_m = 12.0
        [[events]]
        kind = "tunnel"
        start_m = 100.0
        end_m = 200.0
        [[events]]
        kind = "slide"
        start_s = 10.0
        duration_s = 2.0
        wheels = ["left"]
        factor = 0.0
        """,
        "x",
    ).events
    assert [type(event) for event in events] == [GnssJump, Tunnel, Slide]
    assert isinstance(events[2], Slide)
    assert events[2].wheels == ("left",)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[imu]\nrate = 1", r"\$\.imu\.rate: unknown field; did you mean rate_hz"),
        ("[imu]\nrate_hz = 0.0", r"\$\.imu\.rate_hz"),
        ("[imu]\nrate_hz = nan", r"\$\.imu\.rate_hz: nan is not a finite number"),
        ("[gnss.errors]\ndecay = 1.0", r"\$\.gnss\.errors\.decay"),
        ('[wheels]\nwheels = ["front"]', r"\$\.wheels\.wheels"),
        ("[wheels]\nwheels = []", r"each once - at `\$\.wheels`"),
        ("truth_rate_hz = -1.0", r"truth_rate_hz"),
        ('[[events]]\nkind = "tunnel"\nstart_s = 1.0', r"ends by one of .* - at `\$\.events\[0\]`"),
        ('[[events]]\nkind = "tunnel"\nduration_s = 1.0', r"begins at one of"),
        (
            '[[events]]\nkind = "tunnel"\nstart_s = 1.0\nstop = 2\nduration_s = 1.0',
            r"begins at one of",
        ),
        ('[[events]]\nkind = "tunel"\nstart_s = 1.0', r"tunel.*\$\.events\[0\]\.kind"),
        (
            '[[events]]\nkind = "slip"\nstart_s = 1.0\nduration_s = 1.0',
            r"one of `factor` and `speed_error_mps`",
        ),
        (
            '[[events]]\nkind = "gnss_jump"\nstop = 1\nest_m = 1.0',
            r"\$\.events\[0\]\.est_m: unknown field; did you mean east_m",
        ),
        ("[driver]\ndwell_s = 20.0\ndwell_max_s = 10.0", r"not below `dwell_s`.*\$\.driver"),
        ("[imu", "not TOML"),
    ],
)
def test_bad_scenario_is_refused_with_a_sentence(text: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as caught:
        parse(text.encode(), "some.toml")
    assert str(caught.value).startswith("some.toml: ")


def test_scenario_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("reverse = true\n[gnss]\nrate_hz = 2.0\n")
    chosen = load(str(path))
    assert chosen.reverse
    assert chosen.imu is None
    with pytest.raises(ConfigError, match=r"give a file or one of chladek2023, city"):
        load("kaspar")


def test_all_built_in_scenarios_have_sensible_angles() -> None:
    for name in names():
        chosen = scenario.load(name)
        if chosen.imu is not None:
            assert all(abs(angle) <= 180 for angle in chosen.imu.mounting_deg)
            assert math.isfinite(chosen.imu.rate_hz)


@pytest.mark.parametrize(("name", "parts"), [("tram", 1), ("tram_articulated", 3)])
def test_trams_have_a_body_and_rails_and_the_sensors_of_city(name: str, parts: int) -> None:
    chosen, city = load(name), load("city")
    assert chosen.body is not None
    assert chosen.body.parts == parts
    assert chosen.track.roughness.felt
    assert (chosen.imu, chosen.gnss) == (city.imu, city.gnss)
    assert city.wheels is not None
    assert chosen.wheels == replace(city.wheels, bogie="front")
    first, second = chosen.body.pivots_m[:2]  # as the configuration has them
    assert chosen.ekf.bogie_distance_m == first - second
    assert chosen.ekf.pivot_m == (first - second) / 2
    assert (chosen.driver, chosen.events) == (city.driver, city.events)


def test_works_know_no_body_and_no_rough_rails() -> None:
    for name in names():
        if name[-4:].isdigit():
            chosen = load(name)
            assert chosen.body is None
            assert not chosen.track.roughness.felt


@pytest.mark.parametrize("field", ["stamp_offset_s", "stamp_jitter_s", "latency_s"])
def test_delay_of_years_is_refused_with_its_range(field: str) -> None:
    text = f"[wheels.timing]\n{field} = 1e9\n"
    with pytest.raises(ConfigError, match=rf"{field}: .* out of range; it must be .*<= 100000"):
        parse(text.encode(), "s")


def test_still_stands_for_six_hours_with_the_reference_sensors_and_nothing_else() -> None:
    chosen, reference = load("still"), load("kaspar2023")
    assert chosen.imu is not None
    assert reference.imu is not None
    assert (chosen.gnss, chosen.wheels, chosen.imu.rate_hz) == (None, None, 2000.0)
    own, theirs = chosen.imu.errors, reference.imu.errors
    for field in ("noise_radps_rthz", "instability_radps", "walk_radps2_rthz"):
        assert getattr(own, f"gyro_{field}") == getattr(theirs, f"gyro_{field}")
    for field in ("noise_mps2_rthz", "instability_mps2", "walk_mps3_rthz"):
        assert getattr(own, f"accel_{field}") == getattr(theirs, f"accel_{field}")
    ride = Simulation(built_in_line(), chosen)
    assert ride.duration_s == 6 * 3600.0
    assert ride.ride.motion([0.0, 21600.0]).standing.all()
    assert not ride.ride.motion(30_100.0).standing


def test_scenario_ends_when_it_says() -> None:
    chosen = parse(b"duration_s = 12.0", "short.toml")
    assert Simulation(built_in_line(), chosen).duration_s == 12.0
    assert Simulation(built_in_line(), chosen, duration_s=5.0).duration_s == 5.0
    longer = parse(b"duration_s = 1e6", "long.toml")
    assert Simulation(built_in_line(), longer).duration_s < 1e5
