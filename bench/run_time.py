"""Run time of each part of the loop on one thread; encoder and policy by number of objects."""

import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.crowd import crowded
from bench.tracking.budgets import acquisition
from bench.tracking.camera import Camera
from bench.tracking.clip import HELD_OUT, ClipName, read
from bench.tracking.options import GRAPH
from bench.tracking.stages import NEEDED, Stages
from drivers.commands import Window
from operators.policy.learned import LearnedPolicySettings
from operators.policy.network import file_of
from operators.roi_features.roi_features import SHIPPED as SHIPPED_ENCODER
from pipeline.boxes import centres, roi_window
from pipeline.inference import Network
from pipeline.messages import Frame, altered
from pipeline.weights import weights_file

PARTS_MS = {"saliency": 55.0, "roi_features": 6.2, "association": 0.5, "policy": 3.0}
TOTAL = "total of the paper's parts"
PAPER_MS = {**PARTS_MS, TOTAL: 64.7}  # "Foveated imaging pipeline runtime evaluation"
FRAMES = 60
CROP_PX = 96
COUNTS = (1, 5, 10, 15, 20, 25)  # objects
Figures = dict[str, dict[str, float]]


def run_time(
    changes: Sequence[str], frames: int = FRAMES, *, tracker: str = "", policy: str = ""
) -> Figures:
    """Return milliseconds per call of each part on one thread, and numbers of objects: p50 and p99.

    `TOTAL` is the sum over the parts that the paper counts, frame by frame. The encoder gets the
    whole picture, so that it describes every object, not only the few in a ROI.
    """
    clip = read(ClipName(seed=HELD_OUT), (1, frames))
    camera = Camera(clip, acquisition("foveated", Fraction(1, 8), clip.size_px))
    everything = Camera(clip, acquisition("full", Fraction(1), clip.size_px))
    truth = clip.truths[0]
    ball = truth.boxes[truth.labels.index("ball")]
    box = tuple(float(side) for side in ball)
    window: Window = roi_window(centres(ball), camera.how.geometry)
    spent: dict[str, list[float]] = {}
    objects: list[float] = []
    cv2.setNumThreads(1)
    with Stages(GRAPH, changes, tracker, policy) as stages:
        aim: dict[str, Any] = {"prompt_box": box, "target": ""}
        stages.begin(camera.header(0), *NEEDED, policy=aim, tracker={"init_box": box})
        for frame in range(frames):
            context, roi = camera.context(frame), camera.roi(frame, window)
            small = _timed(stages, spent, "downsample", frame=context)
            found = _timed(stages, spent, "saliency", frame=small)
            tracks = _timed(stages, spent, "association", detections=found)
            objects.append(len(tracks.ids))
            scanpath = _timed(stages, spent, "policy", tracks=tracks)
            _timed(stages, spent, "dispatch", scanpath=scanpath)
            whole = everything.context(frame)
            looks = _timed(stages, spent, "roi_features", roi=whole, tracks=tracks)
            stages.call("policy", features=looks)
            _timed(stages, spent, "tracker", context=context, roi=roi)
    spent[TOTAL] = [sum(each) for each in zip(*(spent[n] for n in PARTS_MS), strict=True)]
    return {
        **{name: _spread(values) for name, values in spent.items()},
        "objects": _spread(objects),
    }


