"""Files of a detached run in its run folder: output, outcome and report.

run.out          its output; bounded, older output is in run.out.old
detached.json    the process and, once it has ended, its exit status
report.json      its report
"""

import os
import time
from datetime import UTC, datetime
from typing import Any

import msgspec

from pipeline.errors import RunError
from pipeline.naming import is_name
from pipeline.private_folder import PrivateFolder
from pipeline.run.rundir import folder_of, run_folders

WORDS, RECORD, REPORT = "run.out", "detached.json", "report.json"
MOST_BYTES = 64 << 10  # of a record
MOST_WORDS = 1 << 20  # bytes of output that are read, from the end
WRITTEN_S = 20.0  # time for an ended run to record its outcome
LOOK_S = 0.05


class Detached(msgspec.Struct, kw_only=True):
    """The record of a run without a terminal."""

    graph: str
    run: str  # the id of the run
    pid: int
    started: str  # date and time
    ended: str = ""
    exit_status: int | None = None  # None: still running, or killed
    why: str = ""  # reason of an exit status other than 0
    report: str = ""  # path of the file


_READ = msgspec.json.Decoder(Detached)


def begin(graph: str, run: str, pid: int) -> Detached:
    """Record that a run has detached from its terminal."""
    found = Detached(graph=graph, run=run, pid=pid, started=_now())
    PrivateFolder(folder_of(graph)).write(RECORD, msgspec.json.encode(found))
    return found


def end(found: Detached, exit_status: int, why: str, report: dict[str, Any] | None) -> None:
    """Record the outcome unless another run has begun; raises `OSError` if writing fails."""
    newest = noted(found.graph)
    if newest is None or newest.run != found.run:
        return
    folder = PrivateFolder(folder_of(found.graph))
    if report is not None:
        folder.write(REPORT, msgspec.json.encode(report, enc_hook=str))
        found.report = str(folder.path / REPORT)
    found.ended, found.exit_status, found.why = _now(), exit_status, why
    folder.write(RECORD, msgspec.json.encode(found))


def noted(graph: str) -> Detached | None:
    """Return the latest detached run of a graph; None when there was none."""
    try:
        folder = PrivateFolder(folder_of(graph))
        found = _READ.decode(folder.read(RECORD, MOST_BYTES))
    except (OSError, RunError, msgspec.MsgspecError, ValueError, RecursionError):
        return None
    return found if is_name(found.graph) else None


def all_noted() -> dict[str, Detached]:
    """Return the latest detached run of every graph, by name."""
    found = {folder.path.name: noted(folder.path.name) for folder in run_folders()}
    return {name: one for name, one in found.items() if one is not None}


def await_end(graph: str, run: str) -> Detached | None:
    """Return the record of a run that has just ended; None when it was not detached."""
    late_s = time.monotonic() + WRITTEN_S
    while (found := noted(graph)) is not None and found.run == run:
        if found.ended or time.monotonic() > late_s:
            return found
        time.sleep(LOOK_S)
    return None


def words(graph: str, lines: int) -> list[str]:
    """Return the last lines of a detached run's output; raises `RunError` when there is none."""
    try:
        with os.fdopen(PrivateFolder(folder_of(graph)).open(WORDS), "rb") as file:
            before = max(0, os.fstat(file.fileno()).st_size - MOST_WORDS)
            file.seek(before)
            data = file.read(MOST_WORDS)
    except FileNotFoundError as error:
        raise RunError(f"{graph}: no detached run wrote anything") from error
    except OSError as error:
        raise RunError(f"{graph}: {WORDS}: cannot be read: {error.strerror}") from error
    if before:  # the first one is incomplete
        data = data.partition(b"\n")[2] or data
    return data.decode(errors="replace").splitlines()[-lines:] if lines else []


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
