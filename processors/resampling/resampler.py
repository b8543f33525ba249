"""The resampler: 2 kHz to 100 Hz, and the only stage that orders.

Inertial batches become window means, published at once (`sync/imu/mean`). A fixed lag behind the
newest of them runs the *fusion horizon*: when it passes a mean, one `sync/fusion/frame` is released
with that mean and every GNSS and odometry measurement up to its stamp, in the order of stamps. All
that follows sees an ordered stream and never reorders.

What comes after the horizon has passed its stamp is not used: `sync/fusion/late` names it, so that
reprocessing treats it the same (`late_recorded`). While there is no inertial data, ticks move the
horizon and frames have no mean. Except for lateness, the result does not depend on the order in
which measurements and inertial batches come.

Equations: docs/theory.md, section 3.8.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Resampler as ResamplerSettings
from tramstream.config import Vehicle
from tramstream.errors import ConfigError
from tramstream.processor import Ledger, Processor, Sample
from tramstream.processors.resampling.windows import (
    Array,
    Window,
    Windows,
    WindowsMemory,
    lowpass_taps,
    mean_taps,
)
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import ImuBatch, Odometry
from tramstream.proto.sync_pb2 import ImuMean, LateSample, SyncFrame, SyncGap

MAX_AHEAD_S = 5.0
"""A measurement further ahead of the newest stamp has a broken clock; it would wait for ever."""
MAX_BATCH_S = 100.0
"""Imported batches last a second, those of a bridge 10 ms; what is longer, or NaN, is none."""
MAX_STRETCH = 0.5
"""Samples follow one another if their stamps are within so much of what their numbers say: the
bridge breaks a batch at 1.5 periods, and its clock fit slews by 10 % at most."""
GNSS, ODOMETRY = 0, 1
_KEYS = (keys.GNSS_FIX, keys.ODO_WHEELS)
_KINDS = {key.path: kind for kind, key in enumerate(_KEYS)}


@dataclass
class ResamplerMemory:
    """What a `Resampler` remembers."""

    windows: WindowsMemory = field(default_factory=WindowsMemory)
    horizon_ns: int = 0
    """Stamp of the last released frame."""
    newest_imu_ns: int = 0
    """Stamp of the newest inertial sample."""
    newest_ns: int = 0
    """Newest instant of inertial samples and ticks."""
    means: deque[ImuMean] = field(default_factory=deque)
    """Not released yet."""
    newer: list[ImuMean] = field(default_factory=list)
    """Since the last frame."""
    measurements: list[tuple[int, int, int, int, GnssFix | Odometry]] = field(default_factory=list)
    """Heap of stamp, kind, `publish_ns`, a number that breaks ties, message."""
    pushed: int = 0
    samples: Ledger = field(default_factory=lambda: Ledger("resampler", "samples"))
    measured: Ledger = field(default_factory=lambda: Ledger("resampler", "measurements"))


class Resampler(Processor):
    """Windows of inertial samples, and frames at the fusion horizon.

    Parameters
    ----------
    vehicle : tramstream.config.Vehicle
    late_recorded : mapping or None
        Reprocessing only: the late samples of the live run by (key path, publish_ns), of its own
        means by (key path, minus number). What is in it is late, whatever the horizon says.
    """

    name = "resampler"
    Settings = ResamplerSettings
    Memory = ResamplerMemory
    memory: ResamplerMemory
    inputs = (keys.IMU_BATCH, keys.GNSS_FIX, keys.ODO_WHEELS, keys.SYNC_TICK)
    outputs = (keys.SYNC_IMU, keys.SYNC_FRAME, keys.SYNC_GAP, keys.SYNC_LATE)
    pacing = (keys.IMU_BATCH,)

    def __init__(
        self,
        vehicle: Vehicle,
        late_recorded: Mapping[tuple[str, int], LateSample] | None = None,
    ) -> None:
        super().__init__()
        config = vehicle.resampler
        self.late_recorded = late_recorded
        self._windows = Windows(config.factor, _taps(vehicle), self.memory.windows)
        self._means = self.memory.means
        self._newer = self.memory.newer
        self._measurements = self.memory.measurements
        self._samples, self._measured = self.memory.samples, self.memory.measured
        self._max_bridge = config.max_bridge_samples
        self._lag_ns = int(config.horizon_lag_s * S)
        self._silence_ns = int(config.imu_silence_s * S)

    def step(self, sample: Sample) -> list[Sample]:
        if sample.key is keys.IMU_BATCH:
            return self._take_batch(sample.message, sample.publish_ns)
        if sample.key is keys.SYNC_TICK:
            return self._take_tick(sample.stamp_ns)
        return self._take_measurement(sample)

    # Inertial samples ----------------------------------------------------------------------------
    def _take_batch(self, batch: ImuBatch, publish_ns: int) -> list[Sample]:
        memory = self.memory
        count = len(batch.gyro_x)
        self._samples.received += count
        if count == 0 or not _is_whole(batch, count):  # somebody else's: bridges make none of those
            self._samples.dropped += count
            return []
        last_ns = batch.stamp_ns + round(batch.period_ns * (count - 1))
        if last_ns <= memory.newest_imu_ns:  # stamps run backwards: nothing to put in order
            self._samples.dropped += count
            return [self._late(keys.IMU_BATCH.path, batch.sequence, publish_ns, batch.stamp_ns)]
        results: list[Sample] = []
        self._continue_run(batch, results)
        memory.newest_imu_ns = last_ns
        memory.newest_ns = max(memory.newest_ns, last_ns)
        for window in self._windows.complete():
            self._take_window(window, batch, results)
            # To the window's end, not the batch's: how samples are batched must not show.
            self._release(window.stamp_ns + int(window.interval_ns) // 2 - self._lag_ns, results)
        return results

    def _continue_run(self, batch: ImuBatch, results: list[Sample]) -> None:
        """Append the batch to the run, bridge a short gap, or start a new run after a long one."""
        windows = self._windows
        if windows.memory.empty:
            self._samples.dropped += windows.begin(batch)
            return
        missing = batch.first_sample_sequence - windows.memory.next_sequence
        start_ns = windows.last_stamp_ns
        gap_ns = batch.stamp_ns - start_ns
        expected_ns = batch.period_ns * (missing + 1)
        in_time = abs(gap_ns - expected_ns) <= MAX_STRETCH * expected_ns
        if missing == 0 and in_time:
            self._samples.dropped += windows.extend(batch)
            return
        bridged = in_time and 0 < missing <= self._max_bridge
        gap = SyncGap(
            first_missing=windows.memory.next_sequence,
            missing_count=max(0, missing),
            duration_s=gap_ns / S,
            bridged=bridged,
        )
        if bridged:
            windows.bridge(batch)
            self._samples.dropped += windows.extend(batch)
        else:
            self._samples.dropped += windows.pending
            self._samples.dropped += windows.begin(batch)
        results.append(self.emit(keys.SYNC_GAP, gap, start_ns))

    def _take_window(self, window: Window, batch: ImuBatch, results: list[Sample]) -> None:
        gyro, accel = batch.gyro_scale_radps, batch.accel_scale_mps2
        counts = window.counts
        mean = ImuMean()  # field by field: by keywords it takes half as long again
        mean.first_sample_sequence = window.first_sequence
        mean.sample_count = window.sample_count
        mean.bridged_count = window.bridged_count
        mean.interval_s = window.interval_ns / S
        mean.gyro_x_radps = counts[0] * gyro
        mean.gyro_y_radps = counts[1] * gyro
        mean.gyro_z_radps = counts[2] * gyro
        mean.accel_x_mps2 = counts[3] * accel
        mean.accel_y_mps2 = counts[4] * accel
        mean.accel_z_mps2 = counts[5] * accel
        scatter = window.scatter
        mean.gyro_x_std_radps = scatter[0] * gyro
        mean.gyro_y_std_radps = scatter[1] * gyro
        mean.gyro_z_std_radps = scatter[2] * gyro
        mean.accel_x_std_mps2 = scatter[3] * accel
        mean.accel_y_std_mps2 = scatter[4] * accel
        mean.accel_z_std_mps2 = scatter[5] * accel
        mean.temperature_degc = batch.temperature * batch.temperature_scale_degc
        self._samples.delivered += window.sample_count
        stamp_ns = window.stamp_ns
        results.append(self.emit(keys.SYNC_IMU, mean, stamp_ns))
        # Late if ticks have moved the horizon on, or a new run overlaps the one before.
        newest_ns = self._means[-1].stamp_ns if self._means else self.memory.horizon_ns
        if stamp_ns <= newest_ns:
            results.append(self._late(keys.SYNC_IMU.path, mean.sequence, 0, stamp_ns))
        else:
            self._means.append(mean)
            self._newer.append(mean)

    # Measurements and silence --------------------------------------------------------------------
    def _take_measurement(self, sample: Sample) -> list[Sample]:
        memory = self.memory
        self._measured.received += 1
        path, stamp_ns, publish_ns = sample.key.path, sample.stamp_ns, sample.publish_ns
        recorded = self.late_recorded
        if recorded is not None and (path, publish_ns) in recorded:
            late = True
        else:
            # Far-future only live: in a record, what was refused is named, and what was not waited.
            known_ns = memory.newest_ns if recorded is None else 0
            too_far = known_ns > 0 and stamp_ns > known_ns + MAX_AHEAD_S * S
            late = too_far or stamp_ns <= memory.horizon_ns
        if late:
            self._measured.dropped += 1
            return [self._late(path, sample.sequence, publish_ns, stamp_ns)]
        # The last number only breaks ties of one message that came twice.
        memory.pushed += 1
        entry = (stamp_ns, _KINDS[path], publish_ns, memory.pushed, sample.message)
        heapq.heappush(self._measurements, entry)
        return []

    def _take_tick(self, stamp_ns: int) -> list[Sample]:
        """Move the horizon by time alone while there is no inertial data."""
        memory = self.memory
        if stamp_ns - memory.newest_imu_ns <= self._silence_ns:
            return []
        memory.newest_ns = max(memory.newest_ns, stamp_ns)
        horizon_ns = stamp_ns - self._lag_ns
        results: list[Sample] = []
        self._release(horizon_ns, results)
        if horizon_ns > memory.horizon_ns:
            results.append(self._frame(horizon_ns, None))
        return results

    def _late(self, path: str, sequence: int, publish_ns: int, stamp_ns: int) -> Sample:
        recorded = (self.late_recorded or {}).get((path, publish_ns or -sequence))
        late = LateSample()
        if recorded is not None:  # with the number that it had live, and where the horizon was
            late.CopyFrom(recorded)
            self._next_sequence[keys.SYNC_LATE.path] = recorded.sequence
        else:
            late.key = path
            late.source_sequence = sequence
            late.source_publish_ns = publish_ns
            late.horizon_ns = self.memory.horizon_ns
        return self.emit(keys.SYNC_LATE, late, stamp_ns)

    # The horizon ---------------------------------------------------------------------------------
    def _release(self, horizon_ns: int, results: list[Sample]) -> None:
        means = self._means
        while means and (stamp_ns := means[0].stamp_ns) <= horizon_ns:
            results.append(self._frame(stamp_ns, means.popleft()))

    def _frame(self, stamp_ns: int, mean: ImuMean | None) -> Sample:
        """Everything up to `stamp_ns` that has not been released yet."""
        frame = SyncFrame(ahead=self._newer)
        self._newer.clear()
        if mean is not None:
            frame.imu.CopyFrom(mean)
        measurements = self._measurements
        while measurements and measurements[0][0] <= stamp_ns:
            _, kind, _, _, message = heapq.heappop(measurements)
            released: Any = frame.gnss if kind == GNSS else frame.odometry
            released.append(message)
            self._measured.delivered += 1
        self.memory.horizon_ns = stamp_ns
        return self.emit(keys.SYNC_FRAME, frame, stamp_ns)

    def ledgers(self) -> list[Ledger]:
        return [
            replace(self._samples, pending=self._windows.pending),
            replace(self._measured, pending=len(self._measurements)),
        ]


def _is_whole(batch: ImuBatch, count: int) -> bool:
    """Whether every column has `count` numbers, and the instants of all can be counted."""
    return 0.0 <= batch.period_ns * count <= MAX_BATCH_S * S and (
        len(batch.gyro_y)
        == len(batch.gyro_z)
        == len(batch.accel_x)
        == len(batch.accel_y)
        == len(batch.accel_z)
        == count
    )


def _taps(vehicle: Vehicle) -> Array:
    """Weights of one window as configured."""
    config = vehicle.resampler
    if config.method == "mean":
        return mean_taps(config.factor)
    rate_hz = vehicle.imu.rate_hz if vehicle.imu is not None else 100.0 * config.factor
    half_hz = rate_hz / config.factor / 2.0
    if config.cutoff_hz >= half_hz:
        raise ConfigError(
            f"$.resampler.cutoff_hz: {config.cutoff_hz:g} Hz is not below half the output rate",
            cure=f"$.imu.rate_hz and $.resampler.factor leave {half_hz:g} Hz",
        )
    return lowpass_taps(config.factor, rate_hz, config.cutoff_hz)
