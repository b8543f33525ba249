"""Who is wrong? What the sources say together, where some of them do not fit the filter `tram`.

A measurement that does not fit is its sensor's fault, or the filter's. One source against the
filter is refused, and the others speak for the filter. Where two sources that have nothing to do
with each other have been refused for a second, the filter is judged by what the fixes show of its
velocity: the receiver's own, and the way between fixes against the filter's own way in the same
time, which is free of the error that neighbouring fixes share. If these contradict the filter, and
not each other, heading and speed are taken from them at once, and what may have led the filter
astray (roll, pitch, biases) is doubted. Without fixes, wheels and lateral force that are both
refused leave the speed to the wheels.

Equations: docs/theory.md, section 7.8.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.events.kinds import Event
from tramstream.processors.tram.events import FILTER_WRONG, IMU_CONTRADICTED
from tramstream.processors.tram.filter import SPEED, TramFilter
from tramstream.processors.tram.start import first_deviations
from tramstream.processors.tram.wheels import WheelPair
from tramstream.processors.tram_model.states import Ix

YAW = int(Ix.YAW)
REFUSED_S = 1.0
"""Sources that have been refused for so long, without a word that fitted, contradict the filter;
chosen by hand, guarded by `tests/processors/tram/test_divergence.py`."""
PLACES = {"position", "way"}
ALONE_S, ALONE_STD_RAD = 3.0, 0.07
"""So long the fixes must contradict it where only their places speak, and a heading that they tell
is no better than this: multipath moves places too; chosen by hand."""
PAUSE_S = 0.3
"""A source that comes with every reading and was not refused for so long fits again; by hand."""
WINDOW_S = 2.5
LEAST_WINDOW_S = 0.8
"""Time over which the way between fixes is held to the filter's; chosen by hand: at 1 Hz two."""
LEAST_MPS = 1.5
"""A slower vehicle shows no heading; chosen by hand."""
WITNESS_GATE = 13.8
"""Squared distance beyond which a velocity contradicts the filter: 0.1 % of honest ones (χ², two
degrees of freedom); which tail, by hand."""
BEND_SHARE = 0.35
"""A way that grows with its square is bent by a quarter of it, one that jumps by half; this is
between; by hand."""
AGREE_SIGMA, AGREE_MPS, AGREE_SHARE = 3.0, 0.5, 0.5
"""The receiver's velocity and the way between its fixes agree within this, the share being that of
what they say the filter is off, for that grows; chosen by hand."""
WHEELS_MPS, WHEELS_SHARE = 0.3, 0.05
"""The receiver's speed and that of the wheels agree within this, the share being that of the speed;
chosen by hand."""
WRONG_TIMES, WRONG_WITHIN_S = 3, 60.0
"""A filter that was wrong so often within so long has an IMU that does not fit it: mounting, units,
a fault that is none of those known. Chosen by hand, guarded by `test_divergence.py`."""
OUT_S, OUT_LONGEST_S = 60.0, 960.0
"""So long the IMU is left out then; twice as long each time that it is wrong again; by hand."""
SURE_SIGMA = 3.0
"""Heading or speed is taken from the fixes where it is off by so many deviations; by hand."""
HEADING_FLOOR_RAD, SPEED_FLOOR_MPS = 0.03, 0.2
"""What is taken from the fixes is no better than this; chosen by hand."""
DOUBT_STD_RAD = 0.02
"""How far roll and pitch may be off in a filter that was wrong; chosen by hand."""
WHITE_SHARE = 0.1
"""Of a fix's error that neighbours do not share, as in the alignment (section 7.3); by hand."""


class Passed(NamedTuple):
    """A fix, and how far the filter itself has come."""

    stamp_ns: int
    off_east_m: float
    """The fix's place less the way that the filter has gone by itself, since any instant."""
    off_north_m: float


class Offset(NamedTuple):
    """What the fixes' velocity is more than the filter's, and how well they tell it."""

    east_mps: float
    north_mps: float
    std_mps: float


class Heard(NamedTuple):
    """What became of a fix."""

    stamp_ns: int
    std_m: float
    """Of its place, each axis."""
    refused: bool
    """Whether its place was."""
    off_m: tuple[float, float]
    """What its place was off by, east and north."""
    velocity: Offset | None
    """What its velocity was off by, if it was refused."""
    velocity_accepted: bool


