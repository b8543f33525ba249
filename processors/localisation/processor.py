"""The localisation filter as a processor: frames of the fusion horizon in, states out.

At the fusion horizon `est/ekf/state` is the filter with everything in it; `est/ekf/now` is the same
carried on to the newest inertial mean, a few milliseconds old, for whoever cannot wait. Which model
does the work is `ekf.model`; this module owns messages, numbering, protection levels and what is
said in health.

It knows no network. Where somebody says which track the vehicle is on (`map/matcher/track`), the
filter is put onto it where no doubt is left, at a stated delay that is the same in every host
(`delayed.py`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import cast

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

from tramstream import keys
from tramstream.clock import S
from tramstream.config import MATCHER, Ekf, Vehicle, takes_track
from tramstream.estimation import events as fix_events
from tramstream.estimation.localiser import Estimate, Localiser
from tramstream.estimation.published import Places, PlacesMemory
from tramstream.estimation.track import CERTAIN, in_level
from tramstream.events import declared
from tramstream.keys import Key
from tramstream.processor import Ledger, Processor, Sample, State
from tramstream.processors.kaspar2023 import events as kaspar2023_events
from tramstream.processors.localisation import events as own_events
from tramstream.processors.localisation.delayed import Delayed, DelayedMemory, Late
from tramstream.processors.localisation.events import MAP_UNMATCHED, TRACK_UNHEARD
from tramstream.processors.localisation.models import localiser, traced
from tramstream.processors.smoothing.smoother import smooth
from tramstream.processors.smoothing.trace import Trace, Tracer
from tramstream.processors.tram_filter import events as tram_events
from tramstream.proto.estimate_pb2 import FilterParameters, MotionState, Parameter, TrackGeometry
from tramstream.proto.sync_pb2 import LateSample, SyncFrame

LOCATION_EVERY = 10
"""Of the states for now: viewers draw maps at 10 Hz."""
MARGIN = 1.25
"""Protection levels over the quantile of the normal distribution: the filter's own covariance has
an error, and errors of GNSS have heavier tails."""
UNHEARD_M = 100.0
"""Way after which it is said that nothing is heard of the track any more: longer than any doubt
behind a switch."""
_KNOWN = LocationFix.PositionCovarianceType.KNOWN


@dataclass
class LocalisationMemory:
    """What the localisation filter remembers, apart from what its model does."""

    second: int = 0
    now_count: int = 0
    now_ns: int = 0
    """Stamp of the last state for now."""
    last: tuple[int, float] | None = None
    """Stamp and height of the last state."""
    unheard_m: float | None = None
    """Way since the track was heard of; None: never."""
    delayed: DelayedMemory = field(default_factory=DelayedMemory)
    places: PlacesMemory | None = None
    """None before the first state."""


class LocalisationFilter(Processor):
    """States of the vehicle from `sync/fusion/frame`."""

    name = "ekf"
    offline = (keys.EST_SMOOTHED,)
    Settings = Ekf
    inputs: tuple[Key, ...] = (keys.SYNC_FRAME,)
    outputs = (
        keys.EST_STATE,
        keys.EST_NOW,
        keys.EST_LOCATION,
        keys.EST_PARAMETERS,
        keys.EST_LATE,
    )
    events = declared(own_events, fix_events, tram_events, kaspar2023_events)
    pacing = (keys.SYNC_FRAME,)
    demanding = True
    Memory = LocalisationMemory
    memory: LocalisationMemory

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        self._vehicle = vehicle
        # The risk is shared by along and across, and each has two sides.
        risk = vehicle.ekf.integrity_risk
        self._quantile = MARGIN * NormalDist().inv_cdf(1.0 - risk / 4.0)
        self.localiser: Localiser = localiser(vehicle)
        self._places: Places | None = None
        self._delayed: Delayed | None = None
        if takes_track(vehicle):
            self.inputs = (keys.SYNC_FRAME, keys.MAP_TRACK)
            self._delayed = Delayed(vehicle.ekf.track_delay_s, self.memory.delayed)
        self._late_recorded: Late | None = None
        self._unmatched = vehicle.map is not None and MATCHER not in vehicle.processors
        self._tracer: Tracer | None = None

    def step(self, sample: Sample) -> list[Sample]:
        if sample.key.path != keys.SYNC_FRAME.path:
            return self._hear(sample)
        if self._delayed is not None:
            for geometry in self._delayed.due(sample.stamp_ns):
                self._follow(geometry)
        made = self._take(sample)
        made += self._now(sample.message)
        return made

    def _now(self, frame: SyncFrame) -> list[Sample]:
        """Go on to the newest mean that there was when the frame was released."""
        means = frame.ahead[:]  # a copy: three times as fast to go through
        for mean in means:
            self.localiser.see(mean)
        estimate = self.localiser.ahead() if means else None
        if estimate is None or estimate.stamp_ns == self.memory.now_ns:
            return []
        message = self._message(estimate, self._here())
        if message is None:
            return []
        self.memory.now_ns = estimate.stamp_ns
        location = _location(message) if self.memory.now_count % LOCATION_EVERY == 0 else None
        message.ClearField("covariance")  # half of what a record held, and in `EST_STATE` as well
        made = [self.emit(keys.EST_NOW, message, estimate.stamp_ns)]
        if location is not None:
            made.append(self.emit(keys.EST_LOCATION, location, estimate.stamp_ns))
        self.memory.now_count += 1
        return made

    def _take(self, sample: Sample) -> list[Sample]:
        estimate = self.localiser.take(sample.message)
        made = []
        if estimate is not None:
            message = self._message(estimate, self._here())
            if message is not None:
                made.append(self.emit(keys.EST_STATE, message, estimate.stamp_ns))
                if self._delayed is not None:
                    made += self._miss(message)
            else:
                made += self._start_again(sample.stamp_ns)
        second = sample.stamp_ns // S
        if second != self.memory.second:
            self.memory.second = second
            made += self._learned(sample.stamp_ns)
            made += self.overdue_events(sample.stamp_ns)
        for event in self.localiser.complaints():
            made += self.raise_event(event, sample.stamp_ns)
        return made

    # The track -----------------------------------------------------------------------------------
    def _hear(self, sample: Sample) -> list[Sample]:
        """Let geometry wait for its frame, or name it if that has gone by."""
        late = self._delayed.take(sample) if self._delayed is not None else None
        if late is None:
            return []
        named = LateSample()
        named.CopyFrom(late)
        if self._late_recorded is not None:  # with the number that it had live
            self._next_sequence[keys.EST_LATE.path] = late.sequence
        return [self.emit(keys.EST_LATE, named, sample.stamp_ns)]

    def _follow(self, geometry: TrackGeometry) -> None:
        """Put the filter onto the track, where there is no doubt left."""
        level, last = self.localiser.level, self.memory.last
        self.memory.unheard_m = 0.0
        if geometry.probability >= CERTAIN and level is not None and last is not None:
            track = in_level(geometry, level, last[1])
            if track is not None:
                self.localiser.follow(track)

    def _miss(self, state: MotionState) -> list[Sample]:
        """Notice that nothing is heard of the track any more, or never will be."""
        memory, stamp_ns, last = self.memory, state.stamp_ns, self.memory.last
        memory.last = stamp_ns, state.height_ellipsoid_m
        if last is None:
            return self.raise_event(MAP_UNMATCHED(), stamp_ns) if self._unmatched else []
        if memory.unheard_m is None or memory.unheard_m > UNHEARD_M:
            return []
        memory.unheard_m += abs(state.speed_mps) * (stamp_ns - last[0]) / S
        if memory.unheard_m <= UNHEARD_M:
            return []
        return self.raise_event(TRACK_UNHEARD(way_m=memory.unheard_m, limit_m=UNHEARD_M), stamp_ns)

    @property
    def late_recorded(self) -> Late | None:
        """See `tramstream.processor.Ordering`."""
        return self._late_recorded

    @late_recorded.setter
    def late_recorded(self, late: Late | None) -> None:
        self._late_recorded = late
        if self._delayed is not None:
            self._delayed.repeat(late)

    def ledgers(self) -> list[Ledger]:
        return [] if self._delayed is None else [self._delayed.ledger]

    def _start_again(self, stamp_ns: int) -> list[Sample]:
        """Nothing that is no number is ever published; the filter begins anew."""
        if self._tracer is None:
            self.localiser = localiser(self._vehicle)
        else:
            self._tracer.restarted()
            self.localiser = traced(self._vehicle, self._tracer)
        self._places = self.memory.places = None
        return self.raise_event(own_events.NO_NUMBER(), stamp_ns)

    def _learned(self, stamp_ns: int) -> list[Sample]:
        learned = self.localiser.learned()
        if not learned:
            return []
        message = FilterParameters(
            model=self.localiser.name,
            parameters=[
                Parameter(name=each.name, value=each.value, std=each.std, unit=each.unit)
                for each in learned
            ],
        )
        return [self.emit(keys.EST_PARAMETERS, message, stamp_ns)]

    def _here(self) -> Places:
        level, places = self.localiser.level, self._places
        assert level is not None  # there is an estimate
        if places is None or places.level is not level:
            places = self._places = Places(level)
            self.memory.places = places.memory
        return places

    def _message(self, estimate: Estimate, places: Places) -> MotionState | None:
        """The state as it is published; None if it is no number."""
        message = places.describe(estimate, self._quantile)
        if message is None:
            return None
        message.mode = cast("MotionState.Mode", estimate.mode)
        message.standing = estimate.standing
        for name, value, variance, accepted in estimate.verdicts:
            message.innovations.add(
                measurement=name, value=value, variance=variance, accepted=accepted
            )
        return message

    # The whole ride known ------------------------------------------------------------------------
    def keep(self) -> None:
        """See `tramstream.processor.Smoothing`.

        Raises
        ------
        ConfigError
            If the model has no smoother.
        """
        tracer = Tracer()
        self.localiser, self._tracer = traced(self._vehicle, tracer), tracer

    def smoothed(self) -> Iterator[Sample]:
        """See `tramstream.processor.Smoothing`."""
        last_ns = 0
        for trace in self.traces:
            places = Places(trace.level)
            for estimate in smooth(trace).estimates():
                message = self._message(estimate, places)
                if estimate.stamp_ns > last_ns and message is not None:
                    last_ns = estimate.stamp_ns
                    yield self.emit(keys.EST_SMOOTHED, message, last_ns)

    @property
    def traces(self) -> list[Trace]:
        """What was written down for a smoother; nothing unless `keep` was called."""
        return [] if self._tracer is None else self._tracer.traces

    # Memory --------------------------------------------------------------------------------------
    def snapshot(self) -> State:
        return {**super().snapshot(), "localiser": self.localiser.snapshot()}

    def restore(self, state: State) -> None:
        self.localiser.restore(state["localiser"])
        super().restore(state)

    def restored(self) -> None:
        self._places = None
        level, places = self.localiser.level, self.memory.places
        if places is not None and level is not None:
            self._places = Places(level, places)


def _location(state: MotionState) -> LocationFix:
    """Give a state as viewers know it; covariance of east, north and up."""
    (ee, en, eu, _, _, _, _, nn, nu, _, _, _, _, uu) = state.covariance[:14]
    return LocationFix(
        frame_id="vehicle",
        latitude=state.latitude_deg,
        longitude=state.longitude_deg,
        altitude=state.height_ellipsoid_m,
        position_covariance=(ee, en, eu, en, nn, nu, eu, nu, uu),
        position_covariance_type=_KNOWN,
    )
