"""Real drives through importer, resampler and filter: the work behind `reproduce drives`.

Outages branch off one run: at each place its memory is copied, and the copy goes on without fixes.
That gives what an import with `--cut` gives, without filtering again what lies before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tramstream import keys
from tramstream.analysis.evaluate.errors import fix_errors, summary
from tramstream.analysis.evaluate.judgement import flat, flat_summary, judge, terms_of
from tramstream.analysis.evaluate.source import gather
from tramstream.analysis.tables.captures import Imports
from tramstream.analysis.tables.tables import Tables
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.localiser import TRACKING, Estimate
from tramstream.estimation.series import TruthSeries
from tramstream.geodesy import LocalLevel
from tramstream.processors.localisation.models import localiser
from tramstream.processors.resampling.resampler import Resampler
from tramstream.proto.sync_pb2 import SyncFrame
from tramstream.recorder.columns import read_ride
from tramstream.recorder.reader import open_record
from tramstream.recorder.reprocess.order import Output, Reprocessor
from tramstream.recorder.reprocess.plan import Plan
from tramstream.recorder.reprocess.run import rerun

CUTS_S = (15.0, 30.0, 60.0)
EVERY_S = 10.0
"""From place to place."""
SETTLED_S = 20.0
"""So long after the heading is known, the first cut may begin."""
LAST = 150
"""States that are kept of an outage: the last truth in it is a quarter of a second old."""
End = tuple[float, list[Estimate], LocalLevel]
"""Duration of an outage, its last states, and the frame that they are in."""


@dataclass(frozen=True)
class Drive:
    """One of the drives."""

    name: str
    folder: str
    mapping: str
    what: str


DRIVES = (
    Drive("rtkx", "rtkx_first_half", "rtkx.toml", "RTK at 1 Hz, judged on the withheld fixes"),
    Drive("smartloc", "smartloc_potsdamer", "smartloc.toml", "snapshot fixes, speed, yaw rate"),
)


@dataclass(frozen=True)
class Other:
    """What another system made of a drive: shared/data/README.md; of rtkx, the whole of it."""

    drive: str
    system: str
    rms_m: float | None = None
    p90_m: float | None = None
    up_m: float | None = None
    cuts_m: tuple[float, ...] = ()


OTHERS = (
    Other("rtkx", "KF-GINS", 0.092, 0.141, 0.032, (7.9, 54.0, 368.0)),
    Other("rtkx", "pyins", 0.128, 0.198, 0.035, (7.4, 57.0, 377.0)),
    Other("rtkx", "GNSS_IMU, no side slip", cuts_m=(5.7, 14.9, 20.9)),
    Other("smartloc", "the fixes as they are", 34.6, 55.9),
    Other("smartloc", "simple EKF, loose σ", 23.8),
)


@dataclass(frozen=True)
class Cut:
    """One outage: errors at the last truth in it, and what the filter said of them."""

    start_s: float
    duration_s: float
    along_m: float
    across_m: float
    std_m: float
    """Root of the sum of both horizontal variances."""

    @property
    def horizontal_m(self) -> float:
        return float(np.hypot(self.along_m, self.across_m))


def whole(data: Path, mapping: Path, say: Callable[[str], None]) -> dict[str, Any]:
    """Import, reprocess, smooth and evaluate a drive as the verbs do; figures of `evaluate`."""
    with TemporaryDirectory() as folder:
        source, out = Path(folder) / "drive.mcap", Path(folder) / "out.mcap"
        _import(data, mapping, source)
        rerun(source, out, None, smooth=True)
        found = gather(out, "", "", say)
        terms = terms_of(found.vehicle, found.origin_ns, 0.0, 5.0)
        figures: dict[str, Any] = {}
        for path, states in found.states.items():
            prefix = "" if path == keys.EST_STATE.path else "smoothed_"
            judgement = judge(states, found.truth, found.fixes, terms)
            figures |= {prefix + k: value for k, value in flat(judgement, terms).items()}
        if found.fixes is not None:
            errors = fix_errors(found.fixes, found.truth, terms.lever_arm_m)
            raw = flat_summary(summary(errors, found.origin_ns))
            figures |= {f"gnss_{k}": value for k, value in raw.items()}
        return figures


def outages(data: Path, mapping: Path, part: int, parts: int) -> list[Cut]:
    """Cut the fixes at every `parts`-th place from number `part` on, for each of `CUTS_S`."""
    vehicle, frames, truth, level = frames_of(data, mapping)
    main = localiser(vehicle)
    first_ns, last_ns = frames[0].stamp_ns, int(truth.stamp_ns[-1])
    place, next_ns, found = 0, 0, []
    for index, frame in enumerate(frames):
        if next_ns and frame.stamp_ns >= next_ns:
            if place % parts == part:
                branch = localiser(vehicle)
                branch.restore(main.snapshot())
                start_s = round((next_ns - first_ns) / S)
                ends = _ends(branch, frames[index:], next_ns, min(last_ns, frames[-1].stamp_ns))
                found += judged(ends, float(start_s), truth, level)
            place, next_ns = place + 1, next_ns + round(EVERY_S * S)
        estimate = main.take(frame)
        if not next_ns and estimate is not None and estimate.mode == TRACKING:
            settled_s = (frame.stamp_ns - first_ns) / S + SETTLED_S
            next_ns = first_ns + round(np.ceil(settled_s / EVERY_S) * EVERY_S * S)
    return found


def _import(
    data: Path, mapping: Path, out: Path, cuts: Sequence[tuple[float, float]] = ()
) -> Vehicle:
    imports = Imports(None, "", "ADIS16465-1")
    imports.tables(Tables(mapping, [str(data)], list(cuts)))
    imports.write(out)
    return imports.vehicle


def frames_of(
    data: Path, mapping: Path, cuts: Sequence[tuple[float, float]] = ()
) -> tuple[Vehicle, list[SyncFrame], TruthSeries, LocalLevel]:
    """What the filter gets of a drive, and the truth."""
    frames: list[SyncFrame] = []

    def take(session: int, log_ns: int, outputs: list[Output]) -> None:
        frames.extend(s.message for s, _ in outputs if s.key is keys.SYNC_FRAME)

    with TemporaryDirectory() as folder:
        source = Path(folder) / "drive.mcap"
        vehicle = _import(data, mapping, source, cuts)
        with open_record(source) as record:
            ride = read_ride(record, (), keys.TRUTH_STATE.path)
        with open_record(source) as record:
            Reprocessor(record, [Resampler(vehicle)], Plan(), take).run()
    assert ride.truth is not None
    assert ride.level is not None
    return vehicle, frames, ride.truth, ride.level


def _ends(branch: Any, frames: list[SyncFrame], start_ns: int, last_ns: int) -> Iterator[End]:
    """Go on without fixes; gives the states of the last second before each cut would end."""
    states: list[Estimate] = []
    lengths = [each for each in CUTS_S if start_ns + each * S <= last_ns]
    for frame in frames:
        while lengths and frame.stamp_ns >= start_ns + lengths[0] * S:
            yield lengths.pop(0), states[-LAST:], branch.level
        if not lengths:
            return
        if frame.gnss:
            blind = SyncFrame()
            blind.CopyFrom(frame)
            del blind.gnss[:]
            frame = blind
        estimate = branch.take(frame)
        if estimate is not None:
            states.append(estimate)


def judged(
    ends: Iterable[End],
    start_s: float,
    truth: TruthSeries,
    level: LocalLevel,
) -> list[Cut]:
    """Errors at the last truth before each end."""
    cuts = []
    for duration_s, states, own in ends:
        stamps = np.array([each.stamp_ns for each in states])
        row = int(np.searchsorted(truth.stamp_ns, stamps[-1], side="right")) - 1
        true = own.from_geodetic(level.to_geodetic(truth.p_l[row : row + 1]))[0]
        at = int(truth.stamp_ns[row])
        east, north = (
            float(np.interp(at, stamps, [each.p_l[k] for each in states])) - true[k] for k in (0, 1)
        )
        last = states[int(np.searchsorted(stamps, at))]
        cos, sin = np.cos(last.yaw_rad), np.sin(last.yaw_rad)
        covariance = np.asarray(last.covariance)
        cuts.append(
            Cut(
                start_s=start_s,
                duration_s=duration_s,
                along_m=float(cos * east + sin * north),
                across_m=float(cos * north - sin * east),
                std_m=float(np.sqrt(covariance[0, 0] + covariance[1, 1])),
            )
        )
    return cuts
