"""Captured bytes as simulated devices: a receiver's log and a CAN bus' log, at their own pace.

A receiver's log is paced by the GPS time of its frames: all bytes from the first frame of an epoch
to the first of the next leave together, as fast as the line carries them. Where no frame tells the
time, the line alone sets the pace. A CAN log is paced by its stamps, in clumps of `CLUMP_NS`, as a
serial adapter's USB hands them over.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median

from tramstream.bridges.gnss.capture import epoch_times
from tramstream.bridges.gnss.framer import Frame, Framer
from tramstream.bridges.odometer import candump, slcan
from tramstream.bridges.odometer.frames import ERROR, EXTENDED, FD, REMOTE, CanFrame
from tramstream.bridges.simulators.receiver import pieces
from tramstream.bridges.simulators.streams import BITS_PER_BYTE, Chunk
from tramstream.clock import S
from tramstream.errors import ConfigError

CLUMP_NS = 2_000_000
SAME_EPOCH_NS = 20_000_000
"""The receiver time of RXM-RAWX differs from the navigation epoch's by up to some milliseconds."""
LONGEST_PAUSE_NS = 60 * S
"""A longer step of a log's time, or one backwards, is a jump of its clock, not a pause: the median
step is taken instead."""


@dataclass(frozen=True, slots=True)
class GnssLog:
    """Bytes of each epoch, and when it begins after the log's start."""

    epochs: list[tuple[int, bytes, int]]
    """Time since the start, bytes, number of frames."""
    length_ns: int
    """From the start until a repetition may begin; 0 where no frame tells the time."""

    @classmethod
    def load(cls, path: Path) -> GnssLog:
        """Read a capture; leading lines that start with `#` are comments.

        Raises
        ------
        ConfigError
            If the file cannot be read.
        """
        try:
            return cls.cut(_without_comments(path.read_bytes()))
        except OSError as error:
            raise ConfigError(f"{path}: cannot read the capture ({error.strerror})") from error

    @classmethod
    def cut(cls, data: bytes) -> GnssLog:
        """Cut a capture into its epochs."""
        framer = Framer()
        frames = [item for item in framer.feed(data) + framer.flush() if isinstance(item, Frame)]
        starts = {frame.start + len(frame.raw): frame.start for frame in frames}
        cuts: list[int] = []
        times: list[int] = []
        for end, gps_ns in epoch_times(data):
            if not times or not 0 <= gps_ns - times[-1] < SAME_EPOCH_NS:
                cuts.append(starts.get(end, end))
                times.append(gps_ns)
        if not times:
            return cls([(0, data, len(frames))] if data else [], 0)
        cuts[0] = 0
        since_ns = _since_start(times)
        edges = [*cuts[1:], len(data)]
        sizes = _count_between(sorted(starts.values()), edges)
        epochs = [
            (at_ns, data[first:last], size)
            for at_ns, first, last, size in zip(since_ns, cuts, edges, sizes, strict=True)
        ]
        return cls(epochs, since_ns[-1] + _typical_step(times))

    def stream(self, start_ns: int, baud_rate: int, loop: bool = False) -> Iterator[Chunk]:
        """Chunks of the log from `start_ns` on, repeated for ever if `loop`."""
        byte_ns = BITS_PER_BYTE * S / baud_rate
        base_ns = free_ns = start_ns
        while self.epochs:
            for at_ns, data, frames in self.epochs:
                chunks = pieces(data, max(base_ns + at_ns, free_ns), byte_ns)
                chunks[-1] = chunks[-1]._replace(counts={"frames": frames, "epochs": 1})
                free_ns = chunks[-1].due_ns
                yield from chunks
            base_ns = base_ns + self.length_ns if self.length_ns else free_ns
            if not loop:
                return


def _without_comments(data: bytes) -> bytes:
    while data.startswith(b"#"):
        _, _, data = data.partition(b"\n")
    return data


def _since_start(times: list[int]) -> list[int]:
    """Time of each epoch since the first, without the jumps of the log's clock."""
    typical_ns = _typical_step(times)
    since = [0]
    for before, now in pairwise(times):
        step_ns = now - before
        since.append(since[-1] + (step_ns if 0 < step_ns <= LONGEST_PAUSE_NS else typical_ns))
    return since


def _typical_step(times: list[int]) -> int:
    steps = [now - before for before, now in pairwise(times)]
    likely = [step for step in steps if 0 < step <= LONGEST_PAUSE_NS]
    return round(median(likely)) if likely else S


def _count_between(starts: list[int], edges: list[int]) -> list[int]:
    """How many starts lie before each edge and not before the edge ahead of it."""
    counts = [0] * len(edges)
    index = 0
    for start in starts:
        while start >= edges[index]:
            index += 1
        counts[index] += 1
    return counts


def can_file_stream(path: Path, start_ns: int, loop: bool = False) -> Iterator[Chunk]:
    """Frames of a candump log as slcan lines; what slcan cannot carry is counted as skipped.

    Lines are read as they are needed. A log whose first frame never comes does not loop.
    """
    base_ns, any_frame = start_ns, True
    while any_frame:
        any_frame = False
        end_ns = base_ns
        for chunk in _can_clumps(path, base_ns):
            any_frame = any_frame or chunk.counts["frames"] > 0
            end_ns = chunk.due_ns
            yield chunk
        base_ns = end_ns + CLUMP_NS
        if not loop:
            return


def _can_clumps(path: Path, base_ns: int) -> Iterator[Chunk]:
    lines: list[bytes] = []
    skipped = 0
    opened_ns = newest_ns = base_ns
    for due_ns, frame in _paced(path, base_ns):
        if lines and due_ns - opened_ns > CLUMP_NS:
            yield Chunk(newest_ns, b"".join(lines), {"frames": len(lines), "skipped": skipped})
            lines, skipped = [], 0
        line = _slcan_line(frame) if isinstance(frame, CanFrame) else b""
        if not line:
            skipped += 1
            continue
        if not lines:
            opened_ns = due_ns
        lines.append(line)
        newest_ns = due_ns
    if lines or skipped:
        yield Chunk(newest_ns, b"".join(lines), {"frames": len(lines), "skipped": skipped})


def _paced(path: Path, base_ns: int) -> Iterator[tuple[int, CanFrame | None]]:
    """Each line's frame and when it is due; None for a line that is no frame."""
    due_ns, before_ns = base_ns, -1
    with path.open(encoding="ascii", errors="replace") as log:
        for line in log:
            if not line.strip():
                continue
            frame = candump.parse_line(line)
            if not isinstance(frame, CanFrame):
                yield due_ns, None
                continue
            if before_ns >= 0 and 0 < frame.stamp_ns - before_ns <= LONGEST_PAUSE_NS:
                due_ns += frame.stamp_ns - before_ns
            before_ns = frame.stamp_ns
            yield due_ns, frame


def _slcan_line(frame: CanFrame) -> bytes:
    """The adapter's line; empty for error frames and CAN FD, which slcan does not know."""
    if frame.flags & (ERROR | FD):
        return b""
    remote_length = frame.nibble if frame.flags & REMOTE else None
    return slcan.encode_frame(
        frame.id,
        frame.data,
        extended=bool(frame.flags & EXTENDED),
        remote_length=remote_length,
    )
