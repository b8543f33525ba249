"""Run `guest_*.py` on a real kernel with CAN, inside qemu: `python tests/vcan/run.py`.

Containers and many servers have a kernel without CAN. This boots Debian's in software (no KVM,
no network in the guest), with the host's `/` mounted read-only, so that the guest runs this
very interpreter and this very working tree. The guest has

- `vcan0`, made by the tests themselves, and
- `can0` and `can1`: two SJA1000 controllers (emulated Kvaser cards) on one emulated bus. They have
  what a virtual interface lacks: bit rate, bus state, a queue of their own.

Needs `qemu-system-x86`, `busybox-static` and `iproute2`; the kernel's package comes by `apt-get
download` once, is kept in the cache folder and is never installed. Whatever follows the options
goes to pytest in the guest: `run.py -k flood -s`. A machine with much else to do wants
`--limit-s 3600`. The exit status is pytest's, 97 if the guest
never got so far, 98 if something is absent here.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parent.parent
NO_RESULT, ABSENT = 97, 98
BOOT_AND_TESTS_S = 600.0
"""One core of software emulation needs a sixth of it."""
QEMU = "qemu-system-x86_64"
KERNEL_PATTERN = "linux-image-*_amd64.deb"
MODULES = (
    *("virtio_pci", "9pnet_virtio", "9p"),
    *("can-raw", "can-dev", "vcan", "kvaser_pci"),
)
GUEST_TESTS = ("guest_frames.py", "guest_link.py", "guest_doctor.py")
TAIL = "VCAN-EXIT "
_PHYSICAL_MIB = 1024


class AbsentError(Exception):
    """Something that has to be installed first; the text says how."""


def cache_folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "tramstream-vcan"


def tools() -> dict[str, str]:
    """Programs of the host, by name.

    Raises
    ------
    AbsentError
        With the package that holds the first one that is absent.
    """
    packages = {
        QEMU: "qemu-system-x86",
        "busybox": "busybox-static",
        "dpkg": "dpkg",
        "ip": "iproute2",
    }
    path = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"  # where ip is, for people without them
    found = {}
    for name, package in packages.items():
        program = shutil.which(name, path=path)
        if program is None:
            raise AbsentError(f"{name} is absent: apt-get install {package}")
        found[name] = program
    if b"ld-linux" in Path(found["busybox"]).read_bytes()[:4096]:
        raise AbsentError("busybox is not the static one: apt-get install busybox-static")
    return found


def kernel_package(cache: Path, download: bool = True) -> Path:
    """The kernel's package: from the cache, or fetched into it.

    Raises
    ------
    AbsentError
        If there is none.
    """
    kept = sorted(cache.glob(KERNEL_PATTERN), key=lambda path: path.stat().st_mtime)
    if kept:
        return kept[-1]
    if not download or shutil.which("apt-get") is None:
        raise AbsentError(
            f"no kernel package in {cache}: put Debian's linux-image-*_amd64.deb there, or run "
            f"{Path(__file__).name} once where apt-get is"
        )
    cache.mkdir(parents=True, exist_ok=True)
    shown = _output("apt-cache", "depends", "linux-image-amd64")
    match = re.search(r"Depends: (linux-image-\d\S*-amd64)", shown)
    if match is None:
        raise AbsentError("apt knows no linux-image-amd64: apt-get update, on Debian's amd64")
    name = match.group(1)
    print(f"downloading {name} into {cache}", flush=True)
    done = subprocess.run(["apt-get", "download", name], cwd=cache, check=False)
    kept = sorted(cache.glob(KERNEL_PATTERN))
    if done.returncode or not kept:
        raise AbsentError(f"apt-get download {name} failed: apt-get update")
    return kept[-1]


def _output(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout


# The first file system ----------------------------------------------------------------------------
def module_files(folder: Path, names: tuple[str, ...]) -> list[Path]:
    """Files of modules and of what they depend on, in the order of loading; built-in ones drop out.

    The package has no `modules.dep` (its installation writes it), but each module names what it
    depends on.
    """
    files = {path.stem.replace("-", "_"): path for path in folder.rglob("*.ko")}
    order: list[Path] = []

    def add(name: str) -> None:
        path = files.get(name.replace("-", "_"))
        if path is None or path in order:
            return
        for line in path.read_bytes().split(b"\0"):
            if line.startswith(b"depends=") and line != b"depends=":
                for needed in line[8:].decode().split(","):
                    add(needed)
        order.append(path)

    for name in names:
        add(name)
    return order


def archive(entries: dict[str, tuple[int, bytes]]) -> bytes:
    """A cpio archive (`newc`) of paths with mode and content."""
    out = bytearray()
    for number, (path, (mode, data)) in enumerate([*entries.items(), ("TRAILER!!!", (0, b""))], 1):
        name = path.encode() + b"\0"
        fields = (number, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(name), 0)
        out += b"070701" + b"".join(b"%08X" % field for field in fields) + name
        out += bytes(-len(out) % 4) + data
        out += bytes(-len(out) % 4)
    return bytes(out)


def init_script(modules: list[str], arguments: list[str]) -> str:
    """What the guest does first, and all it does."""
    python = sys.executable
    command = [
        *(python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "guest_bus"),
        *("-o", "addopts=--strict-markers", "--rootdir", str(REPOSITORY)),
        *("--durations=5", "--basetemp=/dev/shm/pytest"),
        *(*arguments, *(str(HERE / name) for name in GUEST_TESTS)),
    ]
    loads = "\n".join(f"insmod /modules/{name}" for name in modules)
    return f"""#!/bin/busybox sh
