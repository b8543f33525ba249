"""The resampler: 2 kHz to 100 Hz, and the only stage that orders.

Inertial batches become window means, published at once (`sync/imu/mean`). A fixed lag behind the
newest of them runs the *fusion horizon*: when it passes a mean, one `sync/fusion/frame` is released
with that mean and every GNSS and odometry measurement up to its stamp, in the order of stamps. All
that follows sees an ordered stream and never reorders.

What comes after the horizon has passed its stamp is not used: `sync/fusion/late` names it, so that
reprocessing treats it the same (`late_recorded`). While there is no inertial data, ticks move the
horizon and frames have no mean. Except for lateness, the result does not depend on the order in
which measurements and inertial batches come.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Mapping
from dataclasses import replace

from tramstream import keys
from tramstream.clock import S
from tramstream.config import Vehicle
from tramstream.processor import Ledger, Processor, Sample, State
from tramstream.processors.windows import Window, Windows, lowpass_taps, mean_taps
from tramstream.proto.gnss_pb2 import GnssFix
from tramstream.proto.raw_pb2 import ImuBatch, Odometry
from tramstream.proto.sync_pb2 import ImuMean, LateSample, SyncFrame, SyncGap

MAX_AHEAD_S = 5.0
"""A measurement further ahead of the newest stamp has a broken clock; it would wait for ever."""
GNSS, ODOMETRY = 0, 1
_KEYS = (keys.GNSS_FIX, keys.ODO_WHEELS)
_KINDS = {key.path: kind for kind, key in enumerate(_KEYS)}


class Resampler(Processor):
    """Windows of inertial samples, and frames at the fusion horizon.

    Parameters
    ----------
    vehicle : tramstream.config.Vehicle
    late_recorded : mapping or None
        Reprocessing only: the late samples of the live run by (key path, publish_ns). What is in it
        is late, whatever the horizon says.
    """

    name = "resampler"
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
        rate_hz = vehicle.imu.rate_hz if vehicle.imu is not None else 100.0 * config.factor
        taps = (
            mean_taps(config.factor)
            if config.method == "mean"
            else lowpass_taps(config.factor, rate_hz, config.cutoff_hz)
        )
        self.late_recorded = late_recorded
        self._windows = Windows(config.factor, taps)
        self._max_bridge = config.max_bridge_samples
        self._lag_ns = int(config.horizon_lag_s * S)
        self._silence_ns = int(config.imu_silence_s * S)
        self._horizon_ns = 0  # stamp of the last released frame
        self._newest_imu_ns = 0  # stamp of the newest inertial sample
        self._newest_ns = 0
        self._means: deque[ImuMean] = deque()
        self._measurements: list[tuple[int, int, int, int, GnssFix | Odometry]] = []  # heap
        self._samples = Ledger("resampler", "samples")
        self._measured = Ledger("resampler", "measurements")

    def step(self, sample: Sample) -> list[Sample]:
        if sample.key is keys.IMU_BATCH:
            return self._take_batch(sample.message)
        if sample.key is keys.SYNC_TICK:
            return self._take_tick(sample.stamp_ns)
        return self._take_measurement(sample)

    # Inertial samples ----------------------------------------------------------------------------
    def _take_batch(self, batch: ImuBatch) -> list[Sample]:
        count = len(batch.gyro_x)
        self._samples.received += count
        if count == 0:
            return []
        last_ns = batch.stamp_ns + round(batch.period_ns * (count - 1))
        if last_ns <= self._newest_imu_ns:  # stamps run backwards: nothing to put in order
            self._samples.dropped += count
            return [self._late(keys.IMU_BATCH.path, batch.sequence, 0, batch.stamp_ns)]
        results = self._continue_run(batch)
        self._newest_imu_ns = last_ns
        self._newest_ns = max(self._newest_ns, last_ns)
        for window in self._windows.complete():
            results += self._take_window(window, batch)
        results += self._release(self._newest_imu_ns - self._lag_ns)
        return results

    def _continue_run(self, batch: ImuBatch) -> list[Sample]:
        """Append the batch to the run, bridge a short gap, or start a new run after a long one."""
        windows = self._windows
        if windows.empty:
            self._samples.dropped += windows.begin(batch)
            return []
        missing = batch.first_sample_sequence - windows.next_sequence
        if missing == 0:
            windows.extend(batch)
            return []
        bridged = 0 < missing <= self._max_bridge
        start_ns = windows.last_stamp_ns
        gap = SyncGap(
            first_missing=windows.next_sequence,
            missing_count=max(0, missing),
            duration_s=(batch.stamp_ns - start_ns) / S,
            bridged=bridged,
        )
        if bridged:
            windows.bridge(batch)
            windows.extend(batch)
        else:
            self._samples.dropped += windows.pending
            self._samples.dropped += windows.begin(batch)
        return [self.emit(keys.SYNC_GAP, gap, start_ns)]

    def _take_window(self, window: Window, batch: ImuBatch) -> list[Sample]:
        gyro, accel = batch.gyro_scale_radps, batch.accel_scale_mps2
        counts = window.counts
        mean = ImuMean(
            first_sample_sequence=window.first_sequence,
            sample_count=window.sample_count,
            bridged_count=window.bridged_count,
            interval_s=window.interval_ns / S,
            gyro_x_radps=counts[0] * gyro,
            gyro_y_radps=counts[1] * gyro,
            gyro_z_radps=counts[2] * gyro,
            accel_x_mps2=counts[3] * accel,
            accel_y_mps2=counts[4] * accel,
            accel_z_mps2=counts[5] * accel,
            temperature_degc=batch.temperature * batch.temperature_scale_degc,
        )
        self._samples.delivered += window.sample_count
        results = [self.emit(keys.SYNC_IMU, mean, window.stamp_ns)]
        if window.stamp_ns <= self._horizon_ns:  # ticks had moved the horizon on meanwhile
            results.append(self._late(keys.SYNC_IMU.path, mean.sequence, 0, window.stamp_ns))
        else:
            self._means.append(mean)
        return results

    # Measurements and silence --------------------------------------------------------------------
    def _take_measurement(self, sample: Sample) -> list[Sample]:
        self._measured.received += 1
        path, stamp_ns = sample.key.path, sample.stamp_ns
        recorded = (self.late_recorded or {}).get((path, sample.publish_ns))
        if recorded is not None:
            self._measured.dropped += 1
            self._next_sequence[keys.SYNC_LATE.path] = recorded.sequence
            again = LateSample()
            again.CopyFrom(recorded)
            return [self.emit(keys.SYNC_LATE, again, recorded.stamp_ns)]
        too_far = self._newest_ns > 0 and stamp_ns > self._newest_ns + MAX_AHEAD_S * S
        if stamp_ns <= self._horizon_ns or too_far:
            self._measured.dropped += 1
            return [self._late(path, sample.sequence, sample.publish_ns, stamp_ns)]
        if self._newest_imu_ns == 0:
            self._newest_ns = max(self._newest_ns, stamp_ns)
        self._push(stamp_ns, _KINDS[path], sample.publish_ns, sample.message)
        return []

    def _push(
        self, stamp_ns: int, kind: int, publish_ns: int, message: GnssFix | Odometry
    ) -> None:
        # The last number only breaks ties of one message that came twice.
        entry = (stamp_ns, kind, publish_ns, len(self._measurements), message)
        heapq.heappush(self._measurements, entry)

    def _take_tick(self, stamp_ns: int) -> list[Sample]:
        """Move the horizon by time alone while there is no inertial data."""
        if stamp_ns - self._newest_imu_ns <= self._silence_ns:
            return []
        self._newest_ns = max(self._newest_ns, stamp_ns)
        horizon_ns = stamp_ns - self._lag_ns
        results = self._release(horizon_ns)
        if horizon_ns > self._horizon_ns:
            results.append(self._frame(horizon_ns, None))
        return results

    def _late(self, path: str, sequence: int, publish_ns: int, stamp_ns: int) -> Sample:
        late = LateSample(
            key=path,
            source_sequence=sequence,
            source_publish_ns=publish_ns,
            horizon_ns=self._horizon_ns,
        )
        return self.emit(keys.SYNC_LATE, late, stamp_ns)

    # The horizon ---------------------------------------------------------------------------------
    def _release(self, horizon_ns: int) -> list[Sample]:
        frames = []
        while self._means and self._means[0].stamp_ns <= horizon_ns:
            mean = self._means.popleft()
            frames.append(self._frame(mean.stamp_ns, mean))
        return frames

    def _frame(self, stamp_ns: int, mean: ImuMean | None) -> Sample:
        """Everything up to `stamp_ns` that has not been released yet."""
        frame = SyncFrame()
        if mean is not None:
            frame.imu.CopyFrom(mean)
        measurements = self._measurements
        while measurements and measurements[0][0] <= stamp_ns:
            _, kind, _, _, message = heapq.heappop(measurements)
            (frame.gnss if kind == GNSS else frame.odometry).append(message)
            self._measured.delivered += 1
        self._horizon_ns = stamp_ns
        return self.emit(keys.SYNC_FRAME, frame, stamp_ns)

    # Memory --------------------------------------------------------------------------------------
    def ledgers(self) -> list[Ledger]:
        waiting = 0 if self._windows.empty else self._windows.pending
        return [
            replace(self._samples, pending=waiting),
            replace(self._measured, pending=len(self._measurements)),
        ]

    def snapshot(self) -> State:
        return {
            "sequences": self.sequences(),
            "windows": self._windows.snapshot(),
            "horizon_ns": self._horizon_ns,
            "newest_imu_ns": self._newest_imu_ns,
            "newest_ns": self._newest_ns,
            "means": [mean.SerializeToString() for mean in self._means],
            "measurements": [
                [kind, publish_ns, message.SerializeToString()]
                for _, kind, publish_ns, _, message in sorted(
                    self._measurements, key=lambda entry: entry[:4]
                )
            ],
            "samples": _counts(self._samples),
            "measured": _counts(self._measured),
        }

    def restore(self, state: State) -> None:
        self.restore_sequences(state["sequences"])
        self._windows.restore(state["windows"])
        self._horizon_ns = state["horizon_ns"]
        self._newest_imu_ns = state["newest_imu_ns"]
        self._newest_ns = state["newest_ns"]
        self._means = deque(ImuMean.FromString(data) for data in state["means"])
        self._measurements = []
        for kind, publish_ns, data in state["measurements"]:
            message: GnssFix | Odometry = (
                GnssFix.FromString(data) if kind == GNSS else Odometry.FromString(data)
            )
            self._push(message.stamp_ns, kind, publish_ns, message)
        self._samples = Ledger("resampler", "samples", *state["samples"])
        self._measured = Ledger("resampler", "measurements", *state["measured"])


def _counts(ledger: Ledger) -> list[int]:
    return [ledger.received, ledger.delivered, ledger.dropped]
