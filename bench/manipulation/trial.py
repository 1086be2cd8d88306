"""One trial of the graph in lockstep: its settings and a seed in, the reward out."""

from dataclasses import dataclass
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
    """Return the graph with its changes, without nodes that start on request."""
    return load(Path(job.graph), Overlay(changes=(*job.changes, *more), clock="lockstep"))


def trial(job: Job, seed: int) -> Outcome:
    """Run the graph until the peg is inserted or the time is over.

    Raises `SettingsError` where more was read than the budget allows.
    """
    cv2.setNumThreads(1)
    steps = 0
    with InlineRunner(plan_of(job, f"{ROBOT}.seed={seed}")) as runner:
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
