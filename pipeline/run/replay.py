"""Run a graph on a recording of it, in line and in lockstep; compare what it computes."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pipeline.cause import cause_of, is_signal
from pipeline.class_cache import adapter
from pipeline.errors import FoveaError, GraphError, RunError
from pipeline.graph.plan import Plan
from pipeline.recording.reader import Recording
from pipeline.recording.recorder import Recorder
from pipeline.run.inline import InlineRunner
from pipeline.run.played import Difference, Verifier, is_viewer, stand_ins
from pipeline.version import described

NS = 1e9


@dataclass(frozen=True, kw_only=True)
class Replayed:
    """The outcome of a replay."""

    frames: int
    duration_s: float
    recorded_s: float  # between the first frame and the last, when they were recorded
    compared: int = 0
    different: int = 0
    first: Difference | None = None
    outside: int = 0  # messages of exposures at the ends, which were not recorded as a whole
    unrecorded: tuple[str, ...] = ()  # outputs that were computed and not compared
    report: Mapping[str, Any]


def plan_in(recording: Recording) -> Plan:
    """Return the plan that a recording holds, in lockstep and without viewers.

    It names code, as a graph file does. Raises `GraphError` when there is none.
    """
    written = recording.newest("graph").get("plan")
    if written is None:
        raise GraphError(f"{recording.path}: holds no graph: expected GRAPH as well")
    try:
        plan: Plan = adapter(Plan).validate_python(written)
    except (ValidationError, FoveaError) as error:
        raise GraphError(f"{recording.path}: its graph is not valid: {error}") from error
    nodes = [node for node in plan.nodes if not is_viewer(plan, node.name)]
    names = {node.name for node in nodes}
    edges = [edge for edge in plan.edges if edge.target in names]
    return replace(
        plan, clock="lockstep", hosts=(), here="",
        nodes=tuple(replace(node, index=i, host="") for i, node in enumerate(nodes)),
        edges=tuple(replace(edge, index=i, keep="every") for i, edge in enumerate(edges)),
    )  # fmt: skip


def replay(
    plan: Plan, recording: Recording, *, nodes: Iterable[str] = (), frames: int = 0,
    verify: bool = False, step: Callable[[int, int], bool] = lambda _seq, _log_ns: True,
) -> Replayed:  # fmt: skip
    """Replay up to `frames` frames (0: all), the recording in place of the source and `nodes`.

    `step` is called after each frame with its number and when it was recorded (wall clock); False
    ends the replay. Raises `RunError` when an operator fails, `GraphError` when `verify` finds no
    recorded output of those that are computed.
    """
    played = stand_ins(plan, recording, nodes)
    verifier = Verifier(plan, recording, played)
    if verify:
        verifier.check()
    runner = InlineRunner(plan, watch=verifier.watch if verify else None, played=played)
    first_ns = last_ns = next(iter(recording.exposures.values()), 0)
    began_s, count, whole = time.monotonic(), 0, True
    with sentences(runner), runner:
        for seq in runner.run(frames):
            count, last_ns = count + 1, recording.exposures[runner.exposure]
            if not step(seq, last_ns):
                whole = False
                break
        duration_s = time.monotonic() - began_s
        report = runner.report()
    if verify and whole and not frames:
        verifier.finish()
    return Replayed(
        frames=count, duration_s=duration_s, recorded_s=(last_ns - first_ns) / NS,
        compared=verifier.compared, different=verifier.different, first=verifier.first,
        outside=verifier.outside, unrecorded=tuple(sorted(verifier.unrecorded)), report=report,
    )  # fmt: skip


@contextmanager
def sentences(runner: InlineRunner) -> Iterator[None]:
    """Turn an operator's exception into a `RunError` that names its node."""
    try:
        yield
    except FoveaError:
        raise
    except BaseException as error:
        if is_signal(error):
            raise
        raise RunError(f"{runner.at}: {cause_of(error)}") from error


class OwnPace:
    """Waits after each frame until the next one is due: the `step` of a replay."""

    def __init__(self, recording: Recording, asked: Callable[[], int]) -> None:
        self._at_ns = sorted(recording.exposures.values())
        self._next, self._began_s, self._asked = 1, 0.0, asked

    def __call__(self, _seq: int, _log_ns: int) -> bool:
        """Wait; return False when the replay should end."""
        if not self._began_s:
            self._began_s = time.monotonic()
        if self._next < len(self._at_ns):
            due_s = self._began_s + (self._at_ns[self._next] - self._at_ns[0]) / NS
            while not self._asked() and (left_s := due_s - time.monotonic()) > 0:
                time.sleep(min(left_s, 0.1))
        self._next += 1
        return not self._asked()


def record_inline(
    plan: Plan, path: Path, frames: int, asked: Callable[[], int]
) -> dict[str, dict[str, int]]:
    """Run a graph in this thread and record every output; return the counts by output.

    Nothing is lost: the run waits for the file. Raises `RunError` when it cannot be written.
    """
    recorder = Recorder(path)
    try:
        written = adapter(Plan).dump_python(plan, mode="json")
        recorder.note("graph", {"name": plan.name, "version": described(), "plan": written})
        runner = InlineRunner(plan, watch=lambda o, m: recorder.add(o, m, wait=True))
        with sentences(runner), runner:
            for _seq in runner.run(frames):
                if asked() or recorder.failure:
                    break
            recorder.note("report", runner.report())
    finally:
        failure = recorder.close()
    if failure:
        raise RunError(failure)
    return recorder.figures()
