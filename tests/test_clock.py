"""The vehicle clock is one for all; the fit finds offset and skew under delays that only add."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live import HANG_S

from tramstream.clock import ClockFit, FitMemory, S, VehicleClock, boot_id
from tramstream.errors import ConfigError
from tramstream.memory.stage import assign, copied, from_plain, to_plain

US, MS = 1_000, 1_000_000
HOST_START_NS = 1_700_000_000 * S
FLOOR_NS = 1 * MS
"""Delay of the fastest arrival: not observable, so truth includes it."""


class Truth:
    """A device clock off by `skew`, and arrivals that are late by the floor and more."""

    def __init__(self, skew: float, start_ns: int = 0) -> None:
        self.skew = skew
        self.start_ns = start_ns

    def host_ns(self, device_ns: int) -> int:
        elapsed_ns = device_ns - self.start_ns
        return HOST_START_NS + FLOOR_NS + elapsed_ns + round(elapsed_ns * self.skew)


def feed(
    fit: ClockFit, truth: Truth, rate_hz: float, duration_s: float, delays_ns: np.ndarray
) -> list[int]:
    """Feed arrivals at `rate_hz`; error of each one's stamp at that time, ns."""
    errors_ns = []
    for k in range(int(rate_hz * duration_s)):
        device_ns = truth.start_ns + round(k * S / rate_hz)
        fit.add(device_ns, truth.host_ns(device_ns) + int(delays_ns[k]))
        errors_ns.append(fit.host_ns(device_ns) - truth.host_ns(device_ns))
    return errors_ns


def exponential_ns(seed: int, mean_ns: float, count: int = 100_000) -> np.ndarray:
    return np.random.default_rng(seed).exponential(mean_ns, count)


# fit ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("skew", [-120e-6, 0.0, 50e-6])
@pytest.mark.parametrize("seed", range(3))
def test_imu_offset_and_skew_are_found_under_exponential_delays(skew: float, seed: int) -> None:
    fit, truth = ClockFit(), Truth(skew)
    errors_ns = np.abs(feed(fit, truth, 200, 60, exponential_ns(seed, 2 * MS)))
    assert errors_ns[40 * 200 :].max() < 20 * US
    assert fit.skew == pytest.approx(skew, abs=1e-6)
    assert fit.residual_ns == pytest.approx(2 * MS * np.log(2), rel=0.3)  # the median's


def test_offset_is_good_to_half_a_millisecond_after_one_second() -> None:
    for seed in range(5):
        fit = ClockFit()
        errors_ns = np.abs(feed(fit, Truth(50e-6), 200, 10, exponential_ns(seed, 2 * MS)))
        assert errors_ns[200:].max() < 0.5 * MS


@pytest.mark.parametrize("rate_hz", [1, 5, 10])
def test_receiver_at_its_slow_rate_is_fitted_within_milliseconds(rate_hz: int) -> None:
    for seed in range(3):
        fit = ClockFit(bucket_s=1.0)
        delays_ns = exponential_ns(seed, 20 * MS)
        errors_ns = np.abs(feed(fit, Truth(20e-6), rate_hz, 300, delays_ns))
        assert errors_ns[100 * rate_hz :].max() < 10 * MS  # half the mean delay
        assert abs(fit.skew - 20e-6) < 200e-6


def test_constant_delay_is_fitted_to_the_nanosecond_scale() -> None:
    fit, truth = ClockFit(), Truth(100e-6)
    errors_ns = feed(fit, truth, 100, 60, np.zeros(6000))
    assert np.abs(errors_ns[-1000:]).max() < 1 * US
    assert fit.offset_ns == pytest.approx(truth.host_ns(60 * S) - 60 * S, abs=5 * US)


@pytest.mark.parametrize("change", [-100e-6, 100e-6])
def test_crystal_that_warms_up_is_followed_once_its_old_rate_is_out_of_the_window(
    change: float,
) -> None:
    """The window lasts 32 s; what came before it has no say, nor is it kept."""
    fit, before = ClockFit(), Truth(0.0)
    feed(fit, before, 100, 60, np.zeros(6000))
    after = Truth(change, start_ns=60 * S)
    for number in range(6000, 13_000):
        device_ns = number * 10 * MS
        truth_ns = after.host_ns(device_ns) + 60 * S
        fit.add(device_ns, truth_ns)
    assert fit.host_ns(device_ns) == pytest.approx(truth_ns, abs=20 * US)
    assert fit.skew == pytest.approx(change, abs=1e-6)
    assert len(fit.memory.minima) <= fit.buckets


def test_late_arrivals_do_not_move_the_line() -> None:
    clean, dirty, truth = ClockFit(), ClockFit(), Truth(30e-6)
    delays_ns = np.zeros(6000)
    feed(clean, truth, 100, 60, delays_ns)
    delays_ns[5::7] = 400 * MS
    feed(dirty, truth, 100, 60, delays_ns)
    assert abs(dirty.host_ns(60 * S) - clean.host_ns(60 * S)) < 1 * US
    assert dirty.restarts == 0


