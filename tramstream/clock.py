"""The vehicle clock, and the fit of a device's clock to it.

The vehicle clock is the host's monotonic clock plus an offset fixed once a boot, so that its
nanoseconds look like Unix time but never step when somebody sets the host's clock. All processes of
a vehicle share the offset through a file. Its relation to UTC and GPS time is published
(`health/clock/reference`, `raw/gnss/time`).

`ClockFit` finds the line under which no arrival lies (transport only ever delays): the edge of the
lower convex hull of arrival − device time that spans the middle of the window. Moon, Skelly and
Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path

from tramstream.errors import ConfigError

S = 1_000_000_000
"""Nanoseconds in a second."""


class VehicleClock:
    """Nanoseconds of the vehicle clock: offset + rate · monotonic.

    `rate` other than 1 serves simulated rides only: every process of the ride then lives faster.
    """

    def __init__(
        self,
        offset_ns: int = 0,
        rate: float = 1.0,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.offset_ns = offset_ns
        self.rate = rate
        self._monotonic_ns = monotonic_ns

    def now_ns(self) -> int:
        monotonic_ns = self._monotonic_ns()
        if self.rate != 1.0:
            monotonic_ns = int(monotonic_ns * self.rate)
        return self.offset_ns + monotonic_ns

    def sleep_s(self, dt_s: float) -> None:
        """Sleep for `dt_s` seconds of this clock."""
        if dt_s > 0:
            time.sleep(dt_s / self.rate)

    @classmethod
    def shared(cls, runtime_dir: Path, rate: float = 1.0) -> VehicleClock:
        """The clock of all processes that use `runtime_dir`, made by whoever comes first.

        Raises
        ------
        ConfigError
            If the folder cannot be written.
        """
        path = runtime_dir / "clock.json"
        boot = boot_id()
        for _ in range(2):
            try:
                known = json.loads(path.read_text())
                if known["boot_id"] == boot:
                    return cls(int(known["offset_ns"]), float(known["rate"]))
            except (OSError, ValueError, KeyError):
                pass  # absent, or of another boot and format: written anew below
            _write_once(path, boot, rate)
        raise ConfigError(
            f"{path}: the clock file cannot be read back; delete it and check that only one "
            "user runs tramstream here"
        )


def boot_id() -> str:
    """The kernel's identifier of this boot."""
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()


def make_runtime_dir(runtime_dir: Path) -> None:
    """Create the folder for socket, clock and snapshot, private to the user.

    Raises
    ------
    ConfigError
        If it cannot be made, or belongs to somebody else.
    """
    try:
        runtime_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
        owner = runtime_dir.stat().st_uid
    except OSError as error:
        raise ConfigError(
            f"{runtime_dir}: cannot make the runtime folder ({error.strerror}); set "
            "$.bus.runtime_dir or TRAMSTREAM_RUNTIME_DIR to one that you may write"
        ) from error
    if owner != os.geteuid():
        raise ConfigError(
            f"{runtime_dir}: the runtime folder belongs to user {owner}; set $.bus.runtime_dir "
            "to one of your own"
        )


def _write_once(path: Path, boot: str, rate: float) -> None:
    make_runtime_dir(path.parent)
    offset_ns = time.time_ns() - int(time.monotonic_ns() * rate)
    text = json.dumps({"boot_id": boot, "offset_ns": offset_ns, "rate": rate})
    temporary = path.with_suffix(f".{os.getpid()}")
    temporary.write_text(text)
    try:
        known = json.loads(path.read_text())["boot_id"]
    except (OSError, ValueError, KeyError):
        known = None
    if known is None and not path.exists():
        try:
            os.link(temporary, path)  # the first of two simultaneous writers wins
        except FileExistsError:
            pass
        temporary.unlink()
    else:
        os.replace(temporary, path)


