"""Work on all cores whose results are taken as they come, until somebody presses Ctrl-C."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from typing import Any, NamedTuple

from tramstream.cli.terminal.session import stop_on_signals

LOOK_S = 0.5
"""How often a signal is looked for."""


class Job(NamedTuple):
    """A function of a module and what it is called with; both go to another process."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]


def results(jobs: Sequence[Job], most: int = 0) -> Iterator[tuple[Job, Any]]:
    """Each job with its result, as they are done; after a signal no more.

    Parameters
    ----------
    jobs : sequence of Job
    most : int
        Processes; 0 is one a core.
    """
    stop = stop_on_signals()
    workers = max(min(most or os.cpu_count() or 1, len(jobs)), 1)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=_leave_signals) as pool:
        waiting: dict[Future[Any], Job] = {
            pool.submit(job.function, *job.arguments): job for job in jobs
        }
        while waiting:
            done, _ = wait(waiting, LOOK_S, return_when="FIRST_COMPLETED")
            for future in done:
                yield waiting.pop(future), future.result()
            if stop.is_set():
                _give_up(pool)
                return


def shown(jobs: Sequence[Job], most: int = 0, what: str = "jobs") -> Iterator[tuple[Job, Any]]:
    """Each job with its result under one line of progress.

    A single job, or one worker, stays in this process, for another would take seconds to begin.
    """
    from concurrent.futures.process import BrokenProcessPool

    from rich.console import Console
    from rich.progress import Progress

    from tramstream.cli.terminal.session import say

    alone = most == 1 or len(jobs) == 1
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(what, total=len(jobs))
        try:
            for done in _here(jobs) if alone else results(jobs, most):
                progress.advance(task)
                yield done
        except BrokenProcessPool:
            say("a process was killed, perhaps for want of memory; fewer --workers take less")


def _here(jobs: Sequence[Job]) -> Iterator[tuple[Job, Any]]:
    """Do the jobs in this process, until a signal."""
    stop = stop_on_signals()
    for job in jobs:
        if stop.is_set():
            return
        yield job, job.function(*job.arguments)


def _leave_signals() -> None:
    """Ctrl-C is for the parent alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _give_up(pool: ProcessPoolExecutor) -> None:
    """Drop what has not begun; what has is ended."""
    processes = list((getattr(pool, "_processes", None) or {}).values())
    pool.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.terminate()
