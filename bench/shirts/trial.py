"""Play one clip of the whole pitch through the graph in line: a row and a seed in, counts out."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from bench.reading.rows import Row
from bench.reading.trial import CAPTURE, POLICY, READER, check_budget, sensor_of, size_of
from bench.shirts.tally import Counts, IdentityTally, on_people
from bench.tracking.classes import with_class
from drivers.scenes import WholePitchScene
from drivers.scenes.soccer.looks import everybody
from pipeline.errors import GraphError, SettingsError
from pipeline.graph.editing import rewired
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan
from pipeline.messages import Header, Message, Percept
from pipeline.run.inline import InlineRunner

NAMES = "names"  # the node whose answers are counted
FOVEATED = "foveated"
ALIKE = {  # rows with a ROI that differ from `foveated` in one node, or one setting
    "everybody": (POLICY, "operators.policy:GreedyPolicy", {}),
    "PP-OCR's detector": (READER, "operators.reader:Reader", {"forget_after": 1}),
}
WITHOUT = {"no handing over": f"{NAMES}.memory=0"}
RATE_HZ = 30.0  # of the whole pitch, where the graph does not set one
SENSOR = ("full", "context", "spatial", "centred", "round_robin")
STRATEGIES = (FOVEATED, *WITHOUT, *ALIKE, *SENSOR)


@dataclass(frozen=True, kw_only=True)
class Job:
    """What a worker process is told."""

    graph: str
    changes: tuple[str, ...]
    frames: int
    seed: int
    strategy: str  # of `STRATEGIES`
    budget: Fraction

    @property
    def row(self) -> Row:
        """How the budget is spent."""
        own = self.strategy if self.strategy in SENSOR else FOVEATED
        return Row(strategy=own, budget=self.budget)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a clip has come to."""

    counts: Counts
    alone: Counts  # the same with what the reader reads in each frame in place of kept names
    pixels: float  # share of the full pixel rate that was read


def trial(job: Job) -> Outcome:
    """Play the clip; raises `RunError` where the share of the pixels was not the budget."""
    cv2.setNumThreads(1)
    plan = plan_of(job)
    percepts: dict[str, dict[int, Percept]] = {NAMES: {}, READER: {}}

    def watch(output: str, message: Message) -> None:
        node = output.partition(".")[0]
        if isinstance(message, Percept) and node in percepts:
            percepts[node][message.header.seq] = message

    with InlineRunner(plan, watch=watch) as runner:
        for _ in runner.run():
            pass
        pixels = runner.operator(CAPTURE).summary()["pixels"]["used"]
    check_budget(job.row, pixels)
    counts, alone = counted(percepts[NAMES], percepts[READER], plan, job)
    return Outcome(counts=counts, alone=alone, pixels=round(pixels, 5))


def counted(
    names: Mapping[int, Percept], readings: Mapping[int, Percept], plan: Plan, job: Job
) -> tuple[Counts, Counts]:
    """Count over every frame of the clip, so that who is legible is the same for all rows."""
    given: dict[str, Any] = dict(options_of(plan)["source_options"])
    given.pop("camera", None)
    known = {"size_px": size_of(plan), "rate_hz": rate_of(plan), "seed": job.seed, **given}
    objects, shirts = (
        WholePitchScene(**{**known, "truth_of": truth}) for truth in ("objects", "shirts")
    )
    looks = everybody(job.seed)
    numbers = {who: look.number for who, look in enumerate(looks, 1) if look.number}
    kept, alone = IdentityTally(numbers=numbers), IdentityTally(numbers=numbers)
    for seq in range(job.frames):
        people, backs = objects.truth(seq), shirts.truth(seq)
        kept.add(seq, names.get(seq, nothing(seq)), people, backs)
        alone.add(seq, on_people(readings.get(seq, nothing(seq)), people), people, backs)
    return kept.counts(), alone.counts()


def rate_of(plan: Plan) -> float:
    """Return the frames a second of the clips."""
    return sensor_of(plan).rate_hz or RATE_HZ


def nothing(seq: int) -> Percept:
    """Return the answer of a frame that was not exposed."""
    none = np.zeros(0, np.float32)
    return Percept(
        header=Header(stream="none", seq=seq, stamp_ns=seq),
        boxes=np.zeros((0, 4), np.float32), ids=np.zeros(0, np.int32), scores=none,
    )  # fmt: skip


def plan_of(job: Job) -> Plan:
    """Return the graph of a row, in lockstep, with what it needs only.

    Raises `GraphError` for a graph without the nodes of the task, `SettingsError` for a strategy.
    """
    if job.strategy not in STRATEGIES:
        raise SettingsError(f"strategies: expected {', '.join(STRATEGIES)}, got {job.strategy}")
    given = (f"{CAPTURE}.frames={job.frames}", f"{CAPTURE}.seed={job.seed}", *job.changes)
    bare = load(Path(job.graph), Overlay(changes=given, clock="lockstep"))
    for name in (CAPTURE, READER, POLICY, NAMES):
        if name not in {node.name for node in bare.nodes}:
            raise GraphError(f"{job.graph}: shirts are read with a node {name}, got none")
    own = job.row.changes(size_of(bare))
    left = [WITHOUT[job.strategy]] if job.strategy in WITHOUT else []
    plan = load(Path(job.graph), Overlay(changes=(*given, *own, *left), clock="lockstep"))
    if job.strategy in ALIKE:
        plan = with_class(plan, *ALIKE[job.strategy])
    if "reader.reads=context" in own:
        plan = rewired(plan, f"{NAMES}.roi={CAPTURE}.context")
    return needed(plan, aimed=job.row.aimed)


def options_of(plan: Plan) -> Mapping[str, Any]:
    """Return the sensor's options; raises `GraphError` unless it sees a whole pitch."""
    options: Mapping[str, Any] = plan.node(CAPTURE).settings.get("options", {})
    if options.get("source_options", {}).get("camera") != "whole":
        raise GraphError(f"{CAPTURE}: expected source_options.camera whole, whose truth is known")
    return options


def needed(plan: Plan, *, aimed: bool) -> Plan:
    """Return what the names need and, where a policy aims the ROI, what that needs."""
    names, edges = [NAMES], []
    for name in names:
        if name == CAPTURE and not aimed:
            continue
        own = list(plan.inputs(name).values())
        edges += own
        names += dict.fromkeys(e.source for e in own if e.source not in names)
    kept = [node for node in plan.nodes if node.name in names]
    return replace(
        plan,
        nodes=tuple(replace(node, index=i) for i, node in enumerate(kept)),
        edges=tuple(replace(edge, index=i) for i, edge in enumerate(edges)),
    )
