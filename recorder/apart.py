"""Reprocessing on two cores: what reads the record runs in a process of its own.

Filters read only what the resampler makes, and they take as long as all the rest. So the record is
read, decoded and resampled in a forked process; what that makes comes through a pipe, in order, and
is stepped on through the filters and written here. Order and bytes are those of one process.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Collection
from contextlib import suppress
from multiprocessing.connection import Connection
from traceback import format_exc
from typing import Any

from tramstream import keys
from tramstream.errors import RecordError
from tramstream.keys import Key
from tramstream.processor import Processor, Sample
from tramstream.recorder.reader import Record
from tramstream.recorder.reprocess import Expect, Output, Plan, Reprocessor, Take, restore

GATHERED = 128
"""Groups of outputs that go through the pipe together: a second of a ride."""
JOIN_S = 10.0

_Group = tuple[int, int, list[tuple[str, bytes, int, int]]]
"""Session, log time, and of each output: key path, encoded message, stamp, sequence."""
_Expected = tuple[int, str, int, bytes]


def part(processors: list[Processor]) -> tuple[list[Processor], list[Processor]]:
    """Part processors into those that read the record and those that read only what these make.

    The second list is empty where they cannot be parted, where only one core is there, and in a
    process that may have no children (a worker of a pool).
    """
    if len(os.sched_getaffinity(0)) == 1 or multiprocessing.current_process().daemon:
        return processors, []
    made = {key.path for processor in processors for key in processor.outputs}
    first, behind = list[Processor](), list[Processor]()
    for processor in processors:
        paths = {key.path for key in processor.inputs}
        (behind if paths <= made else first).append(processor)
        if not paths <= made and not paths.isdisjoint(made):
            return processors, []
    return first, behind


class Followers:
    """Steps what the first processors make through those behind them.

    Parameters
    ----------
    processors : list of Processor
        Those behind; fresh ones.
    others : collection of str
        Names of the first ones: their memory in a snapshot is not looked at here.
    """

    def __init__(
        self, processors: list[Processor], plan: Plan, take: Take, others: Collection[str]
    ) -> None:
        self._processors, self._others = processors, others
        self._plan, self._take = plan, take
        self._session = -1
        self._steps: dict[str, list[Callable[[Sample], list[Sample]]]] = {}
        for processor in processors:
            for key in processor.inputs:
                self._steps.setdefault(key.path, []).append(processor.step)
        self._keys: dict[str, Key] = {}

    def take(self, group: _Group) -> None:
        """Hand on one group of outputs, then what follows from it."""
        session, log_ns, encoded = group
        if session != self._session and self._plan.anchored:
            restore(self._plan.sessions[session].snapshot, self._processors, self._others)
        self._session = session
        outputs = [self._output(*each) for each in encoded]
        self._take(session, log_ns, outputs)
        work = [sample for sample, _ in outputs]
        following: list[Output] = []
        for sample in work:  # grows meanwhile
            for step in self._steps.get(sample.key.path, ()):
                for result in step(sample):
                    following.append((result, result.message.SerializeToString()))
                    work.append(result)
        if following:
            self._take(session, log_ns, following)

    def _output(self, path: str, payload: bytes, stamp_ns: int, sequence: int) -> Output:
        key = self._keys.get(path)
        if key is None:
            found = keys.find(path)
            assert found is not None
            key = self._keys[path] = found
        message: Any = key.type.FromString(payload) if path in self._steps else None
        return Sample(key, message, stamp_ns, sequence), payload


class _Sender:
    """The child's end: gathers and sends."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._groups: list[_Group] = []
        self._expected: list[_Expected] = []

    def take(self, session: int, log_ns: int, outputs: list[Output]) -> None:
        encoded = [(s.key.path, payload, s.stamp_ns, s.sequence) for s, payload in outputs]
        self._groups.append((session, log_ns, encoded))
        if len(self._groups) >= GATHERED:
            self.flush()

    def expect(self, session: int, path: str, sequence: int, payload: bytes) -> None:
        self._expected.append((session, path, sequence, payload))

    def flush(self) -> None:
        self._connection.send((self._groups, self._expected))
        self._groups, self._expected = [], []

    def send(self, run: Reprocessor) -> None:
        """Send everything, then what was missing or the exception that ended it."""
        end: dict[str, int] | Exception = run.missing
        try:
            run.run()
            self.flush()
        except BrokenPipeError:
            raise
        except Exception as error:  # noqa: BLE001  raised again on the other side
            error.add_note(format_exc())
            end = error
        self._connection.send(end)


def run_apart(
    record: Record,
    processors: tuple[list[Processor], list[Processor]],
    plan: Plan,
    take: Take,
    expect: Expect | None,
) -> dict[str, int]:
    """Do what `Reprocessor.run` does with `part`ed processors; return what was missing.

    Raises
    ------
    RecordError
        As `Reprocessor.run`, or if the other process was killed.
    """
    first, behind = processors
    names = [{processor.name for processor in each} for each in processors]
    here, there = multiprocessing.Pipe(duplex=False)
    sender = _Sender(there)
    run = Reprocessor(record, first, plan, sender.take, names[1])
    if expect is not None:
        run.compare(sender.expect, {key.path for each in behind for key in each.outputs})

    def work() -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the pipe's end tells this process to end
        here.close()
        with suppress(BrokenPipeError):
            sender.send(run)

    process = multiprocessing.get_context("fork").Process(target=work, daemon=True)
    process.start()
    there.close()
    try:
        return _receive(here, Followers(behind, plan, take, names[0]), expect)
    except EOFError as error:
        raise RecordError(
            f"{record.paths[0]}: the process that read it was killed; is there enough memory?"
        ) from error
    finally:
        here.close()
        process.join(JOIN_S)


def _receive(here: Connection, followers: Followers, expect: Expect | None) -> dict[str, int]:
    while True:
        received = here.recv()
        if isinstance(received, Exception):
            raise received
        if isinstance(received, dict):
            return received
        groups, expected = received
        for group in groups:
            followers.take(group)
        if expect is not None:
            for each in expected:
                expect(*each)
