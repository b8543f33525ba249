"""Inertial bridge: bytes of the IMU's serial line to batches of integer columns.

Each read is taken on its own, in this order.

1. Frames (`adis`). The read's stamps and sequence numbers are unwrapped from 32 bits and cut into
   pieces without a break. At a break the device either lost samples (the sequence jumps ahead and
   the stamp with it: counted), paused between two samples, or started anew (the sequence falls back
   or repeats, or the stamp does not fit the sequence: new run).
2. The newest sample of a run is one point of the clock fit: it arrived with the read, less the time
   its frame took on the line. A new run begins a new fit.
3. Samples are collected until the sequence reaches a multiple of `batch`, so that one batch is one
   window of the resampler. A break closes a batch early. An open batch waits for its last sample;
   a later read that brings no sample at all closes it once it has waited `HOLD_NS`.

Columns depend on the bytes alone (but for a silence of more than an hour), stamps on the bytes and
on when each read arrived; how reads are put together into messages makes no difference.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream import keys
from tramstream.bridges.imu.framer import FRAME_LENGTH, AdisFramer, join
from tramstream.clock import ClockFit, FitMemory, S
from tramstream.config import Imu, Vehicle
from tramstream.errors import ConfigError
from tramstream.processor import Ledger, Processor, Sample
from tramstream.proto.raw_pb2 import ImuBatch, RawBytes

STANDARD_GRAVITY_MPS2 = 9.80665
RADPS_PER_DEGPS = np.pi / 180.0
ACCEL_SCALE_MPS2 = 0.25e-3 * STANDARD_GRAVITY_MPS2
TEMPERATURE_SCALE_DEGC = 0.1

# ADIS16465 data sheet, gyroscope data format: °/s per count of the 16-bit output.
GYRO_SCALE_RADPS = {
    "ADIS16465-1": 0.00625 * RADPS_PER_DEGPS,
    "ADIS16465-2": 0.025 * RADPS_PER_DEGPS,
    "ADIS16465-3": 0.1 * RADPS_PER_DEGPS,
}

U32 = 0xFFFFFFFF
HALF_U32 = 0x80000000
HOLD_NS = S // 10
"""An open batch is closed by a read without samples so long after its newest sample."""
BREAK_PERIODS = 1.5
"""Neighbours further apart than this are not contiguous, whatever the sequence says."""
STAMP_SLACK_US = 100_000
RATE_TOLERANCE = 0.1
"""Stamp and sequence of one run agree within slack and tolerance: the sensor keeps its rate to a
few percent, and the slack lets the microcontroller pause. How often the stamp has wrapped in a long
silence is told by the arrivals. After some six hours the rate no longer tells, and the device
begins a new run."""

NOTE_RESTART = "device restart"
NOTE_PAUSE = "pause without lost samples"
NOTE_COUNTER = "DATA_CNTR disagrees"


class _Piece(NamedTuple):
    """Samples of one read without a break between them."""

    frames: NDArray[np.void]
    sequence: int  # unwrapped, of the first
    first_us: int  # unwrapped device stamps
    last_us: int
    contiguous: bool  # with the sample before
    restarted: bool


class _Newest(NamedTuple):
    """The newest sample: sequence and stamp, unwrapped, and the sensor's own counter."""

    sequence: int
    stamp_us: int
    counter: int


@dataclass
class BridgeMemory:
    """What an `ImuBridge` remembers."""

    framer: AdisFramer = field(default_factory=AdisFramer)
    fit: FitMemory = field(default_factory=FitMemory)
    last: _Newest | None = None
    last_arrival_ns: int = 0
    open: list[NDArray[np.void]] = field(default_factory=list)
    """Frames of the batch that is not full yet."""
    open_sequence: int = 0
    open_first_us: int = 0
    open_last_us: int = 0
    decoded: int = 0
    lost: int = 0
    notes: dict[str, int] = field(default_factory=dict)


