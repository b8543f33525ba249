"""Wheel readings for the model `tram`: which wheel, how far since its last reading, and slip.

A wheel's path is held against the filter's own, reading by reading, and never loses a pulse. When a
reading does not fit, the wheel slips or slides: it tells nothing until it has gone the filter's way
for a while. A wheel that begins to slip at walking pace fits reading by reading, and the filter
takes it for a slope; Page's test (CUSUM) finds it by the mean of its innovations.

Equations: docs/theory.md, sections 6.5, 6.6 and 7.5.
"""

from __future__ import annotations

import math

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.localiser import Verdict
from tramstream.events.kinds import Event
from tramstream.processors.tram_filter.events import WHEEL_REFUSED, WHEEL_SPEED_REFUSED
from tramstream.processors.tram_filter.filter import SPEED, TramFilter
from tramstream.processors.tram_filter.start import set_wheel_constant
from tramstream.processors.tram_model.measurement import SCALAR_GATE
from tramstream.processors.tram_model.states import Ix
from tramstream.processors.tram_model.wheel_path import WheelPath
from tramstream.processors.tram_model.wheel_speed import WheelSpeed
from tramstream.processors.tram_sources.wheel import CUSUM_LIMIT, CUSUM_SLACK, PairMemory, Wheel
from tramstream.proto.raw_pb2 import Odometry, WheelReading
from tramstream.proto.sync_pb2 import SyncFrame

_PATHS, _SPEEDS = ("wheel_a", "wheel_b"), ("rim_a", "rim_b")
QUANTISATION = 1.0 / 3.0
"""Variance of a wheel's reading in pulses²: 1/12 of rounding, more at low speed (docs/theory.md,
section 3.5)."""
READMIT_S = 0.8
"""A wheel that has slipped is used again when it has gone the filter's way for so long; chosen by
hand, guarded by `tests/processors/tram/test_tram_faults.py`..."""
READMIT_SIGMA = 4.0
OVERRULE_S = 20.0
"""... or when it has disagreed for so long: then the filter's speed is wrong, not the wheel."""
OVERRULE_STD_RAD = 0.01
"""... and its pitch, which took gravity for a push."""
COMPANION_SHARE = 0.3
"""A wheel whose sum is so much of that of a wheel that slips, to the same side, slips too; chosen
by hand."""
EXCLUDED_S = 2.0
"""So long such a wheel is not used: the filter, misled by it, would find it right; chosen by
hand."""
MISLED_STD_MPS = 0.005
MISLED_STD_RAD = 0.001
"""What a slip has done to speed and pitch when Page's test finds it; chosen by hand, guarded by
`test_slip_at_walking_pace_is_no_slope`."""
SPEED_SHARE = 0.1
"""Of a new reading in the speed of a wheel that slips; chosen by hand."""
LONGEST_PAUSE_S = 0.5
"""After a longer pause a path says nothing about the wheel's grip,"""
LONGEST_COUNTED_S = 20.0
BLIND_STD_M = 0.3
"""but up to this one it says more than a filter that knows its way no better."""
MAX_MPS = 40.0
"""A counter that runs faster has started anew; a wheel that says so errs."""
COUNTS_DOWN = 2
"""Readings in a row by which a counter is seen to count down; one may have started anew."""
BACKWARDS_MPS = 0.3
TURNING_MPS = 0.03
"""A wheel that gives its speed turns above this."""


