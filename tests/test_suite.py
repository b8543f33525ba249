"""What the suite demands of itself: no test decides by the wall clock."""

from __future__ import annotations

from hypothesis import HealthCheck, settings


def test_examples_have_no_deadline_and_may_be_slow_to_make() -> None:
    assert settings.default is not None
    assert settings.default.deadline is None
    assert HealthCheck.too_slow in settings.default.suppress_health_check
    assert settings(max_examples=1).deadline is None  # what a test sets for itself builds on it
