"""Fixtures of all tests."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil
import pytest
from hypothesis import HealthCheck, settings
from live import until

if TYPE_CHECKING:
    from prague import Prague

REPOSITORY = Path(__file__).resolve().parent.parent
MARK = "TRAMSTREAM_TEST_RUN"
"""Environment variable by which a process is known to be this run's, whoever its parent is."""

# A busy machine is slow, not wrong: no example has a time, and making examples may be slow. What
# failed is printed as a line that repeats it.
settings.register_profile(
    "house", deadline=None, print_blob=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("house")


def pytest_configure() -> None:
    os.environ[MARK] = str(os.getpid())
    # Whoever starts the tests in the background (`&`, nohup) has these ignored, and what the tests
    # start would too.
    for number in (signal.SIGINT, signal.SIGHUP):
        if signal.getsignal(number) == signal.SIG_IGN:
            default = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
            signal.signal(number, default)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Keep the rubbish collector off what collection makes: a million objects that stay.

    It would look through them 29 times while they are made, and again in many a test, 0.9 s each.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give whole modules to the workers of `-n 2`, in their order: each has fixtures of its own."""
    from xdist.scheduler import LoadFileScheduling

    config.option.loadscopereorder = False
    return LoadFileScheduling(config, log)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with the modules that wait for real processes, where workers share the modules.

    They are the longest: one that comes last would be waited for by all other workers.
    """
    if hasattr(config, "workerinput"):
        items.sort(key=_is_quick(items))


def _is_quick(items: list[pytest.Item]) -> Callable[[pytest.Item], bool]:
    slow = {item.path for item in items if item.get_closest_marker("live")}
    return lambda item: item.path not in slow


def _left() -> list[str]:
    """Command lines of processes that tests have begun and not ended."""
    found = []
    for process in psutil.process_iter():
        try:
            if process.environ().get(MARK) == str(os.getpid()) and not _serves(process):
                found.append(f"{process.pid}: {' '.join(process.cmdline())}")
        except (psutil.NoSuchProcess, psutil.AccessDenied, psutil.ZombieProcess):
            continue
    return found


def _serves(process: psutil.Process) -> bool:
    """Whether it is the interpreter's own server, which ends with this run."""
    return process.ppid() == os.getpid() and "multiprocessing." in " ".join(process.cmdline())


@pytest.fixture(scope="module", autouse=True)
def no_process_is_left_behind() -> Iterator[None]:
    """Wait for the end of all that the module's tests have begun; name what never ends."""
    yield
    until(lambda: not _left(), "the end of what tests have begun", _left)


@pytest.fixture(scope="module", autouse=True)
def what_a_module_has_cached_ends_with_it(request: pytest.FixtureRequest) -> Iterator[None]:
    """Forget rides that only the module's own tests need: those of all modules are gigabytes."""
    yield
    for each in vars(request.module).values():
        if hasattr(each, "cache_clear") and each.__module__ == request.module.__name__:
            each.cache_clear()


NO_DATA = "no recordings at"


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say in one line what has not been shown because real recordings are absent."""
    skipped = terminalreporter.stats.get("skipped", [])
    missed = sum(NO_DATA in str(each.longrepr) for each in skipped)
    if missed:
        terminalreporter.write_line(
            f"NOT SHOWN: {missed} tests on real recordings were left out, for there are none; "
            "README.md, section Tests, says what to do",
            yellow=True,
        )


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of real recordings; skips, naming the folder, where it is absent."""
    chosen = os.environ.get("TRAMSTREAM_DATA")
    folder = Path(chosen) if chosen else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"{NO_DATA} {folder}; set TRAMSTREAM_DATA to their folder")
    return folder


@pytest.fixture(scope="session")
def prague(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Prague:
    """Prague's network; building it takes 5 s, once in a run, however many workers."""
    from prague import shared

    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # that of all workers
    return shared(data_dir / "maps" / "prague", folder / "prague")
