"""The filter of the slope: what a frame, a state, a fix and the motor force tell of it.

The localiser's pitch is that of the body: the track's slope, the springs' nod, and an error that
walks. The localiser has fused accelerometer, gyroscope, wheels and fixes into it, so none of these
is fused here again but the height and the climb of fixes; their part in the pitch is allowed for by
taking the pitch's error for twice as large as stated (docs/theory.md, section 18.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.fix_error import FixError, FixErrorMemory
from tramstream.estimation.fixes import deviations, measures_height, unusable
from tramstream.estimation.localiser import Verdict
from tramstream.machine.kernels import bound
from tramstream.processors.grade import kernels
from tramstream.processors.grade.kernels import STATES, Ix
from tramstream.processors.grade.own_speed import OwnSpeed, SpeedMemory
from tramstream.processors.grade.said import Said
from tramstream.processors.grade.settings import GradeSettings
from tramstream.processors.grade.waiting import Place, State
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry

Array = NDArray[np.float64]

SLOPE_STD_RAD = 0.03
"""Before anything is known; Prague's steepest tram track has 0.09."""
DOUBTED = 2.25
"""Variance of a height over the stated one, until it has been seen: receivers are too sure of
themselves in streets."""
STEP = 1.1
"""What is learned of heights is told to the filter when it is off by this factor."""
HEIGHT_NOISE_M = 0.3
"""White part of a fix's height."""
LEAST_FIX_STD_M = 0.5
CLIMB_STDS, LEAST_CLIMB_STD_MPS, UNSTATED_CLIMB_STD_MPS = 1.5, 0.1, 0.3
"""Likewise of the vertical speed, which is correlated between fixes."""
FORCE_S = 0.1
"""Force and acceleration are means over so long,"""
FORCE_STD_MPS2 = 0.12
"""and fit each other by so much, as acceleration."""
LEAST_SPEED_MPS = 0.5
"""Slower, the parking brake may hold a part."""
MASS_WALK = 0.01
"""Part by which the mass changes at a stop of `STOP_S`: passengers."""
STOP_S = 20.0
GATE = 5.0
"""Deviations beyond which a measurement is refused."""
REFUSALS = 20
"""So many heights refused in a row: the receiver has another height now."""
HEIGHT_STD_M = 100.0
OWN_SPEED_STD_MPS = 0.1
NAN = math.nan
_MASS = int(Ix.MASS)
LOST_S = 1.0
"""A localiser that is silent for so long is away."""


UNKNOWN = State(
    stamp_ns=0,
    speed_mps=0.0,
    speed_std_mps=OWN_SPEED_STD_MPS,
    acceleration_mps2=0.0,
    pitch_rad=math.nan,
    pitch_variance=SLOPE_STD_RAD**2,
    level_error_rad=math.nan,
    level_variance=0.0,
    standing=False,
    mapped=False,
)
"""What stands for a localiser that is away."""


@dataclass
class FilterMemory:
    """What a `GradeFilter` remembers."""

    x: Array = field(default_factory=lambda: np.zeros(STATES))
    P: Array = field(default_factory=lambda: np.zeros((STATES, STATES)))
    shaking: Array = field(default_factory=lambda: np.zeros(2))
    """See `kernels.follow`."""
    stamp_ns: int = 0
    state_ns: int = 0
    """Of the last state of the localiser."""
    state: State = UNKNOWN
    """The last one, or what stands for it."""
    level_error_rad: float = math.nan
    """The last one that a localiser has told."""
    datum_m: float = math.nan
    """Height of the first fix, from which heights are counted."""
    fix_variance: float = 1.0
    fix_error: FixErrorMemory = field(
        default_factory=lambda: FixErrorMemory(whole=DOUBTED, part=DOUBTED)
    )
    """Of heights, over what the receiver states."""
    fix_share: float = DOUBTED
    """The largest variance over the stated one that heights have been doubted for."""
    refused: int = 0
    """Heights, in a row."""
    forces: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0, 0.0])
    """Sums of force, acceleration and speed, and how many."""
    forced_ns: int = 0
    own: SpeedMemory = field(default_factory=SpeedMemory)


