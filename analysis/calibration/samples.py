"""Inertial samples of records laid out by axis on disk, and how each second of them looks.

An axis of a day at 2 kHz is 0.35 GB: the six are kept in temporary files, and one at a time is
brought into memory. While they pass by, mean and scatter of every window of a second are kept,
which show where the vehicle stands.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tramstream import keys
from tramstream.analysis.calibration.allan import Counts, Run
from tramstream.analysis.calibration.inertial import Samples, inertial_samples, inertial_topic
from tramstream.errors import RecordError
from tramstream.recorder.reader import Record

Array = NDArray[np.float64]

AXES = ("gyro x", "gyro y", "gyro z", "accel x", "accel y", "accel z")
BRIDGED_S = 1.0
"""Longest gap that is filled with the last reading, so that a run goes on."""
WINDOW_S = 1.0
FEWEST_IN_WINDOW = 16
_READ = 1 << 20


class Scales(NamedTuple):
    """Unit of one count."""

    gyro_radps: float
    accel_mps2: float

    def of(self, axis: int) -> float:
        """Of one of `AXES`."""
        return self.gyro_radps if axis < 3 else self.accel_mps2


class Spool:
    """Six axes on disk. Samples are `put` in; then runs, windows and one axis at a time come out.

    Use it as a context: the files go at its end.
    """

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="tramstream-")
        self._files = [Path(self._folder.name) / str(number) for number in range(len(AXES))]
        self._low = np.zeros(6, np.int64)
        self._high = np.zeros(6, np.int64)
        self._last = np.zeros((6, 1), np.int32)
        self._expected = -1
        self._end_ns = 0
        self._starts: list[int] = []
        self._temperature: list[tuple[NDArray[np.int64], Array]] = []
        self._rest = np.zeros((6, 0), np.int32)
        self._windows: list[tuple[Array, Array]] = []
        self._window_starts: list[int] = []
        self._window = 0
        self.count = 0
        self.rate_hz = math.nan
        self.scales = Scales(math.nan, math.nan)
        self.bridged = 0
        """Samples that were missing and are filled with the last reading."""
        self.spans_ns: list[tuple[int, int]] = []
        """First and last instant of each run, vehicle clock."""

    def __enter__(self) -> Spool:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._folder.cleanup()

    # Filling --------------------------------------------------------------------------------------
    def put(self, samples: Samples) -> None:
        """Take consecutive messages.

        Raises
        ------
        RecordError
            If rate or scale change: the sensor is another one.
        """
        if not len(samples.length) or not int(samples.length.sum()):
            return
        self._check(samples)
        filled = 0
        breaks = self._breaks(samples)
        for begin, end in zip([0, *breaks], [*breaks, len(samples.length)], strict=True):
            if end == begin:
                continue
            size = int(samples.length[begin:end].sum())
            self._join(int(samples.first[begin]), int(samples.stamp_ns[begin]))
            ends = self.count + np.cumsum(samples.length[begin:end]) - 1
            self._temperature.append((ends, samples.temperature_degc[begin:end]))
            self._write(samples.counts[:, filled : filled + size])
            filled += size
            self._expected = int(samples.first[end - 1] + samples.length[end - 1])
            last_ns = float(samples.length[end - 1]) * samples.period_ns[end - 1]
            self._end_ns = int(samples.stamp_ns[end - 1]) + round(last_ns)
            self.spans_ns[-1] = (self.spans_ns[-1][0], self._end_ns)

    def _check(self, samples: Samples) -> None:
        period_ns = float(samples.period_ns[0])
        if not period_ns > 0:
            raise RecordError("inertial samples say no rate: period_ns is not positive")
        rate_hz = 1e9 / period_ns
        if self.count == 0:
            self.rate_hz = rate_hz
            self.scales = Scales(
                float(samples.gyro_scale_radps[0]), float(samples.accel_scale_mps2[0])
            )
            self._window = max(round(rate_hz * WINDOW_S), FEWEST_IN_WINDOW)
        rates = 1e9 / np.maximum(samples.period_ns, 1e-3)
        same = (
            np.all(np.abs(rates / self.rate_hz - 1) < 0.05)
            and np.all(samples.gyro_scale_radps == self.scales.gyro_radps)
            and np.all(samples.accel_scale_mps2 == self.scales.accel_mps2)
        )
        if not same:
            raise RecordError(
                "rate or scale of the inertial samples change on the way: it is another sensor; "
                "name the records of one"
            )

    def _breaks(self, samples: Samples) -> list[int]:
        """Messages that do not follow the one before."""
        followed = samples.first[:-1] + samples.length[:-1]
        breaks: list[int] = (np.flatnonzero(samples.first[1:] != followed) + 1).tolist()
        return breaks

    def _join(self, first: int, stamp_ns: int) -> None:
        """Go on with the run, over a short gap, or begin another."""
        missing = first - self._expected if self.count else -1
        late_ns = stamp_ns - self._end_ns
        short = 0 <= missing <= BRIDGED_S * self.rate_hz
        if short and abs(late_ns - missing / self.rate_hz * 1e9) < BRIDGED_S * 1e9:
            if missing:
                self.bridged += missing
                self._write(np.repeat(self._last, missing, axis=1))
            return
        self._rest = np.zeros((6, 0), np.int32)
        self._starts.append(self.count)
        self.spans_ns.append((stamp_ns, stamp_ns))

    def _write(self, counts: NDArray[np.int32]) -> None:
        if not counts.shape[1]:
            return
        for axis, path in enumerate(self._files):
            with path.open("ab") as file:
                file.write(np.ascontiguousarray(counts[axis]).data)
        np.minimum(self._low, counts.min(axis=1), out=self._low)
        np.maximum(self._high, counts.max(axis=1), out=self._high)
        self._last = counts[:, -1:].copy()
        waiting = np.concatenate([self._rest, counts], axis=1)
        begin = self.count - self._rest.shape[1]
        self.count += counts.shape[1]
        whole = waiting.shape[1] // self._window
        if whole:
            cut = waiting[:, : whole * self._window].reshape(6, whole, self._window)
            values = cut.astype(np.float64)
            mean = values.mean(axis=2)
            values -= mean[:, :, None]
            variance = np.einsum("awi,awi->aw", values, values) / (self._window - 1)
            self._windows.append((mean.T, variance.T))
            self._window_starts += range(begin, begin + whole * self._window, self._window)
        self._rest = waiting[:, whole * self._window :].copy()

    # What comes out -------------------------------------------------------------------------------
    @property
    def runs(self) -> list[Run]:
        """Samples without a gap."""
        return [
            Run(start, end)
            for start, end in zip(self._starts, [*self._starts[1:], self.count], strict=True)
        ]

    @property
    def windows(self) -> Windows:
        """How each second of the record looks."""
        none: Array = np.zeros((0, 6))
        return Windows(
            np.array(self._window_starts, dtype=np.int64),
            self._window,
            np.concatenate([none, *(mean for mean, _ in self._windows)]),
            np.concatenate([none, *(variance for _, variance in self._windows)]),
        )

    @property
    def temperature(self) -> tuple[Array, Array]:
        """Sample numbers and the temperature there, °C."""
        numbers = [numbers for numbers, _ in self._temperature]
        values = [values for _, values in self._temperature]
        none: Array = np.zeros(0)
        return np.concatenate([none, *numbers]), np.concatenate([none, *values])

    def axis(self, number: int) -> Counts:
        """All readings of one of `AXES`, in the smallest integers that hold them."""
        narrow = self._low[number] >= -32768 and self._high[number] <= 32767
        type_: type[Any] = np.int16 if narrow else np.int32
        found = np.empty(self.count, type_)
        with self._files[number].open("rb") as file:
            for begin in range(0, self.count, _READ):
                data = file.read(4 * min(_READ, self.count - begin))
                found[begin : begin + len(data) // 4] = np.frombuffer(data, np.int32)
        return found


class Windows(NamedTuple):
    """Seconds of a record; counts."""

    start: NDArray[np.int64]
    """First sample of each."""
    size: int
    mean: Array
    """Shape (n, 6)."""
    variance: Array
    """Around the mean of the window."""


def fill(spool: Spool, records: Iterable[Record]) -> str:
    """Put all inertial samples of records into a spool; the key that they come from, or empty."""
    used = ""
    for record in records:
        source = inertial_samples(record) if inertial_topic(record) else None
        if source is not None:
            used = used or keys.IMU_BATCH.path
        elif receiver_topic(record):
            source = receiver_samples(record)
            used = used or keys.GNSS_ESF_MEASUREMENTS.path
        for samples in source or ():
            spool.put(samples)
    return used


# The sensors of a receiver ------------------------------------------------------------------------
_GYRO, _ACCEL = (14, 13, 5), (16, 17, 18)
"""u-blox data types of x, y, z."""
_DEGC = 12
_GYRO_RADPS, _ACCEL_MPS2 = math.radians(2.0**-12), 2.0**-10


def receiver_topic(record: Record) -> str:
    """The topic with readings of a receiver's own sensors; empty if there is none."""
    for topic in record.channels:
        if keys.split(topic)[1] == keys.GNSS_ESF_MEASUREMENTS.path:
            return topic
    return ""