def by_objects(changes: Sequence[str], frames: int = FRAMES, *, policy: str = "") -> Figures:
    """Return milliseconds of encoder and policy together by the number of objects.

    These are p50 and p99 of the operators, cutting and packing included, and the p50 of the
    networks alone. The encoder gets all objects; in the loop it gets only those inside the ROI.
    """
    clip = read(ClipName(seed=HELD_OUT), (1, 2))
    camera = Camera(clip, acquisition("full", Fraction(1), clip.size_px))
    pictured = camera.context(0)
    cv2.setNumThreads(1)
    found: Figures = {}
    with Stages(GRAPH, changes, policy=policy) as stages:
        networks = [Network(file) for file in networks_of(stages)]
        stages.begin(camera.header(0), *NEEDED)
        for frame in range(2):
            small = stages.call("downsample", frame=camera.context(frame))
            tracks = stages.tracks(stages.call("saliency", frame=small), small)
        for count in COUNTS:
            stages.begin(camera.header(0), "policy")
            spent: list[float] = []
            for seq in range(frames):
                crowd = altered(crowded(tracks, count), header=replace(tracks.header, seq=seq))
                began_ns = time.perf_counter_ns()
                whole = Frame(header=crowd.header, pixels=pictured.pixels, window=pictured.window)
                looks = stages.call("roi_features", roi=whole, tracks=crowd)
                stages.call("policy", features=looks)
                stages.call("policy", tracks=crowd)
                spent.append((time.perf_counter_ns() - began_ns) / 1e6)
            alone = [_alone_ms(networks, count) for _ in range(frames)]
            found[str(count)] = {**_spread(spent), "networks": round(statistics.median(alone), 2)}
    return found


def networks_of(stages: Stages) -> list[Path]:
    """Return the files of encoder and policy; only the encoder's if the policy has no network."""
    encoder, policy = stages.settings("roi_features"), stages.settings("policy")
    files = [weights_file(encoder.weights, {"": SHIPPED_ENCODER})]
    if isinstance(policy, LearnedPolicySettings):
        files.append(file_of(policy.weights))
    return files


def _alone_ms(networks: Sequence[Network], count: int) -> float:
    """Return the time of one encoder call and one policy call for `count` crops and objects."""
    fed = [_sides(network, 1, count) for network in networks]
    fed[0] = _sides(networks[0], count, CROP_PX)
    began_ns = time.perf_counter_ns()
    for network, inputs in zip(networks, fed, strict=True):
        network(inputs)
    return (time.perf_counter_ns() - began_ns) / 1e6


def _sides(network: Network, first: int, others: int) -> dict[str, NDArray[np.generic]]:
    """Return ones for every input of a network, with these lengths of its open sides."""
    found: dict[str, NDArray[np.generic]] = {}
    for name, shape in network.inputs.items():
        sides = [first if isinstance(shape[0], str) or shape[0] is None else shape[0]]
        sides += [side if isinstance(side, int) else others for side in shape[1:]]
        found[name] = np.ones(sides, np.bool_ if name == "mask" else np.float32)
    return found


def _timed(stages: Stages, spent: dict[str, list[float]], name: str, **messages: Any) -> Any:
    began_ns = time.perf_counter_ns()
    answer = stages.call(name, **messages)
    spent.setdefault(name, []).append((time.perf_counter_ns() - began_ns) / 1e6)
    return answer


def _spread(values: list[float]) -> dict[str, float]:
    return {
        "p50": round(statistics.median(values), 2),
        "p99": round(statistics.quantiles(values, n=100)[-1], 2),
    }


def markdown(table: Mapping[str, Mapping[str, float]]) -> str:
    """Return the run-time table, with the paper's figures."""
    lines = ["| part | ms p50 | ms p99 | the paper, i7-7700HQ |", "|---|---|---|---|"]
    for name, figures in table.items():
        paper = PAPER_MS.get(name, "")
        lines.append(f"| {name} | {figures['p50']} | {figures['p99']} | {paper} |")
    return "\n".join(lines) + "\n"


def by_objects_markdown(table: Mapping[str, Mapping[str, float]]) -> str:
    """Return a table of encoder and policy together by the number of objects."""
    lines = ["| objects | encoder and policy, ms p50 | ms p99 | networks alone, ms p50 |"]
    lines.append("|---|---|---|---|")
    for count, figures in table.items():
        lines.append(f"| {count} | {figures['p50']} | {figures['p99']} | {figures['networks']} |")
    return "\n".join(lines) + "\n"
