"""Check the installation: package versions, weights, bus, folders, leftovers of killed runs."""

import fcntl
import os
import secrets
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Iterator
from importlib import metadata
from pathlib import Path

import psutil
from packaging.requirements import Requirement

from pipeline import weights
from pipeline.bus.session import Session
from pipeline.doctor.finding import Finding, ok, warning, wrong
from pipeline.errors import FoveaError, RunError
from pipeline.run.leftovers import foreign, leftovers, node_processes
from pipeline.run.memory_folder import MemoryFolder, path_of
from pipeline.run.rundir import LONGEST_ADDRESS, base
from pipeline.text import harmless

PROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"
OLDEST = (3, 11)
LONGEST_NAME = 40  # of graph and node names together
ECHO_S = 3.0


def examine_installation(project: Path = PROJECT) -> Iterator[Finding]:
    """Yield all findings on the installation and on leftovers."""
    yield python(sys.version_info[:2])
    yield from versions(requirements(project))
    yield pulled_weights()
    yield from folders()
    yield bus()
    yield from left_over()


def python(version: tuple[int, ...]) -> Finding:
    """Check that the interpreter is new enough."""
    found = ".".join(map(str, version))
    if version < OLDEST:
        return wrong("python", found, "use Python 3.11 or newer")
    return ok("python", found)


def requirements(project: Path) -> list[Requirement]:
    """Return the requirements, from the project file or else from the installed package."""
    try:
        asked = tomllib.loads(project.read_text())["project"]["dependencies"]
    except (OSError, ValueError, KeyError):
        try:
            asked = metadata.requires("fovea") or []
        except metadata.PackageNotFoundError:
            asked = []
    return [r for r in map(Requirement, asked) if not r.marker or r.marker.evaluate({"extra": ""})]


def versions(asked: Iterable[Requirement]) -> Iterator[Finding]:
    """Yield a finding per missing or wrong package, and one for all others."""
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
    """Check the pulled third-party networks; none is needed, but a broken one is reported."""
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
    """Check that sockets can be created in the folder of runs."""
    what = "run folder"
    try:
        folder = base()
    except (FoveaError, OSError) as error:
        yield wrong(what, str(error), "remove it, or set TMPDIR to a folder of this user")
        return
    length = len(os.fsencode(folder)) + LONGEST_NAME
    if length > LONGEST_ADDRESS:
        why = f"{folder}: {length} bytes with names, a socket's path may have {LONGEST_ADDRESS}"
        yield wrong(what, why, "set TMPDIR to a shorter path")
    else:
        yield ok(what, f"{folder}, private")


def bus() -> Finding:
    """Check that two sessions can reach each other over unix sockets."""
    key = f"fovea/doctor-{secrets.token_hex(4)}/@health"
    with tempfile.TemporaryDirectory(prefix="fovea-") as name:
        sessions: list[Session] = []
        try:
            sessions.append(Session(Path(name), "hub"))
            sessions.append(Session(Path(name), "asker", timeout_s=1.0))
            sessions[0].answer(key, lambda question, reply: reply(question[::-1]))
            heard = sessions[1].ask(key, b"well", ECHO_S)
        except (FoveaError, OSError) as error:
            return wrong("bus", str(error), "allow unix sockets in the temporary folder")
        finally:
            for session in reversed(sessions):
                session.close()
    if heard != b"llew":
        why = f"no reply to a question over a unix socket for {ECHO_S:.0f} s"
        return wrong("bus", why, "look for a sandbox or security module that forbids sockets")
    return ok("bus", "a question over a unix socket is answered; nothing listens on a network")


def left_over() -> Iterator[Finding]:
    """Check for leftovers of killed supervisors; the next start of any graph removes fovea's."""
    dead = leftovers()
    if dead:
        todo = "start any graph: it removes them; or `fovea doctor --cleanup`"
        yield warning("left over", f"runs that were killed: {', '.join(dead)}", todo)
    others = foreign()
    for folder, names in others.items():
        listed = harmless(", ".join(names[:3]), 200)
        why = f"{folder} is of a killed run and has files that are none of it: {listed}"
        yield warning("left over", why, "remove the folder, if these are not needed")
    orphans = [process.pid for process in orphaned()]
    if orphans:
        listed = " ".join(map(str, orphans))
        yield wrong("left over", f"node processes without a supervisor: {listed}", f"kill {listed}")
    if not (dead or others or orphans):
        yield ok("left over", "nothing")


def orphaned() -> Iterator[psutil.Process]:
    """Yield node processes of this user whose run is over: memory folder gone or not locked."""
    return (process for process, run_id in node_processes() if not _supervised(process, run_id))


def _supervised(process: psutil.Process, run_id: str) -> bool:
    """Whether its supervisor lives; seen from the process, which may be in a container."""
    path = Path(f"/proc/{process.pid}/root") / path_of(run_id).relative_to("/")
    try:
        return path.exists() and not MemoryFolder(path).lock(fcntl.LOCK_SH)
    except (RunError, OSError):
        return bool(process.is_running())  # it has ended, or access is denied
