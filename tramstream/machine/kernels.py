"""Compiled kernels: machine code of one function for one signature, kept in one file.

A file's name holds a digest of all that its code was made of: the function and every function and
constant that it reaches (`tramstream/machine/digest.py`), the types of its arguments, the
processor, the compiler. So an edit makes only those kernels anew whose code it can change, and two
checkouts and an installed wheel share what they have in common.

numba's own cache knows a kernel by the path and content of its file, and not the kernels that it
calls.

Two processes that need the same kernel do not both compile it: one locks a byte of the file `lock`,
the other waits for it. The system takes a lock from whoever dies, and nobody waits longer than
`PATIENCE_S` for somebody who stands still.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import pickle
import platform
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import compiler, serialize
from numba.core.caching import _Cache

from tramstream import private
from tramstream.machine import machine_code
from tramstream.machine.digest import digest_of_function, digest_of_type

F = TypeVar("F", bound=Callable[..., Any])
PATIENCE_S = 120.0
"""The largest kernel takes 26 s with what it calls while both cores are busy twice over."""
POLL_S = 0.02
SEAL = hashlib.sha256().digest_size
"""Bytes before the code, a digest of it: a power cut leaves files that are empty or half zero."""
_AGAIN_S = 86400.0
"""A file's time of last use is set once a day at most."""
_used: set[str] = set()


class KernelCache(_Cache):
    """Where numba looks for machine code of one function before it compiles, and puts it after."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._enabled = True
        self._digest = ""
        self._claims: dict[Path, int] = {}

    @property
    def cache_path(self) -> str:
        """The folder, as numba's statistics ask for it."""
        return str(machine_code.folder())

    def enable(self) -> None:
        """Look and put from now on."""
        self._enabled = True

    def disable(self) -> None:
        """Compile always."""
        self._enabled = False

    def flush(self) -> None:
        """Forget nothing: what is there belongs to others too, and names tell what it is of."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Give the machine code for a signature; None if it has to be compiled, by this process."""
        target_context.refresh()
        if not self._enabled:
            return None
        path = self._path(sig, target_context.codegen())
        reduced = _read(path)
        if reduced is None:
            self._claims[path] = _claim(path)
            reduced = _read(path)  # by another process meanwhile
        if reduced is None:
            return None
        self._release(path)
        _used.add(path.name)
        result: Any = compiler.CompileResult
        return result._rebuild(target_context, *reduced)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled."""
        if not self._enabled:
            return
        path = self._path(sig, data.codegen)
        if not data.lifted and not data.library.has_dynamic_globals:
            pickler: Any = serialize
            payload = pickler.dumps(data._reduce())
            private.write(path, hashlib.sha256(payload).digest() + payload)
            _used.add(path.name)
        self._release(path)

    def _path(self, sig: Any, codegen: Any) -> Path:
        """The file of one signature; the digest is made late, when all globals are there."""
        if not self._digest:
            self._digest = digest_of_function(self._function)
        digest = hashlib.sha256(f"{self._digest}{_compiler()}{codegen.magic_tuple()}".encode())
        for each in sig if isinstance(sig, tuple) else (*sig.args, sig.return_type):
            digest.update(digest_of_type(each).encode())
        name = f"{self._function.__module__}.{self._function.__qualname__}"
        name = name.removeprefix("tramstream.").replace("<locals>.", "")
        return machine_code.folder() / f"{name}-{digest.hexdigest()[:24]}.nbc"

    def _release(self, path: Path) -> None:
        place = self._claims.pop(path, -1)
        if place >= 0:
            fcntl.lockf(_locks(machine_code.folder()), fcntl.LOCK_UN, 1, place)


def compiled(function: F) -> F:
    """Compile with numba when first called; keep the machine code on disk.

    No fast-math: NaN must stay NaN, and two machines of a kind must agree to the bit.
    """
    jitted: Any = numba.njit(error_model="numpy")(function)
    jitted._cache = KernelCache(function)
    return cast(F, jitted)


def bound(kernel: F, *arguments: Any) -> F:
    """Give the machine code of a kernel for arguments of the types of these.

    It looks no types up: those of a tuple of fourteen arrays take longer than the call. Whoever
    hands in others gets a TypeError.
    """
    jitted: Any = kernel
    signature = tuple(map(numba.typeof, arguments))
    jitted.compile(signature)
    return cast(F, jitted.overloads[signature].entry_point)


def used() -> frozenset[str]:
    """Names of the files that this process has loaded or made."""
    return frozenset(_used)


@cache
def _compiler() -> str:
    return f"{platform.python_version()} {numba.__version__} {version('llvmlite')}"


def _read(path: Path) -> Any:
    """What a file holds; None if it is not there, torn, or of a class that is no more."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    payload = data[SEAL:]
    if hashlib.sha256(payload).digest() != data[:SEAL]:
        return None
    with suppress(OSError):  # a read-only disk: nobody prunes there either
        if time.time() - path.stat().st_mtime > _AGAIN_S:
            os.utime(path)
    return pickle.loads(payload)


@cache
def _locks(folder: Path) -> int:
    """The file of which bytes are locked, open as long as the process lives.

    Closing any handle of it would give up all locks of the process.
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
    return os.open(folder / "lock", flags, 0o600)


def _claim(path: Path) -> int:
    """Wait until nobody else makes this file, and say that we do; which byte says so, or -1."""
    handle = _locks(path.parent)
    place = 1 + int.from_bytes(hashlib.sha256(path.name.encode()).digest()[:6], "big")
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        try:
            fcntl.lockf(handle, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
        except BlockingIOError:
            time.sleep(POLL_S)
        else:
            return place
    return -1
