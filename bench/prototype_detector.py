"""What the detector finds of the panorama's objects, by how it looks at the context.

`python -m bench.prototype_detector [--weights FILE] [--series 12] [--json FILE]`. The context of
graphs/prototype.yaml, a mosaic of 2040x1148, is read by the detector as a whole, reduced to several
widths, and by tiles (operators/saliency/moved.py) of several widths. A series is ten previews of a
world of its own, as many as come before a plan; the last five are judged. Beside the hits stands
the processor's time of one thread for a preview, development included: 33 ms are a frame of delay.
"""

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from bench.machine import facts
from bench.options import JSON, Bench
from bench.prototype import table
from drivers.scenes import PanoramaScene
from drivers.source import CLASS_OF_ROLE, LEAST_VISIBLE, Annotations
from drivers.virtual_board.profiles import PAPER_PX, PROFILES
from drivers.virtual_board.world import World
from operators.downsample import Downsample, DownsampleSettings
from operators.saliency import MovedSaliency, MovedSaliencySettings, Saliency, SaliencySettings
from operators.saliency.judging import find_hits
from pipeline import Detections, Frame, SettingsError
from pipeline.pixel_formats import FORMATS
from pipeline.testing import header

PREVIEWS, JUDGED = 10, 5  # of a series, and of those the last
PREVIEW_FRAMES = 4
FORM = FORMATS["bayer_rggb8"]
JUDGED_WIDTH_PX = 480  # in whose pixels a ball may be off by six, as in the training's evaluation
CLASSES = ("ball", "player", "referee")
PEOPLE = "people, any class"
Operators = tuple[Downsample, Saliency | MovedSaliency]


@dataclass(frozen=True, kw_only=True)
class Look:
    """One way to look at the context; widths are of the picture that the detector gets."""

    width_px: int
    tiles: int = 0  # most of them in one preview; 0: the picture is read whole
    overlap_px: int = 48

    def __str__(self) -> str:
        how = f"{self.tiles} tiles a preview" if self.tiles else "whole"
        return f"{self.width_px} wide, {how}"

    def operators(self, weights: str) -> Operators:
        """Return the two operators, opened."""
        develop = Downsample(DownsampleSettings(width_px=self.width_px))
        detect = self._tiled(weights) if self.tiles else self._whole(weights)
        develop.open()
        detect.open()
        return develop, detect

    def _whole(self, weights: str) -> Saliency:
        height_px = round(self.width_px * PAPER_PX[1] / PAPER_PX[0])
        sides = (-(-self.width_px // 32) * 32, -(-height_px // 32) * 32)
        usual = (0, 0) if self.width_px == JUDGED_WIDTH_PX else sides
        return Saliency(SaliencySettings(weights=weights, input_px=usual))

    def _tiled(self, weights: str) -> MovedSaliency:
        return MovedSaliency(
            MovedSaliencySettings(weights=weights, tiles=self.tiles, overlap_px=self.overlap_px)
        )


LOOKS = (
    Look(width_px=480),
    Look(width_px=1020),
    Look(width_px=2040),
    Look(width_px=1020, tiles=4, overlap_px=64),
    Look(width_px=1020, tiles=9, overlap_px=64),
    Look(width_px=2040, tiles=8, overlap_px=120),
)


@dataclass(kw_only=True)
class Score:
    """Hits and what there was to find, by class, over previews, and times."""

    present: dict[str, int] = field(default_factory=dict)
    found: dict[str, int] = field(default_factory=dict)
    hits: dict[str, int] = field(default_factory=dict)
    times_ms: list[float] = field(default_factory=list)

    def add(self, seen: Detections, truth: Annotations) -> None:
        """Judge a preview."""
        share = np.float32(JUDGED_WIDTH_PX / PAPER_PX[0])
        names = np.array([CLASS_OF_ROLE.get(label, label) for label in truth.labels])
        said = np.array([seen.names[k] for k in seen.labels], dtype=str)
        hidden = truth.visibility < LEAST_VISIBLE
        kinds = {name: (said == name, names == name) for name in CLASSES}
        kinds[PEOPLE] = (said != "ball", names != "ball")
        for kind, (mine, real) in kinds.items():
            order = np.flatnonzero(mine)[np.argsort(-seen.scores[mine], kind="stable")]
            hits, counts = find_hits(
                seen.boxes[order] * share, truth.boxes[real] * share, hidden[real],
                by_centre=kind == "ball",
            )  # fmt: skip
            self._count(kind, int((~hidden[real]).sum()), int(counts.sum()), int(hits.sum()))

    def _count(self, kind: str, present: int, found: int, hits: int) -> None:
        for counts, more in ((self.present, present), (self.found, found), (self.hits, hits)):
            counts[kind] = counts.get(kind, 0) + more

    def row(self) -> dict[str, Any]:
        """Return found of present, and the share of what was found that is right."""
        row: dict[str, Any] = {}
        for kind in (*CLASSES, PEOPLE):
            row[kind] = f"{self.hits[kind]} of {self.present[kind]}"
            wrong = self.found[kind] - self.hits[kind]
            row[f"{kind}, wrong"] = wrong
        median, high = np.quantile(self.times_ms, [0.5, 0.95]).round(1).tolist()
        return {**row, "ms": median, "ms p95": high, "frames": round(median * 30 / 1000, 2)}


@click.command(cls=Bench)
@click.option("--weights", default="", help="An ONNX file of a detector; the shipped one without.")
@click.option("--series", default=12, show_default=True, type=click.IntRange(1, 1000))
@click.option("--seed", default=100, show_default=True, help="Of the first series' world.")
@JSON
def main(weights: str, series: int, seed: int, path: Path | None) -> None:
    """Compare ways in which the detector looks at the prototype's context."""
    looks = tuple(possible(weights))
    rows = []
    for size, share in {"as they are": 1.0, "half": 0.5}.items():
        scores = {look: Score() for look in looks}
        for number in track(range(series), f"objects {size}", transient=True):
            one_series(seed + number, share, weights, scores)
        rows += [
            {"objects": size, "look": str(look), **score.row()} for look, score in scores.items()
        ]
    Console().print(table("found of those present", rows))
    if path:
        file = SaliencySettings(weights=weights).detector.path
        result = {
            "bench": "prototype_detector", **facts(), "seed": seed, "series": series,
            "judged_previews": series * JUDGED, "weights": Path(weights).name or "shipped",
            "weights_sha256": sha256(file.read_bytes()).hexdigest(),
            "rows": rows,
        }  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1) + "\n")


