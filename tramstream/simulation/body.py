"""The vehicle's body: parts carried by bogies, on springs. Where its sensors are and how they move.

Each part is carried by two pivots that stay on the track. Its axis is the chord between them, so
its yaw is not the track's in a curve, nor its pitch the grade; its roll without springs is the mean
of the cants under both pivots. Neighbouring parts share a pivot (Jacobs bogies). The first pivot is
the vehicle's origin, with the first part's axes; it stays on the track exactly.

Pivots are solved for, |p_j − p_(j+1)| = L with p on the line, and their derivatives against the
first one's arc length follow from differentiating that twice:

    s' = c·p_j' / c·t          s'' = (c·p_j'' + c'·c' − s'² c·t') / c·t

with c the chord, t the tangent at the pivot behind. Two derivatives give rates and accelerations
exactly, however the vehicle speeds up.

Springs (`simulation.springs`) add pitch and roll, as the specific force along and across at the
middle of the part wants it (standing on a grade it leans as well), about a point at a height
between its pivots.

What is left out: bogies that turn and sway under their pivots, springs that give vertically, and
the sensors' way when a pivot runs outside the line (there the track goes straight on).
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike, NDArray

from tramstream import geodesy
from tramstream.attitude import C_vl, body_rates
from tramstream.config import NotNegative, Positive, Struct, Vector
from tramstream.lines.line import Line
from tramstream.lines.profile import Shape
from tramstream.simulation.imu import angular_acceleration_v
from tramstream.simulation.ride import Motion, Ride
from tramstream.simulation.springs import NODES_HZ, Oscillator, Springs

Array = NDArray[np.float64]

_NEWTON_STEPS = 4
"""The chord is nearly as long as the way: each step doubles the digits, from 3 on."""
MAX_PARTS = 3
Number = Annotated[int, Meta(ge=1, le=MAX_PARTS)]


class Body(Struct, frozen=True, kw_only=True):
    """Bogies and springs; the defaults are those of a tram of one part, its springs soft."""

    pivots_m: Annotated[tuple[float, ...], Meta(min_length=2, max_length=MAX_PARTS + 1)] = (
        0.0,
        -6.4,
    )
    """x of the pivots of the bogies, or of the axles of a single truck, from the first on
    backwards; neighbours carry a part between them."""
    pitch_deg_per_mps2: NotNegative = 0.3
    """How far springs let the body nod; 0: not at all."""
    roll_deg_per_mps2: NotNegative = 0.3
    pitch_hz: Positive = 1.2
    roll_hz: Positive = 1.0
    damping: Annotated[float, Meta(gt=0, lt=1)] = 0.25
    centre_height_m: float = 0.8
    """About which the body nods and leans, in the middle between a part's pivots."""

    def __post_init__(self) -> None:
        if self.pivots_m[0] != 0.0 or any(b >= a for a, b in pairwise(self.pivots_m)):
            raise ValueError("`pivots_m` begins with 0, the vehicle's origin, and descends")

    @property
    def parts(self) -> int:
        return len(self.pivots_m) - 1


class Attitude(NamedTuple):
    """Roll, pitch and yaw with two derivatives, one row an instant; names as in `Motion`."""

    roll_rad: Array
    pitch_rad: Array
    yaw_rad: Array
    roll_rate_radps: Array
    pitch_rate_radps: Array
    yaw_rate_radps: Array
    roll_acceleration_radps2: Array
    pitch_acceleration_radps2: Array
    yaw_acceleration_radps2: Array

    @property
    def C_vl(self) -> Array:
        return C_vl(self.roll_rad, self.pitch_rad, self.yaw_rad)

    @property
    def omega_v(self) -> Array:
        rates = (self.roll_rate_radps, self.pitch_rate_radps, self.yaw_rate_radps)
        return np.stack(body_rates(self.roll_rad, self.pitch_rad, rates), axis=-1)

    def moved(self, lever_v: Array) -> tuple[Array, Array]:
        """Velocity and acceleration in `v` that turning gives a point, (n, 3) each."""
        omega = self.omega_v
        velocity = np.cross(omega, lever_v)
        turning = np.cross(angular_acceleration_v(self), lever_v)
        return velocity, turning + np.cross(omega, velocity)


