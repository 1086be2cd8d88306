"""`fovea run --detach`: start a run in a process without a terminal, and return once it works.

The remaining process is `fovea run` with the hidden option `--detached FD`. Until its graph runs,
it prints where its parent does. Then it writes the graph's name as a line to the descriptor, prints
to a file in the run folder from there on, and records its outcome when it ends.
"""

import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import click
from rich.live import Live
from rich.text import Text

from pipeline import output, terminal
from pipeline.cli.tables import live_line
from pipeline.client import detached
from pipeline.client.graph_client import GraphClient
from pipeline.errors import FoveaError, RunError
from pipeline.naming import is_name
from pipeline.node.logfile import log_to
from pipeline.run.rundir import folder_of, running
from pipeline.signals import Interruption
from pipeline.text import error_text, harmless
from pipeline.user_modules import interpreter_options

REFRESH_S = 0.5
WAIT_S = 0.25


def start(words: Sequence[str]) -> tuple[str, int]:
    """Start `fovea run WORDS`, wait until its graph runs, and return graph name and process id.

    If that process ends before, this one exits with the same status.
    """
    told, tells = os.pipe()
    fovea = [sys.executable, *interpreter_options(), "-m", "pipeline.entry"]
    command = [*fovea, "run", "--detached", str(tells), *words]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, pass_fds=(tells,), start_new_session=True
    ) as process:
        os.close(tells)
        try:
            graph = _told(told, process)
        except BaseException:  # e.g. Ctrl-C during the start
            process.terminate()
            process.wait()
            raise
        if is_name(graph):
            process.returncode = 0  # it keeps running; this process does not wait for it
            return graph, process.pid
        process.wait()
    sys.exit(process.returncode if process.returncode > 0 else 1)


def _told(told: int, process: "subprocess.Popen[bytes]") -> str:
    """Return the line that a process writes; empty if it ends before.

    The end of the pipe is no sign of that: a child forked by an operator's module keeps it open.
    """
    poll = select.poll()
    poll.register(told, select.POLLIN)
    with os.fdopen(told, "rb") as file:
        while not poll.poll(1000 * WAIT_S):
            if process.poll() is not None and not poll.poll(0):
                return ""
        return file.readline().decode().removesuffix("\n")


class DetachedRun:
    """The run in the remaining process."""

    def __init__(self, tells: int) -> None:
        self.graph, self._tells = "", tells
        self._noted: detached.Detached | None = None
        os.set_inheritable(tells, False)

    @contextmanager
    def noting(self) -> Iterator[Callable[[int, str, dict[str, Any]], None]]:
        """Record the outcome: what is passed to the yielded function, or what the block raises."""
        try:
            yield self._end
        except FoveaError as error:
            self._end(1, str(error), None)
            raise
        except BaseException as error:
            self._end(1, harmless(error_text(error)), None)
            raise

    def leave(self, graph: str) -> None:
        """Signal the parent that the graph runs, and print to the run folder from now on."""
        self.graph = graph
        facts = running().get(self.graph)
        if facts is None:
            raise RunError(f"{self.graph}: expected a running graph, got no record of it")
        self._noted = detached.begin(self.graph, facts["run"], os.getpid())
        output.flush()
        output.redirect(log_to(folder_of(self.graph) / detached.WORDS, fresh=True).fileno())
        os.write(self._tells, f"{self.graph}\n".encode())
        os.close(self._tells)

    def _end(self, exit_status: int, why: str, report: dict[str, Any] | None) -> None:
        """Record the outcome once, if the graph ever ran."""
        if self._noted is None or self._noted.ended:
            return
        try:
            detached.end(self._noted, exit_status, why, report)
        except OSError as error:
            click.echo(f"{self.graph}: its outcome cannot be recorded: {error.strerror}", err=True)


def attach(client: GraphClient) -> str:
    """Show a graph on one line until Ctrl-C, which leaves it running; return a closing line."""
    console = terminal.console()
    with (
        Interruption() as asked,
        client.watching() as look,
        Live(console=console, auto_refresh=False, transient=True) as live,
    ):
        click.echo(f"{client.name}: Ctrl-C leaves it running")
        shown_s = 0.0
        while not asked.count and client.runs():
            if console.is_terminal and time.monotonic() - shown_s > REFRESH_S:
                shown_s = time.monotonic()
                try:
                    live.update(Text(f"{client.name}  {live_line(look())}"), refresh=True)
                except RunError:  # it has just ended
                    break
            time.sleep(WAIT_S)
    if client.runs():
        return f"{client.name}: goes on; `fovea stop {client.name}` ends it"
    ended = detached.noted(client.name)
    return ended_line(ended) if ended and ended.ended else f"{client.name}: the graph has ended"


def ended_line(found: detached.Detached) -> str:
    """Describe how a detached run ended."""
    status = "was killed" if found.exit_status is None else f"exit status {found.exit_status}"
    why = f": {found.why}" if found.why else ""
    report = f"; report: {found.report}" if found.report else ""
    ended = f"ended {found.ended}, " if found.ended else ""
    return f"{found.graph}: {ended}{status}{why}{report}"