def possible(weights: str) -> Iterator[Look]:
    """Yield the looks that the network can take; the input of some has one size."""
    for look in LOOKS:
        try:
            look.operators(weights)
        except SettingsError as error:
            print(f"{look}: left out: {error}")
        else:
            yield look


def one_series(seed: int, share: float, weights: str, scores: dict[Look, Score]) -> None:
    """Look at the previews of one world in every way; objects have a share of their size."""
    scene = PanoramaScene(seed=seed, person_share=0.1 * share, ball_share=0.0125 * share)
    operators = {look: look.operators(weights) for look in scores}
    for number, (frame, truth) in enumerate(previews(scene)):
        judged = number >= PREVIEWS - JUDGED
        for look, (develop, detect) in operators.items():
            if not look.tiles and not judged:
                continue  # what is read whole has no memory
            began_s = time.thread_time()
            seen = detect.on_frame(develop.on_frame(frame))
            if judged:
                scores[look].times_ms.append((time.thread_time() - began_s) * 1000)
                scores[look].add(seen, truth)


def previews(scene: PanoramaScene) -> Iterator[tuple[Frame, Annotations]]:
    """Yield the context as the board sends it, and the truth."""
    size_px = PROFILES["paper-prototype"].can.context_px
    window = (0, 0, *PAPER_PX)
    world = World(scene, pixel_format=FORM.code, noise=0.0, seed=0, most_px=size_px[0] * size_px[1])
    for seq in range(0, PREVIEWS * PREVIEW_FRAMES, PREVIEW_FRAMES):
        pixels: NDArray[np.uint8] = np.empty(size_px[0] * size_px[1], np.uint8)
        world.render(seq, window, size_px, pixels, 0)
        frame = Frame(
            header=header(seq), pixels=pixels.reshape(world.readout.shape(size_px)),
            pixel_format=FORM.name, window=window,
        )  # fmt: skip
        yield frame, scene.truth(seq)


if __name__ == "__main__":
    main()
