"""Silence is held against a node only in time during which it could have been heard."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tramstream.supervision.heartbeats import (
    FIRST_FROZEN_S,
    FIRST_SAID_S,
    FROZEN_S,
    SAID_S,
    Heartbeats,
    Silence,
)

TURN_S = 0.1
ROUTER = "router"


class Listening:
    """The watch loop, with a beat of each healthy node every second."""

    def __init__(self, *names: str) -> None:
        self.beats = Heartbeats(ROUTER)
        self.now_s = 0.0
        self.found: list[tuple[float, Silence]] = []
        for name in names:
            self.beats.started(name)

    def go_on(self, seconds: float, *healthy: str) -> list[Silence]:
        """Let time pass while `healthy` beat; return what was found in it."""
        before = len(self.found)
        for turn in range(round(seconds / TURN_S)):
            if turn % 10 == 0:
                for name in healthy:
                    self.beats.beat(name)
            self.now_s += TURN_S
            self.found += [(self.now_s, each) for each in self.beats.pass_time(TURN_S)]
        return [silence for _, silence in self.found[before:]]


def test_frozen_node_is_said_after_three_seconds_and_taken_for_frozen_after_five() -> None:
    loop = Listening(ROUTER, "recorder", "imu")
    assert loop.go_on(20.0, ROUTER, "recorder", "imu") == []
    begin_s = loop.now_s
    loop.beats.beat("recorder")
    loop.go_on(30.0, ROUTER, "imu")
    assert [silence for _, silence in loop.found] == [
        Silence("recorder", SAID_S, False),
        Silence("recorder", FROZEN_S, True),
    ]
    said_s, frozen_s = (at_s - begin_s for at_s, _ in loop.found)
    assert said_s == pytest.approx(3.0, abs=2 * TURN_S)
    assert frozen_s == pytest.approx(5.0, abs=2 * TURN_S)


def test_node_that_beats_again_is_told_once_and_begins_anew() -> None:
    loop = Listening(ROUTER, "imu")
    loop.go_on(2.0, ROUTER, "imu")
    assert loop.go_on(3.5, ROUTER) == [Silence("imu", SAID_S, False)]
    assert loop.beats.beat("imu")
    assert not loop.beats.beat("imu")
    assert loop.go_on(2.5, ROUTER) == []


@given(st.lists(st.floats(0.05, 2.8), min_size=1, max_size=60), st.floats(0.01, 0.15))
def test_node_whose_heartbeats_are_late_is_never_said(pauses_s: list[float], turn_s: float) -> None:
    beats = Heartbeats(ROUTER)
    for name in (ROUTER, "imu"):
        beats.started(name)
        beats.beat(name)
    for pause_s in pauses_s:
        passed_s = 0.0
        while passed_s + turn_s < pause_s:
            passed_s += turn_s
            beats.beat(ROUTER)
            assert beats.pass_time(turn_s) == []
        beats.beat("imu")


def test_time_in_which_the_watch_stood_still_counts_for_nothing() -> None:
    loop = Listening(ROUTER, "imu")
    loop.go_on(2.0, ROUTER, "imu")
    assert loop.beats.pass_time(3600.0) == []
    assert loop.go_on(1.0) == []  # what waited in the queues may take its time
    assert loop.go_on(20.0, ROUTER, "imu") == []


def test_router_that_is_away_makes_nobody_look_frozen() -> None:
    loop = Listening(ROUTER, "recorder", "imu")
    loop.go_on(5.0, ROUTER, "recorder", "imu")
    loop.beats.ended(ROUTER)
    assert loop.go_on(60.0) == []
    loop.beats.started(ROUTER)
    loop.beats.beat(ROUTER)
    assert loop.go_on(2.9, ROUTER) == []  # the nodes come back one by one
    assert loop.go_on(2.0, ROUTER, "imu") == [Silence("recorder", SAID_S, False)]


def test_frozen_router_is_found_itself_and_no_other() -> None:
    loop = Listening(ROUTER, "recorder", "imu")
    loop.go_on(5.0, ROUTER, "recorder", "imu")
    assert loop.go_on(60.0) == [Silence(ROUTER, SAID_S, False), Silence(ROUTER, FROZEN_S, True)]


def test_before_its_first_heartbeat_a_node_may_take_its_time() -> None:
    loop = Listening(ROUTER, "recorder")
    assert loop.go_on(FIRST_SAID_S - 1.0, ROUTER) == []
    assert loop.go_on(2.0, ROUTER) == [Silence("recorder", FIRST_SAID_S, False)]
    assert loop.go_on(FIRST_FROZEN_S - FIRST_SAID_S, ROUTER) == [
        Silence("recorder", FIRST_FROZEN_S, True)
    ]


def test_node_that_was_taken_over_frozen_is_found_as_well() -> None:
    loop = Listening()
    for name in (ROUTER, "imu"):
        loop.beats.started(name, heard=True)
    assert loop.go_on(6.0, ROUTER) == [
        Silence("imu", SAID_S, False),
        Silence("imu", FROZEN_S, True),
    ]


def test_ended_node_and_strangers_are_nobody() -> None:
    loop = Listening(ROUTER, "imu")
    loop.beats.ended("imu")
    assert not loop.beats.beat("imu")
    assert not loop.beats.beat("stranger")
    assert loop.go_on(300.0, ROUTER) == []


def test_limits_rise() -> None:
    limits = (SAID_S, FROZEN_S, FIRST_SAID_S, FIRST_FROZEN_S)
    assert all(one < other for one, other in pairwise(limits))
