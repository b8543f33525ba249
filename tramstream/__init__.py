"""Localisation stack of a tram's onboard computer; `import tramstream as ts` is its library face.

    record = ts.open_record("d.mcap")                    # a file, or a folder with the parts of one
    frame = record["est/ekf/state"].to_pandas()          # any key, ours or a stranger's
    ride = ts.simulate("kaspar2023", seed=1)             # a record with its truth
    estimates = ts.localise(ride)                        # what the vehicle's processors make of it
    other = ts.localise(ride, {"ekf": {"model": "kaspar2023"}})    # with other settings
    ts.evaluate(estimates, ride)["horizontal_rms_m"]

Units
    SI and radians. A column's, figure's or setting's name ends in its unit: `speed_mps`, `yaw_rad`,
    `stamp_ns`; `_deg` is for latitude, longitude and what receivers say. Deviations are
    `speed_std_mps`.
Frames
    `l` local level: east, north, up at the line's origin. `v` vehicle: forward, left, up; its
    origin is the point that positions are of. `b` case of the inertial sensor. `e` fixed to the
    Earth. Heights are above the ellipsoid unless the name says otherwise. `p_va_v` goes from the
    origin of `v` to the antenna, resolved in `v`.
Signs
    Yaw counts counter-clockwise from east, and a left turn has a positive rate. Roll is positive
    with the right side down, pitch with the nose down; both are the body's, which nods on its
    springs. The track's slope is `grade_rad`, positive uphill. Speed is along x of the vehicle,
    negative when it runs backwards. An error is estimate minus truth, an innovation z - h(x).
Clocks
    Stamps are on the vehicle clock: nanoseconds that look like Unix time, monotonic, never stepped.
    `stamp_ns` says when a quantity was true, `publish_ns` when it was sent, `log_ns` when it
    reached the record. `Columns.time_s` counts from the record's first arrival, `Columns.utc` is
    UTC.
Covariances
    `MotionState.covariance` is the upper triangle, row by row, of east, north, up, speed, roll,
    pitch, yaw.

What is damaged, or cannot be decoded, is left out, counted and warned of (`LeftOutWarning`), never
guessed at. Errors are `TramstreamError` with one sentence. docs/python.md shows all of it at work.

Behind the face are the library of the vehicle (messages, keys, the bus, the one loop, clocks, the
simulator: `tramstream.*`), `tramstream.bridges` (device bytes to messages), `tramstream.processors`
(messages to messages), `tramstream.recorder` (files) and `tramstream.cli`. A name of the face is
loaded when it is first used, so that a process on the vehicle carries nothing of it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tramstream.analysis.evaluate.evaluation import Evaluation
    from tramstream.analysis.notebook.judging import evaluate
    from tramstream.analysis.notebook.localisation import localise
    from tramstream.analysis.notebook.record import Record, open_record
    from tramstream.analysis.notebook.rides import simulate
    from tramstream.errors import LeftOutWarning, TramstreamError
    from tramstream.recorder.message_columns import Columns

__version__ = "0.1.0"
__all__ = [
    "Columns",
    "Evaluation",
    "LeftOutWarning",
    "Record",
    "TramstreamError",
    "evaluate",
    "localise",
    "open_record",
    "simulate",
]

_PLACES = {
    "Columns": "tramstream.recorder.message_columns",
    "Evaluation": "tramstream.analysis.evaluate.evaluation",
    "LeftOutWarning": "tramstream.errors",
    "Record": "tramstream.analysis.notebook.record",
    "TramstreamError": "tramstream.errors",
    "evaluate": "tramstream.analysis.notebook.judging",
    "localise": "tramstream.analysis.notebook.localisation",
    "open_record": "tramstream.analysis.notebook.record",
    "simulate": "tramstream.analysis.notebook.rides",
}
"""Where each name of the face is at home; loaded when it is asked for (PEP 562)."""


def __getattr__(name: str) -> Any:
    place = _PLACES.get(name)
    if place is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = globals()[name] = getattr(import_module(place), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
