"""The shipped networks keep their target in view and follow it: means over several seeds.

The seeds are fixed, so machines differ only by noise and by the order of sums; each bound is below
the mean of the seeds by far more than three standard deviations of that. No test here needs footage
or third-party weights.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.tracking.classes import planned
from pipeline.boxes import covered, iou
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.run.inline import InlineRunner

GRAPH = Path(__file__).resolve().parents[2] / "graphs" / "learned.yaml"
FRAMES = 60
CHANGED = 30  # the frame after which the referee is the target
SEEDS = (401, 404, 405)
MORE_SEEDS = (*SEEDS, 402, 407, 409)
# Bounds of means over SEEDS. Behind each: the mean, and its largest change by two threads or by
# noise of 1 or 1.4 levels.
BALL = 0.95  # 1.000, .000
REFEREE = 0.95  # 1.000, .000
FOLLOWED = 0.5  # .680, .001. One seed may lose the object and give about .2, two may not
# Bound of the share of the ball inside the ROI in all 60 frames under pursuit, over MORE_SEEDS
PURSUED = 0.6  # .867, .000. One seed may lose the ball, two may not
ELSEWHERE = {  # differences between machines: the order of sums, a grey level of a pixel
    "two threads": tuple(f"{n}.threads=2" for n in ("saliency", "policy", "roi_features")),
    "noise": ("capture.noise=1.0",),
}


@dataclass(frozen=True)
class Shares:
    """Means over the frames of one run: the ball before the change, the referee after it."""

    ball: float  # share of its box inside the ROI
    referee: float
    iou: float  # of the consumer's box with the referee's, 0 where it has none


def run(seed: int, *changes: str) -> Shares:
    """Run the shipped graph in line; the target is the ball, later the referee by a box."""
    heard: dict[str, Any] = {}
    ball, referee, overlap = [], [], []
    plan = load(GRAPH, Overlay(changes=(f"capture.seed={seed}", *changes), clock="lockstep"))
    with InlineRunner(plan, watch=lambda name, message: heard.update({name: message})) as runner:
        for seq in runner.run(FRAMES):
            truth, window = heard["capture.truth"], np.array(heard["capture.roi"].window)
            boxes = dict(zip(truth.labels, truth.boxes[:, None], strict=True))
            if 10 <= seq < CHANGED and "ball" in boxes:
                ball.append(float(covered(boxes["ball"], window)[0]))
            if seq == CHANGED:
                told = {"prompt_box": boxes["main referee"][0].tolist(), "target": ""}
                runner.change("policy", told)
            if seq >= CHANGED + 4:
                referee.append(float(covered(boxes["main referee"], window)[0]))
            if seq >= CHANGED + 10:
                seen = heard["tracker.out"].boxes
                overlap.append(float(iou(boxes["main referee"], seen).max(initial=0)))
        pixels = runner.report()["pixels"]
    assert pixels["used"] == pytest.approx(pixels["budget"], rel=0.01)
    return Shares(float(np.mean(ball)), float(np.mean(referee)), float(np.mean(overlap)))


def check(seeds: Sequence[int], *changes: str) -> None:
    """Assert that the means over the seeds are above their bounds."""
    found = [run(seed, *changes) for seed in seeds]

    assert np.mean([shares.ball for shares in found]) > BALL
    assert np.mean([shares.referee for shares in found]) > REFEREE
    assert np.mean([shares.iou for shares in found]) > FOLLOWED


@pytest.mark.lengthy
def test_the_roi_and_the_consumer_go_with_what_the_policy_is_asked_for() -> None:
    check(SEEDS)


@pytest.mark.lengthy
@pytest.mark.parametrize("changes", ELSEWHERE.values(), ids=ELSEWHERE)
@pytest.mark.parametrize("seeds", [SEEDS[:1], pytest.param(SEEDS, marks=pytest.mark.slow)], ids=len)
def test_threads_and_a_grey_level_of_noise_change_little(
    seeds: tuple[int, ...], changes: tuple[str, ...]
) -> None:
    check(seeds, *changes)


@pytest.mark.slow
@pytest.mark.parametrize("changes", [(), *ELSEWHERE.values()], ids=["as shipped", *ELSEWHERE])
def test_pursuit_keeps_the_ball_in_view_without_the_learned_policy(
    changes: tuple[str, ...],
) -> None:
    found = []
    for seed in MORE_SEEDS:
        plan = planned(GRAPH, (f"capture.seed={seed}", *changes), policy="pursuit")
        with InlineRunner(plan) as runner:
            for _ in runner.run(FRAMES):
                pass
            found.append(runner.report()["roi_coverage"]["ball"])

    assert np.mean(found) > PURSUED
