"""Run a command of this machine in a small virtual machine with a kernel of its own.

    python -m tests.guest.boot KERNEL COMMAND…

KERNEL is an unpacked Debian kernel package (`dpkg-deb -x linux-image-….deb KERNEL`). The guest sees
the root of this machine read-only, runs COMMAND as root in it, and is switched off.
"""

import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

BASE = ("virtio_pci", "9pnet_virtio", "9p")  # modules with which the guest reads this machine
ENDED = re.compile(r"^guest: ended with status (\d+)\s*$", re.M)
INIT = """#!/bin/busybox sh
/bin/busybox --install -s /bin
mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev
for module in {base}; do insmod /modules/$module || echo "guest: no $module"; done
mount -t 9p -o trans=virtio,version=9p2000.L,ro,msize=524288,cache=loose host /host
for module in {modules}; do insmod /host$module || echo "guest: no $module"; done
for place in proc sys dev; do mount --bind /$place /host/$place; done
mkdir -p /dev/shm; mount -t tmpfs shm /host/dev/shm
for place in tmp run; do mount -t tmpfs tmp /host/$place; done
ip link set lo up
chroot /host /bin/sh -c {command}
echo "guest: ended with status $?"
poweroff -f
"""


def boot(kernel: Path, command: Sequence[str], *, modules: Sequence[str], limit_s: float) -> int:
    """Run the command in a guest; return its exit status, 124 where it did not end in time."""
    (image,) = kernel.glob("boot/vmlinuz-*")
    found = modules_of(kernel)
    base, wanted = (list(in_order(found, names)) for names in (BASE, modules))
    with tempfile.TemporaryDirectory() as folder:
        archive = Path(folder) / "init.cpio"
        script = INIT.format(
            base=" ".join(p.name for p in base),
            modules=" ".join(str(p.resolve()) for p in wanted if p not in base),
            command=shlex.quote(shlex.join(command)),
        )
        archive.write_bytes(cpio({
            "init": (0o100755, script.encode()),
            "bin/busybox": (0o100755, Path("/bin/busybox").read_bytes()),
            **{f"modules/{p.name}": (0o100644, p.read_bytes()) for p in base},
        }))  # fmt: skip
        return _run(image, archive, limit_s)


def _run(image: Path, archive: Path, limit_s: float) -> int:
    words = [
        "qemu-system-x86_64", "-m", "2048", "-smp", "2", "-accel", "tcg", "-cpu", "max",
        "-nographic", "-no-reboot", "-kernel", str(image), "-initrd", str(archive),
        "-append", "console=ttyS0 quiet panic=-1",
        "-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap",
    ]  # fmt: skip
    with tempfile.TemporaryFile() as log:
        try:
            subprocess.run(
                words, stdin=subprocess.DEVNULL, stdout=log, timeout=limit_s, check=False
            )
            status = 125
        except subprocess.TimeoutExpired:
            status = 124
        log.seek(0)
        output = log.read().decode("utf-8", "replace")
    print(output)
    ended = ENDED.search(output)
    return int(ended[1]) if ended else status


def modules_of(kernel: Path) -> dict[str, Path]:
    """Return the file of every module by its name."""
    return {p.stem.replace("-", "_"): p for p in kernel.glob("lib/modules/*/kernel/**/*.ko")}


def in_order(found: dict[str, Path], names: Sequence[str]) -> Iterator[Path]:
    """Yield files of modules, each after those that it depends on; built-in ones are left out."""
    seen: set[str] = set()

    def after(name: str) -> Iterator[Path]:
        name = name.replace("-", "_")
        if name in seen or name not in found:
            return
        seen.add(name)
        depends = re.search(rb"\0depends=([^\0]*)\0", b"\0" + found[name].read_bytes())
        for other in (depends[1].decode() if depends else "").split(","):
            yield from after(other)
        yield found[name]

    for name in names:
        yield from after(name)


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


if __name__ == "__main__":
    sys.exit(boot(Path(sys.argv[1]), sys.argv[2:], modules=("vhci_hcd",), limit_s=600))
