"""The installation: package versions, weights, the bus, folders, and what killed runs left."""

import os
import secrets
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from importlib import metadata
from pathlib import Path

import psutil
from packaging.requirements import Requirement

from pipeline import weights
from pipeline.bus.ledger import ledger_file
from pipeline.bus.session import Session
from pipeline.doctor.finding import Finding, ok, warning, wrong
from pipeline.errors import FoveaError
from pipeline.run.rundir import MEMORY, base, leftovers, running

PROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"
OLDEST = (3, 11)
LONGEST_SOCKET = 107  # bytes of a unix socket's path
LONGEST_NAME = 40  # of graph and node together, as long as they come
ECHO_S = 3.0
FRESH_S = 60.0  # a graph that starts has not written down yet what is its own


def examine_installation(project: Path = PROJECT) -> Iterator[Finding]:
    """Everything about what is installed and left lying about."""
    yield python(sys.version_info[:2])
    yield from versions(requirements(project))
    yield pulled_weights()
    yield from folders()
    yield bus()
    yield from remains()


def python(version: tuple[int, ...]) -> Finding:
    """Whether the interpreter is new enough."""
    found = ".".join(map(str, version))
    if version < OLDEST:
        return wrong("python", found, "use Python 3.11 or newer")
    return ok("python", found)


def requirements(project: Path) -> list[Requirement]:
    """What the project asks for: by its file where there is one, else as it was installed."""
    try:
        asked = tomllib.loads(project.read_text())["project"]["dependencies"]
    except (OSError, ValueError, KeyError):
        try:
            asked = metadata.requires("fovea") or []
        except metadata.PackageNotFoundError:
            asked = []
    return [r for r in map(Requirement, asked) if not r.marker or r.marker.evaluate({"extra": ""})]


def versions(asked: Iterable[Requirement]) -> Iterator[Finding]:
    """A line for every package that is absent or of another version, one for all that are not."""
    good = 0
    for requirement in asked:
        name, range_ = requirement.name, requirement.specifier
        try:
            found = metadata.version(name)
        except metadata.PackageNotFoundError:
            found = ""
        if found and range_.contains(found, prereleases=True):
            good += 1
        else:
            yield wrong(
                "package", f"{name}: expected {range_ or 'any'}, got {found or 'none'}",
                f"pip install '{requirement}'",
            )  # fmt: skip
    yield ok("packages", f"{good} as asked for")


def pulled_weights() -> Finding:
    """Which third-party networks are here; nothing needs them, a broken one is told of."""
    what = "weights"
    try:
        known = weights.entries()
        folder = weights.default_folder()
        there = [n for n, entry in known.items() if (folder / entry.file).is_file()]
        broken = [n for n in there if weights.find(n) is None]
    except FoveaError as error:
        return wrong(what, str(error), "restore the manifest")
    if broken:
        names = " ".join(broken)
        return wrong(what, f"not what the manifest names: {names}", f"fovea weights pull {names}")
    return ok(what, f"{len(there)} of {len(known)} third-party networks pulled; none is needed")


def folders() -> Iterator[Finding]:
    """Whether sockets can be made where runs are kept."""
    what = "run folder"
    try:
        folder = base()
    except (FoveaError, OSError) as error:
        yield wrong(what, str(error), "remove it, or set TMPDIR to a folder of this user")
        return
    length = len(os.fsencode(folder)) + LONGEST_NAME
    if length > LONGEST_SOCKET:
        why = f"{folder}: {length} bytes with names, a socket's path may have {LONGEST_SOCKET}"
        yield wrong(what, why, "set TMPDIR to a shorter path")
    else:
        yield ok(what, f"{folder}, private")


def bus() -> Finding:
    """Whether two sessions find one another by unix socket and answer."""
    key = f"fovea/doctor-{secrets.token_hex(4)}/@health"
    with tempfile.TemporaryDirectory(prefix="fovea-") as name:
        sessions: list[Session] = []
        try:
            sessions.append(Session(Path(name), "hub"))
            sessions.append(Session(Path(name), "asker", patience_s=1.0))
            sessions[0].answer(key, lambda question, reply: reply(question[::-1]))
            heard = sessions[1].ask(key, b"well", ECHO_S)
        except (FoveaError, OSError) as error:
            return wrong("bus", str(error), "allow unix sockets in the temporary folder")
        finally:
            for session in reversed(sessions):
                session.close()
    if heard != b"llew":
        why = f"a question over a unix socket found no answer for {ECHO_S:.0f} s"
        return wrong("bus", why, "look for a sandbox or security module that forbids sockets")
    return ok("bus", "a question over a unix socket is answered; nothing listens on a network")


def remains() -> Iterator[Finding]:
    """What supervisors that were killed have left: the next start of any graph removes it."""
    dead = leftovers()
    if dead:
        todo = "start any graph: it removes them; or `fovea doctor --sweep`"
        yield warning("left over", f"runs that were killed: {', '.join(dead)}", todo)
    prefixes = {str(facts["prefix"]) for facts in running().values()} | supervised()
    mine = [] if dead else sorted(unclaimed(prefixes))
    if mine:
        size_mb = sum(p.stat().st_size for p in mine) / 1e6
        shown = f"{size_mb:.0f} MB in {MEMORY} of no running graph"
        yield warning("left over", shown, f"rm {' '.join(map(str, mine))}")
    orphans = [p.pid for p in orphaned(prefixes)]
    if orphans:
        listed = " ".join(map(str, orphans))
        yield wrong("left over", f"node processes without a supervisor: {listed}", f"kill {listed}")
    if not (dead or mine or orphans):
        yield ok("left over", "nothing")


def unclaimed(prefixes: Iterable[str]) -> Iterator[Path]:
    """Files of this user in shared memory that no running graph claims, but for quite new ones."""
    claimed = tuple(prefixes)
    for path in MEMORY.glob("fovea-*"):
        with suppress(FileNotFoundError):
            seen = path.stat()
            old = time.time() - seen.st_mtime > FRESH_S
            if old and seen.st_uid == os.getuid() and not path.name.startswith(claimed):
                yield path


def orphaned(prefixes: Iterable[str]) -> Iterator[psutil.Process]:
    """Node processes of this user whose run is not running."""
    known = set(prefixes)
    for process, prefix in _node_processes():
        if prefix not in known:
            yield process


def supervised() -> set[str]:
    """Runs whose supervisor lives, wherever its folder is: in a container, for another TMPDIR."""
    nodes = list(_node_processes())
    pids = {process.pid for process, _ in nodes}
    found = set()
    for process, prefix in nodes:
        with suppress(psutil.Error):
            parent = process.ppid()
            if parent not in pids and _maps(parent, ledger_file(MEMORY, prefix).name):
                found.add(prefix)
    return found


def _maps(pid: int, name: str) -> bool:
    """Whether a process has a file of that name in memory; who may not be asked has it."""
    try:
        return f"/{name}" in Path(f"/proc/{pid}/maps").read_text()
    except PermissionError:
        return True
    except OSError:
        return False


def _node_processes() -> Iterator[tuple[psutil.Process, str]]:
    """Those of this user, each with the prefix of its run."""
    for process in psutil.process_iter(["cmdline", "uids"]):
        words = process.info["cmdline"] or []
        if "pipeline.node.process" not in words or process.info["uids"].real != os.getuid():
            continue
        after = words[words.index("pipeline.node.process") + 1 :]
        if after:
            yield process, after[0]
