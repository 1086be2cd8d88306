"""Play one clip through the graph in line: a row and a seed in, how many texts were read out."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from bench.reading.clips import Clip
from bench.reading.known import Knowing
from bench.reading.rows import LEARNED, PARTS, POLICIES, Row
from bench.tracking.classes import with_class
from drivers.simulated.settings import SimulatedSensorSettings
from drivers.simulated.sources import open_recording, open_scene
from drivers.source import Annotations, FrameSource
from operators.transcribed import Tally
from pipeline import settings as checked
from pipeline.errors import GraphError, RunError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan
from pipeline.messages import Header, Message, Percept, Truth
from pipeline.run.inline import InlineRunner

CAPTURE, POLICY, READER = "capture", "policy", "reader"
TOLERANCE = 0.02  # of the budget


@dataclass(frozen=True, kw_only=True)
class Job:
    """What a worker process is told."""

    graph: str
    changes: tuple[str, ...]
    frames: int
    row: Row
    clip: Clip


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a clip has come to."""

    clip: str
    legible: int
    read: int
    nearly: int  # read but for one edit, or exactly
    waits_s: tuple[float, ...]  # from legible to read
    duration_s: float
    pixels: float  # share of the full pixel rate that was read


def trial(job: Job) -> Outcome:
    """Play the clip.

    Raises `RunError` where another share of the pixels was read than the budget.
    """
    cv2.setNumThreads(1)
    plan = plan_of(job)
    source = source_of(plan)
    frames = frames_of(source, job.frames)
    percepts: dict[int, Percept] = {}

    def watch(output: str, message: Message) -> None:
        if isinstance(message, Percept) and output.startswith(f"{READER}."):
            percepts[message.header.seq] = message

    with InlineRunner(plan, watch=watch) as runner:
        for node in plan.nodes:
            if isinstance(operator := runner.operator(node.name), Knowing):
                operator.truth_of = truth_until(source, frames)
        for _ in runner.run():
            pass
        pixels = runner.operator(CAPTURE).summary()["pixels"]
    check_budget(job.row, pixels["used"])
    tally = tallied(percepts, source, frames)
    counts = tally.counts()
    return Outcome(
        clip=job.clip.name,
        legible=counts["legible"],
        read=counts["read"],
        nearly=counts["nearly"],
        waits_s=tuple(round(wait / source.rate_hz, 3) for wait in tally.waits()),
        duration_s=frames / source.rate_hz,
        pixels=round(pixels["used"], 5),
    )


def frames_of(source: FrameSource, most: int) -> int:
    """Return how many frames of a source are played."""
    return most if source.length is None else min(most, source.length)


def truth_until(source: FrameSource, frames: int) -> Callable[[int], Annotations | None]:
    """Return the truth of a frame, None past the end."""
    return lambda index: source.truth(index) if index < frames else None


def tallied(percepts: dict[int, Percept], source: FrameSource, frames: int) -> Tally:
    """Count over every frame of the clip, so that what is legible is the same for all rows."""
    tally = Tally()
    for index in range(frames):
        found = source.truth(index)
        if found is None:
            raise GraphError(f"{CAPTURE}: expected a source that knows its texts, got one without")
        header = Header(stream="truth", seq=index, stamp_ns=index)
        tally.add(percepts.get(index, nothing(header)), told(found, header))
    return tally


def nothing(header: Header) -> Percept:
    """Return the answer of a frame that was not exposed."""
    none = np.zeros(0, np.float32)
    return Percept(
        header=header, boxes=np.zeros((0, 4), np.float32), ids=np.zeros(0, np.int32), scores=none
    )


def told(found: Annotations, header: Header) -> Truth:
    """Return a source's truth as a message."""
    return Truth(
        header=header, boxes=found.boxes, ids=found.ids, labels=found.labels,
        visibility=found.visibility,
    )  # fmt: skip


