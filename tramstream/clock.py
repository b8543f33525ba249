"""The vehicle clock, and the fit of a device's clock to it.

The vehicle clock is the host's monotonic clock plus an offset fixed once a boot, so that its
nanoseconds look like Unix time but never step when somebody sets the host's clock. All processes of
a vehicle share the offset through a file. Its relation to UTC and GPS time is published
(`health/clock/reference`, `raw/gnss/time`).

`ClockFit` finds the line under which no arrival lies (transport only ever delays): the edge of the
lower convex hull of arrival − device time that spans the middle of the window. Moon, Skelly and
Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999.

What stamps use is not that line but a chain of straight pieces that runs after it. A new line bends
the chain at the newest arrival and never touches what lies before, so the map from device to host
time is one continuous rising curve: stamps cannot jump or turn back, whoever asks and however late.

Equations: docs/theory.md, section 3.7.
"""

from __future__ import annotations

import fcntl
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from tramstream import private
from tramstream.errors import ConfigError
from tramstream.memory.stage import assign

S = 1_000_000_000
"""Nanoseconds in a second."""
GPS_EPOCH_UNIX_S = 315_964_800
"""1980-01-06, from which GPS time counts, in Unix time."""


class VehicleClock:
    """Nanoseconds of the vehicle clock: offset + rate · monotonic.

    `rate` other than 1 serves simulated rides only: every process of the ride then lives faster.
    """

    def __init__(
        self,
        offset_ns: int = 0,
        rate: float = 1.0,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        utc_ns: Callable[[], int] | None = None,
    ) -> None:
        self.offset_ns = offset_ns
        self.rate = rate
        self._monotonic_ns = monotonic_ns
        real = rate == 1.0 and monotonic_ns is time.monotonic_ns
        self._utc_ns = utc_ns or (time.time_ns if real else None)

    def now_ns(self) -> int:
        monotonic_ns = self._monotonic_ns()
        if self.rate != 1.0:
            monotonic_ns = int(monotonic_ns * self.rate)
        return self.offset_ns + monotonic_ns

    def host_utc_ns(self) -> int | None:
        """What the host takes for UTC; None for a clock that does not live in the host's time."""
        return self._utc_ns() if self._utc_ns is not None else None

    @classmethod
    def shared(cls, runtime_dir: Path, rate: float = 1.0) -> VehicleClock:
        """The clock of all processes that use `runtime_dir`, made by whoever comes first.

        Raises
        ------
        ConfigError
            If the folder cannot be written, or is not this user's alone.
        """
        make_runtime_dir(runtime_dir)
        path = runtime_dir / "clock.json"
        boot = boot_id()
        known = _read_clock(path, boot)
        if known is None:
            try:
                # Whoever waited for the lock finds the winner's file: reading and writing under
                # one lock is what makes all agree, also over the file of an earlier boot.
                with (runtime_dir / "clock.lock").open("w") as lock:
                    fcntl.flock(lock, fcntl.LOCK_EX)
                    known = _read_clock(path, boot) or _write_clock(path, boot, rate)
            except OSError as error:
                raise ConfigError(
                    f"{path}: cannot write the clock file ({error.strerror})",
                    cure="set "
                    "$.bus.runtime_dir or TRAMSTREAM_RUNTIME_DIR to a folder that you may write",
                ) from error
        return cls(*known)


def boot_id() -> str:
    """The kernel's identifier of this boot."""
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()


def make_runtime_dir(runtime_dir: Path) -> None:
    """See to the folder for socket, clock and snapshot: there, and private to the user.

    Nothing in it is looked at before: whoever made it has written what is in it.

    Raises
    ------
    ConfigError
        If it cannot be made, or somebody else made it or may write in it.
    """
    try:
        doubt = private.make(runtime_dir)
    except OSError as error:
        raise ConfigError(
            f"{runtime_dir}: cannot make the runtime folder ({error.strerror})",
            cure="set $.bus.runtime_dir or TRAMSTREAM_RUNTIME_DIR to one that you may write",
        ) from error
    if doubt:
        raise ConfigError(
            f"{runtime_dir}: the runtime folder {doubt}",
            cure="set $.bus.runtime_dir or TRAMSTREAM_RUNTIME_DIR to one of your own (mode 700)",
        )