class ImuBridge(Processor):
    """ADIS16465 bytes to `ImuBatch`."""

    name = "imu"
    Settings = Imu
    Memory = BridgeMemory
    memory: BridgeMemory
    inputs = (keys.IMU_BYTES,)
    outputs = (keys.IMU_BATCH,)

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        if vehicle.imu is None:
            raise ConfigError("$.imu: missing", cure="the imu bridge needs its device and model")
        config = vehicle.imu
        self._batch = config.batch
        self._period_us = 1e6 / config.rate_hz
        self._break_us = BREAK_PERIODS * self._period_us
        self._line_ns = round(10 * FRAME_LENGTH * S / config.baud_rate)  # 8N1: 10 bits a byte
        self._model = config.model
        self._fit = ClockFit(memory=self.memory.fit)

    def step(self, sample: Sample) -> list[Sample]:
        memory = self.memory
        out: list[Sample] = []
        for data, arrival_ns in _reads(sample.message):
            frames = memory.framer.feed(data).frames
            if len(frames):
                memory.decoded += len(frames)
                self._take(self._cut(frames, arrival_ns), arrival_ns, out)
                memory.last_arrival_ns = arrival_ns
            elif memory.open and arrival_ns - memory.last_arrival_ns > HOLD_NS:
                self._close(out)
        return out

    # sequence and stamp ---------------------------------------------------------------------------

    def _cut(self, frames: NDArray[np.void], arrival_ns: int) -> list[_Piece]:
        """Unwrap the samples of a read and cut them at breaks."""
        sequence, stamp_us = frames["sequence"], frames["stamp_us"]
        steps, intervals_us = np.diff(sequence), np.diff(stamp_us)  # wrap like the counters
        breaks = np.flatnonzero((steps != 1) | (intervals_us > self._break_us)) + 1
        edges = [0, *breaks.tolist(), len(frames)]
        pieces = []
        elapsed_us = (arrival_ns - self.memory.last_arrival_ns) / 1000
        for start, end in pairwise(edges):
            part = frames[start:end]
            counter = part["data_cntr"]
            wrapped = _Newest(int(sequence[start]), int(stamp_us[start]), int(counter[0]))
            first, contiguous, restarted = self._follow(wrapped, elapsed_us)
            elapsed_us = 0.0  # the others came with it
            span_us = (int(stamp_us[end - 1]) - wrapped.stamp_us) & U32
            last_us = first.stamp_us + span_us
            pieces.append(
                _Piece(part, first.sequence, first.stamp_us, last_us, contiguous, restarted)
            )
            self.memory.last = _Newest(first.sequence + len(part) - 1, last_us, int(counter[-1]))
            if len(part) > 1:
                self._note(NOTE_COUNTER, int(np.count_nonzero(np.diff(counter) != 1)))
        return pieces

    def _follow(self, first: _Newest, elapsed_us: float) -> tuple[_Newest, bool, bool]:
        """Unwrap `first` by the sample before it; whether it is contiguous, and restarted.

        `elapsed_us` lies between the arrivals of the two.
        """
        memory = self.memory
        last = memory.last
        if last is None:
            return first, False, False
        step = (first.sequence - last.sequence) & U32
        stamp_step_us = (first.stamp_us - last.stamp_us) & U32
        interval_us = interval_between(step, stamp_step_us, self._period_us, elapsed_us)
        if interval_us is None:
            self._note(NOTE_RESTART, 1)
            return first, False, True
        memory.lost += step - 1
        self._note(NOTE_COUNTER, int((first.counter - last.counter - step) & 0xFFFF != 0))
        paused = step == 1 and interval_us > self._break_us
        self._note(NOTE_PAUSE, int(paused))
        first = _Newest(last.sequence + step, last.stamp_us + interval_us, first.counter)
        return first, step == 1 and not paused, False

    def _note(self, what: str, count: int) -> None:
        memory = self.memory
        if count:
            memory.notes[what] = memory.notes.get(what, 0) + count

    # clock and batches ----------------------------------------------------------------------------

    def _take(self, pieces: list[_Piece], arrival_ns: int, out: list[Sample]) -> None:
        newest_us = pieces[-1].last_us
        starts = [index for index, piece in enumerate(pieces) if piece.restarted]
        if not starts or starts[0] > 0:
            end_us = pieces[starts[0] - 1].last_us if starts else newest_us
            self._fit.add(end_us * 1000, arrival_ns - self._line_ns)
        for index, piece in enumerate(pieces):
            if piece.restarted:
                self._close(out)
                self._fit.restart()
                later = [start for start in starts if start > index]
                end_us = pieces[later[0] - 1].last_us if later else newest_us
                self._fit.add(end_us * 1000, arrival_ns - self._line_ns)
            elif not piece.contiguous:
                self._close(out)
            self._collect(piece, out)

    def _collect(self, piece: _Piece, out: list[Sample]) -> None:
        """Add a piece to the open batch, closing batches as they fill."""
        memory = self.memory
        stamp_us, count, start = piece.frames["stamp_us"], len(piece.frames), 0
        base_us = int(stamp_us[0])
        while start < count:
            sequence = piece.sequence + start
            end = min(count, start + self._batch - sequence % self._batch)
            if not memory.open:
                memory.open_sequence = sequence
                memory.open_first_us = piece.first_us + ((int(stamp_us[start]) - base_us) & U32)
            memory.open.append(piece.frames[start:end])
            memory.open_last_us = piece.first_us + ((int(stamp_us[end - 1]) - base_us) & U32)
            if (piece.sequence + end) % self._batch == 0:
                self._close(out)
            start = end

    def _close(self, out: list[Sample]) -> None:
        """Turn the open batch, if there is one, into a sample."""
        memory = self.memory
        if not memory.open:
            return
        frames = memory.open[0] if len(memory.open) == 1 else join(memory.open)
        memory.open = []
        # A run that began before it arrived, where time begins: of a capture, never of a vehicle.
        stamp_ns = max(0, self._fit.host_ns(memory.open_first_us * 1000))
        period_ns = 1000 * self._period_us
        if len(frames) > 1:
            last_ns = self._fit.host_ns(memory.open_last_us * 1000)
            period_ns = (last_ns - stamp_ns) / (len(frames) - 1)
        gyro, accel = frames["gyro"].T.tolist(), frames["accel"].T.tolist()
        message = ImuBatch(
            first_sample_sequence=memory.open_sequence,
            period_ns=period_ns,
            gyro_x=gyro[0],
            gyro_y=gyro[1],
            gyro_z=gyro[2],
            accel_x=accel[0],
            accel_y=accel[1],
            accel_z=accel[2],
            temperature=int(frames["temperature"][-1]),
            diag_stat=int(np.bitwise_or.reduce(frames["diag_stat"])),
            model=self._model,
            gyro_scale_radps=GYRO_SCALE_RADPS[self._model],
            accel_scale_mps2=ACCEL_SCALE_MPS2,
            temperature_scale_degc=TEMPERATURE_SCALE_DEGC,
        )
        out.append(self.emit(keys.IMU_BATCH, message, stamp_ns))

    # what became of it ----------------------------------------------------------------------------

    @property
    def _pending(self) -> int:
        return sum(len(frames) for frames in self.memory.open)

    def ledgers(self) -> list[Ledger]:
        memory = self.memory
        framer, pending = memory.framer, self._pending
        return [
            Ledger(
                self.name,
                "bytes",
                framer.bytes_fed,
                framer.bytes_framed,
                framer.bytes_rejected,
                framer.bytes_pending,
            ),
            Ledger(self.name, "samples", memory.decoded, memory.decoded - pending, 0, pending),
        ]

    def device_counters(self) -> dict[str, Any]:
        """Figures of `DeviceHealth`, under its field names.

        `rejected_by_reason` also holds what was noticed and kept (restarts, pauses, a DATA_CNTR
        that disagrees), so it may add up to more than `frames_rejected`.
        """
        memory = self.memory
        reasons = memory.framer.rejected_by_reason
        counters: dict[str, Any] = {
            "messages_decoded": memory.decoded,
            "frames_rejected": sum(reasons.values()),
            "bytes_rejected": memory.framer.bytes_rejected,
            "samples_lost": memory.lost,
            "rejected_by_reason": {**reasons, **memory.notes},
        }
        if self._fit.ready:
            counters["clock_offset_s"] = self._fit.offset_ns / S
            counters["clock_skew_ppm"] = self._fit.skew * 1e6
            counters["clock_residual_s"] = self._fit.residual_ns / S
        return counters


