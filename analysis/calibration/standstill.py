"""Where a record's vehicle stands, told by its inertial sensors, its wheels and its fixes.

A window of a second is at rest where no axis scatters more than the quietest windows do and no
mean jumps against its neighbour's. A ride without any shaking at constant speed looks the same to
the sensors; where the record has wheels or fixes, they are asked too.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tramstream import keys
from tramstream.analysis.calibration.allan import Run
from tramstream.analysis.calibration.samples import Spool, Windows
from tramstream.clock import S
from tramstream.recorder.message_columns import read_columns
from tramstream.recorder.reader import Record

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

QUIETEST = 5.0
"""Percentile of windows whose scatter is taken for that of standstill."""
LOUDER = 10.0
"""A variance so many times that is motion; an engine's idling differs by 8 from stop to stop (rtkx,
docs/calibration.md)."""
JUMP = 30.0
"""A mean that differs so much from its neighbour's, in deviations by white noise, is motion; the
bias of a poor gyroscope walks by one."""
TURNING_RADPS = 0.05
"""3 °/s: no gyroscope in use has such a bias; a curve of 200 m at 10 m/s turns so."""
MARGIN = 2
"""Windows next to motion that are left out too: a body sways on."""
SHORTEST_S = 10.0
"""A stretch below is left out."""
ROLLING_MPS, FIX_MPS = 0.02, 0.5
"""Speeds from which wheels and fixes say that the vehicle moves."""


class Rest(NamedTuple):
    """What was found."""

    stretches: list[Run]
    standing_s: float
    moving_s: float
    """Windows that move or shake."""


def find(spool: Spool, records: Iterable[Record]) -> Rest:
    """Find the stretches at rest."""
    windows = spool.windows
    moving = moves(windows, spool.scales.gyro_radps)
    start_ns = _instants(spool, windows)
    for record in records:
        for begin_ns, end_ns in _rolling(record):
            late = np.searchsorted(start_ns, begin_ns, side="right") - 1
            until = np.searchsorted(start_ns, end_ns, side="right")
            moving[max(int(late), 0) : int(until)] = True
    found = stretches(spool.runs, windows, moving, spool.rate_hz)
    samples = sum(run.end - run.start for run in found)
    moving_s = float(np.count_nonzero(moving)) * windows.size / spool.rate_hz
    return Rest(found, samples / spool.rate_hz, moving_s)


def moves(windows: Windows, gyro_radps: float) -> Flags:
    """Windows in which the sensors feel motion.

    Parameters
    ----------
    windows : Windows
    gyro_radps : float
        Unit of a count of the gyroscopes.
    """
    if not len(windows.start):
        return np.zeros(0, bool)
    freedom = windows.size - 1
    scatter = windows.variance + 1 / 12  # rounding to whole counts
    floor = np.percentile(scatter, QUIETEST, axis=0)
    louder = max(LOUDER, 1.5 * float(stats.chi2.isf(1e-7, freedom)) / freedom)
    moving: Flags = np.any(scatter > louder * floor, axis=1)
    moving |= np.any(np.abs(windows.mean[:, :3]) * gyro_radps > TURNING_RADPS, axis=1)
    follows = np.diff(windows.start) == windows.size
    jump = np.abs(np.diff(windows.mean, axis=0)) > JUMP * np.sqrt(2 * floor / windows.size)
    jumps = np.any(jump, axis=1) & follows
    moving[:-1] |= jumps
    moving[1:] |= jumps
    return moving


def stretches(runs: list[Run], windows: Windows, moving: Flags, rate_hz: float) -> list[Run]:
    """Samples at rest: neighbouring windows of a run without motion, away from it."""
    near = moving.copy()
    for shift in range(1, MARGIN + 1):
        near[shift:] |= moving[:-shift]
        near[:-shift] |= moving[shift:]
    found = []
    for run in runs:
        inside = np.flatnonzero((windows.start >= run.start) & (windows.start < run.end))
        if not len(inside):
            continue
        quiet = np.concatenate([[False], ~near[inside], [False]])
        edges = np.flatnonzero(np.diff(quiet.astype(np.int8)))
        for first, end in edges.reshape(-1, 2).tolist():
            begin = int(windows.start[inside[first]])
            stop = int(windows.start[inside[end - 1]]) + windows.size
            whole = end == len(inside)  # what does not fill a window any more belongs to it
            found.append(Run(begin, run.end if whole else stop))
    least = max(SHORTEST_S * rate_hz, 1)
    return [each for each in found if each.end - each.start >= least]


def _instants(spool: Spool, windows: Windows) -> NDArray[np.int64]:
    """When each window begins, vehicle clock."""
    starts = np.array([run.start for run in spool.runs], dtype=np.int64)
    begins = np.array([begin for begin, _ in spool.spans_ns], dtype=np.int64)
    if not len(windows.start):
        return windows.start
    run = np.searchsorted(starts, windows.start, side="right") - 1
    past = (windows.start - starts[run]) / spool.rate_hz * S
    return begins[run] + past.astype(np.int64)


def _rolling(record: Record) -> list[tuple[int, int]]:
    """Spans of time in which wheels turn or fixes move."""
    spans: list[tuple[int, int]] = []
    for topic in record.channels:
        path = keys.split(topic)[1]
        if path == keys.ODO_WHEELS.path:
            columns = read_columns(record, {topic: ("wheels",)})[topic].elements("wheels")
            spans += _turning(columns["wheel"], columns["stamp_ns"], columns["pulses"])
        elif path == keys.GNSS_FIX.path:
            found = read_columns(record, {topic: ("speed_mps", "valid")})[topic]
            fast = found["valid"].astype(bool) & (found["speed_mps"] > FIX_MPS)
            spans += [(int(each), int(each)) for each in found.stamp_ns[fast]]
    return spans


def _turning(
    names: NDArray[np.object_], stamp_ns: NDArray[np.int64], pulses: NDArray[np.int64]
) -> list[tuple[int, int]]:
    """Spans between two readings of a wheel that differ; wheels that tell no pulses say nothing."""
    spans: list[tuple[int, int]] = []
    for name in sorted(set(names.tolist())):
        own = names == name
        counted, stamps = np.ma.asarray(pulses[own]), stamp_ns[own]
        if np.ma.getmaskarray(counted).any():
            continue
        turned = np.flatnonzero(np.diff(counted.data.astype(np.int64)))
        spans += zip(stamps[turned].tolist(), stamps[turned + 1].tolist(), strict=True)
    return spans
