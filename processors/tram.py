"""The localiser `tram`: finds place and heading by itself, then runs the filter.

    waiting ──first usable fix──▶ resting ◀──stands again too early── finding
                                     │ moves                            ▲
                                     └──────────────────────────────────┘
                                                 finding ──heading known──▶ running

*Resting*: the filter runs without a heading, which a vehicle that stands does not need; it learns
biases and averages nothing, for fixes at a stop share their error. *Finding*: the vehicle moves,
frames are kept; when the displacements between fixes tell the heading (`alignment`), the filter is
set to the departure and goes through the kept frames with a heading, once for either direction of
travel where the wheels do not tell it; the likelier one goes on. *Running*: the filter as it is.
After a gap in time the vehicle is looked for again, with all that has been learned of its sensors.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.geodesy import LocalLevel
from tramstream.localisation import HEADING_UNKNOWN, Estimate, Learned, Verdict
from tramstream.processor import State
from tramstream.processors.ahead import Ahead
from tramstream.processors.alignment import Alignment
from tramstream.processors.standstill import Standstill
from tramstream.processors.tram_estimate import at_fix, estimate_of, plain, without_heading
from tramstream.processors.tram_fixes import antenna_l, unusable
from tramstream.processors.tram_navigation import Navigation
from tramstream.processors.tram_states import SIZE, UNITS, Ix, Pm
from tramstream.processors.tram_wheels import counted
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame

GAP_S = 2.0
"""A longer pause of the ordered stream, and nothing is known of the motion in it."""
KEEP_S = 120.0
"""Frames of so long are kept while the heading is sought."""
HEADING_PRIOR_RAD = 0.35
"""The heading that displacements gave is only where the filter begins: it sees the same fixes."""
SPEED_PRIOR_MPS = 3.0
SURE = 3.0
"""Difference of log-likelihood at which a direction of travel is taken."""
UNSURE_WAY_M = 100.0
"""After so long a way the likelier direction is taken, however little."""


class TramLocaliser:
    """See the module; keeps `tramstream.localisation.Localiser`."""

    name = "tram"
    navigation_type: type[Navigation] = Navigation

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._navigation: Navigation | None = None
        self._standstill = Standstill()
        self._aligned = False
        self._anchor: dict[str, Any] | None = None  # navigation at the departure
        self._kept: list[SyncFrame] = []
        self._alignment: Alignment | None = None
        self._departed_ns = 0
        self._rested = False  # whether the departure was from standstill
        self._turned = 0.0
        self._last_fix: GnssFix | None = None
        self._stamp_ns = 0
        self._inertial = False
        self._complaints: list[str] = []
        self._ahead = Ahead(vehicle)
        self._last: Estimate | None = None

    @property
    def level(self) -> LocalLevel | None:
        return self._navigation.level if self._navigation is not None else None

    # One frame -----------------------------------------------------------------------------------
    def take(self, frame: SyncFrame) -> Estimate | None:
        if frame.stamp_ns <= self._stamp_ns:
            self._complaints.append("time ran backwards; the frame was left out")
            return None
        gap_s = (frame.stamp_ns - self._stamp_ns) / S if self._stamp_ns else 0.0
        self._stamp_ns = frame.stamp_ns
        navigation = self._navigation
        if navigation is None:
            navigation = self._wait(frame)
            if navigation is None:
                return None
        elif gap_s > GAP_S:
            self._resume(navigation, gap_s)
        standing = self._observe(navigation, frame, gap_s)
        if self._aligned:
            noise = self._standstill.noise if self._inertial else None
            verdicts = navigation.run(frame, standing, noise)
        else:
            verdicts = self._seek(navigation, frame, standing)
        self._complaints += navigation.complaints
        navigation.complaints.clear()
        self._last = self._estimate(navigation, standing, verdicts)
        return self._last

    def _wait(self, frame: SyncFrame) -> Navigation | None:
        """Begin at the first usable fix."""
        for fix in frame.gnss:
            if not fix.valid:
                continue
            reason = unusable(fix, None)
            if reason:
                self._complaints.append(f"{reason} was left out")
                continue
            level = LocalLevel.at_deg(fix.latitude_deg, fix.longitude_deg, fix.height_ellipsoid_m)
            self._navigation = navigation = self.navigation_type(self._vehicle, level)
            navigation.stamp_ns = frame.stamp_ns
            navigation.unface()
            return navigation
        return None

    def _observe(self, navigation: Navigation, frame: SyncFrame, gap_s: float) -> bool:
        """Read the sensors and tell whether the vehicle stands."""
        self._inertial = navigation.read(frame)
        standstill, wheels = self._standstill, navigation.wheels
        for reading in frame.odometry:
            turned = wheels.turned(reading)
            if turned is not None:
                standstill.wheels(reading.stamp_ns, turned[0])
        for fix in frame.gnss:
            if fix.valid:
                speed = self._speed_over_ground(navigation, fix)
                if speed is not None:
                    standstill.speed_over_ground(fix.stamp_ns, speed)
                self._last_fix = fix
        x = navigation.ekf.memory
        speed = float(x[Ix.SPEED]) if self._aligned else math.nan
        u = navigation.inputs[1] if self._inertial else None
        return standstill.step(frame.stamp_ns, u, min(gap_s, 0.1), speed, float(x[Ix.GYRO_Z]))

    def _speed_over_ground(self, navigation: Navigation, fix: GnssFix) -> float | None:
        """What the receiver measured, or else how far apart two neighbouring fixes are."""
        if fix.HasField("vel_e_mps") and fix.HasField("vel_n_mps"):
            return math.hypot(fix.vel_e_mps, fix.vel_n_mps)
        last = self._last_fix
        if last is None or not 0 < fix.stamp_ns - last.stamp_ns < 3 * S:
            return None
        if unusable(fix, navigation.level) or unusable(last, navigation.level):
            return None
        a, b = antenna_l(last, navigation.level), antenna_l(fix, navigation.level)
        dt_s = (fix.stamp_ns - last.stamp_ns) / S
        # Neighbours share most of their error; what they do not share is no motion.
        noise = 0.2 * navigation.accuracy_m(fix)
        return max(0.0, math.hypot(b[0] - a[0], b[1] - a[1]) - noise) / dt_s

    # Without a heading ---------------------------------------------------------------------------
    def _seek(self, navigation: Navigation, frame: SyncFrame, standing: bool) -> list[Verdict]:
        if self._alignment is None:
            if standing:
                noise = self._standstill.noise if self._inertial else None
                return navigation.run(frame, True, noise)
            self._depart(navigation)
        self._keep(navigation, frame)
        if standing or frame.stamp_ns - self._departed_ns > KEEP_S * S:
            self._settle(navigation)
            return []
        alignment = self._alignment
        assert alignment is not None
        return self._align(navigation, alignment) if alignment.ready else []

    def _depart(self, navigation: Navigation) -> None:
        self._anchor = navigation.snapshot()
        self._departed_ns = navigation.stamp_ns
        self._rested = navigation.stood
        self._kept, self._turned = [], 0.0
        self._alignment = alignment = Alignment(navigation.fixes.tau_s)
        fix = self._last_fix
        if fix is not None and not unusable(fix, navigation.level):
            east, north, _ = antenna_l(fix, navigation.level)
            alignment.take(0.0, east, north, 0.0, navigation.accuracy_m(fix))

    def _keep(self, navigation: Navigation, frame: SyncFrame) -> None:
        """Keep a frame of the motion; follow the turning and the fixes."""
        alignment = self._alignment
        assert alignment is not None
        bias = float(navigation.ekf.memory[Ix.GYRO_Z])
        last_ns = self._kept[-1].stamp_ns if self._kept else self._departed_ns
        dt_s = (frame.stamp_ns - last_ns) / S
        self._turned += (float(navigation.inputs[2, 2]) - bias) * dt_s
        self._kept.append(frame)
        for reading in frame.odometry:
            if not navigation.wheels.known:
                navigation.wheels.meet(reading, navigation.ekf)
            navigation.wheels.note(reading)
        for fix in frame.gnss:
            if fix.valid and not unusable(fix, navigation.level):
                east, north, _ = antenna_l(fix, navigation.level)
                time_s = (fix.stamp_ns - self._departed_ns) / S
                std = navigation.accuracy_m(fix)
                alignment.take(time_s, east, north, self._turned, std)

    def _settle(self, navigation: Navigation) -> None:
        """Give up the search: what is known of the sensors stays, the place is the fixes' again."""
        assert self._anchor is not None
        stamp_ns = self._stamp_ns
        wheels = navigation.wheels.snapshot()
        navigation.restore(self._anchor)
        navigation.wheels.restore(wheels)
        navigation.stamp_ns = stamp_ns
        self._place_again(navigation)
        self._anchor, self._alignment, self._kept = None, None, []

    def _place_again(self, navigation: Navigation) -> None:
        ekf = navigation.ekf
        fix = self._last_fix
        std = 1000.0
        if fix is not None and not unusable(fix, navigation.level):
            ekf.memory[Ix.EAST : Ix.UP + 1] = antenna_l(fix, navigation.level)
            std = 3.0 * navigation.accuracy_m(fix)
        ekf.forget((Ix.EAST, Ix.NORTH, Ix.UP), (std, std, std))
        ekf.memory[Ix.SPEED] = 0.0
        ekf.forget((Ix.SPEED,), (0.0,))

    def _align(self, navigation: Navigation, alignment: Alignment) -> list[Verdict]:
        """Go through the motion again with a heading, in both directions if need be."""
        assert self._anchor is not None
        now = navigation.snapshot()
        direction = navigation.wheels.direction(counted(self._kept))
        tried = []
        for sign in (1.0, -1.0) if direction == 0.0 else (direction,):
            verdicts = self._replay(navigation, alignment.yaw_rad, sign)
            tried.append((navigation.ekf.log_likelihood_sum, sign, navigation.snapshot(), verdicts))
        tried.sort(key=lambda each: -each[0])
        clear = len(tried) == 1 or tried[0][0] - tried[1][0] > SURE
        if not clear and alignment.way_m < UNSURE_WAY_M:
            navigation.restore(now)
            return []
        navigation.restore(tried[0][2])
        self._aligned = True
        self._anchor, self._alignment, self._kept = None, None, []
        return tried[0][3]

    def _replay(self, navigation: Navigation, yaw_rad: float, sign: float) -> list[Verdict]:
        assert self._anchor is not None
        navigation.restore(self._anchor)
        ekf = navigation.ekf
        ekf.log_likelihood_sum = 0.0
        yaw = yaw_rad if sign > 0.0 else yaw_rad + math.pi
        navigation.face(yaw, HEADING_PRIOR_RAD, self._vehicle)
        navigation.wheels.run(sign, counted(self._kept), ekf)
        if not self._rested:
            ekf.memory[Ix.SPEED] = sign * self._standstill.speed_over_ground_mps
            ekf.forget((Ix.SPEED,), (SPEED_PRIOR_MPS,))
        verdicts: list[Verdict] = []
        for frame in self._kept:
            inertial = navigation.read(frame)
            noise = self._standstill.noise if inertial else None
            verdicts = navigation.run(frame, False, noise)
        return verdicts

    def _resume(self, navigation: Navigation, gap_s: float) -> None:
        """Look for the vehicle again after a pause; one that stood is taken to stand there yet."""
        self._complaints.append(f"nothing came for {gap_s:.1f} s; the vehicle is looked for again")
        navigation.stamp_ns = self._stamp_ns
        if self._aligned and self._standstill.standing:
            return
        self._aligned = False
        self._anchor, self._alignment, self._kept = None, None, []
        navigation.unface()
        self._place_again(navigation)

    # What comes out ------------------------------------------------------------------------------
    def _estimate(
        self, navigation: Navigation, standing: bool, verdicts: list[Verdict]
    ) -> Estimate:
        mode = navigation.mode(self._stamp_ns) if self._aligned else HEADING_UNKNOWN
        memory = navigation.ekf.memory
        share = float(navigation.ekf.parameters[Pm.CLOCK_SHARE])
        estimate = estimate_of(memory, share, self._stamp_ns, mode, standing, verdicts)
        if self._aligned:
            return estimate
        fix = self._last_fix
        if standing or fix is None or unusable(fix, navigation.level):
            return without_heading(estimate)
        std_m = navigation.accuracy_m(fix)
        age_s = (self._stamp_ns - fix.stamp_ns) / S
        speed_mps = self._standstill.speed_over_ground_mps
        return at_fix(estimate, antenna_l(fix, navigation.level), std_m, speed_mps, age_s)

    def see(self, mean: ImuMean) -> None:
        self._ahead.append(mean)

    def ahead(self) -> Estimate | None:
        stamp_ns = max(self._ahead.newest_ns, self._stamp_ns)
        navigation, last = self._navigation, self._last
        if navigation is None or last is None:
            return None
        if not self._aligned:
            return replace(last, stamp_ns=stamp_ns, verdicts=[])
        m = self._ahead.predict(navigation.ekf, self._stamp_ns)
        share = float(navigation.ekf.parameters[Pm.CLOCK_SHARE])
        return estimate_of(m, share, stamp_ns, last.mode, last.standing, [])

    def learned(self) -> list[Learned]:
        navigation = self._navigation
        if navigation is None:
            return []
        values = navigation.ekf.memory[:SIZE].tolist()
        variances = np.diag(navigation.ekf.P).tolist()
        return [
            Learned(slot.name.lower(), values[slot], math.sqrt(max(variances[slot], 0.0)), unit)
            for slot, unit in UNITS.items()
        ]

    def complaints(self) -> list[str]:
        found, self._complaints = self._complaints, []
        return found

    # Memory --------------------------------------------------------------------------------------
    def snapshot(self) -> State:
        navigation = self._navigation
        level = self.level
        return {
            "level": None
            if level is None
            else [level.latitude_rad, level.longitude_rad, level.height_m],
            "navigation": None if navigation is None else navigation.snapshot(),
            "standstill": self._standstill.snapshot(),
            "aligned": self._aligned,
            "anchor": self._anchor,
            "kept": [frame.SerializeToString() for frame in self._kept],
            "alignment": None if self._alignment is None else self._alignment.snapshot(),
            "departed_ns": self._departed_ns,
            "turned": self._turned,
            "last_fix": None if self._last_fix is None else self._last_fix.SerializeToString(),
            "stamp_ns": self._stamp_ns,
            "inertial": self._inertial,
            "rested": self._rested,
            "ahead": self._ahead.snapshot(),
            "last": None if self._last is None else plain(self._last),
        }

    def restore(self, state: State) -> None:
        self._navigation = None
        if state["level"] is not None:
            self._navigation = self.navigation_type(self._vehicle, LocalLevel(*state["level"]))
            self._navigation.restore(state["navigation"])
        self._standstill.restore(state["standstill"])
        self._aligned, self._anchor = state["aligned"], state["anchor"]
        self._kept = [SyncFrame.FromString(data) for data in state["kept"]]
        self._alignment = None
        if state["alignment"] is not None and self._navigation is not None:
            self._alignment = Alignment(self._navigation.fixes.tau_s)
            self._alignment.restore(state["alignment"])
        self._departed_ns, self._turned = state["departed_ns"], state["turned"]
        last = state["last_fix"]
        self._last_fix = None if last is None else GnssFix.FromString(last)
        self._stamp_ns, self._inertial = state["stamp_ns"], state["inertial"]
        self._rested = state["rested"]
        self._ahead.restore(state["ahead"])
        self._last = None if state["last"] is None else Estimate(**state["last"])
