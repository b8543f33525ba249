"""Does the configuration fit the data? A processor that says so, and nothing else.

It reads the ordered stream, beside the filters and knowing nothing of them: a filter that was told
wrong is no witness. Within the first stand it sees gravity, within the first departure the force of
driving, within a minute of motion the scale of wheels and fixes, their delay, and the antenna's
place (`mounting`, `speeds`). What contradicts the configuration by more than its own deviation
allows is an event with the figures and the likely cure; it is said again every five minutes as long
as it holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.events import Event, declared
from tramstream.keys import Key
from tramstream.processor import Processor, Sample
from tramstream.processors.consistency import events as own_events
from tramstream.processors.consistency.fixes import FRESH_S, STANDS_MPS, FixesMemory, FixHistory
from tramstream.processors.consistency.mounting import (
    BACKWARDS_RAD,
    GRAVITY_LIMIT_MPS2,
    GRAVITY_MPS2,
    MANY_STANDS,
    STDS,
    Mounting,
    MountingMemory,
    Turn,
)
from tramstream.processors.consistency.moved import Moved, MovedMemory, origin_of
from tramstream.processors.consistency.speeds import Fixes, Speeds, compared, lever
from tramstream.processors.consistency.way import Course, Way, WayMemory
from tramstream.processors.consistency.windows import Window, WindowMemory
from tramstream.proto.sync_pb2 import ImuMean, LateSample, SyncFrame

AGAIN_S = 300.0
"""What holds is said again after so long."""
RECENT = 40
"""Points of the way that a moment of driving needs: four seconds."""
FITTING = math.log(1.12)
"""Force over the wheels' acceleration, to either side: a worn tyre is 8 % off."""
LONG = 260
"""Points of the way that whether the IMU was moved needs: twenty-six seconds."""
LONGEST_S = 0.1
"""No frame stands for a longer turning."""
JUDGED_S = 5.0
"""Between judgements of fixes and wheels."""
SCALE_LIMIT = 0.12
"""Worn tyres are 5 % off, 8 % did no harm; by hand."""
GROSS = math.log(1.4)
"""A receiver whose speed is off by less has no other unit: then it is the wheels."""
WITNESS_S = 25.0
"""So long after the departure the force's word is waited for."""
DELAY_LIMIT_S = 0.08
"""Less is learned by the filter, of which 0.1 s did no harm; by hand."""
DELAY_STD_S = 0.03
"""A delay that is known no better is not said."""
LEVER_LIMIT_M = 0.7
"""The filter loses 10 % at a metre (issue of the worlds); by hand."""
LEVER_STD_M = 0.25
CERTAIN = 5.0
"""Deviations of what is found."""
LATE_SPAN_S = 10.0
LEAST_LATE = 10
_UNITS = ((3.6, "km/h taken for m/s"), (1.0 / 3.6, "m/s taken for km/h"))
OF_WHEELS = (
    *_UNITS,
    (1000.0, "millimetres taken for metres"),
    (0.001, "metres taken for millimetres"),
    (2.0, "both edges of a pulse counted for one"),
    (0.5, "one edge of a pulse counted for both"),
)
OF_FIXES = (*_UNITS, (1.944, "knots taken for m/s"), (0.5144, "m/s taken for knots"))
"""Wrong over right, and what it looks like."""
NEAR = 0.06
"""A factor is one of them within this part: a worn tyre is 5 % off."""
UNLIKE = ("a wheel of another size, or other pulses a turn", "no unit that is known")


@dataclass
class LateMemory:
    """Messages of one key within a span."""

    came: int = 0
    late: int = 0
    late_s: float = 0.0


@dataclass
class CheckMemory:
    """What the check remembers; times are seconds since the first frame."""

    way: WayMemory = field(default_factory=WayMemory)
    mounting: MountingMemory = field(default_factory=MountingMemory)
    window: WindowMemory = field(default_factory=WindowMemory)
    moved: MovedMemory = field(default_factory=MovedMemory)
    fitted: bool = False
    """Whether the force of a departure was that of the wheels, as it is mounted."""
    fixes: FixesMemory = field(default_factory=FixesMemory)
    frame_s: float = 0.0
    judged_s: float = 0.0
    late: dict[str, LateMemory] = field(default_factory=dict)
    late_s: float = 0.0
    """When the span of `late` began."""
    told: dict[str, float] = field(default_factory=dict)
    """When a kind was said last, by kind and texts."""


