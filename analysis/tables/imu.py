"""Inertial rows of a table as the batches that a bridge would have made.

Stamps in tables are rounded, or were taken when a logger had time. A sensor samples evenly, so each
stretch of rows without a gap is laid on the straight line that fits its stamps, as a bridge fits a
device's clock; where no line comes near enough the stretch is cut in two. A gap counts the samples
that are missing, and ends a batch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tramstream.analysis.tables.mapping import ImuTable
from tramstream.analysis.tables.reader import Array, Content, Stamps
from tramstream.analysis.tables.units import UNITS
from tramstream.bridges.imu.bridge import BREAK_PERIODS
from tramstream.clock import S
from tramstream.config import Imu
from tramstream.errors import ConfigError
from tramstream.proto.raw_pb2 import ImuBatch

MAX_JITTER = 0.25
"""Furthest that a stamp may lie beside its line, in periods: twice this is what the resampler
takes for a neighbour (its MAX_STRETCH)."""
RATE_TOLERANCE = 0.1
"""How far the configuration's rate may be from that of the table."""
_MAX_COUNT = 2**31 - 1
_MAX_DIGITS = 12
_TEMPERATURE_SCALE_DEGC = 0.01


@dataclass(frozen=True)
class Stretch:
    """Rows [start, stop) at even times."""

    start: int
    stop: int
    first_ns: float
    """After the table's first stamp."""
    period_ns: float


def batches(
    content: Content, stamps: Stamps, table: ImuTable, imu: Imu
) -> tuple[list[ImuBatch], float, float]:
    """Turn rows into batches.

    Parameters
    ----------
    stamps : ndarray, shape (n,)
        Of the rows, on the record's clock, ns.
    imu : Imu
        Tells how many samples make a batch; its rate must be the table's.

    Returns
    -------
    batches : list of ImuBatch
    rate_hz, jitter_s : float
        Of the table; the furthest that a stamp was from where its sample is now.

    Raises
    ------
    ConfigError
        If the rate is not the configuration's.
    """
    if len(stamps) < 2:
        raise ConfigError(f"{content.path}: one inertial sample has no rate; give a longer table")
    relative_ns = (stamps - stamps[0]).astype(float)
    period_ns = float(np.median(np.diff(relative_ns)))
    stretches = list(even_stretches(relative_ns, period_ns))
    longest = max(stretches, key=lambda stretch: stretch.stop - stretch.start)
    rate_hz = S / longest.period_ns
    if abs(rate_hz / imu.rate_hz - 1.0) > RATE_TOLERANCE:
        raise ConfigError(
            f"$.vehicle.imu.rate_hz: is {imu.rate_hz:g}, but {content.path} has a row every "
            f"{longest.period_ns / 1e6:.3f} ms; write rate_hz = {rate_hz:.4g}"
        )
    gyro, gyro_scale = _counts(content, table.gyro.columns)
    accel, accel_scale = _counts(content, table.accel.columns)
    gyro_scale *= UNITS["turn rate"][table.gyro.unit]
    accel_scale *= UNITS["acceleration"][table.accel.unit]
    temperature = _temperature(content, table)
    numbers = _sequence(relative_ns, period_ns)
    made: list[ImuBatch] = []
    jitter_ns = 0.0
    for stretch in stretches:
        size = stretch.stop - stretch.start
        even_ns = stretch.first_ns + stretch.period_ns * np.arange(size)
        late_ns = relative_ns[stretch.start : stretch.stop] - even_ns
        jitter_ns = max(jitter_ns, float(np.abs(late_ns).max()))
        for start, stop in _cut(numbers, stretch, imu.batch):
            made.append(
                ImuBatch(
                    stamp_ns=int(stamps[0]) + round(even_ns[start - stretch.start]),
                    model=content.path.name,
                    first_sample_sequence=int(numbers[start]),
                    period_ns=stretch.period_ns,
                    gyro_scale_radps=gyro_scale,
                    accel_scale_mps2=accel_scale,
                    temperature_scale_degc=_TEMPERATURE_SCALE_DEGC,
                    gyro_x=gyro[start:stop, 0].tolist(),
                    gyro_y=gyro[start:stop, 1].tolist(),
                    gyro_z=gyro[start:stop, 2].tolist(),
                    accel_x=accel[start:stop, 0].tolist(),
                    accel_y=accel[start:stop, 1].tolist(),
                    accel_z=accel[start:stop, 2].tolist(),
                    temperature=int(temperature[stop - 1]),
                )
            )
    return made, rate_hz, jitter_ns / S


def even_stretches(relative_ns: Array, period_ns: float) -> Iterator[Stretch]:
    """Cut rows at gaps, and where a line would miss a stamp by more than `MAX_JITTER`."""
    gaps = np.flatnonzero(np.diff(relative_ns) > BREAK_PERIODS * period_ns) + 1
    waiting = [*reversed(list(pairwise([0, *gaps.tolist(), len(relative_ns)])))]
    while waiting:
        start, stop = waiting.pop()
        part = relative_ns[start:stop]
        if stop - start == 1:
            yield Stretch(start, stop, float(part[0]), period_ns)
            continue
        steps = np.arange(stop - start) - (stop - start - 1) / 2.0
        slope = float(steps @ part / (steps @ steps))
        line = part.mean() + slope * steps
        if np.abs(part - line).max() <= MAX_JITTER * period_ns:
            yield Stretch(start, stop, float(line[0]), slope)
        else:
            middle = (start + stop) // 2
            waiting += [(middle, stop), (start, middle)]


def _sequence(relative_ns: Array, period_ns: float) -> Stamps:
    """Number the rows, and count what is missing between them."""
    steps = np.maximum(1, np.rint(np.diff(relative_ns) / period_ns)).astype(np.int64)
    steps[np.diff(relative_ns) <= BREAK_PERIODS * period_ns] = 1
    return np.concatenate(([0], np.cumsum(steps)))


def _cut(numbers: Stamps, stretch: Stretch, size: int) -> list[tuple[int, int]]:
    """Rows of each batch: it ends where the number reaches a multiple of `size`, as a bridge's."""
    inner = np.arange(stretch.start + 1, stretch.stop)
    edges = inner[numbers[inner] % size == 0].tolist()
    return list(pairwise([stretch.start, *edges, stretch.stop]))


def _counts(content: Content, columns: tuple[str | int, ...]) -> tuple[Stamps, float]:
    """Integers and their unit: a power of ten that keeps every digit, if 32 bits have room."""
    values = np.stack([content.numbers[column] for column in columns], axis=1)
    largest = float(np.abs(values).max())
    digits = 0
    for more in range(_MAX_DIGITS + 1):
        if largest * 10.0**more > _MAX_COUNT:
            break
        digits = more
        # A quotient of integers is rounded as the text was when it was read: equal, if exact.
        if np.array_equal(np.rint(values * 10.0**more) / 10.0**more, values):
            break
    if largest > _MAX_COUNT:
        raise ConfigError(
            f"{content.path}: {largest:g} is no inertial reading; are the columns right?"
        )
    return np.rint(values * 10.0**digits).astype(np.int64), 10.0**-digits


def _temperature(content: Content, table: ImuTable) -> Stamps:
    quantity = table.temperature
    degc: Array = np.zeros(len(content.time_ns))
    if quantity is not None and quantity.column is not None:
        degc = content.numbers[quantity.column]
    elif quantity is not None and quantity.value is not None:
        degc = degc + quantity.value
    counts: Stamps = np.rint(np.clip(degc, -300, 1e6) / _TEMPERATURE_SCALE_DEGC).astype(np.int64)
    return counts
