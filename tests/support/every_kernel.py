"""Digests every kernel that there is, wherever it stands; prints how many: run by a test."""

from __future__ import annotations

import importlib
import pkgutil
import sys

from numba.core.dispatcher import Dispatcher

from tramstream.machine.digest import digest_of_function

for part in ("tramstream", "tramstream.processors", "tramstream.analysis"):
    package = importlib.import_module(part)
    for module in pkgutil.walk_packages(package.__path__, f"{part}."):
        importlib.import_module(module.name)
kernels = {
    value.py_func
    for name, module in list(sys.modules.items())
    for value in list(vars(module).values())
    if name.startswith("tramstream") and isinstance(value, Dispatcher)
}
assert len({digest_of_function(each) for each in kernels}) == len(kernels)
print(len(kernels))
