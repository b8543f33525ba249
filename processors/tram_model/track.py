"""That the vehicle is on a track: its distance, its heading, its grade; three measurements.

    0 = n · (p − d − p_track),    ψ_track(s) = ψ,    γ = −θ

with the track's left unit normal n and the shift d of the rails from the map as a whole (see
`map_shift.py`). The heading that a track has depends on how far along it the vehicle is: in a curve
its row reads the place along the track. What the map tells is of a state that was, at `east_m`,
`north_m`, `yaw_rad`; what updates have moved since is taken into account.
"""

from __future__ import annotations

from typing import NamedTuple

from tramstream.estimation.kalman import Array, compiled
from tramstream.processors.tram_model.measurement import EVERY, SCALAR_GATE
from tramstream.processors.tram_model.records import MEMORY, PARAMETERS
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.update import columns_of, update_row

NOD_RAD_PER_MPS2 = 0.005
"""Springs of a Tatra T3's kind give by 0.3° for each m/s² (scenario `tram`)."""
NODS_M = 100.0
"""So long a body nods alike: the way of a departure or a braking, over which a grade is taken once
a metre."""
_PLACE = columns_of(Ix.EAST, Ix.NORTH, Ix.MAP_EAST, Ix.MAP_NORTH)
_HEADING = columns_of(Ix.EAST, Ix.NORTH, Ix.YAW, Ix.MAP_EAST, Ix.MAP_NORTH)
_PITCH = columns_of(Ix.PITCH)


@compiled
def take_distance(
    memory: Array, normal_east: float, normal_north: float, across: float, R: float, gate: float
) -> None:
    """Take the distance from a track; see `TrackDistance`."""
    f = memory.view(MEMORY)[0]
    f.H[0, Ix.EAST], f.H[0, Ix.NORTH] = normal_east, normal_north
    f.H[0, Ix.MAP_EAST], f.H[0, Ix.MAP_NORTH] = -normal_east, -normal_north
    f.y[0] = -across
    update_row(f, 0, _PLACE, R, gate)


class TrackDistance(NamedTuple):
    """How far left of the track the state as it is lies, its place less the map's shift."""

    normal_east: float
    normal_north: float
    """Left unit normal of the track, in `l`."""
    across_m: float
    variance_m2: float
    gate: float = SCALAR_GATE

    @property
    def names(self) -> tuple[str, ...]:
        return ("track_across",)

    @property
    def verdicts(self) -> int:
        return EVERY

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        take_distance(memory, *self)


@compiled
def take_heading(
    memory: Array,
    normal_east: float,
    normal_north: float,
    yaw_off: float,
    bend: float,
    east: float,
    north: float,
    yaw: float,
    R: float,
    gate: float,
) -> None:
    """Take the heading of a track; see `TrackHeading`."""
    f = memory.view(MEMORY)[0]
    x, h = f.x, f.H[0]
    along = normal_north * (x[Ix.EAST] - x[Ix.MAP_EAST] - east)
    along -= normal_east * (x[Ix.NORTH] - x[Ix.MAP_NORTH] - north)
    h[Ix.MAP_EAST], h[Ix.MAP_NORTH] = bend * normal_north, -bend * normal_east
    h[Ix.EAST], h[Ix.NORTH], h[Ix.YAW] = -bend * normal_north, bend * normal_east, 1.0
    f.y[0] = bend * along - (yaw_off + x[Ix.YAW] - yaw)
    update_row(f, 0, _HEADING, R, gate)


class TrackHeading(NamedTuple):
    """How much further left than along the track a state headed."""

    normal_east: float
    normal_north: float
    """Left unit normal of the track, in `l`."""
    yaw_off_rad: float
    bend_per_m: float
    """How much the track turns left for each metre that the vehicle goes along it."""
    east_m: float
    north_m: float
    yaw_rad: float
    """That state, on the map."""
    variance_rad2: float
    gate: float = SCALAR_GATE

    @property
    def names(self) -> tuple[str, ...]:
        return ("track_heading",)

    @property
    def verdicts(self) -> int:
        return EVERY

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        take_heading(memory, *self)


@compiled
def nod_variance(force_mps2: float) -> float:
    """Variance that springs add to a grade that is taken for the body's pitch, rad².

    Parameters
    ----------
    force_mps2 : float
        Specific force along the track.
    """
    nod = NOD_RAD_PER_MPS2 * force_mps2
    return nod * nod * NODS_M


@compiled
def take_grade(
    memory: Array, parameters: Array, grade: float, variance: float, gate: float
) -> None:
    """Take the grade of a track; see `TrackGrade`."""
    f, c = memory.view(MEMORY)[0], parameters.view(PARAMETERS)[0]
    R = variance + nod_variance(f.acceleration + c.gravity * grade)
    f.H[0, Ix.PITCH] = 1.0
    f.y[0] = -grade - f.x[Ix.PITCH]
    update_row(f, 0, _PITCH, R, gate)


class TrackGrade(NamedTuple):
    """Grade of the track, uphill positive along x of the vehicle; taken for the body's pitch."""

    grade_rad: float
    variance_rad2: float
    """Of the grade; what springs may add is added to it."""
    gate: float = SCALAR_GATE

    @property
    def names(self) -> tuple[str, ...]:
        return ("track_grade",)

    @property
    def verdicts(self) -> int:
        return EVERY

    def update(self, memory: Array, parameters: Array, situation: Array) -> None:
        take_grade(memory, parameters, *self)
