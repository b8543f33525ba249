"""The folder of records: one running recording in parts, repair at the start, a floor of space.

How a part is called, `names` says; it has `.active` behind it while it is written. Every part can
be read alone: it repeats all schemas, channels (with the same ids) and metadata, and its metadata
has `session` and `part`, so that parts can be put in order.

Nothing here waits for the disk: `append` only touches memory, `flush` hands work to a thread.
What is wrong stands in `state` and `trouble`, dropped messages are counted, and writing goes on as
soon as the disk allows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from google.protobuf.message import Message

from tramstream.clock import S, VehicleClock
from tramstream.config import Recorder
from tramstream.errors import RecordError
from tramstream.events.kinds import Event
from tramstream.keys import Key
from tramstream.proto.health_pb2 import NodeHealth
from tramstream.recorder.events import (
    EMPTY_DELETED,
    FOLDER_REFUSED,
    PART_NOT_REPAIRED,
    PART_REPAIRED,
)
from tramstream.recorder.file.recover import Recovery
from tramstream.recorder.file.repair import REDO, repair
from tramstream.recorder.file.sink import ACTIVE, Loss, LossBook, Worker, why
from tramstream.recorder.file.writer import RecordFile, host_metadata
from tramstream.recorder.names import UTC_OFFSET, WORTH_CORRECTING_NS, PartNames, UtcOffset, parse
from tramstream.recorder.space import FreeSpace

_PATIENCE_S = 10.0
_SPOILED_SPLIT_NS = 10 * S
"""After a sync that failed, go on in a new file, but not more often than this."""


class Recording:
    """One session of recording into a folder.

    Parameters
    ----------
    directory : Path
    vehicle : str
    settings : Recorder
    clock : VehicleClock
        Names parts and decides when to split.
    metadata : Mapping[str, str], optional
        Goes into every part, e.g. the configuration's text as `config`.
    worker : Worker, optional
        Runs the disk work; a thread of its own if not given.
    """

    def __init__(
        self,
        directory: Path,
        vehicle: str,
        settings: Recorder,
        clock: VehicleClock,
        metadata: Mapping[str, str] | None = None,
        worker: Worker | None = None,
    ) -> None:
        self.directory = directory
        self.vehicle = vehicle
        self.settings = settings
        self.space = FreeSpace(directory, settings.free_space_floor_bytes)
        self.part = 0
        self._clock = clock
        self._worker = worker or Worker()
        self._values = {**host_metadata(), **(metadata or {})}
        boot = self._values["boot_id"]
        self._values["session"] = f"{vehicle}-{clock.now_ns():x}-{boot[:8]}"
        self.utc = UtcOffset()
        self._names: PartNames | None = None
        self._corrected = False
        self._file: RecordFile | None = None
        self._previous: RecordFile | None = None
        self._closing: list[RecordFile] = []
        self._losses = LossBook()
        self._folder_trouble: Event | None = None
        self._end_trouble: Event | None = None
        self._begun_ns = 0
        self._checking = False

    @property
    def path(self) -> Path | None:
        """The part that is being written, under its final name."""
        return self._file.path if self._file is not None else None

    @property
    def state(self) -> int:
        """A value of NodeHealth.State."""
        if self._stopped:
            return int(NodeHealth.FAILED)
        files = [self._file, *self._closing]
        return max((file.state for file in files if file is not None), default=int(NodeHealth.OK))

    @property
    def trouble(self) -> Event | None:
        """What is wrong if the state is not OK."""
        troubles = [self._end_trouble, self._stopped]
        troubles += [file.trouble for file in [self._file, *self._closing] if file is not None]
        return next((trouble for trouble in troubles if trouble is not None), None)

    def start(self) -> list[Event]:
        """Make the folder, repair what was left unfinished, look at the space.

        Returns what was found and done. May be called once, before `append`.
        """
        found: list[Event] = []
        self._make_folder()
        if self._folder_trouble is None:
            self._check_space()
            self._worker.drain(_PATIENCE_S)  # repairs want the room that it makes
            for active in sorted(self.directory.glob(f"*.mcap{ACTIVE}")):
                try:
                    found.append(_repaired(repair(active)))
                except RecordError as error:
                    found.append(PART_NOT_REPAIRED(reason=error.reason, advice=error.cure))
            for redo in self.directory.glob(f"*.mcap{REDO}"):
                if not redo.with_name(redo.name.removesuffix(REDO) + ACTIVE).exists():
                    redo.unlink(missing_ok=True)  # a repair was killed right before this
        return found

    def append(
        self,
        topic: str,
        type_: type[Message] | Key | str,
        payload: bytes,
        log_ns: int,
        publish_ns: int,
        sequence: int,
    ) -> None:
        """Record one message; see `RecordFile.append`."""
        if self._file is None:
            if self._names is None:
                self._make_folder()
            if self._stopped:
                self._losses.add(topic, publish_ns)
                return
            self._file = self._begin()
        self._file.append(topic, type_, payload, log_ns, publish_ns, sequence)

    def flush(self) -> None:
        """Have everything written and synced; split, delete, stop or go on. Every `flush_s`."""
        if self._folder_trouble is not None:
            self._make_folder()
        self._check_space()
        self._see_host()
        if not self._corrected and self.utc.ns is not None:
            self._corrected = True
            self._worker.submit(self._correct_names)
        if self._file is not None:
            if self.space.blocked or self._due():
                self._end_part()
            else:
                self._file.flush()
        self._settle()

    def take_losses(self) -> list[Loss]:
        """What was dropped since the last call: make a Loss message (cause DISK) of each."""
        losses = self._losses.take()
        for file in [self._file, *self._closing]:
            if file is not None:
                losses += file.take_losses()
        return losses

    def take_events(self) -> list[Event]:
        """What was done about space and files since the last call."""
        taken = []
        for events in (self.space.events, self._worker.events):
            while events:
                taken.append(events.popleft())
        return taken

    def close(self, timeout_s: float = 10.0) -> bool:
        """Finish the last part; False if the disk did not take everything.

        What it did not take is counted (`take_losses`); the file stays `.active` and is repaired at
        the next start.
        """
        if self._file is not None:
            self._end_part()
        self._settle()  # parts that the disk has refused so far get another chance
        drained = self._worker.drain(timeout_s)
        self._settle(again=False)
        if self._closing:
            self._end_trouble = self.trouble
        left, self._closing = self._closing, []
        for file in left:
            file.abandon(busy=not drained)
            for loss in file.take_losses():
                self._losses.add_all(loss)
        self._worker.close(timeout_s if drained else 0.0)
        return not left

    @property
    def _stopped(self) -> Event | None:
        return self._folder_trouble or self.space.blocked

    def _make_folder(self) -> None:
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            self._folder_trouble = self._refused(error)
        else:
            self._folder_trouble = None
            self._names = PartNames(self.directory, self.vehicle, self._values["boot_id"], self.utc)

    def _refused(self, error: OSError) -> Event:
        reason, advice = why(error)
        return FOLDER_REFUSED(folder=self.directory, reason=reason, advice=advice)

    def _check_space(self) -> None:
        """Look at the space in the background, one look at a time."""
        if not self._checking:
            self._checking = True
            self._worker.submit(self._look(self._clock.now_ns()))

    def _look(self, now_ns: int) -> Callable[[], None]:
        def look() -> None:
            self._checking = False
            self.space.check(now_ns)

        return look

    def _due(self) -> bool:
        """Whether the part is long enough, or its file can no longer be trusted."""
        assert self._file is not None
        age_ns = self._clock.now_ns() - self._begun_ns
        if self._file.spoiled:
            return age_ns >= _SPOILED_SPLIT_NS
        long = age_ns >= self.settings.split_s * S or self._file.size >= self.settings.split_bytes
        return long and self._file.state == NodeHealth.OK

    def _begin(self) -> RecordFile:
        """Begin the next part, in memory."""
        self.part += 1
        self._begun_ns = self._clock.now_ns()
        assert self._names is not None  # the folder is there
        while (path := self._names.next(self._begun_ns)).exists() or _active(path).exists():
            pass  # somebody put it there since the folder was looked at
        values = {**self._values, "part": str(self.part)}
        file = RecordFile(path, self.vehicle, values, self._worker)
        if self._previous is not None:
            file.adopt(self._previous)
        return file

    def _see_host(self) -> None:
        utc_ns = self._clock.host_utc_ns()
        if utc_ns is not None:
            self.utc.see_host(utc_ns, self._clock.now_ns())

    def _correct_names(self) -> None:
        """Correct the names of parts that were finished before the time was known."""
        assert self._names is not None
        try:
            self.space.events.extend(self._names.correct_finished(self._worker.storage))
        except OSError as error:
            self._corrected = False  # again at the next flush
            self.space.events.append(self._refused(error))

    def _end_part(self) -> None:
        assert self._file is not None
        assert self._names is not None
        offset_ns = self.utc.ns
        if offset_ns is not None and abs(offset_ns) >= WORTH_CORRECTING_NS:
            path = self._names.corrected(self._file.path, self._begun_ns)
            self._file.retitle(path, {UTC_OFFSET: str(offset_ns)})
        self._file.close()
        self._closing.append(self._file)
        self._previous, self._file = self._file, None

    def _settle(self, again: bool = True) -> None:
        """Look after files that are being finished; have the others tried `again`."""
        for file in list(self._closing):
            if file.finished:
                self.space.latest = parse(file.path.name)
                for loss in file.take_losses():
                    self._losses.add_all(loss)
                self._closing.remove(file)
            elif again:
                file.close()


def _active(path: Path) -> Path:
    return path.with_name(path.name + ACTIVE)


def _repaired(recovery: Recovery) -> Event:
    part = recovery.source.name
    if recovery.target is None:
        return EMPTY_DELETED(part=part)
    return PART_REPAIRED(
        part=part,
        messages=recovery.messages,
        lasting_s=(recovery.end_ns - recovery.start_ns) / S,
        damaged_bytes=recovery.bytes_damaged,
        torn=recovery.chunks_damaged,
        unknown=recovery.messages_unknown,
    )