/bin/busybox --install -s /bin
export PATH=/bin HOME=/root
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t devtmpfs dev /dev
echo 3 > /proc/sys/kernel/printk
{loads}
mount -t 9p -o trans=virtio,version=9p2000.L,ro,cache=loose,msize=512000 host /host \\
    || echo "9p: no host file system"
mount -t proc proc /host/proc
mount -t sysfs sysfs /host/sys
mount -t devtmpfs dev /host/dev
mkdir -p /host/dev/shm /host/dev/pts
mount -t tmpfs tmpfs /host/dev/shm
mount -t tmpfs tmpfs /host/run
mount -t devpts devpts /host/dev/pts
chmod 1777 /host/dev/shm
ip link set lo up
echo "guest: $(uname -r), $(cut -d' ' -f1 /proc/uptime) s after the start"
cat > /host/run/tests.sh <<'END'
export PATH={Path(python).parent}:/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin
export HOME=/run TMPDIR=/dev/shm PYTHONDONTWRITEBYTECODE=1 PYTHONUNBUFFERED=1 NO_COLOR=1
export PYTHONPATH={shlex.quote(str(HERE))}
export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
cd {shlex.quote(str(REPOSITORY))}
{shlex.join(command)}
echo {TAIL}$?
END
chroot /host /bin/sh /run/tests.sh
sync
poweroff -f
"""


def first_file_system(unpacked: Path, busybox: str, arguments: list[str]) -> bytes:
    """The archive that the guest starts from."""
    modules = module_files(unpacked / "lib" / "modules", MODULES)
    folders = ("bin", "dev", "etc", "host", "modules", "proc", "root", "run", "sys", "tmp")
    entries: dict[str, tuple[int, bytes]] = dict.fromkeys(folders, (0o040755, b""))
    entries["bin/busybox"] = (0o100755, Path(busybox).read_bytes())
    for path in modules:
        entries[f"modules/{path.name}"] = (0o100644, path.read_bytes())
    script = init_script([path.name for path in modules], arguments)
    entries["init"] = (0o100755, script.encode())
    return archive(entries)


# The guest ----------------------------------------------------------------------------------------
def boot(kernel: Path, initrd: Path, qemu: str, limit_s: float = BOOT_AND_TESTS_S) -> int:
    """Start the guest, show what it says, and return its verdict."""
    command = [
        *(qemu, "-accel", "tcg", "-cpu", "max", "-smp", "1", "-m", str(_PHYSICAL_MIB)),
        *("-nodefaults", "-no-user-config", "-display", "none", "-no-reboot", "-net", "none"),
        *("-serial", "stdio", "-kernel", str(kernel), "-initrd", str(initrd)),
        *("-append", "console=ttyS0 quiet panic=-1 mitigations=off"),
        *("-fsdev", "local,id=host,path=/,security_model=none,readonly=on,multidevs=remap"),
        *("-device", "virtio-9p-pci,fsdev=host,mount_tag=host"),
        *("-object", "can-bus,id=wire"),
        *("-device", "kvaser_pci,canbus=wire", "-device", "kvaser_pci,canbus=wire"),
    ]
    started_s = time.monotonic()
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    watch = threading.Timer(limit_s, process.kill)
    watch.start()
    verdict = NO_RESULT
    try:
        assert process.stdout is not None
        for octets in process.stdout:
            line = octets.decode(errors="replace").rstrip()
            if line.startswith(TAIL) and line[len(TAIL) :].isdigit():
                verdict = int(line[len(TAIL) :])
            else:
                print(line, flush=True)
        process.wait()
    finally:
        watch.cancel()
        if process.poll() is None:
            process.kill()
            process.wait()
    took_s = time.monotonic() - started_s
    text = {0: "passed", NO_RESULT: "FAILED: the guest did not come to its end"}
    print(f"vcan: {text.get(verdict, 'FAILED')} (status {verdict}, {took_s:.0f} s)", flush=True)
    return verdict


def run(arguments: list[str], kernel: Path, limit_s: float = BOOT_AND_TESTS_S) -> int:
    """Unpack, build and boot in a temporary folder; the guest's verdict."""
    programs = tools()
    found = importlib.util.find_spec("tramstream")
    if found is None or importlib.util.find_spec("pytest") is None:
        raise AbsentError(f"{sys.executable} lacks tramstream: pip install -e '.[test]'")
    print(f"{kernel.name}; {found.origin}", flush=True)
    with tempfile.TemporaryDirectory(prefix="tramstream-vcan-") as name:
        folder = Path(name)
        subprocess.run([programs["dpkg"], "-x", str(kernel), str(folder / "deb")], check=True)
        initrd = folder / "initrd"
        initrd.write_bytes(first_file_system(folder / "deb", programs["busybox"], arguments))
        image = next((folder / "deb" / "boot").glob("vmlinuz-*"))
        return boot(image, initrd, programs[QEMU], limit_s)


def main() -> int:
    parser = argparse.ArgumentParser(description="Test SocketCAN on a real kernel, in qemu.")
    parser.add_argument("--kernel", type=Path, help="kernel package (.deb), instead of apt's")
    parser.add_argument(
        "--limit-s", type=float, default=BOOT_AND_TESTS_S, help="end the guest after so long"
    )
    options, arguments = parser.parse_known_args()
    try:
        tools()
        kernel = options.kernel or kernel_package(cache_folder())
        return run(arguments, kernel, options.limit_s)
    except AbsentError as error:
        print(f"vcan: {error}", file=sys.stderr)
        return ABSENT


if __name__ == "__main__":
    sys.exit(main())
