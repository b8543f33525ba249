"""The localisation filter as a processor: frames of the fusion horizon in, states out.

At the fusion horizon `est/ekf/state` is the filter with everything in it; `est/ekf/now` is the same
carried on to the newest inertial mean, a few milliseconds old, for whoever cannot wait. Which model
does the work is `ekf.model`; this module owns messages, numbering, protection levels and what is
said in health.

With a map, each state is matched to a track in the same step, and the filter is put onto that track
where no doubt is left: what comes back belongs to this very state, in every host.
"""

from __future__ import annotations

from collections.abc import Iterator
from statistics import NormalDist
from typing import cast

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Ekf, Vehicle
from tramstream.estimation import events as fix_events
from tramstream.estimation.localiser import Estimate, Localiser
from tramstream.estimation.published import Places, PlacesMemory
from tramstream.events import declared
from tramstream.memory.stage import assign, from_plain, to_plain
from tramstream.processor import Processor, Sample, State
from tramstream.processors.kaspar2023 import events as kaspar2023_events
from tramstream.processors.localisation import events as own_events
from tramstream.processors.localisation.matching import Matched, location_of
from tramstream.processors.localisation.models import localiser, traced
from tramstream.processors.tram import events as tram_events
from tramstream.processors.tram.smoother import smooth
from tramstream.processors.tram.trace import Trace, Tracer
from tramstream.proto.estimate_pb2 import FilterParameters, MapMatch, MotionState, Parameter
from tramstream.proto.sync_pb2 import SyncFrame

LOCATION_EVERY = 10
"""Of the states for now: viewers draw maps at 10 Hz."""
MARGIN = 1.25
"""Protection levels over the quantile of the normal distribution: the filter's own covariance has
an error, and errors of GNSS have heavier tails."""
_KNOWN = LocationFix.PositionCovarianceType.KNOWN


class LocalisationFilter(Processor):
    """States of the vehicle from `sync/fusion/frame`."""

    name = "ekf"
    offline = (keys.EST_SMOOTHED,)
    Settings = Ekf
    inputs = (keys.SYNC_FRAME,)
    outputs = (
        keys.EST_STATE,
        keys.EST_NOW,
        keys.EST_LOCATION,
        keys.EST_PARAMETERS,
        keys.MAP_MATCH,
        keys.MAP_LOCATION,
    )
    events = declared(own_events, fix_events, tram_events, kaspar2023_events)
    pacing = (keys.SYNC_FRAME,)
    demanding = True

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        self._vehicle = vehicle
        # The risk is shared by along and across, and each has two sides.
        risk = vehicle.ekf.integrity_risk
        self._quantile = MARGIN * NormalDist().inv_cdf(1.0 - risk / 4.0)
        self.localiser: Localiser = localiser(vehicle)
        self._places: Places | None = None
        self._map = Matched(vehicle) if vehicle.map is not None else None
        self._match_count = 0
        self._second = 0
        self._now_count = 0
        self._now_ns = 0  # stamp of the last state for now
        self._tracer: Tracer | None = None

    def step(self, sample: Sample) -> list[Sample]:
        made = self._take(sample)
        made += self._now(sample.message)
        return made

    def _now(self, frame: SyncFrame) -> list[Sample]:
        """Go on to the newest mean that there was when the frame was released."""
        means = frame.ahead
        for mean in means:
            self.localiser.see(mean)
        estimate = self.localiser.ahead() if means else None
        if estimate is None or estimate.stamp_ns == self._now_ns:
            return []
        message = self._message(estimate, self._here())
        if message is None:
            return []
        self._now_ns = estimate.stamp_ns
        location = _location(message) if self._now_count % LOCATION_EVERY == 0 else None
        message.ClearField("covariance")  # half of what a record held, and in `EST_STATE` as well
        made = [self.emit(keys.EST_NOW, message, estimate.stamp_ns)]
        if location is not None:
            made.append(self.emit(keys.EST_LOCATION, location, estimate.stamp_ns))
        self._now_count += 1
        return made

    def _take(self, sample: Sample) -> list[Sample]:
        estimate = self.localiser.take(sample.message)
        made = []
        if estimate is not None:
            message = self._message(estimate, self._here())
            if message is not None:
                made.append(self.emit(keys.EST_STATE, message, estimate.stamp_ns))
                if self._map is not None:
                    made += self._match(self._map, estimate)
            else:
                made += self._start_again(sample.stamp_ns)
        second = sample.stamp_ns // S
        if second != self._second:
            self._second = second
            made += self._learned(sample.stamp_ns)
            made += self.overdue_events(sample.stamp_ns)
        for event in self.localiser.complaints():
            made += self.raise_event(event, sample.stamp_ns)
        return made

    def _match(self, with_map: Matched, estimate: Estimate) -> list[Sample]:
        """Find the track, and put the filter onto it where there is no doubt left."""
        level = self.localiser.level
        assert level is not None  # there is an estimate
        found = with_map.take(estimate, level)
        made = []
        if found is not None:
            match, on_track = found
            stamp_ns = estimate.stamp_ns
            if on_track is not None:
                self.localiser.constrain(on_track)
            made.append(self.emit(keys.MAP_MATCH, match, stamp_ns))
            if self._match_count % LOCATION_EVERY == 0 and match.state == MapMatch.ON_TRACK:
                made.append(self.emit(keys.MAP_LOCATION, location_of(match), stamp_ns))
            self._match_count += 1
        for event in with_map.complaints:
            made += self.raise_event(event, estimate.stamp_ns)
        with_map.complaints.clear()
        return made

    def _start_again(self, stamp_ns: int) -> list[Sample]:
        """Nothing that is no number is ever published; the filter begins anew."""
        if self._tracer is None:
            self.localiser = localiser(self._vehicle)
        else:
            self._tracer.restarted()
            self.localiser = traced(self._vehicle, self._tracer)
        self._places = None
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
        return {
            "sequences": self.sequences(),
            "localiser": self.localiser.snapshot(),
            "second": self._second,
            "map": None if self._map is None else self._map.snapshot(),
            "match_count": self._match_count,
            "now_count": self._now_count,
            "now_ns": self._now_ns,
            "places": None if self._places is None else to_plain(self._places.memory),
        }

    def restore(self, state: State) -> None:
        self.restore_sequences(state["sequences"])
        self.localiser.restore(state["localiser"])
        self._second = state["second"]
        self._now_count, self._now_ns = state["now_count"], state["now_ns"]
        self._places = None
        level = self.localiser.level
        self._match_count = state["match_count"]
        if self._map is not None and state["map"] is not None:
            self._map.restore(state["map"], level)
        if state["places"] is not None and level is not None:
            self._places = Places(level)
            assign(self._places.memory, from_plain(PlacesMemory, state["places"]))


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
