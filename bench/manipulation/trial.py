"""One trial of the graph in lockstep: its settings and a seed in, the reward out."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2

from bench.manipulation.rows import ROBOT
from drivers.scenes.insertion import COMPLETE
from pipeline.errors import SettingsError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan
from pipeline.run.inline import InlineRunner

TOLERANCE = 0.01  # of the budget


@dataclass(frozen=True, kw_only=True)
class Job:
    """A graph and its changes; what a worker process is told."""

    graph: str
    changes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a trial has come to."""

    seed: int
    reward: int  # 4: complete; at least 3: partial
    steps: int
    pixels: float  # share of the full pixel rate that was read


def plan_of(job: Job, *more: str) -> Plan:
    """Return the graph with its changes, in lockstep."""
    return load(Path(job.graph), Overlay(changes=(*job.changes, *more), clock="lockstep"))


def needed(plan: Plan) -> Plan:
    """Return what the robot hears of: its consumer, and what aims a ROI only where one is aimed."""
    strategy = plan.node(ROBOT).settings["options"].get("strategy", "foveated")
    heard = ("action", "schedule") if strategy == "foveated" else ("action",)
    edges = [e for name, e in plan.inputs(ROBOT).items() if name in heard]
    names = [ROBOT, *(e.source for e in edges)]
    for name in names:
        before = [e for e in plan.inputs(name).values() if name != ROBOT]
        edges += before
        names += [e.source for e in before if e.source not in names]
    return replace(
        plan,
        nodes=tuple(
            replace(node, index=i)
            for i, node in enumerate(n for n in plan.nodes if n.name in names)
        ),
        edges=tuple(replace(edge, index=i) for i, edge in enumerate(dict.fromkeys(edges))),
    )


def trial(job: Job, seed: int) -> Outcome:
    """Run the graph until the peg is inserted or the time is over.

    Raises `SettingsError` where more was read than the budget allows.
    """
    cv2.setNumThreads(1)
    steps = 0
    with InlineRunner(needed(plan_of(job, f"{ROBOT}.seed={seed}"))) as runner:
        robot = runner.operator(ROBOT)
        for seq in runner.run():
            steps = seq + 1
            if robot.summary()["reward"] == COMPLETE:
                break
        found = robot.summary()
    read, allowed = found["pixels"]["used"], found["pixels"]["budget"]
    if read > allowed * (1 + TOLERANCE):
        raise SettingsError(f"budget: {read:.5f} of the pixels were read, expected {allowed:.5f}")
    return Outcome(seed=seed, reward=found["reward"], steps=steps, pixels=read)