class ClockFit:
    """Fit host time to device time from arrivals, on line.

    Feed every arrival with `add`, map device instants with `host_ns`. The minimum delay over the
    window cannot be told from the offset: subtract a known delay outside. Outliers above the line
    do not matter; a jump of the device clock (either way by more than `step_s` for several
    arrivals) starts the fit anew and is counted in `restarts`.

    Parameters
    ----------
    bucket_s : float
        One lowest arrival is kept for each bucket of device time.
    buckets : int
        Length of the window in buckets.
    max_skew : float
        Bound on |host rate / device rate − 1|; a crystal keeps 100e-6.
    step_s : float
        A residual beyond this is a jump, not a delay.
    """

    JUMP_ARRIVALS = 5
    """So many arrivals in a row beyond `step_s` are a jump of the clock, not a late thread."""
    MAX_SLEW = 500e-6
    """A new line is approached at this rate, so that stamps stay evenly spaced."""

    def __init__(
        self,
        bucket_s: float = 0.5,
        buckets: int = 64,
        max_skew: float = 200e-6,
        step_s: float = 1.0,
    ) -> None:
        self.bucket_ns = int(bucket_s * S)
        self.buckets = buckets
        self.max_skew = max_skew
        self.step_ns = int(step_s * S)
        self.restarts = 0
        self._reset()

    def _reset(self) -> None:
        self._origin_ns: int | None = None  # device time
        self._base_ns = 0  # arrival − device time of the first arrival
        self._minima: list[tuple[int, int]] = []  # (device − origin, delay − base), per bucket
        self._offset_ns = 0.0  # of the line in use, at _anchor_ns
        self._anchor_ns = 0
        self._skew = 0.0
        self._jumps = 0
        self._residuals: list[float] = []

    @property
    def ready(self) -> bool:
        return self._origin_ns is not None

    @property
    def skew(self) -> float:
        """Host rate / device rate − 1 of the line in use."""
        return self._skew

    @property
    def offset_ns(self) -> int:
        """Host − device time now; 0 before the first arrival."""
        return self._base_ns + round(self._offset_ns) if self.ready else 0

    @property
    def residual_ns(self) -> float:
        """Median delay above the line over the last arrivals."""
        ordered = sorted(self._residuals)
        return ordered[len(ordered) // 2] if ordered else 0.0

    def add(self, device_ns: int, arrival_ns: int) -> None:
        """Take note that what was stamped `device_ns` arrived at `arrival_ns`."""
        if self._origin_ns is None:
            self._origin_ns, self._base_ns = device_ns, arrival_ns - device_ns
            self._minima = [(0, 0)]
            return
        elapsed_ns = device_ns - self._origin_ns
        delay_ns = arrival_ns - device_ns - self._base_ns
        residual_ns = delay_ns - self._line(elapsed_ns)
        if abs(residual_ns) > self.step_ns:
            self._jumps += 1
            if self._jumps >= self.JUMP_ARRIVALS:
                self.restarts += 1
                self._reset()
                self.add(device_ns, arrival_ns)
            return
        self._jumps = 0
        self._residuals.append(residual_ns)
        if len(self._residuals) > 128:
            del self._residuals[:64]
        last_ns, lowest_ns = self._minima[-1]
        if elapsed_ns // self.bucket_ns == last_ns // self.bucket_ns:
            if delay_ns < lowest_ns:
                self._minima[-1] = (elapsed_ns, delay_ns)
        elif elapsed_ns > last_ns:
            self._minima.append((elapsed_ns, delay_ns))
            del self._minima[: -self.buckets]
            self._refit(elapsed_ns)

    def host_ns(self, device_ns: int) -> int:
        """Map a device instant to host time; needs at least one arrival."""
        if self._origin_ns is None:
            raise ValueError("ClockFit.host_ns before the first arrival")
        elapsed_ns = device_ns - self._origin_ns
        return device_ns + self._base_ns + round(self._line(elapsed_ns))

    def _line(self, elapsed_ns: int) -> float:
        return self._offset_ns + self._skew * (elapsed_ns - self._anchor_ns)

    def _refit(self, now_ns: int) -> None:
        """Move the line in use towards the window's supporting line."""
        skew, offset_ns = _supporting_line(self._minima, self.max_skew)
        target_ns = offset_ns + skew * now_ns
        current_ns = self._line(now_ns)
        limit_ns = self.MAX_SLEW * self.bucket_ns
        settling = len(self._minima) <= 4  # the first two seconds find the offset quickly
        step_ns = target_ns - current_ns
        if not settling:
            step_ns = max(-limit_ns, min(limit_ns, step_ns))
        self._offset_ns, self._anchor_ns, self._skew = current_ns + step_ns, now_ns, skew

    def snapshot(self) -> dict[str, object]:
        return {
            "origin_ns": self._origin_ns,
            "base_ns": self._base_ns,
            "minima": [list(pair) for pair in self._minima],
            "offset_ns": self._offset_ns,
            "anchor_ns": self._anchor_ns,
            "skew": self._skew,
            "jumps": self._jumps,
            "residuals": list(self._residuals),
            "restarts": self.restarts,
        }

    def restore(self, state: dict[str, object]) -> None:
        values = dict(state)
        self.restarts = values.pop("restarts")  # type: ignore[assignment]
        minima: list[list[int]] = values.pop("minima")  # type: ignore[assignment]
        self._minima = [(pair[0], pair[1]) for pair in minima]
        self._residuals = list(values.pop("residuals"))  # type: ignore[call-overload]
        for name, value in values.items():
            setattr(self, f"_{name}", value)


def _supporting_line(points: list[tuple[int, int]], max_skew: float) -> tuple[float, float]:
    """Slope and intercept of the line below all points with the least total distance to them.

    Of all lines below, that is the lower hull's edge over the mean abscissa.
    """
    hull: list[tuple[int, int]] = []
    for point in points:
        while len(hull) >= 2 and _turns_right(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    mean = sum(x for x, _ in points) / len(points)
    slope = 0.0
    for left, right in zip(hull, hull[1:], strict=False):
        slope = (right[1] - left[1]) / (right[0] - left[0])
        if right[0] >= mean:
            break
    if len(points) < 8:
        slope = 0.0  # too short to tell skew from jitter
    slope = max(-max_skew, min(max_skew, slope))
    return slope, min(y - slope * x for x, y in hull)


def _turns_right(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) <= 0
