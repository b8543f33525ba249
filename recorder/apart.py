"""Reprocessing on two cores: demanding processors run in another process than all the rest.

A localisation filter reads only what the resampler makes, and takes as long as everything else. So
the record is read, decoded and resampled in a forked process; what that makes comes through a pipe,
in order, and here it is stepped on through the filter and written. On one core the same is done in
one process: order and bytes are the same.
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
    """Part processors into the first ones and the demanding ones behind them, if there are any.

    Behind is who reads only what processors make that read the record themselves, and what is made
    behind. All steps then see their samples in the order of the live run, which steps everything
    that followed from an input before what followed from that.
    """
    made = _paths(processors)
    direct = _paths([each for each in processors if not _inputs(each) <= made])
    behind = [each for each in processors if each.demanding]
    for _ in processors:
        outputs = _paths(behind)
        behind = [each for each in processors if each in behind or _inputs(each) & outputs]
    if any(not _inputs(each) <= direct | _paths(behind) for each in behind):
        return processors, []
    return [each for each in processors if each not in behind], behind


def _paths(processors: list[Processor]) -> set[str]:
    return {key.path for processor in processors for key in processor.outputs}


def _inputs(processor: Processor) -> set[str]:
    return {key.path for key in processor.inputs}


class Followers:
    """Steps what the first processors make through those behind them.

    Parameters
    ----------
    processors : list of Processor
        Those behind; fresh ones.
    plan : Plan
    take : callable
        Gets what the first ones make and what follows from it.
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

    def take(self, session: int, log_ns: int, outputs: list[Output]) -> None:
        """Hand on what followed from one input, then what follows from that."""
        if session != self._session and self._plan.anchored:
            restore(self._plan.sessions[session].snapshot, self._processors, self._others)
        self._session = session
        self._take(session, log_ns, outputs)
        following: list[Output] = []
        work = [sample for sample, _ in outputs]
        for sample in work:  # grows meanwhile
            for step in self._steps.get(sample.key.path, ()):
                for result in step(sample):
                    following.append((result, result.message.SerializeToString()))
                    work.append(result)
        if following:
            self._take(session, log_ns, following)

    def decode(self, path: str, payload: bytes, stamp_ns: int, sequence: int) -> Output:
        """An output that came encoded; its message only if somebody here wants it."""
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


def run(
    record: Record, processors: list[Processor], plan: Plan, take: Take, expect: Expect | None
) -> dict[str, int]:
    """Reprocess `record`; return what the live processors had of each key and the record does not.

    `take` gets the outputs and `expect` the recorded ones; see `reprocess`.

    Raises
    ------
    RecordError
        As `Reprocessor.run`, or if the other process was killed.
    """
    first, behind = part(processors)
    names = [{processor.name for processor in each} for each in (first, behind)]
    followers = Followers(behind, plan, take, names[0])
    # A worker of a pool may have no children.
    apart = len(os.sched_getaffinity(0)) > 1 and not multiprocessing.current_process().daemon
    if behind and apart:
        here, there = multiprocessing.Pipe(duplex=False)
        sender = _Sender(there)
        run = Reprocessor(record, first, plan, sender.take, names[1])
        if expect is not None:
            run.compare(sender.expect, _paths(behind))
        return _run_apart(run, sender, (here, there), followers, expect)
    run = Reprocessor(record, first, plan, followers.take if behind else take, names[1])
    if expect is not None:
        run.compare(expect, _paths(behind))
    run.run()
    return run.missing


def _run_apart(
    run: Reprocessor,
    sender: _Sender,
    pipe: tuple[Connection, Connection],
    followers: Followers,
    expect: Expect | None,
) -> dict[str, int]:
    here, there = pipe

    def work() -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the pipe's end tells this process to end
        here.close()
        with suppress(BrokenPipeError):
            sender.send(run)

    process = multiprocessing.get_context("fork").Process(target=work, daemon=True)
    process.start()
    there.close()
    try:
        return _receive(here, followers, expect)
    except EOFError as error:
        raise RecordError(
            "the process that read the record was killed; is there enough memory?"
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
        for session, log_ns, encoded in groups:
            followers.take(session, log_ns, [followers.decode(*each) for each in encoded])
        if expect is not None:
            for each in expected:
                expect(*each)
