"""One large ROI against two and four small ones at equal pixels: what lies inside any of them.

`python -m bench.rois [--clips 8] [--frames 120] [--json FILE]` runs `graphs/several_rois.yaml` in
line on drawn clips that nothing was trained on. All arrangements read the same context and may read
as many ROI pixels; detector, policy and its target are the same. `around the choice` is one window
as in most graphs; the others choose windows by the same expected utility. Figures
are mean shares of the true boxes of what is visible, by class, and the IoU of the graph's tracker,
which follows the ball; differences are paired by clip, against one window by the same utility.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from scipy.stats import t as student

from bench.machine import facts
from bench.options import JSON, ROOT, Bench
from bench.prototype import table
from drivers.source import CLASS_OF_ROLE, LEAST_VISIBLE
from pipeline.boxes import covered_by, iou
from pipeline.errors import RunError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.messages import Frame, Message, Percept, Truth
from pipeline.run.inline import InlineRunner

GRAPH = ROOT / "graphs" / "several_rois.yaml"
FIRST_CLIP = 70_000  # no training and no choice of a setting has used seeds from here on
AREA = 1 / 16  # of the field: all windows of an exposure; the context has as much
ARRANGEMENTS = {"around the choice": 1, "one": 1, "two": 2, "four": 4}
BASE = "one"
CLASSES = ("ball", "referee", "player")
IOU = "ball, IoU of the tracker"
Shares = dict[str, float]  # class -> mean share over the frames of a clip


@dataclass(kw_only=True, eq=False)
class Clip:
    """What the windows of one clip showed."""

    skip: int  # frames at the start, before there are tracks
    shares: dict[str, list[float]] = field(default_factory=lambda: {c: [] for c in CLASSES})
    windows: list[tuple[int, int, int, int]] = field(default_factory=list)  # of this exposure
    read_px: int = 0
    frames: int = 0
    balls: dict[int, NDArray[np.float32]] = field(default_factory=dict)  # (4,) by frame, visible
    answers: dict[int, NDArray[np.float32]] = field(default_factory=dict)  # (4,) by frame

    def hear(self, output: str, message: Message) -> None:
        """Take a message of the graph: the windows come before the truth."""
        if isinstance(message, Frame) and output.startswith("capture.roi"):
            if message.pixels.size:
                self.windows.append(message.window)
                self.read_px += message.size_px[0] * message.size_px[1]
        elif isinstance(message, Truth) and output == "capture.truth":
            self.frames += 1
            if self.frames > self.skip:
                self._count(message)
            self.windows = []
        elif isinstance(message, Percept) and output == "tracker.out" and len(message.boxes):
            self.answers[message.header.seq] = message.boxes[0]

    def means(self) -> Shares:
        """Return means over frames: by class, if it was ever visible, and of the tracker's IoU."""
        found = {name: float(np.mean(v)) for name, v in self.shares.items() if v}
        nowhere = np.zeros(4, np.float32)
        overlaps = [
            float(iou(self.answers.get(seq, nowhere)[None], ball[None])[0, 0])
            for seq, ball in self.balls.items()
        ]
        return found | ({IOU: float(np.mean(overlaps))} if overlaps else {})

    def _count(self, truth: Truth) -> None:
        shown = covered_by(truth.boxes, np.array(self.windows, np.float32).reshape(-1, 4))
        labels = np.array([CLASS_OF_ROLE.get(label, label) for label in truth.labels])
        for name, values in self.shares.items():
            own = (labels == name) & (truth.visibility >= LEAST_VISIBLE)
            if own.any():
                values.append(float(shown[own].mean()))
                if name == "ball":
                    self.balls[truth.header.seq] = truth.boxes[own][0]


def changes(arrangement: str, seed: int, others: float, area: float = AREA) -> tuple[str, ...]:
    """Return what is laid over the graph; `area` is that of all windows together.

    >>> changes("two", 70000, 0.05)[1:3]
    ('capture.rois=2', 'capture.roi_area=0.03125')
    """
    count = ARRANGEMENTS[arrangement]
    weight = 0.0 if arrangement == "around the choice" else others
    return (
        f"capture.seed={seed}",
        f"capture.rois={count}",
        f"capture.roi_area={area / count}",
        f"dispatch.windows={count}",
        f"dispatch.others={weight}",
    )