def test_arrival_kept_in_a_buffer_at_the_start_is_forgotten_within_a_second() -> None:
    fit, delays_ns = ClockFit(), np.zeros(400)
    delays_ns[0] = 80 * MS
    errors_ns = feed(fit, Truth(0.0), 200, 2, delays_ns)
    assert errors_ns[0] == 80 * MS
    assert abs(errors_ns[200]) < 1 * US


@given(st.lists(st.integers(0, 200 * MS), min_size=2, max_size=120), st.floats(-150e-6, 150e-6))
@settings(max_examples=60)
def test_stamps_rise_and_what_was_stamped_stays_as_it_was(delays: list[int], skew: float) -> None:
    fit, truth, given_ns = ClockFit(), Truth(skew), []
    for k, delay_ns in enumerate(delays):
        device_ns = k * 100 * MS
        fit.add(device_ns, truth.host_ns(device_ns) + delay_ns)
        given_ns.append(fit.host_ns(device_ns))
    assert all(b - a > 85 * MS for a, b in pairwise(given_ns))
    newest = range(max(0, len(delays) - 10), len(delays))
    assert [fit.host_ns(k * 100 * MS) for k in newest] == [given_ns[k] for k in newest]


@pytest.mark.parametrize("jump_s", [-30.0, 30.0, 4000.0])
def test_jump_of_the_device_clock_starts_the_fit_anew(jump_s: float) -> None:
    fit = ClockFit()
    feed(fit, Truth(0.0), 100, 20, exponential_ns(1, 1 * MS))
    for k in range(300):
        device_ns = round((20 + jump_s + k / 100) * S)
        fit.add(device_ns, HOST_START_NS + FLOOR_NS + 20 * S + k * 10 * MS)
    assert fit.restarts == 1
    assert fit.host_ns(device_ns) == pytest.approx(HOST_START_NS + FLOOR_NS + 22_990 * MS, abs=US)


def test_stalled_reader_that_empties_its_buffer_is_no_jump() -> None:
    fit, truth = ClockFit(), Truth(0.0)
    feed(fit, truth, 100, 20, np.zeros(2000))
    for k in range(2000, 2500):  # 5 s of samples wait, and are read within 50 ms
        fit.add(k * 10 * MS, truth.host_ns(25 * S) + (k - 2000) * 100 * US)
    assert fit.restarts == 0
    assert fit.host_ns(25 * S) == pytest.approx(truth.host_ns(25 * S), abs=US)


def test_single_impossible_stamp_is_no_jump() -> None:
    fit, truth = ClockFit(), Truth(0.0)
    feed(fit, truth, 100, 20, np.zeros(2000))
    fit.add(4_000_000 * S, truth.host_ns(20 * S))
    fit.add(20 * S, truth.host_ns(20 * S))
    assert fit.restarts == 0
    assert fit.host_ns(20 * S) == pytest.approx(truth.host_ns(20 * S), abs=US)


def test_jump_that_no_delay_explains_is_believed_after_five_arrivals() -> None:
    """A device clock that jumps ahead makes arrivals come before what they are stamped with."""
    fit, truth = ClockFit(), Truth(0.0)
    feed(fit, truth, 100, 20, np.zeros(2000))
    for count in range(1, ClockFit.JUMP_ARRIVALS + 1):
        assert fit.restarts == 0
        fit.add((50 * S) + count * 10 * MS, truth.host_ns(20 * S + count * 10 * MS))
    assert fit.restarts == 1


def test_jump_that_a_delay_could_be_is_believed_after_a_second_on_end() -> None:
    fit, truth = ClockFit(), Truth(0.0)
    feed(fit, truth, 100, 20, np.zeros(2000))
    for number in range(101):
        assert fit.restarts == 0
        fit.add((5 * S) + number * 10 * MS, truth.host_ns(20 * S + number * 10 * MS))
    assert fit.restarts == 1


@pytest.mark.parametrize("off_s", [30, -10])
def test_impossible_stamps_now_and_then_are_no_jump_however_many(off_s: int) -> None:
    fit, truth = ClockFit(), Truth(0.0)
    feed(fit, truth, 100, 20, np.zeros(2000))
    for number in range(2000, 3000):
        device_ns = number * 10 * MS
        wrong_ns = off_s * S if number % ClockFit.JUMP_ARRIVALS else 0
        fit.add(device_ns + wrong_ns, truth.host_ns(device_ns))
    assert fit.restarts == 0
    assert fit.host_ns(30 * S) == pytest.approx(truth.host_ns(30 * S), abs=US)


def test_fit_survives_silence_of_an_hour() -> None:
    fit, truth = ClockFit(), Truth(50e-6)
    feed(fit, truth, 100, 60, exponential_ns(3, 2 * MS))
    later_ns = 3660 * S  # 1 ppm of skew not known is 3.6 ms in an hour
    assert fit.host_ns(later_ns) == pytest.approx(truth.host_ns(later_ns), abs=10 * MS)
    for k in range(200):
        device_ns = later_ns + k * 10 * MS
        fit.add(device_ns, truth.host_ns(device_ns))
    assert fit.restarts == 0
    assert fit.skew == pytest.approx(50e-6, abs=1e-6)


