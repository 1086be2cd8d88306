"""The attacks of another user: `python -m bench.other_user_attempts UID VICTIM_UID SECONDS`.

Started by root, the process first becomes the user UID. Then it repeatedly tries to enter, read,
alter, replace, connect to and stop what user VICTIM_UID has of fovea, and to make its files first.
At the end it prints its successes as JSON. Only the standard library is used.
"""

import contextlib
import ctypes
import json
import os
import secrets
import signal
import socket
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOTS = (Path("/dev/shm"), Path(tempfile.gettempdir()))
NODE_MODULE = b"pipeline.node.process"
DECOY = "decoy"  # in the names of what is open on purpose, to show that attacks can succeed
GUESSES = 20  # folders made in every round, which a run might use
PTRACE_ATTACH, PTRACE_DETACH = 16, 17
LISTENING = "0A"  # the state of a TCP socket as the kernel lists it
libc = ctypes.CDLL(None, use_errno=True)


class OtherUser:
    """Attempts of one user against another one."""

    def __init__(self, victim: int) -> None:
        self._victim = victim
        self.tried: Counter[str] = Counter()
        self.achieved: Counter[str] = Counter()
        self.decoys: Counter[str] = Counter()
        self._made: list[Path] = []
        self.ports: set[int] = set()  # on which the victim listens

    def round(self) -> None:
        """Try everything once."""
        pids, runs = self._nodes()
        self._precede(runs)
        for path in self._found():
            self._touch(path)
        for pid in pids:
            self._look_into(pid)
        self._knock()
        self._gather()

    def told(self) -> dict[str, object]:
        """Return how often each act was tried and succeeded, on fovea's files and on decoys."""
        return {
            "tried": self.tried, "achieved": self.achieved, "decoys": self.decoys,
            "ports": sorted(self.ports),
        }  # fmt: skip

    def _count(self, act: str, where: object) -> None:
        (self.decoys if DECOY in str(where) else self.achieved)[act] += 1

    def _found(self) -> Iterator[Path]:
        """Yield every path with fovea in its name below the roots, and what its folder shows."""
        for root in ROOTS:
            with contextlib.suppress(OSError):
                for entry in os.scandir(root):
                    if "fovea" in entry.name and Path(entry.path) not in self._made:
                        yield Path(entry.path)
                        yield from self._inside(Path(entry.path))

    def _inside(self, folder: Path) -> Iterator[Path]:
        self.tried["enter"] += 1
        with contextlib.suppress(OSError):
            names = os.listdir(folder)
            self._count("enter", folder)
            yield from (folder / name for name in names)

    def _touch(self, path: Path) -> None:
        """Try to read, alter, truncate, rename and connect to a path, and to put a file into it."""
        for act in (self._read, self._alter, self._rename, self._connect, self._put_beside):
            self.tried[act.__name__] += 1
            with contextlib.suppress(OSError):
                if act(path):
                    self._count(act.__name__, path)

    def _read(self, path: Path) -> bool:
        with path.open("rb") as file:
            return bool(file.read(4096))

    def _alter(self, path: Path) -> bool:
        handle = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        try:
            os.pwrite(handle, b"altered", 8192)
            os.ftruncate(handle, 0)
        finally:
            os.close(handle)
        return True

    def _rename(self, path: Path) -> bool:
        aim = path.with_name(f"{path.name}-taken")
        path.rename(aim)
        aim.rename(path)
        return True

    def _connect(self, path: Path) -> bool:
        if not path.is_socket():
            return False
        for kind in (socket.SOCK_STREAM, socket.SOCK_SEQPACKET):
            with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, kind) as link:
                link.connect(str(path))
                return True
        return False

    def _put_beside(self, path: Path) -> bool:
        if not path.is_dir():
            return False
        (path / "ledger").touch(exist_ok=False)
        return True

    def _nodes(self) -> tuple[list[int], set[str]]:
        """Return the victim's node processes and run ids, both of which all users may see."""
        pids, runs = [], set()
        for folder in Path("/proc").iterdir():
            if not folder.name.isdigit():
                continue
            with contextlib.suppress(OSError):
                words = (folder / "cmdline").read_bytes().split(b"\0")
                if NODE_MODULE in words and folder.stat().st_uid == self._victim:
                    pids.append(int(folder.name))
                    runs.add(words[words.index(NODE_MODULE) + 1].decode(errors="replace"))
        return pids, runs

    def _precede(self, runs: set[str]) -> None:
        """Make folders that a run might make next."""
        stem = f"fovea-{self._victim}-"
        names = [f"{stem}{run}" for run in runs]
        names += [f"{stem}{secrets.token_hex(8)}" for _ in range(GUESSES)]
        for root in ROOTS:
            for name in (*names, f"fovea-{self._victim}"):
                self.tried["precede"] += 1
                with contextlib.suppress(OSError):
                    (root / name).mkdir(mode=0o777)
                    (root / name).chmod(0o777)
                    self._made.append(root / name)

    def _gather(self) -> None:
        """Count the folders made by `_precede` that the victim has used, and remove them."""
        for folder in self._made:
            with contextlib.suppress(OSError):
                if any(p.stat().st_uid == self._victim for p in folder.iterdir()):
                    self.achieved["precede"] += 1
                folder.rmdir()
        self._made.clear()

    def _look_into(self, pid: int) -> None:
        """Try to reach a process by its files in /proc, by a signal and by a debugger."""
        for name in ("mem", "maps", "environ"):
            self.tried["proc"] += 1
            with contextlib.suppress(OSError):
                if (Path(f"/proc/{pid}") / name).read_bytes()[:1]:
                    self.achieved["proc"] += 1
        self.tried["descriptors"] += 1
        with contextlib.suppress(OSError):
            for link in os.listdir(f"/proc/{pid}/fd"):
                os.close(os.open(f"/proc/{pid}/fd/{link}", os.O_RDONLY | os.O_NONBLOCK))
                self.achieved["descriptors"] += 1
        self.tried["signal"] += 1
        with contextlib.suppress(OSError):
            os.kill(pid, signal.SIGSTOP)
            self.achieved["signal"] += 1
        self.tried["debugger"] += 1
        if libc.ptrace(PTRACE_ATTACH, pid, None, None) == 0:
            self.achieved["debugger"] += 1
            libc.ptrace(PTRACE_DETACH, pid, None, None)

    def _knock(self) -> None:
        """Try to connect to each socket with fovea in its name; note the victim's open ports."""
        for line in Path("/proc/net/unix").read_text().splitlines()[1:]:
            path = line.split()[-1]
            if "fovea" in path:
                self.tried["_connect"] += 1
                with contextlib.suppress(OSError):
                    if self._connect(Path(path)):
                        self._count("_connect", path)
        for table in ("tcp", "tcp6"):
            for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
                words = line.split()
                self.tried["port"] += 1
                if words[3] == LISTENING and int(words[7]) == self._victim:
                    self.ports.add(int(words[1].rpartition(":")[2], 16))


def become(user: int) -> None:
    """Drop all rights of this process by becoming another user."""
    os.setgroups([])
    os.setresgid(user, user, user)
    os.setresuid(user, user, user)


def main(words: list[str]) -> None:
    """Repeat the attempts for so many seconds."""
    user, victim, seconds = int(words[0]), int(words[1]), float(words[2])
    if os.geteuid() == 0:
        become(user)
    assert os.geteuid() == user != victim
    other_user, end_s = OtherUser(victim), time.monotonic() + seconds
    while time.monotonic() < end_s:
        other_user.round()
    print(json.dumps(other_user.told()), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
