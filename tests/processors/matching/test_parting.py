"""Beyond a switch nothing is said surer than maps of switches are; before it, everything."""

from __future__ import annotations

import networks
import numpy as np
import pytest
from estimates import driven, steady
from test_matching import matched

from tramstream.processors.matching.parting import FAR_M, WRONG_SHARE, beyond_switch_m, surest


def test_way_since_the_switch_is_that_along_the_rails() -> None:
    case = networks.ladder(3)
    found = beyond_switch_m(case.network)
    assert found[case.run("lead 0")] == FAR_M
    assert found[case.run("track 0")] == found[case.run("lead 1")] == 0.0
    assert found[case.run("track 2")] == 0.0
    last = case.lines["lead 3"].length_m
    assert found[case.run("lead 3")] == 0.0
    assert last > 0.0
    # Trailing, the rails of both come together: nothing parts.
    assert found[case.run("-lead 0")] == FAR_M


def test_way_goes_on_over_nodes_that_are_no_switch() -> None:
    case = networks.passing_loop()
    found = beyond_switch_m(case.network)
    assert found[case.run("left")] == 0.0
    assert found[case.run("behind")] == pytest.approx(
        min(case.lines["left"].length_m, case.lines["right"].length_m, FAR_M)
    )


def test_certainty_grows_with_the_way_and_is_whole_far_from_switches() -> None:
    way_m = np.linspace(0.0, FAR_M, 50)
    most = np.array([surest(float(each)) for each in way_m])
    assert most[0] == 1.0 - WRONG_SHARE
    assert (np.diff(most) >= 0.0).all()
    assert surest(60.0) > 0.9999
    assert surest(FAR_M) == 1.0


@pytest.mark.parametrize("taken", ["straight", "branch"])
def test_what_is_said_is_no_surer_and_what_is_believed_is_as_it_was(taken: str) -> None:
    case = networks.switch()
    ride = matched(case, driven(case.path("stem", taken), steady(400.0, 8.0), seed=1))
    said = [ride.matcher.said(match) for match in ride.matches]
    beyond = 0
    for match, published in zip(ride.matches, said, strict=True):
        assert published.probability <= match.probability
        if match.run == case.run(taken) and match.chainage_m < 10.0:
            beyond += match.probability > published.probability
            assert published.probability <= surest(match.chainage_m)
        if match.others and published.probability < match.probability:
            total = sum(each.probability for each in (match, *match.others))
            rest = sum(each.probability for each in published.others)
            assert published.probability + rest == pytest.approx(total)
    assert beyond > 0
    far = ride.s > 360.0
    assert min(each.probability for each, s in zip(said, far, strict=True) if s) > 0.995
    before = (ride.s > 50.0) & (ride.s < 250.0)
    assert all(
        published is match
        for match, published, s in zip(ride.matches, said, before, strict=True)
        if s
    )
