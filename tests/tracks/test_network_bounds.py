"""Numbers that no rail has are refused when a network is read: kernels do not look again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from networks import town

from tramstream.errors import ConfigError
from tramstream.tracks.network import LineStop, Network, RouteLine, Stop, Way, load


def with_(name: str, value: float, at: int = 1) -> Callable[[Network], Network]:
    """The network with one number of an array changed."""

    def change(network: Network) -> Network:
        array = np.array(getattr(network, name))
        array[at] = value
        return replace(network, **{name: array})

    return change


def named(**names: Any) -> Callable[[Network], Network]:
    return lambda network: replace(network, **names)


def line(**fields: Any) -> Callable[[Network], Network]:
    whole: dict[str, Any] = {"runs": (0, 2), "begin_m": 0.0, "length_m": 10.0, "stops": ()}
    return named(lines=(RouteLine("9", "", "a", "b", **whole | fields),))


def overrun(network: Network) -> Network:
    """Starts whose differences run over 32 bits and look as if they rose."""
    starts = np.array(network.starts)
    starts[1:3] = 2**31 - 1, -(2**31) + 100
    return replace(network, starts=starts)


HOSTILE: dict[str, Callable[[Network], Network]] = {
    "starts that run over": overrun,
    "a length beyond Earth": with_("length_m", 1e300),
    "a length that no samples fill": with_("length_m", 1e6),
    "a length of nearly nothing": with_("length_m", 1e-300),
    "an endless curvature": with_("curvature_per_m", 200.0),
    "a deviation beyond Earth": with_("across_std_m", 3e38),
    "a height in space": with_("height", 1e30),
    "a latitude beyond the pole": named(latitude_rad=2.0),
    "a stop beyond Earth": named(stops=(Stop("A", 0, 1e300),)),
    "a way beyond Earth": named(ways=(Way(0, 0.0, 1e300, 1, {}),)),
    "a line over no track": line(runs=()),
    "a line beyond Earth": line(length_m=1e300),
    "a line that begins beyond Earth": line(begin_m=-1e300),
    "a line's stop beyond Earth": line(stops=(LineStop("A", 1e300),)),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_network_with_numbers_of_no_rail_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / "a.tracks"
    HOSTILE[name](town()).save(path)
    with pytest.raises(ConfigError, match="is no track network, or a damaged one"):
        load(path)


def test_network_with_a_line_and_unknown_heights_is_read(tmp_path: Path) -> None:
    network = with_("height", np.nan)(line()(town()))
    network.save(tmp_path / "a.tracks")
    assert load(tmp_path / "a.tracks").lines == network.lines