def check_budget(row: Row, used: float) -> None:
    """Raise `RunError` where more was read than the budget, or much less."""
    allowed = float(row.budget)
    most = used > allowed * (1 + TOLERANCE)
    if most or (row.strategy != "context" and used < allowed * (1 - 5 * TOLERANCE)):
        raise RunError(f"{row.strategy}: expected {allowed:.5f} of the pixels, got {used:.5f} read")


def plan_of(job: Job) -> Plan:
    """Return the graph of a row, in lockstep, with what it needs only.

    Raises `GraphError` for a graph without the nodes of the task.
    """
    shown = (*job.clip.changes, f"{CAPTURE}.frames={job.frames}")
    bare = load(Path(job.graph), Overlay(changes=shown, clock="lockstep"))
    for name in (CAPTURE, READER, POLICY):
        if name not in {node.name for node in bare.nodes}:
            raise GraphError(f"{job.graph}: texts are read with a node {name}, got none")
    changes = (*shown, *job.changes, *job.row.changes(size_of(bare)))
    plan = load(Path(job.graph), Overlay(changes=changes, clock="lockstep"))
    if path := POLICIES.get(job.row.strategy, ""):
        plan = with_class(plan, POLICY, path, {})
    elif job.row.policy:
        plan = with_class(plan, POLICY, LEARNED, {"weights": job.row.policy})
    if job.row.replaced:
        node, path = PARTS[job.row.replaced]
        plan = with_class(plan, node, path, {})
    if job.row.without:
        plan = cut(plan, job.row.without)
    return needed(plan, aimed=job.row.aimed)


def cut(plan: Plan, name: str) -> Plan:
    """Return the plan without an input of the policy; raises `GraphError` if it has none."""
    kept = [edge for edge in plan.edges if (edge.target, edge.input) != (POLICY, name)]
    if len(kept) == len(plan.edges):
        raise GraphError(f"without: expected an input of {POLICY}, got {name}, which is not there")
    return replace(plan, edges=tuple(replace(edge, index=i) for i, edge in enumerate(kept)))


def needed(plan: Plan, *, aimed: bool) -> Plan:
    """Return what the reader needs and, where a policy aims the ROI, what that needs."""
    edges = [e for e in plan.inputs(READER).values() if aimed or e.source == CAPTURE]
    if aimed:
        edges += plan.inputs(CAPTURE).values()
    names = [READER, CAPTURE, *(e.source for e in edges)]
    for name in names:
        if name in (READER, CAPTURE):
            continue
        before = list(plan.inputs(name).values())
        edges += before
        names += [e.source for e in before if e.source not in names]
    kept = [node for node in plan.nodes if node.name in names]
    return replace(
        plan,
        nodes=tuple(replace(node, index=i) for i, node in enumerate(kept)),
        edges=tuple(replace(edge, index=i) for i, edge in enumerate(dict.fromkeys(edges))),
    )


def sensor_of(plan: Plan) -> SimulatedSensorSettings:
    """Return the settings of the simulated sensor; raises `GraphError` for another sensor."""
    settings = plan.node(CAPTURE).settings
    if not str(settings.get("sensor", "")).endswith(":SimulatedSensor"):
        raise GraphError(f"{CAPTURE}: expected the simulated sensor, got {settings.get('sensor')}")
    return checked.build(SimulatedSensorSettings, dict(settings.get("options", {})), CAPTURE)


def size_of(plan: Plan) -> tuple[int, int]:
    """Return the size of the sensor's field, pixels."""
    size_px = sensor_of(plan).size_px
    if any(size_px):
        return size_px
    source = source_of(plan)
    source.close()
    return source.size_px


def source_of(plan: Plan) -> FrameSource:
    """Return the source of the graph's sensor, opened once more for its truth."""
    s = sensor_of(plan)
    if s.source:
        return open_recording(s.source, path=s.path, options=s.source_options)
    return open_scene(
        s.scene, size_px=s.size_px, rate_hz=s.rate_hz, seed=s.seed, length=s.frames or None,
        options=s.source_options,
    )  # fmt: skip