@dataclass
class DivergenceMemory:
    """What `Divergence` remembers; times are 0 while a source fits."""

    passed: deque[Passed] = field(default_factory=deque)
    way_east_m: float = 0.0
    """Way of the filter by itself, without what fixes have moved it."""
    way_north_m: float = 0.0
    antenna_m: tuple[float, float] | None = None
    """Where the filter had its antenna after the last fix."""
    position_ns: int = 0
    """Since when places of fixes are refused."""
    velocity_ns: int = 0
    way_ns: int = 0
    """Since when the way between fixes is not the filter's."""
    force_ns: tuple[int, int] = (0, 0)
    """Since when, and when last, the lateral force was refused."""
    track_ns: tuple[int, int] = (0, 0)
    sign: float = 1.0
    """−1 if the vehicle last ran backwards, by a filter that nothing contradicted."""
    wrong_ns: list[int] = field(default_factory=list)
    """When the filter was wrong, of late."""
    out_ns: int = 0
    """Until when the IMU is left out; 0: it never was."""
    out_s: float = 0.0
    """For how long the last time."""


class Divergence:
    """Hears what becomes of each measurement, and tells when the filter is wrong."""

    def __init__(
        self, vehicle: Vehicle, tau_s: float, memory: DivergenceMemory | None = None
    ) -> None:
        self._tau_s = tau_s
        lever = vehicle.gnss.lever_arm_m if vehicle.gnss is not None else (0.0, 0.0, 0.0)
        self._lever_m = lever[0], lever[1]
        self._has_imu = vehicle.imu is not None
        self._stds = first_deviations(vehicle).tolist()
        self.memory = DivergenceMemory() if memory is None else memory

    # What is heard -------------------------------------------------------------------------------
    def before_fix(self, ekf: TramFilter, stamp_ns: int, east_m: float, north_m: float) -> None:
        """Note a fix that the filter, which is at its stamp, has not taken yet."""
        memory = self.memory
        if memory.antenna_m is not None:
            east, north = self._antenna(ekf)
            memory.way_east_m += east - memory.antenna_m[0]
            memory.way_north_m += north - memory.antenna_m[1]
        passed = memory.passed
        passed.append(Passed(stamp_ns, east_m - memory.way_east_m, north_m - memory.way_north_m))
        while stamp_ns - passed[0].stamp_ns > WINDOW_S * S:
            passed.popleft()

    def refuse_force(self, stamp_ns: int) -> None:
        """Hear that the lateral force was refused."""
        self.memory.force_ns = _prolonged(self.memory.force_ns, stamp_ns, PAUSE_S)

    def refuse_track(self, stamp_ns: int) -> None:
        """Hear that the map's track was refused."""
        self.memory.track_ns = _prolonged(self.memory.track_ns, stamp_ns, REFUSED_S)

    def forget(self) -> None:
        """Let the filter be another one: what was heard of it means nothing."""
        memory = self.memory
        memory.passed.clear()
        memory.antenna_m = None
        memory.position_ns = memory.velocity_ns = memory.way_ns = 0
        memory.force_ns = memory.track_ns = (0, 0)

    # Who is wrong --------------------------------------------------------------------------------
    def after_fix(self, ekf: TramFilter, wheels: WheelPair, heard: Heard) -> list[Event]:
        """Judge after a fix that was taken or refused; gives what was found."""
        memory, stamp_ns = self.memory, heard.stamp_ns
        memory.antenna_m = self._antenna(ekf)
        memory.position_ns = _since(memory.position_ns, heard.refused, stamp_ns)
        memory.velocity_ns = _since(memory.velocity_ns, heard.velocity is not None, stamp_ns)
        way = self._way_offset(heard.std_m)
        if way is not None and _distance(ekf, way) <= WITNESS_GATE:
            way = None
        memory.way_ns = _since(memory.way_ns, way is not None, stamp_ns)
        if heard.velocity_accepted or (way is None and heard.velocity is None):
            speed = ekf.state[SPEED]
            if not heard.refused and abs(speed) > LEAST_MPS:
                memory.sign = math.copysign(1.0, speed)
            return []
        lasted = self._against(stamp_ns, wheels)
        if len(lasted) < 2:
            return []
        offset = self._witness(ekf, wheels, way, heard.velocity, lasted)
        return [] if offset is None else self._correct(ekf, wheels, offset, lasted)

    def _witness(
        self,
        ekf: TramFilter,
        wheels: WheelPair,
        way: Offset | None,
        velocity: Offset | None,
        lasted: dict[str, float],
    ) -> Offset | None:
        """What the fixes show of the filter's velocity, where two of them say the same."""
        if velocity is None:
            return way if not lasted.keys() <= PLACES or lasted["way"] > ALONE_S else None
        if "wheels" in lasted:
            speed, yaw = ekf.state[SPEED], ekf.state[YAW]
            east = speed * math.cos(yaw) + velocity.east_mps
            measured = math.hypot(east, speed * math.sin(yaw) + velocity.north_mps)
            apart_mps = abs(wheels.speed_mps(ekf.stamp_ns) - measured)
            if apart_mps < WHEELS_MPS + WHEELS_SHARE * measured:
                return velocity
        if way is None:
            return None
        east, north = velocity.east_mps - way.east_mps, velocity.north_mps - way.north_mps
        most = max(math.hypot(*velocity[:2]), math.hypot(*way[:2]))
        agrees = AGREE_SIGMA * way.std_mps + AGREE_MPS + AGREE_SHARE * most
        return velocity if math.hypot(east, north) < agrees else None

    def without_fix(self, ekf: TramFilter, wheels: WheelPair, stamp_ns: int) -> list[Event]:
        """Judge where no fix comes: wheels against a filter that its own force contradicts."""
        passed = self.memory.passed
        if passed and stamp_ns - passed[-1].stamp_ns < WINDOW_S * S:
            return []
        lasted = self._against(stamp_ns, wheels)
        if not {"wheels", "force"} <= lasted.keys():
            return []
        off_mps = wheels.speed_mps(stamp_ns) - abs(ekf.state[SPEED])
        ekf.widen(Ix.SPEED, abs(off_mps) + SPEED_FLOOR_MPS)
        return self._begin_anew(ekf, wheels, lasted, 0.0, off_mps)

    def _against(self, stamp_ns: int, wheels: WheelPair) -> dict[str, float]:
        """Which sources have been refused for long, and for how long, s."""
        memory = self.memory
        since = {
            "position": memory.position_ns,
            "velocity": memory.velocity_ns,
            "way": memory.way_ns,
        }
        lasted = {name: (stamp_ns - ns) / S for name, ns in since.items() if ns}
        lasted["wheels"] = wheels.refused_s(stamp_ns)
        for name, (first, last), pause_s in (
            ("force", memory.force_ns, PAUSE_S),
            ("track", memory.track_ns, REFUSED_S),
        ):
            lasted[name] = (last - first) / S if stamp_ns - last < pause_s * S else 0.0
        return {name: each for name, each in lasted.items() if each >= REFUSED_S}

    def _correct(
        self, ekf: TramFilter, wheels: WheelPair, offset: Offset, lasted: dict[str, float]
    ) -> list[Event]:
        """Take heading and speed from the fixes, where they contradict the filter's."""
        speed, yaw = ekf.state[SPEED], ekf.state[YAW]
        cos, sin = math.cos(yaw), math.sin(yaw)
        along = speed + cos * offset.east_mps + sin * offset.north_mps
        across = cos * offset.north_mps - sin * offset.east_mps
        shown = math.hypot(along, across)
        sign = self.memory.sign
        turned = math.atan2(sign * across, sign * along)
        std = max(SPEED_FLOOR_MPS, offset.std_mps)
        std_rad = max(HEADING_FLOOR_RAD, offset.std_mps / max(shown, LEAST_MPS))
        if lasted.keys() <= PLACES:
            std_rad = max(std_rad, ALONE_STD_RAD)
        faster = sign * shown - speed
        heading = shown > LEAST_MPS and abs(turned) > SURE_SIGMA * math.hypot(
            std_rad, math.sqrt(ekf.variances[YAW])
        )
        # Wheels that fit speak for the filter's speed.
        fast = not wheels.fits(ekf.stamp_ns) and abs(faster) > SURE_SIGMA * math.hypot(
            std, math.sqrt(ekf.variances[SPEED])
        )
        if not (heading or fast):
            return []
        if heading:
            ekf.reset(Ix.YAW, yaw + turned, std_rad)
        if fast:
            ekf.reset(Ix.SPEED, sign * shown, std)
        off = turned if heading else 0.0, faster if fast else 0.0
        return self._begin_anew(ekf, wheels, lasted, *off)

    def _begin_anew(
        self,
        ekf: TramFilter,
        wheels: WheelPair,
        lasted: dict[str, float],
        turned_rad: float,
        faster_mps: float,
    ) -> list[Event]:
        """Doubt the filter, and say so."""
        self.doubt(ekf, wheels)
        said = FILTER_WRONG(
            sources=", ".join(sorted(lasted)),
            refused_s=max(lasted.values()),
            heading_off_rad=turned_rad,
            speed_off_mps=faster_mps,
        )
        if lasted.keys() <= PLACES:  # multipath may say so again and again
            return [said]
        return [said, *self._blame(ekf.stamp_ns)]

    def doubt(self, ekf: TramFilter, wheels: WheelPair) -> None:
        """Doubt what may have led the filter astray, and hear all sources afresh."""
        for angle in (Ix.ROLL, Ix.PITCH):
            ekf.widen(angle, DOUBT_STD_RAD)
        for bias in (Ix.GYRO_X, Ix.GYRO_Y, Ix.GYRO_Z, Ix.ACCEL_X, Ix.ACCEL_Y):
            ekf.widen(bias, self._stds[bias])
        wheels.trust_again(ekf)
        self.forget()

    def _blame(self, stamp_ns: int) -> list[Event]:
        """Leave the IMU out where the filter has been wrong again and again."""
        memory = self.memory
        if not self._has_imu or stamp_ns < memory.out_ns:
            return []
        recent = [each for each in memory.wrong_ns if stamp_ns - each < WRONG_WITHIN_S * S]
        memory.wrong_ns = [*recent, stamp_ns]
        again = memory.out_ns > 0 and stamp_ns - memory.out_ns < WRONG_WITHIN_S * S
        times = len(memory.wrong_ns)
        if times < WRONG_TIMES and not again:
            return []
        memory.out_s = min(2.0 * memory.out_s, OUT_LONGEST_S) if again else OUT_S
        memory.out_ns, memory.wrong_ns = stamp_ns + int(memory.out_s * S), []
        return [IMU_CONTRADICTED(times=times, within_s=WRONG_WITHIN_S, left_out_s=memory.out_s)]

    # What the fixes show -------------------------------------------------------------------------
    def _antenna(self, ekf: TramFilter) -> tuple[float, float]:
        """East and north of the antenna as the filter has it, m."""
        x = ekf.state
        cos, sin = math.cos(x[YAW]), math.sin(x[YAW])
        ahead, left = self._lever_m[0] + x[Ix.PIVOT], self._lever_m[1]
        return x[Ix.EAST] + cos * ahead - sin * left, x[Ix.NORTH] + sin * ahead + cos * left

    def _way_offset(self, std_m: float) -> Offset | None:
        """Way between fixes less the filter's own, a second; None where that tells nothing."""
        passed = self.memory.passed
        first, last = passed[0], passed[-1]
        dt_s = (last.stamp_ns - first.stamp_ns) / S
        if dt_s < LEAST_WINDOW_S:
            return None
        east, north = last.off_east_m - first.off_east_m, last.off_north_m - first.off_north_m
        apart = 1.0 - math.exp(-dt_s / self._tau_s)
        noise_m = std_m * math.sqrt(2.0 * (apart + WHITE_SHARE))
        bend_m = BEND_SHARE * math.hypot(east, north) + AGREE_SIGMA * noise_m
        for each in passed:
            share = (each.stamp_ns - first.stamp_ns) / S / dt_s
            off_east = each.off_east_m - first.off_east_m - share * east
            off_north = each.off_north_m - first.off_north_m - share * north
            if math.hypot(off_east, off_north) > bend_m:
                return None
        return Offset(east / dt_s, north / dt_s, noise_m / dt_s)


def _distance(ekf: TramFilter, offset: Offset) -> float:
    """Squared distance of a velocity from the filter's, along and across."""
    speed, yaw = ekf.state[SPEED], ekf.state[YAW]
    cos, sin = math.cos(yaw), math.sin(yaw)
    along = cos * offset.east_mps + sin * offset.north_mps
    across = cos * offset.north_mps - sin * offset.east_mps
    variance = offset.std_mps * offset.std_mps
    turned = speed * speed * ekf.variances[YAW]
    squared: float = along * along / (variance + ekf.variances[SPEED])
    squared += across * across / (variance + turned)
    return squared


def _since(since_ns: int, refused: bool, stamp_ns: int) -> int:
    """Since when a source has been refused without a pause; 0: it was not."""
    return (since_ns or stamp_ns) if refused else 0


def _prolonged(since_ns: tuple[int, int], stamp_ns: int, pause_s: float) -> tuple[int, int]:
    """First and last time of a refusal that goes on."""
    first, last = since_ns
    return (first if stamp_ns - last < pause_s * S else stamp_ns), stamp_ns