def interval_between(
    step: int, stamp_step_us: int, period_us: float, elapsed_us: float = 0.0
) -> int | None:
    """Device time between two samples; None if the device has started anew between them.

    Parameters
    ----------
    step, stamp_step_us : int
        What their sequence and their stamp differ by, of 32 bits each.
    period_us : float
        Of the sensor.
    elapsed_us : float
        Between their arrivals: how often the stamp may have wrapped, once in 72 minutes.
    """
    interval_us = stamp_step_us + max(0, round((elapsed_us - stamp_step_us) / 2**32)) * 2**32
    expected_us = step * period_us
    allowed_us = STAMP_SLACK_US + RATE_TOLERANCE * expected_us
    plausible = interval_us > 0 and abs(interval_us - expected_us) < allowed_us < HALF_U32
    return interval_us if 0 < step < HALF_U32 and plausible else None


def _reads(message: RawBytes) -> Iterator[tuple[bytes, int]]:
    """Bytes and arrival of each read of a message; without read lengths it is one read."""
    start, arrival_ns = 0, message.stamp_ns
    for length, offset_ns in zip(message.read_length, message.read_offset_ns, strict=False):
        arrival_ns = message.stamp_ns + offset_ns
        yield message.data[start : start + length], arrival_ns
        start += length
    if start < len(message.data):
        yield message.data[start:], arrival_ns