class ConfigurationCheck(Processor):
    """Says what of the configuration the data contradict."""

    name = "configuration_check"
    Memory = CheckMemory
    memory: CheckMemory
    inputs = (keys.SYNC_FRAME, keys.SYNC_LATE)
    outputs = ()
    events = declared(own_events)
    pacing = (keys.SYNC_FRAME,)

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        self._vehicle = vehicle
        self._way = Way(vehicle, self.memory.way)
        self._window = Window(self.memory.window)
        self._fixes = FixHistory(self._way, self.memory.fixes)
        imu = vehicle.imu
        self._mounting = Mounting(imu, self.memory.mounting) if imu is not None else None
        self._moved = Moved(imu, self.memory.moved) if imu is not None else None
        self._origin = origin_of(vehicle)

    def restored(self) -> None:
        if self._mounting is not None:
            self._mounting.restored()

    def step(self, sample: Sample) -> list[Sample]:
        if sample.key is keys.SYNC_LATE:
            self._count_late(sample.message)
            return []
        frame: SyncFrame = sample.message
        time_s = self._way.time_s(sample.stamp_ns)
        # Copies: to go through what protobuf holds takes three times as long.
        odometry, gnss = frame.odometry[:], frame.gnss[:]
        for reading in odometry:
            self._way.read(reading)
        for fix in gnss:
            self._fixes.take(fix)
        found: list[Event] = []
        if frame.HasField("imu") and self._mounting is not None:
            found += self._take_imu(frame.imu, time_s, self._mounting)
        memory = self.memory
        self._count_came(keys.GNSS_FIX, len(gnss))
        self._count_came(keys.ODO_WHEELS, len(odometry))
        if time_s - memory.judged_s >= JUDGED_S:
            memory.judged_s = time_s
            found += self._judge_speeds(time_s)
            found += self._judge_lateness(time_s)
        return [each for event in found for each in self._tell(event, time_s, sample.stamp_ns)]

    def _tell(self, event: Event, time_s: float, stamp_ns: int) -> list[Sample]:
        identity = "\n".join((event.kind.name, *event.identity))
        last_s = self.memory.told.get(identity)
        if last_s is not None and time_s - last_s < AGAIN_S:
            return []
        self.memory.told[identity] = time_s
        return self.raise_event(event, stamp_ns)

    # Inertial sensor -----------------------------------------------------------------------------
    def _take_imu(self, imu: ImuMean, time_s: float, mounting: Mounting) -> list[Event]:
        memory = self.memory
        dt_s = min(time_s - memory.frame_s, LONGEST_S)
        memory.frame_s = time_s
        x, y, z = imu.gyro_x_radps, imu.gyro_y_radps, imu.gyro_z_radps
        self._way.turn(time_s, mounting.rate(x, y, z), dt_s)
        if not self._window.add(imu, time_s):
            return []
        mean, moved_m = self._window.end(time_s, memory.way.path_m)
        if mean is None:
            memory.mounting.windows.clear()
            return []
        still = self._still(time_s, moved_m)
        found = self._judge_moved(time_s, mean, still, mounting)
        if mounting.take(time_s, mean, still):
            return found + self._judge_stand(mounting)
        if memory.mounting.still:
            return found
        mounting.drive(Course(memory.way.path[-RECENT:]))
        return found + self._judge_drive(mounting)

    def _judge_moved(
        self, time_s: float, mean: list[float], still: bool, mounting: Mounting
    ) -> list[Event]:
        moved, way = self._moved, self.memory.way
        if moved is None:
            return []
        if time_s - way.read_s > FRESH_S:  # nobody says how the vehicle moves
            moved.forget()
            return []
        change = moved.take(time_s, mean, still, Course(way.path[-LONG:]))
        self.memory.fitted = self.memory.fitted or _fits(mounting)
        if change is not None and self.memory.fitted:
            moved.memory.found = list(change.numbers)
        return moved.told(time_s, self._origin)

    def _still(self, time_s: float, moved_m: float) -> bool:
        """Whether wheels, or fixes where there are none, say that the vehicle stands."""
        way, fixes = self.memory.way, self.memory.fixes
        fresh = time_s - fixes.time_s < FRESH_S
        if fresh and fixes.speed_mps > STANDS_MPS:
            return False
        if time_s - way.read_s < FRESH_S:
            return moved_m <= self._way.least_m
        return fresh

    def _judge_stand(self, mounting: Mounting) -> list[Event]:
        force = mounting.memory.force_mps2
        if abs(force - GRAVITY_MPS2) > GRAVITY_LIMIT_MPS2:
            facts = {"gravity_mps2": GRAVITY_MPS2, "limit_mps2": GRAVITY_LIMIT_MPS2}
            return [own_events.GRAVITY_WRONG(force_mps2=force, **facts)]
        tilt, limit = mounting.tilt_deg, mounting.tilt_limit_deg
        if tilt <= limit:
            return self._judge_stands(mounting)
        angles = _angles(mounting.mounting_deg())
        return [own_events.MOUNTING_TILTED(tilt_deg=tilt, limit_deg=limit, **angles)]

    def _judge_stands(self, mounting: Mounting) -> list[Event]:
        """Judge the mean of many, each of which is within its own limit."""
        stands = mounting.memory.stands
        tilt, limit = mounting.mean_tilt_deg, mounting.mean_tilt_limit_deg
        if stands < MANY_STANDS or tilt <= limit:
            return []
        facts = {"tilt_deg": tilt, "limit_deg": limit, "origin": self._origin}
        angles = _angles(mounting.mounting_deg())
        return [own_events.MOUNTING_DIFFERS(stands=stands, **facts, **angles)]

    def _judge_drive(self, mounting: Mounting) -> list[Event]:
        turn = mounting.turn()
        if turn is None:
            return []
        angle, std, limit = turn.angle_rad, turn.std_rad, mounting.turn_limit_deg
        if abs(math.degrees(angle)) <= limit or abs(angle) <= STDS * std:
            return []
        turned = math.degrees(angle)
        if abs(angle) > BACKWARDS_RAD:
            return [own_events.WHEELS_BACKWARDS(turned_deg=turned, windows=turn.moments)]
        return [
            own_events.MOUNTING_TURNED(
                windows=turn.moments,
                turned_deg=turned,
                turned_std_deg=math.degrees(std),
                limit_deg=limit,
                **_angles(mounting.mounting_deg(angle)),
            )
        ]

    # Fixes and wheels ----------------------------------------------------------------------------
    def _judge_speeds(self, time_s: float) -> list[Event]:
        memory = self.memory
        if not self._fixes.newer(time_s - JUDGED_S - FRESH_S):
            return []
        fixes, path = self._fixes.columns(), Course(memory.way.path)
        found = compared(fixes, path)
        if found is None:
            return []
        turn = self._mounting.turn() if self._mounting is not None else None
        limit = 1.0 + max(SCALE_LIMIT, STDS * self._vehicle.wheels.scale_std)
        off = abs(math.log(found.factor))
        delay = self._judge_delay(found)
        if off > math.log(limit) and off > CERTAIN * found.factor_std / found.factor:
            awaited = self._mounting is not None and turn is None
            if awaited and time_s - fixes.time_s[0] < WITNESS_S:
                return delay
            return [self._scale(found, turn, limit), *delay]
        return [*delay, *self._judge_lever(fixes, path, found, turn)]

    def _scale(self, found: Speeds, turn: Turn | None, limit: float) -> Event:
        # The IMU is the third witness: wheels that are right have the force that it feels.
        off = abs(math.log(found.factor))
        of_fixes = turn is not None and off > GROSS and abs(math.log(turn.size)) < 0.5 * off
        kind = own_events.FIX_SPEED_SCALE if of_fixes else own_events.WHEEL_SCALE
        likely = (
            _likely(found.factor, OF_FIXES, UNLIKE[1])
            if of_fixes
            else _likely(1.0 / found.factor, OF_WHEELS, UNLIKE[0])
        )
        return kind(
            wheel_mps=found.wheel_mps,
            fix_mps=found.fix_mps,
            factor=found.factor,
            factor_std=found.factor_std,
            fixes=found.fixes,
            limit=limit,
            likely=likely,
        )

    def _judge_delay(self, found: Speeds) -> list[Event]:
        delay, std = found.delay_s, found.delay_std_s
        if not std < DELAY_STD_S:
            return []
        gnss, wheels = self._vehicle.gnss, self._vehicle.wheels
        known = math.hypot(gnss.delay_std_s if gnss is not None else 0.0, wheels.delay_std_s)
        limit = max(DELAY_LIMIT_S, STDS * known)
        if abs(delay) <= limit or abs(delay) <= CERTAIN * std:
            return []
        receiver_s = (gnss.receiver_delay_s if gnss is not None else 0.0) + delay
        return [
            own_events.FIX_DELAY(
                delay_s=delay,
                delay_std_s=std,
                limit_s=limit,
                receiver_delay_s=receiver_s,
                wheel_delay_s=wheels.delay_s - delay,
            )
        ]

    def _judge_lever(
        self, fixes: Fixes, path: Course, found: Speeds, turn: Turn | None
    ) -> list[Event]:
        gnss, mounting = self._vehicle.gnss, self._mounting
        if gnss is None or mounting is None or turn is None:
            return []
        if abs(math.degrees(turn.angle_rad)) > mounting.turn_limit_deg:
            return []  # who knows where is ahead, and to which side the wheels turn
        at = lever(fixes, path, Course(self.memory.way.turned), found, self._way.wheels_left_m)
        pivot_m, pivot_std_m = self._vehicle.ekf.pivot_m, self._vehicle.ekf.pivot_std_m
        ahead_m, left_m, _ = gnss.lever_arm_m
        limit_m = max(LEVER_LIMIT_M, STDS * pivot_std_m)
        sides = (
            ("ahead", at.forward_m, at.forward_std_m, ahead_m + pivot_m, limit_m),
            ("to the left", at.left_m, at.left_std_m, left_m, LEVER_LIMIT_M),
        )
        return [
            own_events.LEVER_ARM(
                direction=direction,
                found_m=there_m,
                found_std_m=std_m,
                configured_m=configured_m,
                limit_m=most_m,
            )
            for direction, there_m, std_m, configured_m, most_m in sides
            if std_m < LEVER_STD_M and abs(there_m - configured_m) > max(most_m, CERTAIN * std_m)
        ]

    # Lateness ------------------------------------------------------------------------------------
    def _count_came(self, key: Key, count: int) -> None:
        if count:
            self.memory.late.setdefault(key.path, LateMemory()).came += count

    def _count_late(self, late: LateSample) -> None:
        kept = self.memory.late.setdefault(late.key, LateMemory())
        kept.late += 1
        kept.late_s += (late.horizon_ns - late.stamp_ns) / S

    def _judge_lateness(self, time_s: float) -> list[Event]:
        memory = self.memory
        span_s = time_s - memory.late_s
        if span_s < LATE_SPAN_S:
            return []
        lag_s = self._vehicle.resampler.horizon_lag_s
        found = [
            own_events.STAMPS_LATE(
                key=path,
                share_percent=100.0 * each.late / (each.late + each.came),
                messages=each.late + each.came,
                span_s=span_s,
                late_s=each.late_s / each.late,
                needed_s=lag_s + each.late_s / each.late,
            )
            for path, each in memory.late.items()
            if each.late >= LEAST_LATE and each.late > each.came
        ]
        memory.late, memory.late_s = {}, time_s
        return found


def _fits(mounting: Mounting) -> bool:
    """Whether mounting and wheels agree, without which no force can be explained."""
    turn = mounting.turn()
    if turn is None or abs(math.degrees(turn.angle_rad)) > mounting.turn_limit_deg:
        return False
    return abs(math.log(turn.size)) < FITTING


def _likely(factor: float, known: tuple[tuple[float, str], ...], unlike: str) -> str:
    """What a factor looks like, of what is wrong over what is right."""
    near = (likely for each, likely in known if abs(math.log(factor / each)) < NEAR)
    return next(near, unlike)


def _angles(mounting_deg: tuple[float, float, float]) -> dict[str, float]:
    names = ("mounting_roll_deg", "mounting_pitch_deg", "mounting_yaw_deg")
    return dict(zip(names, mounting_deg, strict=True))
