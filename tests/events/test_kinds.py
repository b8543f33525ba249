"""An event is a kind with its facts; a wrong one is refused where it is made."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tramstream.events import define
from tramstream.events.kinds import DEBUG, ERROR, INFO, WARNING, Severity
from tramstream.events.messages import facts_of, identity_of, log_of, message_of, sentence_of
from tramstream.events.sentences import UNITS, filled, quantity, unit_of
from tramstream.proto import health_pb2

REFUSED = define(
    "test.refused",
    "{key}: innovation {innovation_m}, limit {limit_m}, {count} sat ({setting})",
    cause="A test.",
    cure="look at {key}",
    key=str,
    innovation_m=float,
    limit_m=float,
    count=int,
    setting=str,
)
FACTS = {"key": "raw/gnss/fix", "innovation_m": 41.23, "limit_m": 12.3, "count": 7}


def refused(**other: object) -> object:
    return REFUSED(**{**FACTS, "setting": "ekf.gate", **other})


def test_event_is_worded_with_the_units_in_which_its_facts_names_end() -> None:
    assert str(refused()) == (
        "raw/gnss/fix: innovation 41.2 m, limit 12.3 m, 7 sat (ekf.gate); look at raw/gnss/fix"
    )


def test_facts_take_numbers_of_any_library_and_texts_of_anything() -> None:
    event = REFUSED(
        key=Path("/dev/x"), innovation_m=np.float32(2), limit_m=3, count=np.int64(4), setting=5
    )
    assert event.facts == {
        "key": "/dev/x", "innovation_m": 2.0, "limit_m": 3.0, "count": 4, "setting": "5",
    }  # fmt: skip
    assert [type(value) for value in event.facts.values()] == [str, float, float, int, str]


@pytest.mark.parametrize(
    ("facts", "said"),
    [
        ({**FACTS}, "setting"),
        ({**FACTS, "setting": "x", "more": 1}, "more"),
        ({**FACTS, "setting": "x", "count": "7"}, "count is a number"),
    ],
)
def test_other_facts_than_declared_are_refused(facts: dict[str, object], said: str) -> None:
    with pytest.raises(TypeError, match=said):
        REFUSED(**facts)


@pytest.mark.parametrize(
    ("name", "sentence", "facts", "said"),
    [
        ("refused", "x", {}, "who.what"),
        ("test.Refused", "x", {}, "who.what"),
        ("test.x", "{limit_m}", {}, "limit_m"),
        ("test.x", "x", {"limit_m": bool}, "float, int or str"),
    ],
)
def test_kind_that_could_not_be_worded_is_refused(
    name: str, sentence: str, facts: dict[str, type], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        define(name, sentence, **facts)


def test_same_event_again_is_told_by_its_texts_not_by_its_numbers() -> None:
    assert refused(innovation_m=1.0, count=1).identity == refused().identity
    assert refused(key="raw/odo/wheels").identity != refused().identity
    one, other = message_of(refused(count=1), "ekf"), message_of(refused(), "ekf")
    assert identity_of(one) == identity_of(other) == ("test.refused", "raw/gnss/fix", "ekf.gate")


# As messages --------------------------------------------------------------------------------------
def test_event_travels_with_all_that_is_needed_to_word_it() -> None:
    message = health_pb2.Event.FromString(message_of(refused(), "ekf").SerializeToString())
    assert (message.source, message.kind, message.unsaid) == ("ekf", "test.refused", 0)
    assert facts_of(message) == refused().facts
    assert sentence_of(message) == str(refused())
    assert {fact.name: fact.unit for fact in message.facts}["limit_m"] == "m"


def test_what_was_not_said_is_counted_in_the_sentence() -> None:
    assert "(and 3 more times since" in sentence_of(message_of(refused(), "ekf", 3))


@pytest.mark.parametrize(
    ("severity", "level"),
    [(DEBUG, "DEBUG"), (INFO, "INFO"), (WARNING, "WARNING"), (ERROR, "ERROR")],
)
def test_viewers_get_the_sentence_with_its_level(severity: Severity, level: str) -> None:
    log = log_of(message_of(define("test.x", "so it is", severity=severity)(), "ekf"))
    assert (log.Level.Name(log.level), log.message) == (level, "so it is")
    assert (log.name, log.file) == ("ekf", "test.x")


def test_severity_and_units_are_those_of_the_proto() -> None:
    assert {each.name: each.value for each in Severity} == dict(health_pb2.Event.Severity.items())


@given(st.text(max_size=40), st.dictionaries(st.text(max_size=8), st.text(max_size=8)))
def test_sentence_of_a_stranger_is_filled_in_by_name_and_by_nothing_else(
    sentence: str, facts: dict[str, str]
) -> None:
    known = {name: (value, "") for name, value in facts.items()}
    assert len(filled(sentence, known)) <= len(sentence) + 8 * len(sentence)
    for attack in ("{0}", "{x.__class__}", "{x!r}", "{x:99999999999}", "{{x}"):
        assert filled(attack, {"y": (1, "")}) == attack


def test_any_event_of_a_stranger_can_be_worded() -> None:
    message = health_pb2.Event(kind="\n", sentence="{a} {b}", severity=77)  # type: ignore[arg-type]
    message.facts.add(name="a")
    message.facts.add(name="b", number=math.nan, unit="m")
    assert sentence_of(message) == " nan m"
    assert log_of(message).message == " nan m"


# As people read them ------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (41.23, "m", "41.2 m"),
        (0.0123, "s", "0.0123 s"),
        (3600.04, "s", "3600 s"),
        (7, "", "7"),
        (12345, "", "12345"),
        (1_234_567, "B", "1.23 MB"),
        (999, "B", "999 B"),
        (12.0, "°", "12°"),
        (math.inf, "m", "inf m"),
        ("raw/gnss/fix", "", "raw/gnss/fix"),
    ],
)
def test_quantities_have_three_digits_and_a_unit(value: float | str, unit: str, text: str) -> None:
    assert quantity(value, unit) == text


def test_unit_is_the_last_word_of_a_name() -> None:
    assert unit_of("innovation_mps") == "m/s"
    assert unit_of("count") == unit_of("m") == unit_of("last_key") == ""
    assert all(unit_of(f"x_{word}") == unit for word, unit in UNITS.items())
