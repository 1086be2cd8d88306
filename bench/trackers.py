"""Trackers side by side: `python -m bench.trackers [--vittrack FILE] [--footage FOLDER]`.

Every tracker starts once on the true box and follows to the end of the clip. Context at a quarter,
ROI (1/16 of the area) around the tracker's own last box: the same help for all. Drawn matches have
seeds that no training uses; on a panorama objects are pasted on drawn lawn, or on the photographs
at `--panorama`. The frame of the start is not scored; frames where the object is hidden are
followed, but not scored. Success is the share of frames above an overlap: its area under the curve,
and at .5; precision the share of centres within 20 px. Each with an interval of 95 %, drawn over
clips, where there are at least five.
"""

import json
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from bench.machine import facts
from bench.options import JSON, Bench
from drivers.datasets.soccernet import SoccerNetSequence
from drivers.scenes.panorama import PanoramaScene
from drivers.scenes.soccer import SoccerScene
from drivers.source import CLASS_OF_ROLE, FrameSource
from operators.tracker.correlation import Correlation
from operators.tracker.following import Method
from operators.tracker.look import Streams
from operators.tracker.template import SHIPPED, Template
from operators.tracker.vittrack import VitTrack
from pipeline import Frame, Geometry
from pipeline.boxes import centres, iou, roi_window
from pipeline.errors import SettingsError
from pipeline.inference import Network
from pipeline.testing import header
from pipeline.whole_file import write_whole

FIRST_SEED = 70_000  # trainings use lower ones
CLASSES = ("ball", "referee", "player")
CONTEXT_SCALE, ROI_SIDE = 4, 4  # the field's side over the context's, over the ROI's
NEAR_PX, OVERLAPS = 20.0, np.linspace(0, 1, 21)
VISIBLE, START_WITHIN = 0.5, 50  # share that is seen; frames in which a target must appear
PANORAMA_PX, PERSON, BALL = (3840, 2160), 0.03, 0.0075
DRAWS = 2000  # of the bootstrap
LEAST_CLIPS = 5  # with fewer, a bootstrap over clips is no interval, and none is given
Box = NDArray[np.float32]  # (4,) xyxy


@dataclass(frozen=True, kw_only=True, eq=False)
class Followed:
    """What one tracker did with one object of one clip; n scored frames, at least one."""

    clip: str
    kind: str  # of CLASSES
    overlaps: NDArray[np.float32]  # (n,)
    apart_px: NDArray[np.float32]  # (n,)
    cpu_ms: NDArray[np.float32]  # (m,) of a core, each update


class Follower:
    """One tracker on one object, from a start on."""

    def __init__(self, method: Method, kind: str, object_id: int) -> None:
        self.method, self.kind, self.object_id = method, kind, object_id
        self.box: Box | None = None
        self._overlaps: list[float] = []
        self._apart: list[float] = []
        self._cpu: list[float] = []

    def step(self, picture: NDArray[np.uint8], context: Frame, truth: Box | None) -> None:
        """Go on by a frame; `truth` is None where the object is not seen."""
        if self.box is None:
            if truth is not None:
                self.box = truth.copy()
                self.method.start(streams_of(picture, context, self.box), self.box)
            return
        streams = streams_of(picture, context, self.box)
        began = time.process_time()
        found, score = self.method.follow(streams, self.box)
        self._cpu.append((time.process_time() - began) * 1e3)
        if score >= self.method.patience_score:  # as `Following`: else it keeps its place
            self.box = found
        if truth is not None:
            self._overlaps.append(float(iou(self.box[None], truth[None])[0, 0]))
            self._apart.append(float(np.linalg.norm(centres(self.box) - centres(truth))))

    def path(self, clip: str) -> Iterator[Followed]:
        """What became of it, if any frame was scored."""
        if self._overlaps:
            yield Followed(
                clip=clip, kind=self.kind,
                overlaps=np.array(self._overlaps, np.float32),
                apart_px=np.array(self._apart, np.float32),
                cpu_ms=np.array(self._cpu, np.float32),
            )  # fmt: skip