def test_restored_fit_goes_on_like_the_one_that_was_copied() -> None:
    delays_ns = exponential_ns(4, 2 * MS)
    fit, truth = ClockFit(), Truth(50e-6)
    feed(fit, truth, 200, 10, delays_ns)
    twin = ClockFit()
    assign(twin.memory, from_plain(FitMemory, json.loads(json.dumps(to_plain(fit.memory)))))
    for k in range(2000, 4000):
        for each in (fit, twin):
            each.add(k * 5 * MS, truth.host_ns(k * 5 * MS) + int(delays_ns[k]))
        assert twin.host_ns(k * 5 * MS) == fit.host_ns(k * 5 * MS)
    assert twin.memory == fit.memory


def test_getters_answer_twice_the_same_and_before_the_first_arrival() -> None:
    fit = ClockFit()
    assert (fit.ready, fit.offset_ns, fit.skew, fit.residual_ns) == (False, 0, 0.0, 0.0)
    with pytest.raises(ValueError, match="before the first arrival"):
        fit.host_ns(0)
    feed(fit, Truth(0.0), 100, 3, exponential_ns(5, MS))
    before = copied(fit.memory)
    assert fit.host_ns(5) == fit.host_ns(5)
    assert (fit.ready, fit.offset_ns, fit.skew) == (True, fit.offset_ns, fit.skew)
    assert fit.residual_ns == fit.residual_ns
    assert fit.memory == before


def test_restart_forgets_everything_but_its_count() -> None:
    fit = ClockFit()
    feed(fit, Truth(0.0), 100, 3, np.zeros(300))
    fit.restart()
    assert not fit.ready
    assert fit.restarts == 1


# vehicle clock ------------------------------------------------------------------------------------


def test_clock_runs_at_its_rate_from_its_offset() -> None:
    assert VehicleClock(7, 1.0, lambda: 10).now_ns() == 17
    assert VehicleClock(7, 5.0, lambda: 10).now_ns() == 57


def test_second_process_finds_the_first_ones_clock(tmp_path: Path) -> None:
    first = VehicleClock.shared(tmp_path / "run", rate=5.0)
    second = VehicleClock.shared(tmp_path / "run")
    assert (second.offset_ns, second.rate) == (first.offset_ns, 5.0)


@pytest.mark.parametrize(
    "text",
    [
        json.dumps({"boot_id": "another boot", "offset_ns": 5, "rate": 1.0}),
        json.dumps({"boot_id": boot_id(), "offset_ns": None, "rate": 1.0}),
        "[1, 2]",
        '{"boot_id": ',
        "",
    ],
)
def test_clock_of_another_boot_or_damaged_is_founded_anew(tmp_path: Path, text: str) -> None:
    (tmp_path / "clock.json").write_text(text)
    clock = VehicleClock.shared(tmp_path)
    assert clock.offset_ns > 1_000_000_000 * S
    assert VehicleClock.shared(tmp_path).offset_ns == clock.offset_ns


def test_folder_that_cannot_be_made_is_a_config_error_with_its_cure(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"\$\.bus\.runtime_dir"):
        VehicleClock.shared(tmp_path / "file" / "run")


@pytest.mark.parametrize("stale", [False, True])
def test_all_who_start_at_once_agree(tmp_path: Path, stale: bool) -> None:
    for turn in range(20):
        folder = tmp_path / str(turn)
        folder.mkdir()
        if stale:
            text = json.dumps({"boot_id": "another boot", "offset_ns": 5, "rate": 1.0})
            (folder / "clock.json").write_text(text)
        barrier = threading.Barrier(8)
        offsets: list[int] = []

        def start(
            folder: Path = folder,
            barrier: threading.Barrier = barrier,
            offsets: list[int] = offsets,
        ) -> None:
            barrier.wait()
            offsets.append(VehicleClock.shared(folder).offset_ns)

        threads = [threading.Thread(target=start) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(offsets) == 8
        assert len(set(offsets)) == 1


@pytest.mark.live
def test_processes_that_start_over_an_old_clock_agree(tmp_path: Path) -> None:
    text = json.dumps({"boot_id": "another boot", "offset_ns": 5, "rate": 1.0})
    (tmp_path / "clock.json").write_text(text)
    program = (
        "import sys; from pathlib import Path; from tramstream.clock import VehicleClock\n"
        "sys.stdin.readline(); print(VehicleClock.shared(Path(sys.argv[1])).offset_ns)"
    )
    command = [sys.executable, "-c", program, str(tmp_path)]
    pipe = subprocess.PIPE
    children = [subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) for _ in range(6)]
    for child in children:
        assert child.stdin is not None
        child.stdin.write("go\n")
        child.stdin.flush()
    offsets = {child.communicate(timeout=HANG_S)[0] for child in children}
    assert len(offsets) == 1
    assert int(offsets.pop()) > 0
