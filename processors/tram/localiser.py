"""The localiser `tram`: finds place and heading by itself, then runs the filter.

It goes through the phases of `modes.py`. *Resting*, it learns biases and averages nothing, for
fixes at a stop share their error. *Seeking*, it aligns (`heading.py`). When nothing has told of the
motion for long, the vehicle is looked for again, with all that has been learned of its sensors; one
that stood before and has not moved is taken to stand there yet (`outage.py`).
"""

from __future__ import annotations

from dataclasses import replace

from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.estimation.fixes import FAR_M, place_deg, unusable
from tramstream.estimation.localiser import HEADING_UNKNOWN, Estimate, Learned, Verdict
from tramstream.estimation.track import LocalTrack
from tramstream.events import kinds
from tramstream.geodesy import LocalLevel
from tramstream.memory.stage import State, assign, from_plain, to_plain
from tramstream.processors.tram.heading import Search
from tramstream.processors.tram.liveness import Liveness
from tramstream.processors.tram.localiser_memory import LocaliserMemory
from tramstream.processors.tram.mounting_witness import RIGHT, WRONG, MountingWitness
from tramstream.processors.tram.navigation import Navigation, Watcher
from tramstream.processors.tram.observer import UNSEEN_MPS, Observer
from tramstream.processors.tram.outage import Parked, Silence, first_fix_was_wrong
from tramstream.processors.tram.predictor import Ahead
from tramstream.processors.tram.unplaced import unplaced
from tramstream.processors.tram_filter import estimate as estimates
from tramstream.processors.tram_filter import events
from tramstream.processors.tram_filter.modes import RUNNING, TRANSITIONS, Event, Phase
from tramstream.proto.sync_pb2 import ImuMean, SyncFrame

SILENT_S = 0.5
"""Neither inertial nor wheel reading for so long: the sensors have fallen silent."""
BLIND_S = 5.0
"""After such a silence the heading is sought anew: a tram turns by 45° in less."""
LATELY_S = 5.0
"""A vehicle whose wheels were found dead, and that was taken to stand so lately, has moved unseen;
chosen by hand, guarded by `tests/processors/tram/test_liveness.py`."""
BACK_S = 5.0
"""Time that goes on from an earlier instant for so long is a clock that was set back."""


