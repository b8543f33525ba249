"""filterpy's filters come without scipy.stats, and with all that they are asked for."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from live import finished

from tramstream.estimation.filterpy_base import KalmanFilter

PROCESSORS = "; ".join(
    f"import tramstream.processors.{each}"
    for each in ("tram.localiser", "kaspar2023.localiser", "distance.processor")
)
GENUINE = "import filterpy.stats"
NORMAL = "print(filterpy.stats.gaussian(0.0, 0.0, 1.0))"


def said(*program: str) -> list[str]:
    done = finished([sys.executable, "-c", "\n".join(program)])
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_log_likelihood_of_a_dense_update_is_that_of_the_normal_density() -> None:
    kf = KalmanFilter(dim_x=1, dim_z=1)
    kf.H = np.eye(1)
    kf.predict()
    kf.update(2.0)  # y = 2, S = P + Q + R = 3
    expected = -0.5 * (math.log(2 * math.pi * 3.0) + 2.0**2 / 3.0)
    assert kf.log_likelihood == pytest.approx(expected, abs=1e-12)


def test_processors_load_without_scipy_stats_which_is_there_for_whoever_wants_it() -> None:
    loaded, attribute, imported = said(
        "import sys",
        PROCESSORS,
        "print('scipy.stats' in sys.modules)",
        "import filterpy",
        NORMAL,
        GENUINE,
        NORMAL,
    )
    assert loaded == "False"
    assert float(attribute) == pytest.approx(1 / math.sqrt(2 * math.pi))
    assert imported == attribute


def test_statistics_that_were_imported_before_stay_what_they_are() -> None:
    load = "from tramstream.estimation.filterpy_base import KalmanFilter"
    same = "print(sys.modules['filterpy.stats'] is genuine is filterpy.stats)"
    assert said(GENUINE, "import sys; genuine = filterpy.stats", load, same) == ["True"]
