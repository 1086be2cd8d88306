"""Run a command of this machine in a small virtual machine with a kernel of its own.

    python -m tests.guest.boot KERNEL COMMAND…

KERNEL is an unpacked Debian kernel package, see tests.guest.kernel. The guest sees the root of this
machine read-only, runs COMMAND as root, in this folder with an empty home, and is switched off. It
has virtual USB ports on both sides of the cable and a virtual webcam, /dev/video0.
"""

import gzip
import lzma
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

BUSYBOX = Path("/bin/busybox")
LIMIT_S = 600.0
UNPACK_S = 60.0  # one module
BASE = ("virtio_pci", "9pnet_virtio", "9p")  # modules with which the guest reads this machine
MODULES = (
    "vhci_hcd",  # a host controller for USB/IP
    "dummy_hcd is_super_speed=1",  # a host controller and a device controller, wired to each other
    "usb_f_fs",
    "vivid node_types=0x1",  # a V4L2 capture device
)
ENDED = re.compile(r"guest: ended with status (\d+)")
INIT = """#!/bin/busybox sh
/bin/busybox --install -s /bin
mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev
load() {{ insmod "/modules/$@" || echo "guest: no module $1"; }}
{base}
mount -t 9p -o trans=virtio,version=9p2000.L,ro,msize=524288,cache=loose host /host
{modules}
for place in proc sys dev; do mount --bind /$place /host/$place; done
mount -t configfs config /host/sys/kernel/config
mkdir -p /dev/shm; mount -t tmpfs shm /host/dev/shm
mount -t tmpfs run /host/run
ip link set lo up
export HOME=/run TMPDIR=/run PYTHONDONTWRITEBYTECODE=1
echo "guest: ready after $(cut -d' ' -f1 /proc/uptime) s"
chroot /host /bin/sh -c {command}
echo "guest: ended with status $?"
poweroff -f
"""


def missing_programs() -> str:
    """Return what is needed beside a kernel and not there, in a sentence; empty: nothing."""
    if platform.machine() != "x86_64":
        return f"guest: expected a machine of x86_64, got {platform.machine()}"
    if shutil.which("qemu-system-x86_64") is None:
        return "guest: no QEMU; Debian and Ubuntu: apt-get install qemu-system-x86"
    if not BUSYBOX.exists() or b"/lib64/ld-linux" in BUSYBOX.read_bytes()[:4096]:
        return f"guest: {BUSYBOX}: expected a static one; apt-get install busybox-static"
    return ""


def missing(kernel: Path) -> str:
    """Return what is needed and not there, in a sentence; empty: nothing."""
    if why_not := missing_programs():
        return why_not
    if len(images := list(kernel.glob("boot/vmlinuz-*"))) != 1:
        return (
            f"guest: {kernel}: expected one unpacked kernel, got {len(images)}; "
            "`make guest-kernel` gets one"
        )
    found = modules_of(kernel)
    names = [line.split()[0] for line in (*BASE, *MODULES)]
    if lacking := [name for name in names if name not in {*found, *built_in(kernel)}]:
        return f"guest: {kernel}: it has no module {', '.join(lacking)}"
    compressed = any(path.suffix == ".zst" for path in found.values())
    if compressed and shutil.which("zstd") is None:
        return "guest: its modules are compressed, and there is no zstd; apt-get install zstd"
    return ""


def boot(kernel: Path, command: Sequence[str], *, limit_s: float = LIMIT_S) -> int:
    """Run the command in a guest; return its exit status, 124 where it did not end in time."""
    (image,) = kernel.glob("boot/vmlinuz-*")
    found = modules_of(kernel)
    base = list(in_order(found, BASE))
    modules = [line for line in in_order(found, MODULES) if line not in base]
    files = {
        f"modules/{name}.ko": (0o100644, module_bytes(found[name]))
        for name in (line.split()[0] for line in base + modules)
    }
    words = f"cd {shlex.quote(str(Path.cwd()))} && {shlex.join(command)}"
    script = INIT.format(base=_loaded(base), modules=_loaded(modules), command=shlex.quote(words))
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "init.cpio"
        archive.write_bytes(cpio({
            "init": (0o100755, script.encode()),
            "bin/busybox": (0o100755, BUSYBOX.read_bytes()),
            **files,
        }))  # fmt: skip
        return _run(image, archive, limit_s, options=_built_in_options(kernel))


def _built_in_options(kernel: Path) -> list[str]:
    """Return the parameters of modules that the kernel has built in, for its command line."""
    inside = built_in(kernel)
    lines = [line.split() for line in (*BASE, *MODULES)]
    return [f"{name}.{option}" for name, *rest in lines if name in inside for option in rest]