def streams_of(picture: NDArray[np.uint8], context: Frame, box: Box) -> Streams:
    """The two streams, the ROI around a box."""
    height, width = picture.shape[:2]
    geometry = Geometry(
        width_px=width, height_px=height,
        roi_width_px=width // ROI_SIDE, roi_height_px=height // ROI_SIDE, step_px=2,
    )  # fmt: skip
    left, top, right, bottom = roi_window(centres(box), geometry)
    roi = Frame(
        header=context.header,
        pixels=np.ascontiguousarray(picture[top:bottom, left:right]),
        window=(left, top, right, bottom),
    )
    return Streams(context=context, roi=roi)


def shrunk(picture: NDArray[np.uint8]) -> Frame:
    """The context of a picture."""
    height, width = picture.shape[:2]
    size = (width // CONTEXT_SCALE, height // CONTEXT_SCALE)
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return Frame(header=header(), pixels=np.asarray(small, np.uint8), window=(0, 0, width, height))


def targets(source: FrameSource, length: int) -> dict[str, int]:
    """One object of each class: the one that is seen first, of several the lowest number."""
    found: dict[str, int] = {}
    for index in range(min(START_WITHIN, length)):
        truth = source.truth(index)
        if truth is None:
            continue
        rows = sorted(range(len(truth.ids)), key=lambda row: int(truth.ids[row]))
        for row in rows:
            kind = CLASS_OF_ROLE.get(truth.labels[row], "")
            if kind in CLASSES and truth.visibility[row] >= VISIBLE:
                found.setdefault(kind, int(truth.ids[row]))
        if len(found) == len(CLASSES):
            break
    return found


def followed(
    source: FrameSource, clip: str, length: int, methods: Mapping[str, Callable[[], Method]]
) -> dict[str, list[Followed]]:
    """Every tracker on every target of a clip, in one pass over its pictures."""
    wanted = targets(source, length)
    running = {
        name: [Follower(make(), kind, number) for kind, number in wanted.items()]
        for name, make in methods.items()
    }
    for index in range(length):
        picture, truth = source.picture(index), source.truth(index)
        context = shrunk(picture)
        seen: dict[int, Box] = {}
        if truth is not None:
            rows = np.flatnonzero(truth.visibility >= VISIBLE)
            seen = {int(truth.ids[row]): truth.boxes[row] for row in rows}
        for group in running.values():
            for follower in group:
                follower.step(picture, context, seen.get(follower.object_id))
    return {name: [p for f in group for p in f.path(clip)] for name, group in running.items()}


def figures(paths: list[Followed], seed: int) -> dict[str, Any]:
    """Success and precision with their intervals, and the time of an update."""
    each = np.array(
        [
            [
                (p.overlaps[:, None] > OVERLAPS).mean(),
                (p.overlaps > 0.5).mean(),
                (p.apart_px <= NEAR_PX).mean(),
            ]
            for p in paths
        ]
    )
    clips = [p.clip for p in paths]
    names = sorted(set(clips))
    rows = [np.flatnonzero([c == name for c in clips]) for name in names]
    rng = np.random.default_rng(seed)
    drawn = [
        each[np.concatenate([rows[k] for k in rng.integers(len(rows), size=len(rows))])].mean(0)
        for _ in range(DRAWS)
    ]
    low, high = np.quantile(drawn, (0.025, 0.975), axis=0)
    cpu = np.concatenate([p.cpu_ms for p in paths])
    return {
        "clips": len(names), "objects": len(paths), "frames": sum(len(p.overlaps) for p in paths),
        **{
            name: {
                "mean": round(float(each[:, k].mean()), 3),
                "interval": [round(float(low[k]), 3), round(float(high[k]), 3)]
                if len(names) >= LEAST_CLIPS
                else [],
            }
            for k, name in enumerate(("success", "success_at_half", "precision_20_px"))
        },
        "processor_ms": {f"p{q}": round(float(np.percentile(cpu, q)), 2) for q in (5, 50, 95)},
    }  # fmt: skip


@click.command(cls=Bench)
@click.option("--clips", default=6, show_default=True, type=click.IntRange(1, 200))
@click.option("--frames", default=150, show_default=True, type=click.IntRange(2, 10_000))
@click.option("--seed", default=FIRST_SEED, show_default=True, type=click.IntRange(FIRST_SEED))
@click.option("--weights", type=click.Path(path_type=Path), help="Of the template tracker.")
@click.option("--vittrack", type=click.Path(path_type=Path), help="vitTracker.onnx.")
@click.option("--panorama", default="", help="Photographs to paste objects on.")
@click.option("--footage", type=click.Path(path_type=Path), help="A SoccerNet sequence.")
@JSON
def main(
    clips: int, frames: int, seed: int, weights: Path | None, vittrack: Path | None,
    panorama: str, footage: Path | None, path: Path | None,
) -> None:  # fmt: skip
    """Compare trackers."""
    methods: dict[str, Callable[[], Method]] = {
        "template": lambda: Template(weights or SHIPPED, threads=1),
        "correlation": Correlation,
    }
    if vittrack is not None:
        methods["vittrack"] = lambda: VitTrack(vittrack, threads=1)
    for make in methods.values():
        make()  # missing weights are an error now, and not after the first clip
    report: dict[str, Any] = {
        "bench": "trackers", **facts(), "seed": seed, "frames": frames,
        "network": Network(weights or SHIPPED).metadata, "worlds": {},
    }  # fmt: skip
    for world, made in worlds(clips, frames, seed, panorama, footage).items():
        found: dict[str, list[Followed]] = {name: [] for name in methods}
        for number, make_source in enumerate(track(made, world, console=Console(stderr=True))):
            source = make_source()
            length = min(frames, source.length or frames)
            for name, paths in followed(source, f"{world} {number}", length, methods).items():
                found[name] += paths
            source.close()
        report["worlds"][world] = {
            kind: {
                name: figures(mine, seed)
                for name, paths in found.items()
                if (mine := [p for p in paths if kind in ("all", p.kind)])
            }
            for kind in ("all", *CLASSES)
        }
        if path:  # after each world: an interrupted run keeps what it has
            write_whole(path, json.dumps(report, indent=1) + "\n")
    Console().print(shown(report))


def worlds(
    clips: int, frames: int, seed: int, panorama: str, footage: Path | None
) -> dict[str, list[Callable[[], FrameSource]]]:
    """The clips of each world, not yet opened."""
    if footage is not None and not footage.is_dir():
        raise SettingsError(f"footage: expected a SoccerNet sequence, got {footage}")
    seeds = range(seed, seed + clips)
    found: dict[str, list[Callable[[], FrameSource]]] = {
        "drawn": [lambda s=s: SoccerScene(seed=s, length=frames) for s in seeds],  # type: ignore[misc]
        "panorama": [
            lambda s=s: PanoramaScene(  # type: ignore[misc]
                size_px=PANORAMA_PX, seed=s, length=frames, path=panorama,
                person_share=PERSON, ball_share=BALL,
            )
            for s in seeds
        ],
    }  # fmt: skip
    if footage is not None:
        found["footage"] = [lambda: SoccerNetSequence(path=str(footage))]
    return found


def shown(report: dict[str, Any]) -> Table:
    """The figures for a terminal."""
    table = Table(title=f"{report['frames']} frames a clip, from seed {report['seed']}")
    for column in ("world", "object", "tracker", "n", "success", "at .5", "20 px", "ms"):
        table.add_column(column)
    for world, kinds in report["worlds"].items():
        for kind, trackers in kinds.items():
            for name, row in trackers.items():
                means = (row[k] for k in ("success", "success_at_half", "precision_20_px"))
                cells = (in_words(m["mean"], m["interval"]) for m in means)
                count = f"{row['objects']} of {row['clips']}"
                table.add_row(world, kind, name, count, *cells, f"{row['processor_ms']['p50']:g}")
    return table


def in_words(mean: float, interval: list[float]) -> str:
    """A mean and its interval, if it has one.

    >>> in_words(0.5, [0.25, 0.75]), in_words(0.5, [])
    ('0.500 (0.25–0.75)', '0.500')
    """
    return f"{mean:.3f}" + (f" ({interval[0]:.2f}–{interval[1]:.2f})" if interval else "")


if __name__ == "__main__":
    main()