def watched(changed: tuple[str, ...], *, frames: int, skip: int) -> Clip:
    """Run one arrangement on one clip; raises `RunError` when it read more than its pixels."""
    overlay = Overlay(clock="lockstep", changes=changed)
    clip = Clip(skip=skip)
    with InlineRunner(load(GRAPH, overlay), watch=clip.hear) as runner:
        for _ in runner.run(frames):
            pass
        pixels = runner.report(summaries=True)["pixels"]
    if pixels["used"] > pixels["budget"] * 1.01:
        raise RunError(
            f"{GRAPH.name}: expected at most {pixels['budget']} of the pixels, got {pixels['used']}"
        )
    return clip


def rows(found: Mapping[str, Sequence[Clip]]) -> Iterator[dict[str, Any]]:
    """Yield means over clips by arrangement and class, and the paired difference to `BASE`."""
    for name, clips in found.items():
        for label in (*CLASSES, IOU):
            pairs = [
                (clip.means()[label], usual.means()[label])
                for clip, usual in zip(clips, found[BASE], strict=True)
                if label in clip.means() and label in usual.means()
            ]
            if not pairs:
                continue
            values, usual_values = np.array(pairs).T
            yield {
                "windows": name,
                "class": label,
                "share in a ROI, or IoU": round(float(values.mean()), 3),
                "lowest clip": round(float(values.min()), 3),
                "highest clip": round(float(values.max()), 3),
                "against one": "" if name == BASE else difference(values - usual_values),
                "clips": len(pairs),
            }


def difference(values: NDArray[np.float64]) -> str:
    """Return a mean of paired differences with its 95 % interval (Student's t over clips).

    >>> difference(np.array([0.1, 0.2, 0.3]))
    '+0.200 (-0.048 .. +0.448)'
    """
    mean = float(values.mean())
    if len(values) < 2:
        return f"{mean:+.3f}"
    half = student.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
    return f"{mean:+.3f} ({mean - half:+.3f} .. {mean + half:+.3f})"


@click.command(cls=Bench)
@click.option("--clips", "count", default=8, show_default=True, type=click.IntRange(2))
@click.option("--frames", default=120, show_default=True, type=click.IntRange(2))
@click.option("--skip", default=10, show_default=True, type=click.IntRange(0), help="Not counted.")
@click.option("--first-clip", default=FIRST_CLIP, show_default=True, type=click.IntRange(0))
@click.option(
    "--others", default=0.05, show_default=True, type=click.FloatRange(0, min_open=True),
    help="Weight of each track beside its probability.",
)  # fmt: skip
@click.option(
    "--area", default=AREA, show_default=True, type=click.FloatRange(1 / 1024, AREA),
    help="Share of the field that all windows of an exposure show together.",
)  # fmt: skip
@JSON
def main(
    *,
    count: int,
    frames: int,
    skip: int,
    first_clip: int,
    others: float,
    area: float,
    path: Path | None,
) -> None:
    """Compare one, two and four windows in one exposure."""
    if skip >= frames:
        raise RunError(f"--skip: expected fewer than the {frames} frames, got {skip}")
    found: dict[str, list[Clip]] = {name: [] for name in ARRANGEMENTS}
    for number in range(count):
        for name, clips in found.items():
            changed = changes(name, first_clip + number, others, area)
            clips.append(watched(changed, frames=frames, skip=skip))
        shown = ", ".join(f"{n} {c[-1].means().get('player', 0):.2f}" for n, c in found.items())
        click.echo(f"clip {number + 1} of {count}: share of the players: {shown}")
    result = list(rows(found))
    Console().print(table(f"share in a ROI, {count} clips of {frames} frames", result))
    if path:
        report = facts() | {
            "bench": "rois", "seed": first_clip, "clips": count, "frames": frames,
            "frames_not_counted": skip, "weight_of_others": others, "area_of_all_windows": area,
            "interval": "95 %, Student's t over clips, paired",
            "roi_pixels_read": {n: sum(c.read_px for c in clips) for n, clips in found.items()},
            "rows": result,
        }  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