def receiver_samples(record: Record) -> Iterator[Samples]:
    """Readings of a receiver's own sensors (ESF-MEAS): the n-th of the gyroscopes with the n-th of
    the accelerometers, which have messages of their own. Their clock counts milliseconds."""
    gyro: list[list[int]] = []
    accel: list[list[int]] = []
    tags: list[int] = []
    degc: list[float] = []
    for _, message in record.decoded(receiver_topic(record).__eq__):
        raw = {item.type: item.raw for item in message.items}
        if all(kind in raw for kind in _GYRO):
            gyro.append([raw[kind] for kind in _GYRO])
            tags.append(message.items[0].time_tag)
            degc.append(raw.get(_DEGC, 0) / 100)
        if all(kind in raw for kind in _ACCEL):
            accel.append([raw[kind] for kind in _ACCEL])
    count = min(len(gyro), len(accel))
    if count == 0:
        return
    tag = np.array(tags[:count], dtype=np.int64)
    step = float(np.median(np.diff(tag))) if count > 1 else 100.0
    period_ns = max(step, 1.0) * 1e6
    taken = np.rint((tag - tag[0]) * 1e6 / period_ns).astype(np.int64)
    taken = np.maximum.accumulate(np.maximum(taken, np.arange(count)))
    ones = np.ones(count)
    yield Samples(
        stamp_ns=tag * 1_000_000,
        first=taken,
        length=ones.astype(np.int64),
        period_ns=ones * period_ns,
        gyro_scale_radps=ones * _GYRO_RADPS,
        accel_scale_mps2=ones * _ACCEL_MPS2,
        temperature_degc=np.array(degc[:count]),
        counts=np.hstack([gyro[:count], accel[:count]]).T.astype(np.int32),
    )
