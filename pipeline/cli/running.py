"""Run a plan, as processes or in line, with a status line; return the report."""

import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.progress import MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

from pipeline.cause import cause_of, is_signal
from pipeline.errors import FoveaError, RunError
from pipeline.graph.advice import advised, built
from pipeline.graph.plan import Plan
from pipeline.run.heartbeat import Heartbeat
from pipeline.run.inline import InlineRunner
from pipeline.run.loaded_graph import account_of
from pipeline.run.reaper import Reaper
from pipeline.run.report import Report
from pipeline.run.supervisor import STOP_S, Supervisor
from pipeline.signals import Interruption
from pipeline.terminal import pair
from pipeline.text import harmless

REFRESH_S = 0.25
MOST_TRACEBACK = 20_000  # characters of a displayed traceback


def inline(
    plan: Plan, frames: int, console: Console, asked: Interruption, *, verbose: bool = False
) -> Report:
    """Run in this thread, frame by frame, until a signal.

    A frame that takes too long after a signal is aborted; the report covers the frames before. The
    exception of an operator becomes the report's `failure`, with its traceback if `verbose`.
    """
    name = TextColumn("{task.description}", markup=False)
    columns = (SpinnerColumn(), name, MofNCompleteColumn(), TimeElapsedColumn())
    runner, report, failure = _loaded(plan), None, ""
    broken: list[BaseException] = []  # exceptions that ended threads of operators
    try:
        with (
            asked.giving_up(STOP_S), _thread_errors(broken), runner,
            Progress(*columns, console=console) as progress,
        ):  # fmt: skip
            task = progress.add_task(plan.name, total=frames or None)
            for _seq in runner.run(frames):
                progress.advance(task)
                if broken:
                    raise broken[0]
                if asked.count:
                    break
            report = runner.report()
    except BaseException as error:
        failure = _told(error, f"{plan.name}: a thread" if error in broken else runner.at)
        if verbose:
            text = "".join(traceback.format_exception(error))
            console.print(harmless(text, MOST_TRACEBACK, lines=True), markup=False, highlight=False)
        if not runner.began:
            raise _fovea_error(error, failure) from error
    report = report if report is not None else runner.report(summaries=False)
    return {**report, "failure": failure} if failure else report


def _loaded(plan: Plan) -> InlineRunner:
    try:
        return InlineRunner(plan)
    except BaseException as error:
        raise _fovea_error(error, _told(error, plan.name)) from error


def _fovea_error(error: BaseException, told: str) -> FoveaError:
    return error if isinstance(error, FoveaError) else RunError(told)


def _told(error: BaseException, node: str) -> str:
    """Describe an operator's error in a sentence; re-raise fovea's own and those of signals."""
    if isinstance(error, FoveaError):
        return harmless(str(error))
    if is_signal(error):
        raise error
    return f"{node}: {cause_of(error)}"


@contextmanager
def _thread_errors(found: list[BaseException]) -> Iterator[None]:
    """Collect the exceptions that end threads of operators."""
    before = threading.excepthook
    threading.excepthook = lambda broken: found.extend(filter(None, [broken.exc_value]))
    try:
        yield
    finally:
        threading.excepthook = before


def processes(
    plan: Plan, frames: int, duration_s: float, console: Console,
    asked: Interruption | None = None, reaper: Reaper | None = None,
    when_it_runs: Callable[[str], None] | None = None, heartbeat: Path | None = None,
) -> Report:  # fmt: skip
    """Run as processes until the source ends, a limit or a signal.

    `when_it_runs` is called with the graph's name once every process is ready. The file `heartbeat`
    is renewed every second.
    """
    if asked is None:
        with Interruption() as asked:
            return processes(
                plan, frames, duration_s, console, asked, reaper, when_it_runs, heartbeat
            )
    with (
        Heartbeat(heartbeat) as alive,
        Supervisor(plan, frames=frames, reaper=reaper) as supervisor,
    ):
        supervisor.asked_to_end = asked.asked
        with console.status(Text(f"{plan.name}: starting {len(plan.processes())} processes")):
            supervisor.start(lambda: alive.beat(works=False))
        if when_it_runs is not None and supervisor.begun:
            when_it_runs(plan.name)
        shown_s = 0.0
        with Live(console=console, auto_refresh=False, transient=True) as live:
            while not supervisor.finished and not supervisor.end_requests:
                supervisor.tick()
                alive.beat(works=supervisor.manager.all_going)
                elapsed_s = time.monotonic() - supervisor.started_s
                if duration_s and elapsed_s >= duration_s:
                    break
                if elapsed_s - shown_s >= REFRESH_S and console.is_terminal:
                    shown_s = elapsed_s
                    live.update(Text(status_line(supervisor, elapsed_s)), refresh=True)
        elapsed_s = supervisor.exposed_s
        if supervisor.begun:
            supervisor.finish()
        supervisor.stop()
        report = account_of(supervisor, elapsed_s)
        if supervisor.failure:
            report["failure"] = supervisor.failure
        return report


def status_line(supervisor: Supervisor, elapsed_s: float) -> str:
    """Return one line with progress, rate and losses."""
    plan, ledger = supervisor.plan, supervisor.ledger
    name = min(supervisor.manager.source_names, default=plan.nodes[0].name)
    source = ledger.nodes[plan.node(name).index]
    loop = source.histograms["loop"].summary()
    dropped = sum(sum(edge.report()["dropped"].values()) for edge in ledger.edges)
    broken = [e.end for e in plan.edges if ledger.edges[e.index].broken]
    parts = [
        f"{elapsed_s:6.1f} s",
        f"frame {source.last_seq}",
        *([f"loop {pair(loop)} ms p50/p99"] if plan.clock == "realtime" else []),
        f"dropped {dropped}",
        f"restarts {sum(supervisor.restarts.values())}",
        *(words for words in supervisor.reports.headlines.values() if words),
    ]
    return "  ".join([*parts, *(["broken: " + ", ".join(broken)] if broken else [])])


def advice(plan: Plan, settings: Mapping[str, Any] | None = None) -> Iterator[str]:
    """Yield what the operators advise before the run (`Operator.advise`)."""
    settings = built_settings(plan) if settings is None else settings
    for node in plan.nodes:
        yield from advised(plan, node, settings)


def built_settings(plan: Plan) -> dict[str, Any]:
    """Return the settings of every node as its operator gets them; some load a network."""
    return {node.name: built(node) for node in plan.nodes}