def _read_clock(path: Path, boot: str) -> tuple[int, float] | None:
    """Offset and rate of this boot's clock file; None if absent, of another boot, or damaged."""
    try:
        known = json.loads(path.read_text())
        if known["boot_id"] != boot:
            return None
        return int(known["offset_ns"]), float(known["rate"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _write_clock(path: Path, boot: str, rate: float) -> tuple[int, float]:
    """Found the clock; the caller holds the lock. Readers see the whole file or none."""
    offset_ns = time.time_ns() - int(time.monotonic_ns() * rate)
    text = json.dumps({"boot_id": boot, "offset_ns": offset_ns, "rate": rate})
    private.write(path, text.encode())
    return offset_ns, rate


@dataclass
class FitMemory:
    """What a `ClockFit` remembers; instants are since the first arrival but for `origin_ns`."""

    restarts: int = 0
    origin_ns: int | None = None
    """Device time of the first arrival."""
    base_ns: int = 0
    """Arrival − device time of the first arrival."""
    newest_ns: int = 0
    minima: list[tuple[int, int]] = field(default_factory=list)
    """Device time and delay over base, one for each bucket."""
    knots: list[tuple[int, float, float]] = field(default_factory=list)
    """Device time, offset over base, slope."""
    skew: float = 0.0
    jumps: int = 0
    jump_since_ns: int = 0
    """Arrival of the first of them."""
    residuals: list[float] = field(default_factory=list)


class ClockFit:
    """Fit host time to device time from arrivals, on line.

    Feed every arrival with `add`, map device instants with `host_ns`. The minimum delay over the
    window cannot be told from the offset: subtract a known delay outside. Late arrivals do not
    matter. A jump of the device clock by more than `step_s` starts the fit anew and is counted in
    `restarts`: after `JUMP_ARRIVALS` in a row that come too early, which no delay explains, or too
    late for `step_s` on end, which a stalled reader emptying its buffer is not.

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
    memory : FitMemory or None
        Part of its owner's memory; one of its own by default.
    """

    JUMP_ARRIVALS = 5
    SETTLING_BUCKETS = 4
    """So long each lower arrival bends the chain at once, with the greatest slew."""
    MAX_SLEW = 0.1
    """The chain's slope stays this close to 1, so it always rises."""
    SLEW_BUCKETS = 8
    """A correction is spread over so many buckets: 1 ms over 4 s changes 10 ms by 2.5 µs."""
    KNOTS = 32
    RESIDUALS = 128

    def __init__(
        self,
        bucket_s: float = 0.5,
        buckets: int = 64,
        max_skew: float = 200e-6,
        step_s: float = 1.0,
        memory: FitMemory | None = None,
    ) -> None:
        self.bucket_ns = int(bucket_s * S)
        self.buckets = buckets
        self.max_skew = max_skew
        self.step_ns = int(step_s * S)
        self.memory = FitMemory() if memory is None else memory

    @property
    def ready(self) -> bool:
        return self.memory.origin_ns is not None

    @property
    def restarts(self) -> int:
        """How often the fit was begun anew."""
        return self.memory.restarts

    @property
    def skew(self) -> float:
        """Host rate / device rate − 1 of the fitted line."""
        return self.memory.skew

    @property
    def offset_ns(self) -> int:
        """Host − device time now; 0 before the first arrival."""
        return self.memory.base_ns + round(self._chain(self.memory.newest_ns)) if self.ready else 0

    @property
    def residual_ns(self) -> float:
        """Median delay above the fit over the last arrivals."""
        ordered = sorted(self.memory.residuals)
        return ordered[len(ordered) // 2] if ordered else 0.0

    def restart(self) -> None:
        """Forget the fit: the device said itself that its clock started anew."""
        assign(self.memory, FitMemory(restarts=self.restarts + 1))

    def add(self, device_ns: int, arrival_ns: int) -> None:
        """Take note that what was stamped `device_ns` arrived at `arrival_ns`."""
        memory = self.memory
        if memory.origin_ns is None:
            memory.origin_ns, memory.base_ns = device_ns, arrival_ns - device_ns
            memory.minima, memory.knots = [(0, 0)], [(0, 0.0, 0.0)]
            return
        elapsed_ns = device_ns - memory.origin_ns
        delay_ns = arrival_ns - device_ns - memory.base_ns
        residual_ns = delay_ns - self._chain(elapsed_ns)
        if abs(residual_ns) > self.step_ns:
            self._suspect_jump(device_ns, arrival_ns, early=residual_ns < 0)
            return
        memory.jumps = 0
        memory.newest_ns = max(memory.newest_ns, elapsed_ns)
        memory.residuals.append(residual_ns)
        if len(memory.residuals) > self.RESIDUALS:
            del memory.residuals[: self.RESIDUALS // 2]
        self._take_minimum(elapsed_ns, delay_ns)

    def _take_minimum(self, elapsed_ns: int, delay_ns: int) -> None:
        memory = self.memory
        last_ns, lowest_ns = memory.minima[-1]
        bucket = elapsed_ns // self.bucket_ns - last_ns // self.bucket_ns
        if bucket > 0:
            self._refit()  # the bucket that ends is complete, the one that begins is not
            memory.minima.append((elapsed_ns, delay_ns))
            del memory.minima[: -self.buckets]
        elif bucket == 0 and delay_ns < lowest_ns:
            memory.minima[-1] = (elapsed_ns, delay_ns)
            if len(memory.minima) <= self.SETTLING_BUCKETS:
                self._refit()

    def _suspect_jump(self, device_ns: int, arrival_ns: int, *, early: bool) -> None:
        memory = self.memory
        if memory.jumps == 0:
            memory.jump_since_ns = arrival_ns
        memory.jumps += 1
        lasting = early or arrival_ns - memory.jump_since_ns >= self.step_ns
        if memory.jumps >= self.JUMP_ARRIVALS and lasting:
            self.restart()
            self.add(device_ns, arrival_ns)

    def host_ns(self, device_ns: int) -> int:
        """Map a device instant to host time; needs at least one arrival."""
        memory = self.memory
        if memory.origin_ns is None:
            raise ValueError("ClockFit.host_ns before the first arrival")
        return device_ns + memory.base_ns + round(self._chain(device_ns - memory.origin_ns))

    def _chain(self, elapsed_ns: int) -> float:
        """Offset over base of the curve in use."""
        for knot_ns, offset_ns, slope in reversed(self.memory.knots):
            if knot_ns <= elapsed_ns:
                return offset_ns + slope * (elapsed_ns - knot_ns)
        knot_ns, offset_ns, slope = self.memory.knots[0]
        return offset_ns + slope * (elapsed_ns - knot_ns)

    def _refit(self) -> None:
        """Bend the curve, from the newest arrival on, towards the window's supporting line."""
        memory = self.memory
        memory.skew, intercept_ns = supporting_line(memory.minima, self.max_skew)
        now_ns = memory.newest_ns
        current_ns = self._chain(now_ns)
        target_ns = intercept_ns + memory.skew * now_ns
        error_ns = target_ns - current_ns
        slew_ns = abs(error_ns) / (self.MAX_SLEW - self.max_skew)
        if len(memory.minima) > self.SETTLING_BUCKETS:
            slew_ns = max(slew_ns, self.SLEW_BUCKETS * self.bucket_ns)
        until_ns = now_ns + int(slew_ns) + 1
        slope = memory.skew + error_ns / (until_ns - now_ns)
        end_ns = target_ns + memory.skew * (until_ns - now_ns)
        past = [knot for knot in memory.knots if knot[0] < now_ns][-self.KNOTS :]
        memory.knots = [*past, (now_ns, current_ns, slope), (until_ns, end_ns, memory.skew)]


MIN_POINTS = 8
"""Fewer buckets are too short to tell skew from jitter."""


def supporting_line(points: list[tuple[int, int]], max_skew: float) -> tuple[float, float]:
    """Slope and intercept of the line below all points with the least total distance to them.

    Of all lines below, that is the lower hull's edge over the mean abscissa.
    """
    hull: list[tuple[int, int]] = []
    for point in points:
        while len(hull) >= 2 and _turns_right(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    slope = 0.0
    if len(points) >= MIN_POINTS:
        mean = sum(x for x, _ in points) / len(points)
        for left, right in pairwise(hull):
            slope = (right[1] - left[1]) / (right[0] - left[0])
            if right[0] >= mean:
                break
    slope = max(-max_skew, min(max_skew, slope))
    return slope, min(y - slope * x for x, y in hull)


def _turns_right(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) <= 0