class GradeFilter:
    """Slope, springs, mass: see `kernels`."""

    def __init__(self, vehicle: Vehicle, settings: GradeSettings, memory: FilterMemory) -> None:
        self.memory = memory
        self._settings = settings
        gnss = vehicle.gnss
        self._lever_m = gnss.lever_arm_m[0] if gnss is not None else 0.0
        self._tau_s = gnss.error_tau_s if gnss is not None else 20.0
        self._shift_m = vehicle.ekf.pivot_m
        self._own = OwnSpeed(vehicle.wheels.m_per_pulse, memory.own)
        if not memory.P.any():
            self._begin()
        self._fix_error = FixError(self._tau_s, memory.fix_error, axes=1)
        self.said = said = Said()
        x, P, number = memory.x, memory.P, 0.5
        constants = np.array([self._shift_m, self._tau_s, settings.mass_kg])
        self._arrays = x, P, memory.shaking, constants, said.numbers, said.encoded
        self._step = bound(kernels.step, *self._arrays, *[number] * 12)
        self._take_height = bound(kernels.take_height, x, P, *[number] * 4)
        self._take_climb = bound(kernels.take_climb, x, P, *[number] * 5)
        self._take_force = bound(kernels.take_force, x, P, *[number] * 5, False)

    def _begin(self) -> None:
        settings, memory = self._settings, self.memory
        memory.x[Ix.SPRING] = math.radians(settings.pitch_deg_per_mps2)
        memory.x[Ix.MASS] = 1.0
        memory.x[Ix.ROLLING] = settings.rolling_resistance
        stds = np.zeros(STATES)
        stds[Ix.SLOPE], stds[Ix.BEND] = SLOPE_STD_RAD, kernels.BEND_STD_PER_M
        stds[Ix.SPRING] = math.radians(settings.pitch_std_deg_per_mps2)
        stds[Ix.OFFSET], stds[Ix.HEIGHT] = SLOPE_STD_RAD, HEIGHT_STD_M
        stds[Ix.FIX_ERROR] = 1.0
        stds[Ix.MASS] = settings.mass_std_kg / settings.mass_kg
        stds[Ix.ROLLING] = settings.rolling_resistance_std
        memory.P[:] = np.diag(stds**2)

    # A frame -------------------------------------------------------------------------------------
    def step(self, stamp_ns: int, state: State | None, place: Place) -> bool:
        """Go on to a frame, with the localiser's state of it; False while nobody says a speed.

        What is found is in `said`, with the chainage that follows from the last match.
        """
        memory = self.memory
        before = memory.stamp_ns
        memory.stamp_ns = stamp_ns
        dt_s = (stamp_ns - before) / S if before else 0.0
        variance, pitch, changed = memory.state.pitch_variance, NAN, NAN
        if state is not None:
            memory.state, memory.state_ns, pitch = state, state.stamp_ns, state.pitch_rad
            if pitch == pitch:
                changed = state.level_error_rad - memory.level_error_rad
                memory.level_error_rad = state.level_error_rad
        elif self.away:
            self._go_alone(stamp_ns)
        if not memory.state_ns and not memory.own.speed_ns:
            return False
        now, way_m, chainage_m = memory.state, 0.0, 0.0
        if place.run >= 0:
            old_s = (stamp_ns - place.stamp_ns) / S
            chainage_m = place.chainage_m + abs(now.speed_mps) * old_s
        if now.standing:
            memory.P[_MASS, _MASS] += MASS_WALK * MASS_WALK * dt_s / STOP_S
        else:
            way_m = now.speed_mps * dt_s
        self._step(
            *self._arrays,
            dt_s,
            way_m,
            now.speed_mps,
            now.acceleration_mps2,
            pitch,
            now.pitch_variance,
            variance,
            changed,
            now.level_variance,
            memory.fix_variance,
            chainage_m,
            place.probability,
        )
        return True

    def _go_alone(self, stamp_ns: int) -> None:
        """Go on by wheels and fixes, without a localiser."""
        own = self._own.at(stamp_ns)
        if own is not None:
            speed, acceleration = own
            # A localiser that comes back has another error.
            self.memory.state = UNKNOWN._replace(
                speed_mps=speed, acceleration_mps2=acceleration, standing=speed == 0.0
            )

    @property
    def away(self) -> bool:
        """Whether there is no localiser, or it is silent."""
        memory = self.memory
        return not memory.state_ns or memory.stamp_ns - memory.state_ns > LOST_S * S

    # Fixes ---------------------------------------------------------------------------------------
    def take_fix(self, fix: GnssFix) -> list[Verdict]:
        """Take height and climb of a fix."""
        if self.away:
            self._own.take_fix(fix)
        if not fix.valid or unusable(fix, None) is not None:
            return []
        found = []
        if measures_height(fix):
            found.append(self._height(fix))
        if fix.HasField("vel_d_mps") and math.isfinite(fix.vel_d_mps):
            found.append(self._climb(fix))
        return found

    def _height(self, fix: GnssFix) -> Verdict:
        memory = self.memory
        height_m = fix.height_ellipsoid_m
        if math.isnan(memory.datum_m):
            memory.datum_m = height_m
        std, share = deviations(fix, LEAST_FIX_STD_M)[1], self._fix_error.size
        self._doubt_heights(share)
        memory.fix_variance = share * std * std
        y, S_, fits = self._take_height(
            memory.x,
            memory.P,
            height_m - memory.datum_m,
            self._lever_m,
            HEIGHT_NOISE_M * HEIGHT_NOISE_M,
            GATE,
        )
        error_m = float(memory.x[Ix.FIX_ERROR]) + (0.0 if fits else y)
        self._fix_error.see(fix.stamp_ns, error_m, 0.0, std)
        memory.refused = 0 if fits else memory.refused + 1
        if memory.refused >= REFUSALS:
            memory.refused = 0
            memory.P[Ix.HEIGHT, Ix.HEIGHT] += HEIGHT_STD_M * HEIGHT_STD_M
        return Verdict("gnss_height", y, S_, fits)

    def _doubt_heights(self, share: float) -> None:
        """Take what heights have told until now for as wrong as they turn out to be."""
        memory = self.memory
        if share > STEP * memory.fix_share:
            P, h, e = memory.P, int(Ix.HEIGHT), int(Ix.FIX_ERROR)
            more = (share / memory.fix_share - 1.0) * P[e, e]
            P[h, h] += more
            P[e, e] += more
            P[h, e] = P[e, h] = P[h, e] - more
            memory.fix_share = share

    def _climb(self, fix: GnssFix) -> Verdict:
        memory = self.memory
        stated = fix.speed_std_mps
        std = CLIMB_STDS * stated if stated > 0.0 else UNSTATED_CLIMB_STD_MPS
        std = max(std, LEAST_CLIMB_STD_MPS)
        speed = 0.0 if memory.state.standing else memory.state.speed_mps
        ahead = self._shift_m + self._lever_m
        y, S_, fits = self._take_climb(
            memory.x, memory.P, -fix.vel_d_mps, speed, ahead, std * std, GATE
        )
        return Verdict("gnss_velocity", y, S_, fits)

    # Wheels and motor ----------------------------------------------------------------------------
    def take_odometry(self, odometry: Odometry) -> None:
        """Take wheels, where nobody else tells the speed."""
        if self.away:
            self._own.take_wheels(odometry)

    def take_force(self, force_n: float) -> Verdict | None:
        """Take the motor force; what it says once a tenth of a second."""
        memory = self.memory
        now, sums = memory.state, memory.forces
        speed = now.speed_mps
        if now.standing or not abs(speed) > LEAST_SPEED_MPS or not math.isfinite(force_n):
            sums[:] = (0.0, 0.0, 0.0, 0.0)
            return None
        for k, value in enumerate((force_n, now.acceleration_mps2, speed, 1.0)):
            sums[k] += value
        if 0 <= memory.stamp_ns - memory.forced_ns < FORCE_S * S:
            return None
        memory.forced_ns = memory.stamp_ns
        count = sums[3]
        force, acceleration, speed = sums[0] / count, sums[1] / count, sums[2] / count
        sums[:] = (0.0, 0.0, 0.0, 0.0)
        settings, x = self._settings, memory.x
        mass = settings.mass_kg
        force -= settings.drag_n_per_mps2 * speed * abs(speed)
        std = FORCE_STD_MPS2 * max(float(x[Ix.MASS]), 0.1)
        way, R = math.copysign(1.0, speed), std * std
        y, S_, fits = self._take_force(
            x, memory.P, force / mass, acceleration, way, R, GATE, not self.away
        )
        return Verdict("motor_force", y * mass, S_ * mass * mass, fits)

    # What is learned -----------------------------------------------------------------------------
    def value(self, k: int) -> tuple[float, float]:
        """Give a state and its deviation."""
        memory = self.memory
        return float(memory.x[k]), math.sqrt(max(float(memory.P[k, k]), 0.0))
