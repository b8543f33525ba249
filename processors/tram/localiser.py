"""The localiser `tram`: finds place and heading by itself, then runs the filter.

It goes through the phases of `modes.py`. *Resting*, it learns biases and averages nothing, for
fixes at a stop share their error. *Seeking*, it aligns (`heading.py`). When nothing has told of the
motion for long, the vehicle is looked for again, with all that has been learned of its sensors; one
that stood before and has not moved is taken to stand there yet (`outage.py`).
"""

from __future__ import annotations

import math
from dataclasses import replace

from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.fixes import FAR_M, antenna_l, unusable
from tramstream.estimation.localiser import HEADING_UNKNOWN, Estimate, Learned, Verdict
from tramstream.estimation.track import LocalTrack
from tramstream.events import kinds
from tramstream.geodesy import LocalLevel
from tramstream.processor import State
from tramstream.processors.tram import estimate as estimates
from tramstream.processors.tram import events
from tramstream.processors.tram.filter import GYRO_Z, SPEED
from tramstream.processors.tram.gnss import doubts, speed_over_ground
from tramstream.processors.tram.heading import Search
from tramstream.processors.tram.modes import TRANSITIONS, Event, Phase, phase_of
from tramstream.processors.tram.navigation import Navigation, Watcher
from tramstream.processors.tram.outage import Parked, Silence
from tramstream.processors.tram.predictor import Ahead
from tramstream.processors.tram.standstill import Standstill
from tramstream.processors.tram_model.states import Ix
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import Odometry
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame

SILENT_S = 0.5
"""Neither inertial nor wheel reading for so long: the sensors have fallen silent."""
BLIND_S = 5.0
"""After such a silence the heading is sought anew: a tram turns by 45° in less."""
UNSEEN_MPS = 15.0
"""How fast a vehicle moves that nobody sees."""
HEARD_S = 0.5
"""Wheels read within so long tell how far the vehicle has come."""
BACK_S = 5.0
"""Time that goes on from an earlier instant for so long is a clock that was set back."""
FAR_S = 10.0
FAR_LATEST_S = 120.0
"""Fixes far from where the ride began for so long, or for as long as the ride has lasted if that is
between the two: it was the first fix that was wrong."""


