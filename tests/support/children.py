"""Child processes whose memory is measured."""

from __future__ import annotations

import sys
from pathlib import Path

from live import finished

MEASURED = """
import resource, sys, time
{imports}
def peak():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
with open("/proc/self/clear_refs", "w") as refs:
    refs.write("5")  # or the peak would be the parent's before the program was loaded
before, begin = peak(), time.process_time()
try:
    {work}
    said = "done"
except Exception as error:
    said = f"{{type(error).__name__}}: {{error}}"
print((peak() - before) // 1024, round(time.process_time() - begin, 2), said, sep="|")
"""
LIMIT_BYTES = 6 << 30
"""Of address space: what takes all memory ends here and not the machine."""


def measured(imports: str, work: str, *arguments: object) -> tuple[int, float, str]:
    """Run `work` in a process of its own.

    Returns
    -------
    more_mb : int
        Memory that it took at most beyond what the imports take, MB.
    cpu_s : float
        Processor time.
    said : str
        What it raised, or "done".
    """
    program = (
        f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({LIMIT_BYTES},) * 2)\n"
        + MEASURED.format(imports=imports, work=work)
    )
    done = finished(
        [sys.executable, "-c", program, *map(str, arguments)],
        cwd=Path(__file__).parent,
    )
    assert done.returncode == 0, done.stderr
    more_mb, cpu_s, said = done.stdout.rstrip("\n").split("\n")[-1].split("|", 2)
    return int(more_mb), float(cpu_s), said
