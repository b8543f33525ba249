"""Reprocessing on several cores: demanding processors run in a process of their own.

A localisation filter reads only what the resampler makes, and takes as long as everything else
together. So the work is parted, each part in a process:

    reading ──what the first processors make──▶ following ──what follows from it──▶ writing
       └──────────────────────────the same, and recorded outputs─────────────────────▲

*Reading* goes through the record and steps the first processors. *Following*, for each group of
outputs, steps those behind and answers with one group. *Writing*, which is the caller's process,
takes the groups and their answers in turn: order and bytes are those of one process, which does
it all where there is one core.

Nobody can wait in a circle: data flow one way, and each group goes to the writer before it goes to
the followers, so that what answers it finds the writer waiting. A process that fails hands its
exception on, and one that is killed closes its pipes; either ends all.
"""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import signal
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from multiprocessing.connection import Connection
from multiprocessing.context import ForkProcess
from traceback import format_exc
from typing import Any, NamedTuple

from tramstream.errors import RecordError
from tramstream.graph import Graph
from tramstream.keys import Key
from tramstream.processor import Processor, Sample, Smoothing
from tramstream.recorder.reader import Record
from tramstream.recorder.reprocess.order import (
    Expect,
    Memories,
    Output,
    Reprocessor,
    Shortfall,
    Take,
    encoded,
)
from tramstream.recorder.reprocess.plan import Plan

GATHERED = 128
"""Groups of outputs that go through a pipe together: a second of a ride."""
PIPE_BYTES = 1 << 20
"""What a pipe holds, so that nobody waits for a neighbour who is a few seconds of the ride behind;
without privileges Linux allows no more."""
AHEAD = 5
"""Niceness of whoever reads: it is always ahead, and on two cores takes time from the followers."""
JOIN_S = 10.0
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
KILLED = "the process that {} was killed; is there enough memory?"
READING, FOLLOWING = "read the record", "ran the filter"

_Parcel = tuple[str, bytes, int, int]
"""Of an output: key path, encoded message, stamp, sequence."""
_Group = tuple[int, int, list[_Parcel]]
"""Session, log time, outputs."""
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


@dataclass
class Takers:
    """Who gets what comes out; all are called in the caller's process."""

    take: Take
    """Gets the outputs."""
    expect: Expect | None = None
    """Gets the recorded ones, to compare; see `Reprocessor.compare`."""
    smoothed: Take | None = None
    """Gets what smoothers say after the ride, one by one at its stamp; None: nobody smooths."""


class Followers:
    """Steps what the first processors make through those behind them.

    Parameters
    ----------
    processors : list of Processor
        Those behind; fresh ones.
    plan : Plan
    others : collection of str
        Names of the first ones: their memory in a snapshot is not looked at here.
    """

    def __init__(self, processors: list[Processor], plan: Plan, others: Collection[str]) -> None:
        self._memories = Memories(plan, processors, others)
        self._plan = plan
        self._session = -1
        self.graph = Graph(processors, step_of=plan.step_of)

    def step(self, session: int, samples: list[Sample]) -> list[Output]:
        """Give what follows from `samples`, which followed from one input."""
        if session != self._session and self._plan.anchored:
            self._memories.begin(self._plan.sessions[session].snapshot)
        self._session = session
        return encoded(self.graph.follow(samples))