class WheelPair:
    """The one or two wheels that the filter has states for."""

    def __init__(self, vehicle: Vehicle, memory: PairMemory | None = None) -> None:
        self._config = config = vehicle.wheels
        self._track_m = config.track_m
        self._m_per_pulse = config.m_per_pulse
        self._pulse_variance = config.m_per_pulse**2 * QUANTISATION
        self._stamp_variance = config.stamp_std_s**2
        self._speed_std = config.speed_std_mps
        odometer = vehicle.odometer
        self._sides = (
            {name: w.side for name, w in odometer.wheels.items() if w.side} if odometer else {}
        )
        self.memory = PairMemory() if memory is None else memory
        self._wheels = self.memory.wheels

    @property
    def slips(self) -> int:
        """How often a wheel was found slipping."""
        return self.memory.slips

    def side(self, name: str) -> str:
        known = self._sides.get(name)
        if known:
            return known
        lower = name.lower()
        return "left" if "left" in lower else "right" if "right" in lower else "middle"

    def assign(self, reading: Odometry, ekf: TramFilter) -> None:
        """Give slots to the wheels of the first reading: left and right, else whatever comes."""
        sides = {wheel.wheel: self.side(wheel.wheel) for wheel in reading.wheels}
        chosen: list[str] = []
        for side in ("left", "right", "middle"):
            named = [name for name, its in sides.items() if its == side]
            chosen += named[:1] if side != "middle" or not chosen else []
        half = self._track_m / 2
        lateral = {"left": half, "right": -half, "middle": 0.0}
        for slot, name in enumerate(chosen[:2]):
            self._wheels[name] = Wheel(slot)
            ekf.set_wheel(slot, lateral[sides[name]])

        self.set_constants(ekf)

    def set_constants(self, ekf: TramFilter) -> None:
        """Begin with what the configuration says of single wheels."""
        for name, wheel in self._wheels.items():
            set_wheel_constant(ekf, wheel.slot, name, self._config)

    @property
    def known(self) -> bool:
        return bool(self._wheels)

    def turned(self, reading: Odometry) -> tuple[bool, float] | None:
        """Whether any wheel has turned since its last reading, and how far on average, m."""
        ways = []
        for each in reading.wheels[:]:  # a copy: three times as fast as protobuf's own
            wheel = self._wheels.get(each.wheel)
            if each.HasField("pulses"):
                if wheel is not None and wheel.pulses is not None:
                    way = (each.pulses - wheel.pulses) * self._m_per_pulse
                    pause_s = (reading.stamp_ns - wheel.stamp_ns) / S
                    ways.append(way if abs(way) < MAX_MPS * max(pause_s, 0.05) else 0.0)
            elif _has_speed(each):
                ways.append(each.speed_mps if abs(each.speed_mps) > TURNING_MPS else 0.0)
        if not ways:
            return None
        return any(ways), sum(ways) / len(ways)

    def apply(self, reading: Odometry, ekf: TramFilter) -> list[Verdict]:
        """Apply all wheels of a reading; the filter is at its stamp."""
        verdicts, stamp_ns, fits = [], reading.stamp_ns, True
        for each in reading.wheels[:]:
            wheel = self._wheels.get(each.wheel)
            if wheel is None:
                continue
            if each.HasField("pulses"):
                verdict = self._wheel_path(wheel, each.pulses, stamp_ns, ekf)
                fits = fits and wheel.fits
            elif _has_speed(each):
                verdict = self._wheel_speed(wheel, each, stamp_ns, ekf)
            else:
                continue
            if verdict is not None:
                verdicts.append(verdict)
        if not fits:
            self._detect_slip(stamp_ns, ekf)
        return verdicts

    def counted(self, frames: list[SyncFrame]) -> float:
        """What all wheels together have counted in `frames`: metres, or seconds times speed."""
        last: dict[str, Wheel] = {}
        total = 0.0
        for frame in frames:
            for reading in frame.odometry:
                for each in reading.wheels:
                    if each.HasField("pulses"):
                        wheel = last.setdefault(each.wheel, Wheel(0))
                        total += self._count(wheel, each.pulses, reading.stamp_ns) or 0.0
                    elif _has_speed(each):
                        total += each.speed_mps
        return total

    def direction(self, counted: float) -> float:
        """1 forwards, −1 backwards, 0 if the wheels do not tell: they may count up both ways."""
        if counted < 0.0:
            return -1.0
        return 1.0 if any(wheel.signed for wheel in self._wheels.values()) else 0.0

    def count_as_running(self, direction: float, counted: float, ekf: TramFilter) -> None:
        """Let the wheels count as they did for a vehicle that ran in `direction`."""
        sign = direction if counted > 0.0 else 1.0
        for slot in (0, 1):
            ekf.set_wheel_sign(slot, sign)

    def note_counters(self, reading: Odometry) -> None:
        """Remember where the wheels' counters are, without a filter to tell."""
        for each in reading.wheels:
            wheel = self._wheels.get(each.wheel)
            if wheel is not None and each.HasField("pulses"):
                self._count(wheel, each.pulses, reading.stamp_ns)

    def slipping_s(self, stamp_ns: int) -> float:
        """For how long a wheel that is read has not fitted the motion."""
        return max(self._slipped_s(stamp_ns), default=0.0)

    def refused_s(self, stamp_ns: int) -> float:
        """For how long no wheel has fitted the motion; 0 if one does, or none is read."""
        return min(self._slipped_s(stamp_ns), default=0.0)

    def fits(self, stamp_ns: int) -> bool:
        """Whether a wheel that is read goes the filter's way."""
        return any(not wheel.slipping for wheel in self._read(stamp_ns))

    def speed_mps(self, stamp_ns: int) -> float:
        """Speed of the wheels that do not fit the motion, without a sign; 0 where all fit."""
        speeds = [wheel.speed_mps for wheel in self._read(stamp_ns) if wheel.slipping]
        return sum(speeds) / len(speeds) if speeds else 0.0

    def _read(self, stamp_ns: int) -> list[Wheel]:
        """Wheels that have been read of late."""
        since_ns = stamp_ns - int(LONGEST_PAUSE_S * S)
        return [wheel for wheel in self._wheels.values() if wheel.stamp_ns > since_ns]

    def _slipped_s(self, stamp_ns: int) -> list[float]:
        """For how long each wheel that is read has slipped."""
        return [(stamp_ns - w.slip_ns) / S if w.slipping else 0.0 for w in self._read(stamp_ns)]

    def counters(self) -> dict[str, int]:
        """Pulses of each wheel, as they were last read."""
        return {n: each.pulses for n, each in self._wheels.items() if each.pulses is not None}

    def _count(self, wheel: Wheel, pulses: int, stamp_ns: int) -> float | None:
        """Way since the last reading, m; None if there is none, or the counter started anew."""
        before, before_ns = wheel.pulses, wheel.stamp_ns
        wheel.pulses, wheel.stamp_ns = pulses, stamp_ns
        pause_s = (stamp_ns - before_ns) / S
        if before is None or pause_s <= 0.0:
            return None
        way = (pulses - before) * self._m_per_pulse
        if abs(way) > MAX_MPS * max(pause_s, 0.05):
            return None
        if way != 0.0:
            wheel.down = wheel.down + 1 if way < 0.0 else 0
            wheel.signed |= wheel.down >= COUNTS_DOWN
        return way

    def _wheel_path(
        self, wheel: Wheel, pulses: int, stamp_ns: int, ekf: TramFilter
    ) -> Verdict | None:
        pause_s = (stamp_ns - wheel.stamp_ns) / S
        way = self._count(wheel, pulses, stamp_ns)
        speed = ekf.state[SPEED]
        variance = self._pulse_variance + speed**2 * self._stamp_variance
        if way is None or (pause_s > LONGEST_PAUSE_S and not self._counts(wheel, pause_s, ekf)):
            self._restart_path(wheel, stamp_ns, variance, ekf)
            wheel.slip_ns = stamp_ns
            return None
        sign = ekf.wheel_signs[wheel.slot]
        if wheel.signed or way * sign * speed < 0.0:
            self._correct_sign(wheel, way, speed, ekf)
        if wheel.slipping:
            return self._watch_slipping(wheel, way, variance, stamp_ns, pause_s, ekf)
        (verdict,) = ekf.apply(WheelPath(wheel.slot, way, variance))
        normal = verdict.innovation / math.sqrt(verdict.variance)
        wheel.refused = not verdict.accepted
        up = wheel.cusum_up + normal - CUSUM_SLACK
        down = wheel.cusum_down - normal - CUSUM_SLACK
        wheel.cusum_up = up if up > 0.0 else 0.0
        wheel.cusum_down = down if down > 0.0 else 0.0
        return verdict

    def _restart_path(self, wheel: Wheel, stamp_ns: int, variance: float, ekf: TramFilter) -> None:
        """Count a wheel's path from here on."""
        wheel.agrees_since_ns, wheel.agreed_path_m = stamp_ns, 0.0
        wheel.cusum_up, wheel.cusum_down, wheel.refused = 0.0, 0.0, False
        ekf.restart_path(wheel.slot, variance)

    def trust_again(self, ekf: TramFilter) -> None:
        """Believe wheels that did not fit: the filter was wrong."""
        for wheel in self._wheels.values():
            wheel.slipping, wheel.pulses = False, None
            self._restart_path(wheel, wheel.stamp_ns, self._m_per_pulse**2, ekf)

    def _detect_slip(self, stamp_ns: int, ekf: TramFilter) -> None:
        """Exclude wheels that slip, and those whose sums of Page's test have grown with theirs.

        The filter may have been misled before that is seen, the more, the greater the sum.
        """
        wheels = [wheel for wheel in self._wheels.values() if not wheel.slipping]
        slipping = [wheel for wheel in wheels if not wheel.fits]
        most = max((wheel.cusum for wheel in slipping), key=abs)
        misled = min(abs(most) / CUSUM_LIMIT, 1.0)
        for wheel in wheels:
            if wheel in slipping or wheel.cusum * most > COMPANION_SHARE * most * most:
                wheel.slipping, wheel.slip_ns = True, stamp_ns
                wheel.speed_mps = abs(ekf.state[SPEED])
                excluded_ns = int(misled * EXCLUDED_S * S)
                self._restart_path(wheel, stamp_ns + excluded_ns, self._m_per_pulse**2, ekf)
                self.memory.slips += 1
        ekf.widen(Ix.SPEED, MISLED_STD_MPS * misled)
        ekf.widen(Ix.PITCH, MISLED_STD_RAD * misled)

    def _counts(self, wheel: Wheel, pause_s: float, ekf: TramFilter) -> bool:
        """Whether what was counted in a pause says more than what the filter knows of it."""
        return pause_s < LONGEST_COUNTED_S and path_variance(ekf, wheel) > BLIND_STD_M**2

    def _overrules(self, wheel: Wheel, stamp_ns: int) -> bool:
        """Whether the filter is wrong, and not the wheel: for long, and nobody speaks for it."""
        disagreed_ns = stamp_ns - max(wheel.slip_ns, self.memory.backed_ns)
        return disagreed_ns > OVERRULE_S * S and not self.fits(stamp_ns)

    def back(self, stamp_ns: int) -> None:
        """Hear that the receiver has measured the filter's speed."""
        self.memory.backed_ns = stamp_ns

    def _correct_sign(self, wheel: Wheel, way: float, speed: float, ekf: TramFilter) -> None:
        """A counter that only counts up does so backwards too."""
        before = ekf.wheel_signs[wheel.slot]
        if wheel.signed:
            sign = 1.0
        elif way * before * speed < 0.0 and abs(speed) > BACKWARDS_MPS:
            sign = -before
        else:
            return
        if sign != before:
            ekf.set_wheel_sign(wheel.slot, sign)
            ekf.restart_path(wheel.slot, self._m_per_pulse**2)

    def _watch_slipping(
        self,
        wheel: Wheel,
        way: float,
        variance: float,
        stamp_ns: int,
        pause_s: float,
        ekf: TramFilter,
    ) -> Verdict:
        """Watch a slipping wheel, without a word to the filter."""
        wheel.agreed_path_m += way
        wheel.speed_mps += SPEED_SHARE * (abs(way) / pause_s - wheel.speed_mps)
        y = wheel.agreed_path_m - ekf.expected_path(wheel.slot)
        S_y = path_variance(ekf, wheel) + variance
        if self._overrules(wheel, stamp_ns):
            ekf.widen(Ix.SPEED, abs(abs(way) / pause_s - abs(ekf.state[SPEED])))
            ekf.widen(Ix.PITCH, OVERRULE_STD_RAD)
            wheel.slipping = False
        elif y * y > READMIT_SIGMA**2 * S_y:
            self._restart_path(wheel, max(stamp_ns, wheel.agrees_since_ns), variance, ekf)
        elif stamp_ns - wheel.agrees_since_ns > READMIT_S * S:
            wheel.slipping = False
        if not wheel.slipping:
            self._restart_path(wheel, stamp_ns, variance, ekf)
        name = "wheel_a" if wheel.slot == 0 else "wheel_b"
        return Verdict(name, y, S_y, False)

    def _wheel_speed(
        self, wheel: Wheel, each: WheelReading, stamp_ns: int, ekf: TramFilter
    ) -> Verdict | None:
        wheel.signed |= each.speed_mps < -TURNING_MPS
        wheel.stamp_ns, wheel.speed_mps = stamp_ns, abs(each.speed_mps)
        speed = ekf.state[SPEED]
        self._correct_sign(wheel, each.speed_mps, speed, ekf)
        measurement = WheelSpeed(wheel.slot, each.speed_mps, self._speed_std * self._speed_std)
        (verdict,) = ekf.apply(measurement)
        if verdict.accepted:
            wheel.slipping = False
        elif not wheel.slipping:
            wheel.slipping, wheel.slip_ns = True, stamp_ns
            self.memory.slips += 1
        elif self._overrules(wheel, stamp_ns):
            ekf.widen(Ix.SPEED, abs(verdict.innovation))
            wheel.slip_ns = stamp_ns
        return verdict

    def refusal(self, verdict: Verdict) -> list[Event]:
        """What to say of a reading that was not used; nothing of one that is only watched."""
        gate_sigma = math.sqrt(SCALAR_GATE)
        off, limit = abs(verdict.innovation), gate_sigma * math.sqrt(max(verdict.variance, 0.0))
        if off <= limit:
            return []
        slot = int(verdict.measurement in (_PATHS[1], _SPEEDS[1]))
        wheel = next((name for name, each in self._wheels.items() if each.slot == slot), "")
        facts = {"key": keys.ODO_WHEELS.path, "wheel": wheel, "gate_sigma": gate_sigma}
        if verdict.measurement in _SPEEDS:
            return [WHEEL_SPEED_REFUSED(innovation_mps=off, limit_mps=limit, **facts)]
        return [WHEEL_REFUSED(innovation_m=off, limit_m=limit, **facts)]


def path_variance(ekf: TramFilter, wheel: Wheel) -> float:
    """Variance of the path that the filter has integrated for a wheel, m²."""
    variance: float = ekf.variances[Ix.PATH_A + wheel.slot]
    return variance


def _has_speed(reading: WheelReading) -> bool:
    """Whether a wheel gives a speed that can be one."""
    return reading.HasField("speed_mps") and abs(reading.speed_mps) < MAX_MPS
