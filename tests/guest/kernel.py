"""Get the kernel for tests.guest.boot: Debian's newest one, downloaded and unpacked, not installed.

    python -m tests.guest.kernel FOLDER

Does nothing where FOLDER has one; ends with a sentence and status 1 where the guest cannot run.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.guest.boot import missing, missing_programs

PACKAGE = "linux-image-amd64"  # it depends on that of the newest version
NEEDED_BYTES = 1 << 30  # of the package, and unpacked
LIMIT_S = 600.0


class NoKernel(Exception):
    """Why there is none."""


def get(folder: Path) -> None:
    """Download and unpack the kernel; raises `NoKernel` and leaves nothing then."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    if folder.exists():
        raise NoKernel(f"{folder}: expected a folder with one kernel, or none; remove this one")
    free_bytes = shutil.disk_usage(folder.parent).free
    if free_bytes < NEEDED_BYTES:
        raise NoKernel(
            f"{folder}: expected {NEEDED_BYTES >> 20} MiB of free space, got {free_bytes >> 20}"
        )
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f"{folder.name}-") as name:
        place = Path(name)
        place.chmod(0o755)  # apt downloads as a user of its own
        run(["apt-get", "download", _package()], place)
        (package,) = place.glob("*.deb")
        run(["dpkg-deb", "-x", package.name, "kernel"], place)
        (place / "kernel").rename(folder)


def _package() -> str:
    about = run(["apt-cache", "show", "--no-all-versions", PACKAGE], Path.cwd())
    found = re.search(r"^Depends:.*?\b(linux-image-\d[\w.+-]*)", about, re.M)
    if found is None:
        raise NoKernel(f"{PACKAGE}: expected the package of a kernel among what it depends on")
    return found[1]


def run(command: Sequence[str], place: Path) -> str:
    """Return the output of a command that works in a folder; raises `NoKernel`."""
    try:
        done = subprocess.run(
            command, cwd=place, capture_output=True, text=True, timeout=LIMIT_S, check=False
        )
    except FileNotFoundError:
        raise NoKernel(f"{command[0]}: not there; the kernel is one of Debian's packages") from None
    except subprocess.TimeoutExpired:
        raise NoKernel(f"{command[0]}: not ready after {LIMIT_S:.0f} s") from None
    if done.returncode:
        errors = [line for line in done.stderr.splitlines() if line.startswith(("E:", "N:"))]
        why = (errors or done.stderr.splitlines() or ["no reason given"])[0]
        raise NoKernel(f"{' '.join(command)}: {why}; `apt-get update` may help")
    return done.stdout


def main(folder: Path) -> int:
    """Return 0 when the guest can run."""
    why_not = missing_programs()
    try:
        if not why_not and not any(folder.glob("boot/vmlinuz-*")):
            get(folder)
    except (NoKernel, OSError) as error:
        why_not = f"guest: {error}"
    if why_not := why_not or missing(folder):
        print(why_not, file=sys.stderr)
    return 1 if why_not else 0


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m tests.guest.kernel FOLDER")
    sys.exit(main(Path(sys.argv[1])))