def run(
    record: Record,
    processors: list[Processor],
    plan: Plan,
    takers: Takers,
    cores: int | None = None,
) -> Shortfall:
    """Reprocess `record` on the machine's cores, or on `cores`; return what had to be done without.

    Raises
    ------
    RecordError
        As `Reprocessor.run`, or if another process was killed.
    """
    first, behind = part(processors)
    names = [{processor.name for processor in each} for each in (first, behind)]
    followers = Followers(behind, plan, names[0])
    # A worker of a pool may have no children.
    cores = cores or len(os.sched_getaffinity(0))
    apart = cores > 1 and not multiprocessing.current_process().daemon
    if behind and apart and not any(isinstance(each, Smoothing) for each in first):
        sender = _Sender(followers.graph.reads)
        run = Reprocessor(record, first, plan, sender.take, names[1])
        if takers.expect is not None:
            run.compare(sender.expect, _paths(behind))
        smoothers = behind if takers.smoothed is not None else []
        known = dict(Graph(processors).outputs)
        for each in processors:
            known |= {key.path: key for key in each.offline} if isinstance(each, Smoothing) else {}
        unpack = _Unpack(known)
        follow = partial(_follow, followers, smoothers, unpack)
        return _run_apart(run, sender, follow, _Writing(takers, unpack))

    def take(session: int, log_ns: int, outputs: list[Output]) -> None:
        takers.take(session, log_ns, outputs)
        made = followers.step(session, [sample for sample, _ in outputs])
        if made:
            takers.take(session, log_ns, made)

    run = Reprocessor(record, first, plan, take if behind else takers.take, names[1])
    if takers.expect is not None:
        run.compare(takers.expect, _paths(behind))
    run.run()
    if takers.smoothed is not None:
        for sample, payload in _smoothed(processors):
            takers.smoothed(0, sample.stamp_ns, [(sample, payload)])
    return run.shortfall


def _smoothed(processors: list[Processor]) -> Iterator[Output]:
    """What smoothers among `processors` say after the ride."""
    for processor in processors:
        if isinstance(processor, Smoothing):
            for sample in processor.smoothed():
                yield sample, sample.message.SerializeToString()


# Reading -----------------------------------------------------------------------------------------
class _Sender:
    """Gathers what the first processors make and sends it to those who write and who follow."""

    def __init__(self, wanted: Callable[[str], bool]) -> None:
        self._wanted = wanted
        self.writing, self.following = _pipe(), _pipe()
        self._groups: list[_Group] = []
        self._expected: list[_Expected] = []

    def take(self, session: int, log_ns: int, outputs: list[Output]) -> None:
        self._groups.append((session, log_ns, _parcels(outputs)))
        if len(self._groups) >= GATHERED:
            self._flush()

    def expect(self, session: int, path: str, sequence: int, payload: bytes) -> None:
        self._expected.append((session, path, sequence, payload))

    def _flush(self) -> None:
        self.writing.sink.send((self._groups, self._expected))
        wanted = self._wanted
        self.following.sink.send(
            [
                (session, [each for each in encoded if wanted(each[0])])
                for session, _, encoded in self._groups
            ]
        )
        self._groups, self._expected = [], []

    def send(self, run: Reprocessor) -> None:
        """Send everything, then what there was too little of or the exception that ended it."""
        try:
            run.run()
            self._flush()
        except BrokenPipeError:
            raise
        except Exception as error:  # noqa: BLE001  raised again on the other side
            error.add_note(format_exc())
            self.writing.sink.send(error)
        else:
            self.writing.sink.send(run.shortfall)
            self.following.sink.send(None)


# Following ---------------------------------------------------------------------------------------
def _follow(
    followers: Followers,
    smoothers: list[Processor],
    unpack: _Unpack,
    source: Connection,
    sink: Connection,
) -> None:
    """Answer each batch of groups with one of what follows; at the end, send what smoothers say."""
    try:
        while (groups := _receive(source, READING)) is not None:
            sink.send(
                [
                    _parcels(followers.step(session, [unpack.sample(*each) for each in made]))
                    for session, made in groups
                ]
            )
        said = _smoothed(smoothers)
        while states := _parcels(islice(said, GATHERED)):
            sink.send(states)
        sink.send(None)
    except BrokenPipeError:
        raise
    except Exception as error:  # noqa: BLE001  raised again on the other side
        error.add_note(format_exc())
        sink.send(error)


