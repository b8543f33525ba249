"""Batches of inertial samples, one row a sample, in SI units: for programs that read no batches."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tramstream.proto.raw_pb2 import ImuBatch
from tramstream.recorder.message_columns import Columns

_AXES = [
    (f"{kind}_{axis}", f"{kind}_scale_{unit}", f"{kind}_{axis}_{unit}")
    for kind, unit in (("gyro", "radps"), ("accel", "mps2"))
    for axis in "xyz"
]
"""Field with the counts, field with their scale, column."""
COLUMNS = ("stamp_ns", "sample", *(column for _, _, column in _AXES), "temperature_degc")
"""Instant of the sample, number by the device's counter, rates, specific forces, temperature (the
device gives one a batch)."""


def samples(batch: ImuBatch) -> Iterator[tuple[float, ...]]:
    """Rows of one batch: `COLUMNS`."""
    axes = zip(*(getattr(batch, field) for field, _, _ in _AXES), strict=False)
    scales = [getattr(batch, scale) for _, scale, _ in _AXES]
    temperature_degc = batch.temperature * batch.temperature_scale_degc
    for number, counts in enumerate(axes):
        readings = (count * scale for count, scale in zip(counts, scales, strict=True))
        stamp_ns = batch.stamp_ns + round(number * batch.period_ns)
        yield stamp_ns, batch.first_sample_sequence + number, *readings, temperature_degc


def spread(columns: Columns) -> dict[str, NDArray[Any]]:
    """The same of many batches, as arrays: `log_ns` of the batch and `COLUMNS`."""
    counts = np.array([len(each) for each in columns["gyro_x"]], dtype=np.intp)
    place = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)

    def each(values: Any) -> NDArray[Any]:
        return np.repeat(np.asarray(values), counts)

    since_ns = np.rint(place * each(columns["period_ns"])).astype(np.int64)
    degrees = np.asarray(columns["temperature"], float) * columns["temperature_scale_degc"]
    return {
        "log_ns": each(columns["log_ns"]),
        "stamp_ns": each(columns["stamp_ns"]).astype(np.int64) + since_ns,
        "sample": each(columns["first_sample_sequence"]).astype(np.int64) + place,
        **{
            column: np.asarray(columns.elements(field)[field], float) * each(columns[scale])
            for field, scale, column in _AXES
        },
        "temperature_degc": each(degrees),
    }