class TramLocaliser:
    """See the module; keeps `tramstream.estimation.localiser.Localiser`."""

    name = "tram"

    def __init__(self, vehicle: Vehicle, watcher: Watcher | None = None) -> None:
        self._vehicle = vehicle
        self._watcher = watcher
        self._navigation: Navigation | None = None
        self._lever_arm_m = vehicle.gnss.lever_arm_m if vehicle.gnss else (0.0, 0.0, 0.0)
        self._standstill = Standstill()
        self.phase = Phase.WAITING
        self._search: Search | None = None
        self._silence = Silence(vehicle)
        self._parked: Parked | None = None
        self._heard_ns = 0  # last inertial or wheel reading
        self._wheels_ns = 0
        self._way_m = 0.0  # at most, since the last usable fix
        self._last_fix: GnssFix | None = None  # usable
        self._begun_ns = 0
        self._stamp_ns = 0
        self._back_ns = (0, 0)  # first and last stamp of frames that went on from an earlier time
        self._far_ns = (0, 0)  # first and last of those fixes in a row that are far away
        self._inertial = False
        self._complaints: list[kinds.Event] = []
        self._ahead = Ahead(vehicle)
        self._last: Estimate | None = None

    @property
    def level(self) -> LocalLevel | None:
        return self._navigation.level if self._navigation is not None else None

    # One frame -----------------------------------------------------------------------------------
    def take(self, frame: SyncFrame) -> Estimate | None:
        stamp_ns = frame.stamp_ns
        if stamp_ns <= self._stamp_ns and not self._clock_was_set_back(stamp_ns):
            return None
        gap_s = (stamp_ns - self._stamp_ns) / S if self._stamp_ns else 0.0
        self._stamp_ns = stamp_ns
        navigation = self._navigation
        if self._silence.note(frame):
            slipping_s = navigation.wheels.slipping_s(self._stamp_ns) if navigation else 0.0
            self._complaints += self._silence.missing(self._stamp_ns, slipping_s)
        if navigation is None:
            navigation = self._wait(frame)
            if navigation is None:
                return None
        self._detect_silence(navigation, frame)
        standing = self._observe(navigation, frame, gap_s)
        noise = self._standstill.noise if self._inertial else None
        if self.phase is Phase.RUNNING:
            verdicts = navigation.run(frame, standing, noise)
        else:
            verdicts = self._align(navigation, frame, standing)
        if self._parked is not None:
            self._resume_parked(self._parked, navigation, frame, standing)
        if navigation.complaints:
            self._complaints += navigation.complaints
            navigation.complaints.clear()
        if navigation.fixes.diverged is not None:
            self._restart(navigation.fixes.diverged)
            return None
        if self._far_ns[0] and self._first_fix_was_wrong():
            self._restart(events.BEGAN_ELSEWHERE(limit_m=FAR_M))
            return None
        if self._watcher is not None and self.phase is Phase.RUNNING:
            self._watcher.heading_confirmed(navigation)
        self._last = self._estimate(navigation, standing, verdicts)
        return self._last

    def _on(self, event: Event) -> None:
        self.phase = TRANSITIONS[self.phase, event]

    def _wait(self, frame: SyncFrame) -> Navigation | None:
        """Begin at the first usable fix."""
        for fix in frame.gnss:
            if not fix.valid:
                continue
            reason = unusable(fix, None)
            if reason is not None:
                self._complaints.append(reason)
                continue
            level = LocalLevel.at_deg(fix.latitude_deg, fix.longitude_deg, fix.height_ellipsoid_m)
            self._navigation = navigation = Navigation(self._vehicle, level, self._watcher)
            self._begun_ns = frame.stamp_ns
            navigation.ekf.set_time(frame.stamp_ns)
            navigation.forget_heading()
            self._on(Event.FIRST_FIX)
            return navigation
        return None

    def _observe(self, navigation: Navigation, frame: SyncFrame, gap_s: float) -> bool:
        """Read the sensors and tell whether the vehicle stands."""
        self._inertial = navigation.read(frame)
        standstill = self._standstill
        counted_m = 0.0
        for reading in frame.odometry:
            counted_m += self._note_wheels(reading)
        x, variances, stamp_ns = navigation.ekf.state, navigation.ekf.variances, self._stamp_ns
        running = self.phase is Phase.RUNNING
        speed, variance = (x[SPEED], variances[SPEED]) if running else (math.nan, 0.0)
        u = navigation.reading if self._inertial else None
        standing = standstill.step(stamp_ns, u, min(gap_s, 0.1), speed, variance, x[GYRO_Z])
        if not standing:
            heard = stamp_ns - self._wheels_ns < HEARD_S * S
            self._way_m += counted_m if heard else UNSEEN_MPS * gap_s
        for fix in frame.gnss:
            if fix.valid:
                self._note_fix(navigation, fix)
        return standing

    def _note_wheels(self, reading: Odometry) -> float:
        """How far the wheels have turned since the last reading, m."""
        assert self._navigation is not None
        turned = self._navigation.wheels.turned(reading)
        if turned is None:
            return 0.0
        self._standstill.wheels(reading.stamp_ns, turned[0])
        self._wheels_ns = reading.stamp_ns
        return abs(turned[1])

    def _note_fix(self, navigation: Navigation, fix: GnssFix) -> None:
        """Take note of a fix, apart from the filter."""
        reason = unusable(fix, navigation.level)
        if reason is not None:
            self._complaints.append(reason)
            if unusable(fix, None) is None:
                self._far_ns = (self._far_ns[0] or fix.stamp_ns, fix.stamp_ns)
            return
        self._complaints += doubts(fix, navigation.level)
        self._far_ns = (0, 0)
        std_m = navigation.accuracy_m(fix)
        speed = speed_over_ground(fix, self._last_fix, navigation.level, std_m)
        if speed is not None:
            self._standstill.speed_over_ground(fix.stamp_ns, speed)
        self._last_fix, self._way_m = fix, 0.0

    # Without a heading ---------------------------------------------------------------------------
    def _align(self, navigation: Navigation, frame: SyncFrame, standing: bool) -> list[Verdict]:
        noise = self._standstill.noise if self._inertial else None
        if self._search is None:
            if standing:
                return navigation.run(frame, True, noise)
            if self._heard_ns and self._stamp_ns - self._heard_ns > SILENT_S * S:
                self._pass_unseen_time(navigation)
                return []
            self._on(Event.DEPARTURE)
            self._search = Search(navigation, self._last_fix)
        search, speed_mps = self._search, self._standstill.speed_over_ground_mps
        verdicts = search.step(navigation, frame, standing, noise, speed_mps)
        if search.found:
            self._on(Event.ALIGNED)
            self._parked = None
        elif search.failed:
            self._on(Event.ALIGNMENT_FAILED)
            search.abandon(navigation)
            self._reset_position(navigation)
        if search.found or search.failed:
            self._search = None
        return verdicts

    def _reset_position(self, navigation: Navigation) -> None:
        """Forget the place but for the last fix, and how far that may be."""
        ekf, fix, std, std_up = navigation.ekf, self._last_fix, 1000.0, 1000.0
        if fix is not None:
            ekf.set_states(Ix.EAST, antenna_l(fix, navigation.level))
            stated = navigation.accuracies_m(fix)
            std, std_up = (math.hypot(3.0 * each, self._way_m) for each in stated)
        ekf.forget((Ix.EAST, Ix.NORTH, Ix.UP), (std, std, std_up))
        ekf.reset(Ix.SPEED, 0.0, 0.0)

    # Silence -------------------------------------------------------------------------------------
    def _pass_unseen_time(self, navigation: Navigation) -> None:
        """Let time pass until now of which nothing is known but what the sensors' errors do."""
        ekf = navigation.ekf
        ekf.rest((self._stamp_ns - ekf.stamp_ns) / S)
        navigation.fixes.renew(ekf)
        for wheel in (0, 1):
            ekf.restart_path(wheel, 0.0)
        ekf.set_time(self._stamp_ns)
        navigation.stood = False
        self._reset_position(navigation)

    def _detect_silence(self, navigation: Navigation, frame: SyncFrame) -> None:
        """Notice that nothing tells of the motion: park a vehicle that stands, or lose it."""
        silent_s = (frame.stamp_ns - (self._heard_ns or frame.stamp_ns)) / S
        if frame.HasField("imu") or frame.odometry:
            self._heard_ns = frame.stamp_ns
        if silent_s <= SILENT_S or self.phase not in (Phase.SEEKING, Phase.RUNNING):
            return
        running = self.phase is Phase.RUNNING
        if running and self._parked is None and self._standstill.standing:
            self._parked = Parked(navigation)
        if silent_s > BLIND_S:
            self._complaints.append(events.HEADING_LOST(silence_s=silent_s, limit_s=BLIND_S))
            self._on(Event.SENSORS_SILENT)
            self._search = None
            self._way_m += UNSEEN_MPS * silent_s
            navigation.forget_heading()
            self._pass_unseen_time(navigation)

    def _resume_parked(
        self, parked: Parked, navigation: Navigation, frame: SyncFrame, standing: bool
    ) -> None:
        """Find out whether a parked vehicle stands there yet."""
        if self._heard_ns != frame.stamp_ns:
            return
        moved = parked.moved(frame.odometry, frame.gnss, navigation, standing)
        if moved is None and (standing or self.phase is not Phase.RUNNING):
            return
        if moved is False:
            parked.resume(navigation, frame.stamp_ns)
            self._on(Event.PARKED_RESUMED)
            self._search = None
        self._parked = None

    # Another beginning ---------------------------------------------------------------------------
    def _restart(self, why: kinds.Event) -> None:
        """Forget everything."""
        self._complaints.append(why)
        self._on(Event.RESTART)
        self.restore(TramLocaliser(self._vehicle).snapshot())

    def _clock_was_set_back(self, stamp_ns: int) -> bool:
        """Whether time that ran backwards has gone on from there: then all begins anew."""
        first_ns, last_ns = self._back_ns
        if not 0 < stamp_ns - last_ns < BACK_S * S:
            first_ns = stamp_ns
        self._back_ns = (first_ns, stamp_ns)
        back_s = (self._stamp_ns - stamp_ns) / S
        if stamp_ns - first_ns < BACK_S * S:
            self._complaints.append(events.TIME_BACKWARDS(back_s=back_s))
            return False
        self._restart(events.SET_BACK(back_s=back_s))
        return True

    def _first_fix_was_wrong(self) -> bool:
        """Whether the first fix was wrong, by all that came later."""
        first_ns, last_ns = self._far_ns
        before_s = (first_ns - self._begun_ns) / S
        return last_ns - first_ns > max(FAR_S, min(before_s, FAR_LATEST_S)) * S

    # What comes out ------------------------------------------------------------------------------
    def _estimate(
        self, navigation: Navigation, standing: bool, verdicts: list[Verdict]
    ) -> Estimate:
        running = self.phase is Phase.RUNNING
        mode = navigation.mode(self._stamp_ns) if running else HEADING_UNKNOWN
        estimate = navigation.ekf.estimate(self._stamp_ns, mode, standing, verdicts)
        if running:
            return estimate
        fix = self._last_fix
        if fix is None or (standing and self._search is None):
            return estimates.without_heading(estimate, self._lever_arm_m)
        if self._search is not None and self._search.trying:
            return estimates.without_heading(estimate, self._lever_arm_m, of_antenna=False)
        speed_mps = self._standstill.speed_over_ground_mps
        std_m, std_up_m = (math.hypot(a, self._way_m) for a in navigation.accuracies_m(fix))
        age_s = (self._stamp_ns - fix.stamp_ns) / S
        antenna = antenna_l(fix, navigation.level)
        return estimates.at_fix(
            estimate, antenna, (std_m, std_up_m), speed_mps, min(age_s, 2.0), self._lever_arm_m
        )

    def follow(self, track: LocalTrack) -> bool:
        navigation, running = self._navigation, self.phase is Phase.RUNNING
        return navigation is not None and running and navigation.follow(track)

    def see(self, mean: ImuMean) -> None:
        self._ahead.append(mean)

    def ahead(self) -> Estimate | None:
        stamp_ns = max(self._ahead.newest_ns, self._stamp_ns)
        navigation, last = self._navigation, self._last
        if navigation is None or last is None:
            return None
        if self.phase is not Phase.RUNNING:
            return replace(last, stamp_ns=stamp_ns, verdicts=[])
        values = self._ahead.predict(navigation.ekf, self._stamp_ns)
        return estimates.of_values(values, stamp_ns, last.mode, last.standing, [])

    def learned(self) -> list[Learned]:
        return [] if self._navigation is None else self._navigation.learned()

    def complaints(self) -> list[kinds.Event]:
        found, self._complaints = self._complaints, []
        return found

    # Memory --------------------------------------------------------------------------------------
    def snapshot(self) -> State:
        navigation, level, search, parked = self._navigation, self.level, self._search, self._parked
        return {
            "level": None
            if level is None
            else [level.latitude_rad, level.longitude_rad, level.height_m],
            "navigation": None if navigation is None else navigation.snapshot(),
            "standstill": self._standstill.snapshot(),
            "phase": self.phase.name,
            "search": None if search is None else search.snapshot(),
            "silence": self._silence.snapshot(),
            "parked": None if parked is None else parked.snapshot(),
            "last_fix": None if self._last_fix is None else self._last_fix.SerializeToString(),
            "back_ns": list(self._back_ns),
            "far_ns": list(self._far_ns),
            "ahead": self._ahead.snapshot(),
            "last": None if self._last is None else estimates.plain(self._last),
            **{name: getattr(self, name) for name in _PLAIN},
        }

    def restore(self, state: State) -> None:
        self._navigation = self._search = self._parked = None
        if self._watcher is not None:
            self._watcher.restarted()
        if state["level"] is not None:
            level = LocalLevel(*state["level"])
            self._navigation = navigation = Navigation(self._vehicle, level, self._watcher)
            if state["search"] is not None:
                self._search = Search(navigation, None)
                self._search.restore(state["search"])
            if state["parked"] is not None:
                self._parked = Parked(navigation)
                self._parked.restore(state["parked"])
            navigation.restore(state["navigation"])
        self._standstill.restore(state["standstill"])
        self._silence.restore(state["silence"])
        self.phase = phase_of(state)
        last = state["last_fix"]
        self._last_fix = None if last is None else GnssFix.FromString(last)
        self._back_ns, self._far_ns = tuple(state["back_ns"]), tuple(state["far_ns"])
        self._ahead.restore(state["ahead"])
        self._last = None if state["last"] is None else estimates.from_plain(state["last"])
        for name in _PLAIN:
            setattr(self, name, state[name])


_PLAIN = (
    "_heard_ns",
    "_wheels_ns",
    "_way_m",
    "_begun_ns",
    "_stamp_ns",
    "_inertial",
)
"""Attributes of the localiser that are numbers."""