# Writing -----------------------------------------------------------------------------------------
def _run_apart(
    run: Reprocessor,
    sender: _Sender,
    follow: Callable[[Connection, Connection], None],
    writing: _Writing,
) -> Shortfall:
    """Start the other processes and write what they send."""
    made, wanted = sender.writing, sender.following
    # Only whoever uses an end keeps it open, or nobody would see a process die.
    processes = [_fork(partial(sender.send, run), made.source, wanted.source, niceness=AHEAD)]
    made.sink.close()
    wanted.sink.close()
    answers = _pipe()
    work = partial(follow, wanted.source, answers.sink)
    processes.append(_fork(work, made.source, answers.source))
    wanted.source.close()
    answers.sink.close()
    try:
        return writing.write(made.source, answers.source)
    except KeyboardInterrupt:
        for process in processes:
            process.terminate()
        raise
    finally:
        made.source.close()
        answers.source.close()
        for process in processes:
            process.join(JOIN_S)


class _Writing:
    """Hands what the other processes send to the takers."""

    def __init__(self, takers: Takers, unpack: _Unpack) -> None:
        self._takers, self._output = takers, unpack.output

    def write(self, made: Connection, answers: Connection) -> Shortfall:
        """Take groups and their answers in turn until both have ended."""
        takers, output = self._takers, self._output
        while True:
            received = _receive(made, READING)
            if isinstance(received, Shortfall):
                break
            groups, expected = received
            for (session, log_ns, parcels), following in zip(
                groups, _receive(answers, FOLLOWING), strict=True
            ):
                takers.take(session, log_ns, [output(*each) for each in parcels])
                if following:
                    takers.take(session, log_ns, [output(*each) for each in following])
            if takers.expect is not None:
                for each in expected:
                    takers.expect(*each)
        while (states := _receive(answers, FOLLOWING)) is not None:
            assert takers.smoothed is not None
            for each in states:
                said = output(*each)
                takers.smoothed(0, said[0].stamp_ns, [said])
        return received


# Processes and pipes -----------------------------------------------------------------------------
class _Pipe(NamedTuple):
    source: Connection
    sink: Connection


def _pipe() -> _Pipe:
    pipe = _Pipe(*multiprocessing.Pipe(duplex=False))
    with suppress(OSError):  # users have a limit for all pipes together
        fcntl.fcntl(pipe.sink.fileno(), fcntl.F_SETPIPE_SZ, PIPE_BYTES)
    return pipe


def _fork(work: Callable[[], None], *others: Connection, niceness: int = 0) -> ForkProcess:
    """Start `work` in a process that does not hold the ends of pipes that are `others`'."""

    def begin() -> None:
        os.nice(niceness)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the pipes' end tells this process to end
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
        for each in others:
            each.close()
        with suppress(BrokenPipeError):
            work()

    process = multiprocessing.get_context("fork").Process(target=begin, daemon=True)
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        process.start()  # it must not die of a signal with our handlers, and their trace
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    return process


def _receive(source: Connection, doing: str) -> Any:
    """What the process that is `doing` something sends; raises the exception that ended it."""
    try:
        received = source.recv()
    except EOFError as error:
        raise RecordError(KILLED.format(doing)) from error
    if isinstance(received, Exception):
        raise received
    return received


def _parcels(outputs: Iterable[Output]) -> list[_Parcel]:
    return [(each.key.path, payload, each.stamp_ns, each.sequence) for each, payload in outputs]


class _Unpack:
    """Outputs out of parcels, by the keys of the processors that made them."""

    def __init__(self, known: Mapping[str, Key]) -> None:
        self._keys = known

    def output(self, path: str, payload: bytes, stamp_ns: int, sequence: int) -> Output:
        """An output for whoever does not look at its message."""
        return Sample(self._keys[path], None, stamp_ns, sequence), payload

    def sample(self, path: str, payload: bytes, stamp_ns: int, sequence: int) -> Sample:
        key = self._keys[path]
        return Sample(key, key.type.FromString(payload), stamp_ns, sequence)