def _loaded(lines: Sequence[str]) -> str:
    """Return the commands that load modules; what follows a name are its parameters."""
    return "\n".join(f"load {' '.join([f'{n}.ko', *rest])}" for n, *rest in map(str.split, lines))


def _run(image: Path, archive: Path, limit_s: float, *, options: Sequence[str] = ()) -> int:
    # what protects a kernel from its processor costs an emulated one most of its time
    usual = ("console=ttyS0", "quiet", "panic=-1", "mitigations=off", "apparmor=0", "audit=0")
    words = [
        # with a second processor an emulated kernel takes 1.8 times the time of processors
        "qemu-system-x86_64", "-m", "1024", "-smp", "1", "-accel", "tcg", "-cpu", "Nehalem",
        "-nodefaults", "-display", "none", "-serial", "stdio", "-no-reboot",
        "-kernel", str(image), "-initrd", str(archive),
        "-append", " ".join([*usual, *options]),
        "-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap",
    ]  # fmt: skip
    status, late = 125, threading.Event()
    with subprocess.Popen(
        words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, errors="replace"
    ) as guest:

        def end() -> None:
            late.set()
            guest.kill()

        timer = threading.Timer(limit_s, end)
        timer.start()
        try:
            for line in guest.stdout or ():
                print(line.rstrip(), flush=True)
                if ended := ENDED.search(line):
                    status = int(ended[1])
        finally:
            timer.cancel()
            guest.kill()
    if status == 125:
        print(f"guest: {'not ready in time' if late.is_set() else 'it ended without a status'}")
    return 124 if late.is_set() else status


def modules_of(kernel: Path) -> dict[str, Path]:
    """Return the file of every module by its name."""
    files = kernel.glob("**/modules/*/kernel/**/*.ko*")
    return {p.name.split(".ko")[0].replace("-", "_"): p for p in files}


def built_in(kernel: Path) -> set[str]:
    """Return the names of the modules that are part of the kernel's image."""
    lists = kernel.glob("**/modules/*/modules.builtin")
    paths = (line.strip() for one in lists for line in one.read_text().splitlines())
    return {Path(path).name.removesuffix(".ko").replace("-", "_") for path in paths}


def module_bytes(path: Path) -> bytes:
    """Return a module, which some kernels compress; .zst takes the program zstd."""
    if path.suffix == ".xz":
        return lzma.decompress(path.read_bytes())
    if path.suffix == ".gz":
        return gzip.decompress(path.read_bytes())
    if path.suffix == ".zst":
        words = ["zstd", "--decompress", "--stdout", "--quiet", str(path)]
        return subprocess.run(words, check=True, capture_output=True, timeout=UNPACK_S).stdout
    return path.read_bytes()


def in_order(found: dict[str, Path], wanted: Sequence[str]) -> Iterator[str]:
    """Yield modules with their parameters, each after those that it depends on.

    What is not found is left out: it is built into the kernel.
    """
    seen: set[str] = set()

    def after(name: str, *parameters: str) -> Iterator[str]:
        name = name.replace("-", "_")
        if name in seen or name not in found:
            return
        seen.add(name)
        depends = re.search(rb"\0depends=([^\0]*)\0", b"\0" + module_bytes(found[name]))
        for other in (depends[1].decode() if depends else "").split(","):
            yield from after(other)
        yield " ".join([name, *parameters])

    for line in wanted:
        yield from after(*line.split())


def cpio(files: dict[str, tuple[int, bytes]]) -> bytes:
    """Return an archive in the format "newc" that the kernel unpacks as its first root."""
    folders = {str(parent) for name in files for parent in Path(name).parents} - {"."}
    folders |= {"proc", "sys", "dev", "host"}
    entries = [(name, 0o040755, b"") for name in sorted(folders)]
    entries += [(name, mode, data) for name, (mode, data) in files.items()]
    archive = b"".join(_entry(*entry, number) for number, entry in enumerate(entries, 1))
    return archive + _entry("TRAILER!!!", 0, b"", 0)


def _entry(name: str, mode: int, data: bytes, number: int) -> bytes:
    path = name.encode() + b"\0"
    fields = (number, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(path), 0)
    head = b"070701" + b"".join(b"%08X" % field for field in fields) + path
    return head + bytes(-len(head) % 4) + data + bytes(-len(data) % 4)


def main(kernel: str, *command: str) -> int:
    """Run the command, or say what is missing."""
    if why_not := missing(Path(kernel)):
        print(why_not, file=sys.stderr)
        return 1
    return boot(Path(kernel), command)


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit("usage: python -m tests.guest.boot KERNEL COMMAND…")
    sys.exit(main(*sys.argv[1:]))
