"""Events of a ride at their times and places."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tramstream.errors import ConfigError
from tramstream.lines.line import built_in_line
from tramstream.simulation.events import MOST_JUMPS, Happenings
from tramstream.simulation.ride import Ride
from tramstream.simulation.scenario import (
    Event,
    Gnss,
    GnssDrift,
    GnssJump,
    Scenario,
    Slide,
    Slip,
    Tunnel,
    Wheels,
)

MM = 1e-3  # m


@cache
def ride() -> Ride:
    return Ride(built_in_line())


def happenings(
    *events: Event, gnss: Gnss | None = None, wheels: Wheels | None = None
) -> Happenings:
    scenario = Scenario(gnss=gnss, wheels=wheels, events=events)  # type: ignore[arg-type]
    return Happenings(scenario, ride(), np.random.default_rng(3))


def test_jump_lasts_from_its_start_to_its_end() -> None:
    jump = GnssJump(start_s=10.0, duration_s=5.0, east_m=3.0, north_m=-4.0)
    offset = happenings(jump).gnss_offset_l(np.array([9.999, 10.0, 14.999, 15.0]))
    np.testing.assert_array_equal(offset, [[0, 0, 0], [3, -4, 0], [3, -4, 0], [0, 0, 0]])


def test_event_at_a_stop_begins_on_arrival_and_ends_with_the_departure() -> None:
    arrival, departure = ride().dwells_s[4]
    found = happenings(GnssJump(stop=5, after_s=1.5, up_m=2.0)).offsets
    assert found[0][:2] == pytest.approx((arrival + 1.5, departure))


def test_drift_comes_evenly_and_goes_evenly() -> None:
    drift = GnssDrift(start_s=100.0, duration_s=20.0, east_m=8.0, recovery_s=4.0)
    time_s = np.array([100.0, 105.0, 120.0, 122.0, 124.0, 130.0])
    offset = happenings(drift).gnss_offset_l(time_s)
    np.testing.assert_allclose(offset[:, 0], [0.0, 2.0, 8.0, 4.0, 0.0, 0.0], atol=1e-12)
    assert not np.any(offset[:, 1:])


def test_tunnel_lasts_until_the_receiver_has_found_its_satellites() -> None:
    tunnel = Tunnel(start_m=300.0, end_m=400.0)
    found = happenings(tunnel, gnss=Gnss(reacquisition_s=3.0))
    begin, end = ride().time_at_s(300.0), ride().time_at_s(400.0)
    lost = found.gnss_lost(np.array([begin - 0.1, begin + 0.1, end + 2.9, end + 3.1]))
    np.testing.assert_array_equal(lost, [False, True, True, False])


def test_slip_and_slide_change_the_way_of_their_wheels_alone() -> None:
    slip = Slip(start_s=20.0, duration_s=4.0, wheels=("left",), factor=1.25)
    slide = Slide(start_s=30.0, duration_s=2.0, speed_error_mps=-0.5)
    time_s = np.array([19.0, 20.0, 22.0, 24.0, 29.0, 31.0, 40.0])
    slipped = happenings(slip, slide).slipped_m(time_s)
    s = ride().motion([20.0, 22.0, 24.0]).arc_length_m
    by_factor = [0, 0, 0.25 * (s[1] - s[0]), *([0.25 * (s[2] - s[0])] * 4)]
    by_speed = np.array([0, 0, 0, 0, 0, -0.5, -1.0])
    np.testing.assert_allclose(slipped[:, 0], by_factor + by_speed, atol=MM)
    np.testing.assert_allclose(slipped[:, 1], by_speed, atol=MM)


def test_locked_wheel_does_not_turn() -> None:
    slide = Slide(start_s=25.0, duration_s=3.0, factor=0.0)
    time_s = np.linspace(25.0, 28.0, 50)
    motion = ride().motion(time_s)
    slipped = happenings(slide).slipped_m(time_s)
    turned = motion.arc_length_m[:, None] + slipped
    np.testing.assert_allclose(turned - turned[0], 0.0, atol=MM)


def test_chance_jumps_come_as_often_as_asked_and_are_as_large() -> None:
    gnss = Gnss(jumps_per_min=6.0, jump_std_m=5.0, jump_duration_s=4.0)
    found = happenings(gnss=gnss).offsets
    expected = 6.0 * ride().duration_s / 60
    assert len(found) == pytest.approx(expected, abs=4 * np.sqrt(expected))
    size = np.array([offset.offset_l for offset in found])
    assert np.std(size[:, :2]) == pytest.approx(5.0, rel=0.2)
    assert not np.any(size[:, 2])
    lasts = [offset.end_s - offset.start_s for offset in found]
    assert np.mean(lasts) == pytest.approx(4.0, rel=0.25)


def test_more_jumps_than_memory_holds_are_refused_before_they_are_drawn() -> None:
    """As of a stand of thirty years, in which fixes jump three times a minute."""
    often = 60 * (MOST_JUMPS + 1) / ride().duration_s
    with pytest.raises(ConfigError, match=r"\$\.gnss\.jumps_per_min"):
        happenings(gnss=Gnss(jumps_per_min=often))


def test_no_chance_jump_is_longer_than_the_longest() -> None:
    gnss = Gnss(jumps_per_min=6.0, jump_std_m=12.0, jump_max_m=30.0)
    free = Gnss(jumps_per_min=6.0, jump_std_m=12.0)
    capped, plain = (
        np.array([offset.offset_l[:2] for offset in happenings(gnss=each).offsets])
        for each in (gnss, free)
    )
    size, size_plain = np.hypot(*capped.T), np.hypot(*plain.T)
    assert np.max(size_plain) > 30.0
    np.testing.assert_allclose(size, np.minimum(size_plain, 30.0))
    np.testing.assert_allclose(np.arctan2(*capped.T), np.arctan2(*plain.T))


def test_chance_slides_while_braking_and_slips_while_starting() -> None:
    found = happenings(wheels=Wheels(slides_per_stop=1.0, slips_per_stop=1.0)).skids
    assert len(found) == 2 * (len(ride().dwells_s) - 1)
    for skid in found:
        acceleration = ride().motion((skid.start_s + skid.end_s) / 2).acceleration_mps2
        assert (acceleration < 0) == (skid.factor < 1)
    assert not happenings(wheels=Wheels()).skids


def test_event_that_does_not_fit_the_line_is_refused_or_left_out() -> None:
    with pytest.raises(ConfigError, match=r"\$\.events\[0\]\.stop: the line has 27 stops"):
        happenings(GnssJump(stop=28))
    with pytest.raises(ConfigError, match=r"\$\.events\[1\]: ends before it begins"):
        happenings(GnssJump(stop=2), Tunnel(start_m=400.0, end_m=300.0))
    assert not happenings(Tunnel(start_m=50_000.0, end_m=60_000.0)).blackouts