class TramLocaliser:
    """See the module; keeps `tramstream.estimation.localiser.Localiser`."""

    name = "tram"

    def __init__(self, vehicle: Vehicle, watcher: Watcher | None = None) -> None:
        self._vehicle = vehicle
        self._watcher = watcher
        self._navigation: Navigation | None = None
        self._lever_arm_m = vehicle.gnss.lever_arm_m if vehicle.gnss else (0.0, 0.0, 0.0)
        self._complaints: list[kinds.Event] = []
        self.memory = memory = LocaliserMemory()
        self._standstill = memory.standstill
        self._search: Search | None = None
        self._silence = Silence(vehicle, memory.silence)
        self._ahead = Ahead(vehicle, memory.ahead)
        self._liveness = Liveness(vehicle.wheels.m_per_pulse, memory.liveness)
        self._witness = MountingWitness(vehicle, memory.witness)
        self._observer = Observer(memory, self._liveness, self._complaints)

    @property
    def level(self) -> LocalLevel | None:
        return self.memory.level

    @property
    def phase(self) -> Phase:
        return self.memory.phase

    # One frame -----------------------------------------------------------------------------------
    def take(self, frame: SyncFrame) -> Estimate | None:
        memory = self.memory
        stamp_ns = frame.stamp_ns
        if stamp_ns <= memory.stamp_ns and not self._clock_was_set_back(stamp_ns):
            return None
        gap_s = (stamp_ns - memory.stamp_ns) / S if memory.stamp_ns else 0.0
        memory.stamp_ns = stamp_ns
        navigation = self._navigation
        if self._silence.note(frame):
            slipping_s = navigation.wheels.slipping_s(memory.stamp_ns) if navigation else 0.0
            self._complaints += self._silence.missing(memory.stamp_ns, slipping_s)
        if navigation is None:
            navigation = self._wait(frame)
            if navigation is None:
                return None
        if stamp_ns >= memory.liveness.due_ns or memory.liveness.dead or frame.gnss:
            frame = self._leave_out(navigation, frame)
        self._detect_silence(navigation, frame)
        standing = self._observer.observe(navigation, frame, gap_s)
        if memory.witness.judged is not RIGHT:
            self._judge_mounting(navigation, frame, standing)
        noise = self._standstill.noise if memory.inertial else None
        if memory.phase is RUNNING:
            verdicts = navigation.run(frame, standing, noise)
        else:
            verdicts = self._align(navigation, frame, standing)
        if memory.parked is not None:
            self._resume_parked(memory.parked, navigation, frame, standing)
        if navigation.memory.contradicted:
            navigation.memory.contradicted = False
            self._on(Event.CONTRADICTED)
        if navigation.complaints:
            self._complaints += navigation.complaints
            navigation.complaints.clear()
        if navigation.fixes.diverged is not None:
            self._restart(navigation.fixes.diverged)
            return None
        if memory.far_ns[0] and first_fix_was_wrong(memory.far_ns, memory.begun_ns):
            self._restart(events.BEGAN_ELSEWHERE(limit_m=FAR_M))
            return None
        if self._watcher is not None and memory.phase is RUNNING:
            self._watcher.heading_confirmed(navigation)
        memory.last = self._estimate(navigation, standing, verdicts)
        return memory.last

    def _leave_out(self, navigation: Navigation, frame: SyncFrame) -> SyncFrame:
        """Give the frame without sensors that do not live."""
        liveness, standstill = self._liveness, self._standstill
        stamp_ns, dead = frame.stamp_ns, liveness.wheels_dead
        running = self.memory.phase is RUNNING
        sure_mps = navigation.sure_mps if running and frame.gnss else 0.0
        honest = liveness.honest(frame, standstill.fast_s(stamp_ns), sure_mps)
        if not liveness.found:
            return honest
        self._complaints += liveness.found
        liveness.found.clear()
        if liveness.wheels_dead and not dead:
            navigation.wheels.trust_again(navigation.ekf)
            if standstill.standing or stamp_ns - standstill.since_ns < LATELY_S * S:
                self._complaints.append(events.WHEELS_LIED(still_s=LATELY_S))
                standstill.leave_wheels(stamp_ns)
                navigation.doubt()
                self._seek_anew(navigation, Event.WHEELS_LIED, LATELY_S)
        return honest

    def _seek_anew(self, navigation: Navigation, event: Event, unseen_s: float) -> None:
        """Look for the vehicle again, which has moved unseen for so long."""
        self._on(event)
        self._end_search()
        self.memory.way_m += UNSEEN_MPS * unseen_s
        navigation.forget_heading()
        self._pass_unseen_time(navigation)

    def _on(self, event: Event) -> None:
        self.memory.phase = TRANSITIONS[self.memory.phase, event]

    def _wait(self, frame: SyncFrame) -> Navigation | None:
        """Begin at the first usable fix."""
        for fix in frame.gnss:
            if not fix.valid:
                continue
            reason = unusable(fix, None)
            if reason is not None:
                self._complaints.append(reason)
                continue
            level = LocalLevel.at_deg(*place_deg(fix))
            navigation = self._navigate(level)
            self.memory.begun_ns = frame.stamp_ns
            navigation.ekf.set_time(frame.stamp_ns)
            navigation.forget_heading()
            self._on(Event.FIRST_FIX)
            return navigation
        return None

    def _judge_mounting(self, navigation: Navigation, frame: SyncFrame, standing: bool) -> None:
        """Leave an IMU out whose mounting turns out to be wrong."""
        memory = self.memory
        found = self._witness.step(frame, standing)
        if memory.witness.judged is WRONG:
            navigation.leave_imu_out(True)
            memory.inertial = False
        if found is not None:
            self._complaints.append(found)
            if not standing and memory.phase is not Phase.RESTING:
                self._seek_anew(navigation, Event.MOUNTING_WRONG, 0.0)

    # Without a heading ---------------------------------------------------------------------------
    def _align(self, navigation: Navigation, frame: SyncFrame, standing: bool) -> list[Verdict]:
        memory = self.memory
        noise = self._standstill.noise if memory.inertial else None
        if self._search is None:
            if standing:
                return navigation.run(frame, True, noise)
            if memory.heard_ns and memory.stamp_ns - memory.heard_ns > SILENT_S * S:
                self._pass_unseen_time(navigation)
                return []
            self._on(Event.DEPARTURE)
            self._search = Search(navigation, memory.last_fix)
            memory.search = self._search.memory
        search, speed_mps = self._search, self._standstill.speed_over_ground_mps
        verdicts = search.step(navigation, frame, standing, noise, speed_mps)
        if search.memory.found:
            self._on(Event.ALIGNED)
            memory.parked = None
        elif search.memory.failed:
            self._on(Event.ALIGNMENT_FAILED)
            search.abandon(navigation)
            navigation.reset_place(self.memory.last_fix, self.memory.way_m)
        if search.memory.found or search.memory.failed:
            self._end_search()
        return verdicts

    # Silence -------------------------------------------------------------------------------------
    def _pass_unseen_time(self, navigation: Navigation) -> None:
        """Let time pass until now of which nothing is known but what the sensors' errors do."""
        ekf = navigation.ekf
        ekf.rest((self.memory.stamp_ns - ekf.stamp_ns) / S)
        navigation.fixes.renew(ekf)
        for wheel in (0, 1):
            ekf.restart_path(wheel, 0.0)
        ekf.set_time(self.memory.stamp_ns)
        navigation.memory.stood = False
        navigation.reset_place(self.memory.last_fix, self.memory.way_m)

    def _detect_silence(self, navigation: Navigation, frame: SyncFrame) -> None:
        """Notice that nothing tells of the motion: park a vehicle that stands, or lose it."""
        memory = self.memory
        silent_s = (frame.stamp_ns - (memory.heard_ns or frame.stamp_ns)) / S
        if frame.HasField("imu") or frame.odometry:
            memory.heard_ns = frame.stamp_ns
        if silent_s <= SILENT_S or memory.phase not in (Phase.SEEKING, RUNNING):
            return
        running = memory.phase is RUNNING
        if running and memory.parked is None and self._standstill.standing:
            memory.parked = Parked.of(navigation)
        if silent_s > BLIND_S:
            self._complaints.append(events.HEADING_LOST(silence_s=silent_s, limit_s=BLIND_S))
            self._seek_anew(navigation, Event.SENSORS_SILENT, silent_s)

    def _resume_parked(
        self, parked: Parked, navigation: Navigation, frame: SyncFrame, standing: bool
    ) -> None:
        """Find out whether a parked vehicle stands there yet."""
        memory = self.memory
        if memory.heard_ns != frame.stamp_ns:
            return
        moved = parked.moved(frame.odometry, frame.gnss, navigation, standing)
        if moved is None and (standing or memory.phase is not RUNNING):
            return
        if moved is False:
            parked.resume(navigation, frame.stamp_ns)
            self._on(Event.PARKED_RESUMED)
            self._end_search()
        memory.parked = None

    # Another beginning ---------------------------------------------------------------------------
    def _restart(self, why: kinds.Event) -> None:
        """Forget everything."""
        self._complaints.append(why)
        self._on(Event.RESTART)
        self._go_on(LocaliserMemory())

    def _clock_was_set_back(self, stamp_ns: int) -> bool:
        """Whether time that ran backwards has gone on from there: then all begins anew."""
        first_ns, last_ns = self.memory.back_ns
        if not 0 < stamp_ns - last_ns < BACK_S * S:
            first_ns = stamp_ns
        self.memory.back_ns = (first_ns, stamp_ns)
        back_s = (self.memory.stamp_ns - stamp_ns) / S
        if stamp_ns - first_ns < BACK_S * S:
            self._complaints.append(events.TIME_BACKWARDS(back_s=back_s))
            return False
        self._restart(events.SET_BACK(back_s=back_s))
        return True

    # What comes out ------------------------------------------------------------------------------
    def _estimate(
        self, navigation: Navigation, standing: bool, verdicts: list[Verdict]
    ) -> Estimate:
        memory, running = self.memory, self.memory.phase is RUNNING
        mode = navigation.mode(memory.stamp_ns) if running else HEADING_UNKNOWN
        estimate = navigation.ekf.estimate(memory.stamp_ns, mode, standing, verdicts)
        if standing:
            way_m, mps = self._standstill.unseen(memory.stamp_ns)
            way_m = max(way_m, navigation.fixes.unexplained_m(navigation.ekf))
            if way_m > 0.0:
                estimates.doubt(estimate.values, way_m, mps)
        if running:
            return estimate
        given = memory, navigation, self._search, standing, self._lever_arm_m
        return unplaced(estimate, *given)

    def follow(self, track: LocalTrack) -> bool:
        navigation, running = self._navigation, self.memory.phase is RUNNING
        return navigation is not None and running and navigation.follow(track)

    def see(self, mean: ImuMean) -> None:
        if self.memory.witness.judged is not WRONG:
            self._ahead.append(mean)

    def ahead(self) -> Estimate | None:
        memory, navigation = self.memory, self._navigation
        stamp_ns, last = max(self._ahead.newest_ns, memory.stamp_ns), memory.last
        if navigation is None or last is None:
            return None
        if memory.phase is not RUNNING:
            return replace(last, stamp_ns=stamp_ns, verdicts=[])
        values = self._ahead.predict(navigation.ekf, memory.stamp_ns)
        return estimates.of_values(values, stamp_ns, last.mode, last.standing, [])

    def learned(self) -> list[Learned]:
        return [] if self._navigation is None else self._navigation.learned()

    def complaints(self) -> list[kinds.Event]:
        found = self._complaints.copy()
        self._complaints.clear()
        return found

    # Memory --------------------------------------------------------------------------------------
    def snapshot(self) -> State:
        if self._navigation is not None:
            self._navigation.mark()
        return to_plain(self.memory)

    def restore(self, state: State) -> None:
        self._go_on(from_plain(LocaliserMemory, state))

    def _go_on(self, memory: LocaliserMemory) -> None:
        if self._watcher is not None:
            self._watcher.restarted()
        own, level, kept = self.memory, memory.level, memory.navigation
        self._navigation = own.navigation = None
        self._end_search()
        begun = None if level is None or kept is None else self._navigate(level)
        assign(own, memory)
        if begun is not None and kept is not None:
            begun.go_back(kept)
            if self._witness.restored():
                begun.leave_imu_out(False)
            if own.search is not None:
                self._search = Search(begun, None, own.search)

    def _navigate(self, level: LocalLevel) -> Navigation:
        """Begin a navigation, whose memory is part of the localiser's."""
        self._navigation = navigation = Navigation(self._vehicle, level, self._watcher)
        self.memory.level, self.memory.navigation = level, navigation.memory
        return navigation

    def _end_search(self) -> None:
        self._search = self.memory.search = None