class Pivots(NamedTuple):
    """Two pivots of a part on a flat Earth, with their derivatives against time."""

    p_l: Array
    """Of the front one, (n, 3), m."""
    vel_l: Array
    acc_l: Array
    middle_acc_l: Array
    """Of the middle between both, m/s²."""


class Part(NamedTuple):
    """One part at some instants."""

    pivots: Pivots
    chord: Attitude
    """Of the axis between the pivots and the cant under them: without springs."""
    body: Attitude
    centre_v: Array
    """About which springs let it turn, from the front pivot."""

    def point(self, lever_v: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration in `l` of a point of the body, on a flat Earth.

        p = p_pivot + C_lw r_c + C_lv (r − r_c): w turns with the chord, v with the body.
        """
        p_l, vel_l, acc_l = self.pivots.p_l, self.pivots.vel_l, self.pivots.acc_l
        for turned, lever in ((self.chord, self.centre_v), (self.body, lever_v - self.centre_v)):
            velocity, acceleration = turned.moved(lever)
            C = turned.C_vl
            p_l = p_l + np.einsum("nvl,v->nl", C, lever)
            vel_l = vel_l + np.einsum("nvl,nv->nl", C, velocity)
            acc_l = acc_l + np.einsum("nvl,nv->nl", C, acceleration)
        return p_l, vel_l, acc_l


class Carriage:
    """All parts of a body on a ride.

    Parameters
    ----------
    body : Body
    ride : Ride
    gravity_mps2 : float
    end_s : float
        Springs are followed until this time of the ride.
    """

    def __init__(self, body: Body, ride: Ride, gravity_mps2: float, end_s: float) -> None:
        self.body = body
        self.ride = ride
        self._gravity_mps2 = gravity_mps2
        self._end_s = end_s
        self._springs: dict[int, Springs] = {}
        """Of the parts that were asked for."""

    @property
    def _on_springs(self) -> bool:
        return bool(self.body.pitch_deg_per_mps2 or self.body.roll_deg_per_mps2)

    def part(self, number: int, time_s: Array) -> Part:
        """Give part `number` (1 is the first) at instants of the ride."""
        pivots, chord = self._carried(number, self.ride.motion(time_s))
        body = _sprung(chord, self._springs_of(number), time_s) if self._on_springs else chord
        length_m = self.body.pivots_m[number - 1] - self.body.pivots_m[number]
        centre_v = np.array([-length_m / 2, 0.0, self.body.centre_height_m])
        return Part(pivots, chord, body, centre_v)

    def lever_v(self, number: int, p_v: Vector) -> Array:
        """Bring a place, from the vehicle's origin with all parts in one line, to its part."""
        return np.array(p_v) - (self.body.pivots_m[number - 1], 0.0, 0.0)

    def motion(self, time_s: Array) -> Motion:
        """Give the vehicle's origin with the axes of the first part: what a filter is to find.

        Speed and acceleration are along x, which is not quite along the track.
        """
        motion, part = self.ride.motion(time_s), self.part(1, time_s)
        C = part.body.C_vl
        forward, left, up = np.moveaxis(C, -2, 0)
        _, omega_y, omega_z = part.body.omega_v.T
        turning = omega_z[:, None] * left - omega_y[:, None] * up
        acceleration = np.sum(part.pivots.acc_l * forward + part.pivots.vel_l * turning, axis=1)
        return motion._replace(
            speed_mps=np.sum(part.pivots.vel_l * forward, axis=1),
            acceleration_mps2=acceleration,
            **part.body._asdict(),
        )

    def _carried(self, number: int, motion: Motion) -> tuple[Pivots, Attitude]:
        """Find pivots and chord of a part, against the way of the first pivot, then time."""
        line, sign = self.ride.line, self.ride.direction
        still = np.zeros_like(motion.arc_length_m)
        way = Shape(motion.arc_length_m, still + 1.0, still)
        front = _on_track(line, way)
        for x, behind in pairwise(self.body.pivots_m[: number + 1]):
            if behind != self.body.pivots_m[number]:
                way = _following(line, way, front, sign * (x - behind))
                front = _on_track(line, way)
        length = self.body.pivots_m[number - 1] - self.body.pivots_m[number]
        behind_way = _following(line, way, front, sign * length)
        rear = _on_track(line, behind_way)
        chord = [a - b for a, b in zip(front, rear, strict=True)]
        roll = _half(_cant(line, way), _cant(line, behind_way), sign)
        speed = motion.speed_mps * sign
        change = motion.acceleration_mps2 * sign
        attitude = _attitude(roll, *_directions(chord, length, motion.yaw_rad), speed, change)
        middle = [(a + b) / 2 for a, b in zip(front, rear, strict=True)]
        vel_l, acc_l = _in_time(front, speed, change)
        return Pivots(front[0], vel_l, acc_l, _in_time(middle, speed, change)[1]), attitude

    def _springs_of(self, number: int) -> Springs:
        """Let springs of a part feel the force of the whole ride, once."""
        known = self._springs.get(number)
        if known is not None:
            return known
        nodes_s = np.arange(math.ceil(self._end_s * NODES_HZ) + 2) / NODES_HZ
        motion = self.ride.motion(nodes_s)
        pivots, chord = self._carried(number, motion)
        up_l = self.ride.up_l(motion) * self._gravity_mps2
        along, across, _ = np.einsum("nvl,nl->vn", chord.C_vl, pivots.middle_acc_l + up_l)
        body = self.body
        nod, lean = math.radians(body.pitch_deg_per_mps2), math.radians(body.roll_deg_per_mps2)
        self._springs[number] = springs = Springs(
            Oscillator(-nod * along, body.pitch_hz, body.damping),
            Oscillator(lean * across, body.roll_hz, body.damping),
        )
        return springs


# Points on the track ------------------------------------------------------------------------------
def _flat_l(line: Line, arc_length_m: Array) -> Array:
    """Position as on a flat Earth, beyond the line's ends straight on."""
    inside = np.clip(arc_length_m, 0.0, line.length_m)
    p_l = line.position_l(inside)
    p_l[..., 2] += np.sum(p_l[..., :2] ** 2, axis=-1) / (2 * geodesy.SEMI_MAJOR_M)
    beyond = arc_length_m - inside
    if np.any(beyond):
        p_l = p_l + beyond[..., None] * _tangent(line, inside)[0]
    return p_l


def _tangent(line: Line, arc_length_m: Array) -> tuple[Array, Array]:
    """Direction of the track and its derivative along it, (n, 3) each."""
    yaw, grade = line.yaw_shape(arc_length_m), line.grade.shape(arc_length_m)
    cos_y, sin_y = np.cos(yaw.value), np.sin(yaw.value)
    cos_g, sin_g = np.cos(grade.value), np.sin(grade.value)
    tangent = np.stack([cos_g * cos_y, cos_g * sin_y, sin_g], axis=-1)
    left = np.stack([-sin_y, cos_y, np.zeros_like(cos_y)], axis=-1)
    upwards = np.stack([-sin_g * cos_y, -sin_g * sin_y, cos_g], axis=-1)
    inside = (arc_length_m >= 0.0) & (arc_length_m <= line.length_m)
    bent = np.where(inside, yaw.slope_per_m * cos_g, 0.0)
    rising = np.where(inside, grade.slope_per_m, 0.0)
    return tangent, bent[..., None] * left + rising[..., None] * upwards


def _on_track(line: Line, way: Shape) -> list[Array]:
    """Place of a pivot, and two derivatives against the first pivot's way."""
    tangent, bend = _tangent(line, way.value)
    slope, change = way.slope_per_m[:, None], way.bend_per_m2[:, None]
    return [
        _flat_l(line, way.value),
        tangent * slope,
        tangent * change + bend * slope**2,
    ]


def _following(line: Line, way: Shape, front: list[Array], length_m: float) -> Shape:
    """Way of the pivot a chord behind (ahead, if the length is negative); see the module's top."""
    s = way.value - length_m
    for _ in range(_NEWTON_STEPS):
        chord = front[0] - _flat_l(line, s)
        excess = np.sum(chord**2, axis=1) - length_m**2
        s = s + excess / (2 * _dot(chord, _tangent(line, s)[0]))
    tangent, bend = _tangent(line, s)
    chord = front[0] - _flat_l(line, s)
    along = _dot(chord, tangent)
    slope = _dot(chord, front[1]) / along
    turning = front[1] - slope[:, None] * tangent
    change = _dot(chord, front[2]) + _dot(turning, turning) - slope**2 * _dot(chord, bend)
    return Shape(s, slope, change / along)


def _dot(a: Array, b: Array) -> Array:
    product: Array = np.sum(a * b, axis=-1)
    return product


def _cant(line: Line, way: Shape) -> Shape:
    """Cant under a pivot against the first pivot's way."""
    cant = line.cant.shape(way.value)
    return Shape(
        cant.value,
        cant.slope_per_m * way.slope_per_m,
        cant.bend_per_m2 * way.slope_per_m**2 + cant.slope_per_m * way.bend_per_m2,
    )


def _half(one: Shape, other: Shape, sign: float) -> Shape:
    return Shape(*(sign * (a + b) / 2 for a, b in zip(one, other, strict=True)))


def _directions(chord: list[Array], length_m: float, track_yaw_rad: Array) -> tuple[Shape, Shape]:
    """Pitch and yaw of a chord, yaw as continuous as the track's."""
    c, slope, change = chord
    level = c[:, 0] ** 2 + c[:, 1] ** 2
    turned = np.arctan2(c[:, 1], c[:, 0]) - track_yaw_rad
    yaw = track_yaw_rad + turned - math.tau * np.rint(turned / math.tau)
    yaw_slope = (c[:, 0] * slope[:, 1] - c[:, 1] * slope[:, 0]) / level
    shrinking = c[:, 0] * slope[:, 0] + c[:, 1] * slope[:, 1]
    yaw_bend = (c[:, 0] * change[:, 1] - c[:, 1] * change[:, 0]) / level
    yaw_bend = yaw_bend - 2 * yaw_slope * shrinking / level
    sine, rising, bending = (each[:, 2] / length_m for each in chord)
    cosine = np.sqrt(1 - sine**2)
    pitch_bend = bending / cosine + sine * rising**2 / cosine**3
    pitch = Shape(-np.arcsin(sine), -rising / cosine, -pitch_bend)
    return pitch, Shape(yaw, yaw_slope, yaw_bend)


def _attitude(roll: Shape, pitch: Shape, yaw: Shape, speed: Array, change: Array) -> Attitude:
    """Derivatives against the way as those against time."""
    shapes = (roll, pitch, yaw)
    return Attitude(
        *(each.value for each in shapes),
        *(each.slope_per_m * speed for each in shapes),
        *(each.slope_per_m * change + each.bend_per_m2 * speed**2 for each in shapes),
    )


def _in_time(point: list[Array], speed: Array, change: Array) -> tuple[Array, Array]:
    """Velocity and acceleration of a point whose derivatives are against the way."""
    v, a = speed[:, None], change[:, None]
    return point[1] * v, point[2] * v**2 + point[1] * a


def _sprung(chord: Attitude, springs: Springs, time_s: Array) -> Attitude:
    """Attitude of the body: that of the chord, and what springs add to roll and pitch."""
    pitch, roll = springs.nod.at(time_s), springs.lean.at(time_s)
    return chord._replace(
        roll_rad=chord.roll_rad + roll[0],
        pitch_rad=chord.pitch_rad + pitch[0],
        roll_rate_radps=chord.roll_rate_radps + roll[1],
        pitch_rate_radps=chord.pitch_rate_radps + pitch[1],
        roll_acceleration_radps2=chord.roll_acceleration_radps2 + roll[2],
        pitch_acceleration_radps2=chord.pitch_acceleration_radps2 + pitch[2],
    )


# Sensors ------------------------------------------------------------------------------------------
def inertial_of(
    part: Part, gravity_mps2: float, lever_v: Array, up_l: ArrayLike
) -> tuple[Array, Array]:
    """Give specific force and angular rate of a point of a part, resolved in it, (n, 3) each."""
    acc_l = part.point(lever_v)[2] + gravity_mps2 * np.asarray(up_l, dtype=float)
    return np.einsum("nvl,nl->nv", part.body.C_vl, acc_l), part.body.omega_v


def antenna_of(part: Part, lever_v: Array) -> tuple[Array, Array]:
    """Give position and velocity in `l` of a point of a part, (n, 3) each."""
    p_l, vel_l, _ = part.point(lever_v)
    sunk = np.sum(part.pivots.p_l[:, :2] ** 2, axis=-1) / (2 * geodesy.SEMI_MAJOR_M)
    p_l[:, 2] -= sunk  # as attitude is against the level of the vehicle's place
    return p_l, vel_l
