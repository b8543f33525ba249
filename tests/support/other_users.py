"""Other users of the machine, as tests need them."""

from __future__ import annotations

import os
import shutil
import tempfile
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


def as_user(uid: int, work: Callable[..., Any], *arguments: Any) -> None:
    """Call `work` in a process of user `uid`; what it raises fails here."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.setgroups([])
            os.setgid(uid)
            os.setuid(uid)
            work(*arguments)
            status = 0
        except BaseException:  # noqa: BLE001  the child must end here, whatever it was
            traceback.print_exc()
        finally:
            os._exit(status)
    assert os.waitpid(child, 0)[1] == 0, f"user {uid} could not do it; see above"


@contextmanager
def open_folder() -> Iterator[Path]:
    """A folder in which everybody may make something of their own, as in /tmp."""
    folder = Path(tempfile.mkdtemp(prefix="tmst", dir="/tmp"))
    folder.chmod(0o1777)
    try:
        yield folder
    finally:
        shutil.rmtree(folder)
