"""A calibration in lines for people; only what the ride tells is a figure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from tramstream.analysis.odometry.calibration import Calibration, Figure

NOTABLE = 0.3
"""Correlations below go unsaid."""
_SHOWN = {
    "1": lambda each: f"{100 * each.value:+.4f} % ± {100 * each.std:.4f} %",
    "m": lambda each: f"{each.value:+.2f} m ± {each.std:.2f} m",
    "s": lambda each: f"{1e3 * each.value:+.1f} ms ± {1e3 * each.std:.1f} ms",
}
_UNKNOWN = {
    "1": lambda std: f"{100 * std:.2g} %",
    "m": lambda std: f"{std:.2g} m",
    "s": lambda std: f"{1e3 * std:.2g} ms",
}
_SENSORS = {"gnss": "the receiver's", "imu": "the IMU's", "wheels": "the wheels'"}


def of_ride(found: Calibration) -> Iterator[str]:
    """Say what came of a ride."""
    if found.clock.sensor:
        clock = found.clock
        yield (
            f"{_SENSORS[clock.sensor]} clock is {clock.offset_s:+.3f} s off "
            f"(± {clock.std_s:.3f} s): its stamps are {'late' if clock.offset_s > 0 else 'early'}"
        )
    if found.verdict:
        yield f"no figures: {found.verdict}"
        return
    yield f"{found.way_m / 1e3:.2f} km, {found.moving_s:.0f} s of motion"
    for each in found.figures:
        yield f"{each.name:<15} {_figure(each)}"
    yield from _together(found)
    for slip in found.slips:
        kind = "slips" if slip.way_m > 0.0 else "slides"
        yield (
            f"{slip.wheel} {kind} from {slip.start_s:.1f} to {slip.end_s:.1f} s: "
            f"{slip.way_m:+.2f} m of way"
        )
    yield from found.notes


def _figure(each: Figure) -> str:
    if not each.told:
        return f"not known from this ride (± {_UNKNOWN[each.unit](each.std)})"
    return _SHOWN[each.unit](each)


def _together(found: Calibration) -> Iterator[str]:
    """Say which figures go together."""
    for i, one in enumerate(found.figures):
        for k in range(i):
            other = found.figures[k]
            size = float(found.correlation[i, k])
            if abs(size) > NOTABLE and one.told and other.told:
                yield f"correlation of {other.name} and {one.name}: {size:+.2f}"


def number(value: Any) -> Any:
    """What JSON can hold."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
