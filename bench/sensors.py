"""Which kinds of sensor keep the contract of a dual-stream sensor: `python -m bench.sensors`.

Runs the tests of `tests/` whose names say `contract_of_a_sensor`, one pytest run for each kind, and
reports what pytest says of them: a kind that could not be run is not run, with pytest's reason, and
never counts as passed. `--kernel FOLDER` adds those that need a kernel with USB and V4L2, as
`make test-guest` runs them in a virtual machine.
"""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import click

from bench.machine import LIBRARIES, facts
from bench.options import JSON, ROOT, Bench
from bench.results.markdown import table_of
from pipeline.errors import RunError
from pipeline.text import harmless

NAMES = "contract_of_a_sensor"
LIMIT_S = 500.0  # of one kind
GUEST_LIMIT_S = 900.0  # beyond those of tests.guest.boot: each guest says itself that it is late
COUNTED = re.compile(r"(\d+) (passed|failed|error|skipped)")


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of sensor, and the tests that run its contract."""

    name: str
    tests: tuple[str, ...]
    marks: str = "not hardware and not footage"


KINDS = (
    Kind(name="simulated", tests=("tests/drivers/test_simulated.py",)),
    Kind(name="USB board over a virtual backend of pyusb",
         tests=("tests/drivers/usb/test_board.py",)),
    Kind(name="GigE camera: Aravis' fake camera on the loopback",
         tests=("tests/drivers/genicam/test_fake_camera.py",)),
    Kind(name="GenICam camera: a modelled one",
         tests=("tests/drivers/genicam/test_virtual_camera.py",)),
    Kind(name="network stream: MJPEG over HTTP",
         tests=("tests/drivers/cameras/test_network_stream.py",)),
    Kind(name="network stream: RTSP of an independent server",
         tests=("tests/drivers/cameras/test_stream_programs.py",)),
    Kind(name="plain camera, cut in software",
         tests=("tests/drivers/cameras/test_camera_sensor.py",)),
)  # fmt: skip
GUEST = "USB board and webcam over a kernel's drivers, in a virtual machine"


@click.command(cls=Bench, help=__doc__)
@click.option("--kernel", type=click.Path(path_type=Path, exists=True, file_okay=False))
@JSON
def main(kernel: Path | None, path: Path | None) -> None:
    """Run the contract of every kind."""
    rows = [outcome(kind) for kind in KINDS]
    rows.append(guest(kernel) if kernel else not_run(GUEST, "needs --kernel; make test-guest"))
    result = {"bench": "sensors", **facts((*LIBRARIES, "pyusb", "PyGObject")), "kinds": rows}
    click.echo(table_of(rows))
    if path:
        path.write_text(json.dumps(result, indent=1) + "\n")
    if any(row["failed"] for row in rows):
        sys.exit(1)


def outcome(kind: Kind) -> dict[str, Any]:
    """Run the tests of a kind; raises `RunError` where pytest itself cannot run."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        words = [
            sys.executable, "-m", "pytest", *kind.tests, "-k", NAMES, "-m", kind.marks,
            "-p", "no:cacheprovider", f"--junitxml={report}",
        ]  # fmt: skip
        began_s = time.monotonic()
        done = run(words)
        if not report.is_file():
            raise RunError(f"{kind.name}: pytest: {_last_line(done.stderr or done.stdout)}")
        return counted(kind.name, report.read_text(), time.monotonic() - began_s)


def counted(name: str, report: str, seconds: float) -> dict[str, Any]:
    """Return the line of a kind from pytest's JUnit report.

    >>> text = "<testsuites><testsuite><testcase/></testsuite></testsuites>"
    >>> counted("a", text, 1.5)["outcome"]
    'passes'
    """
    cases = list(ElementTree.fromstring(report).iter("testcase"))
    failed = [c for c in cases if c.find("failure") is not None or c.find("error") is not None]
    skipped = [c.find("skipped") for c in cases if c.find("skipped") is not None]
    reasons = {harmless(s.get("message", "")) for s in skipped if s is not None}
    return _row(
        name, len(cases) - len(failed) - len(skipped), len(failed), len(skipped),
        "; ".join(sorted(reasons)), seconds,
    )  # fmt: skip


def guest(kernel: Path) -> dict[str, Any]:
    """Run `make test-guest` with that kernel."""
    began_s = time.monotonic()
    done = run(["make", "test-guest", f"KERNEL={kernel.resolve()}"], GUEST_LIMIT_S)
    counts = outcomes(done.stdout)
    failed = counts.get("failed", 0) + counts.get("error", 0)
    failed = max(failed, int(done.returncode != 0))
    note = _last_line(done.stderr or done.stdout) if done.returncode else ""
    return _row(
        GUEST, counts.get("passed", 0), failed, counts.get("skipped", 0), note,
        time.monotonic() - began_s,
    )  # fmt: skip


def outcomes(said: str) -> Counter[str]:
    """Return the counts in pytest's last lines, together for all guests.

    >>> outcomes("== 2 passed, 1 skipped in 3 s ==\\n== 3 passed, 4 deselected in 5 s ==")
    Counter({'passed': 5, 'skipped': 1})
    """
    counts: Counter[str] = Counter()
    for number, word in COUNTED.findall(said):
        counts[word] += int(number)
    return counts


def not_run(name: str, reason: str) -> dict[str, Any]:
    """Return the line of a kind that was not run."""
    return _row(name, 0, 0, 0, reason, 0.0)


def _row(
    name: str, passed: int, failed: int, skipped: int, note: str, seconds: float
) -> dict[str, Any]:
    word = "fails" if failed else "passes" if passed else "not run"
    return {
        "kind": name, "outcome": word, "passed": passed, "failed": failed, "skipped": skipped,
        "note": note[:300], "seconds": round(seconds, 1),
    }  # fmt: skip


def run(words: Sequence[str], limit_s: float = LIMIT_S) -> subprocess.CompletedProcess[str]:
    """Run a program; it and what it started are killed at the limit, and when this is left."""
    with subprocess.Popen(
        words, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    ) as process:  # fmt: skip
        try:
            said, errors = process.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            what = " ".join(words[:3])
            raise RunError(f"{what}: expected its end within {limit_s:g} s, got none") from None
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    return subprocess.CompletedProcess(list(words), process.returncode, said, errors)


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return harmless(lines[-1]) if lines else "nothing said"


if __name__ == "__main__":
    main()
