"""Where a shirt number is lost on the way to a reader: `python -m bench.shirts.stages`.

Asked of every number that the truth calls legible, in some frames of some matches: does the
detector of texts find it in the context of a quarter of the sides, and which readers read it?
PP-OCR with its own detector sees a window of full resolution around it; PP-OCR's recogniser sees
the true box of the number, and the part of the true box of the person that `ShirtReader` reads, at
full resolution and in the context.
"""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
from numpy.typing import NDArray

from bench.machine import facts
from bench.options import Bench
from bench.outputs import make_folder
from drivers.scenes import WholePitchScene
from drivers.scenes.soccer.shirts import ILLEGIBLE
from operators.reader.ctc import OnnxReaderSettings, Recogniser, cut, recogniser_of
from operators.reader.ocr import PaddleOcr
from operators.reader.shirts import ShirtReaderSettings
from operators.saliency import Saliency, SaliencySettings
from operators.transcribed import plain
from pipeline import Frame
from pipeline.boxes import centres, parts_of
from pipeline.messages import Geometry
from pipeline.testing import header
from pipeline.whole_file import write_whole

SIZE = (7680, 4320)
REDUCED = 4  # sides of the context
WINDOW = (640, 360)  # shown to PP-OCR, around a number
LIBRARIES = ("numpy", "onnxruntime", "opencv-python-headless", "rapidocr")
Image = NDArray[np.uint8]
COUNT = click.IntRange(1, 100_000)
STAGES = (
    ("found", "detector of texts, in the context", "a box whose middle is on the number"),
    ("ppocr", "PP-OCR with its own detector", "640x360 at full resolution around the number"),
    ("line", "PP-OCR's recogniser", "the true box of the number"),
    ("part", "PP-OCR's recogniser, as `ShirtReader`", "a part of the true box of the person"),
    ("context", "the same in the context", "a part of the true box of the person"),
)


@dataclass(frozen=True, kw_only=True)
class Legible:
    """A number in one frame."""

    text: str
    box: NDArray[np.float32]  # (4,) of the sensor
    person: NDArray[np.float32]  # (4,) of the one who wears it


@click.command(cls=Bench, help=(__doc__ or "").split("\n", 1)[0])
@click.option("--matches", default=10, show_default=True, type=COUNT, help="seeds in succession")
@click.option(
    "--seed", default=50_000, show_default=True, type=click.IntRange(0), help="of the first match"
)
@click.option("--frames", default=150, show_default=True, type=COUNT, help="length of a clip")
@click.option(
    "--every", default=50, show_default=True, type=COUNT, help="frames between those looked at"
)
@click.option("--report", type=Path, help="JSON")
def main(matches: int, seed: int, frames: int, every: int, report: Path | None) -> None:
    """See the module."""
    if report:
        make_folder("report", report.parent)
    cv2.setNumThreads(1)
    stages = Readers()
    told = [
        stages.asked(scene, match, index, each)
        for match in range(seed, seed + matches)
        for scene in [WholePitchScene(size_px=SIZE, seed=match, truth_of="shirts")]
        for index in range(0, frames, every)
        for each in legible(scene, index, match)
    ]
    rows = [
        {"who": who, "sees": sees, "share": share([each[name] for each in told])}
        for name, who, sees in STAGES
    ]
    for row in rows:
        click.echo(f"{row['share']}: {row['who']}: {row['sees']}")
    found = {
        "bench": "shirts_stages",
        **facts(LIBRARIES),
        "seed": seed,
        "matches": matches,
        "frames": frames,
        "every": every,
        "numbers": len(told),
        "height_px": median([each["height_px"] for each in told]),
        "rows": rows,
    }
    if report:
        write_whole(report, json.dumps(found, indent=1) + os.linesep)


class Readers:
    """What is asked about each number."""

    def __init__(self) -> None:
        self._read: Recogniser = recogniser_of(OnnxReaderSettings())
        self._ocr = PaddleOcr()
        self._part = ShirtReaderSettings().part
        self._detector = Saliency(SaliencySettings(weights="text"))
        self._detector.open()
        self._seen: tuple[int, int] = (-1, -1)  # seed, frame
        self._middles: NDArray[np.float32] = np.zeros((0, 2), np.float32)

    def asked(self, scene: WholePitchScene, seed: int, index: int, each: Legible) -> dict[str, Any]:
        """Return whether each stage has the number, in a frame of the match of a seed."""
        left, top = (
            int(np.clip(middle - side / 2, 0, whole - side)) // REDUCED * REDUCED
            for middle, side, whole in zip(centres(each.box[None])[0], WINDOW, SIZE, strict=True)
        )
        corner = np.array([left, top] * 2, np.float32)
        sharp = window(scene, index, left, top, 1)
        small = window(scene, index, left, top, REDUCED)
        part = parts_of(each.person[None], self._part)[0] - corner
        middles = self._found(scene, seed, index)
        inside = (middles >= each.box[:2]) & (middles <= each.box[2:])
        texts = [plain(reading.text) for reading in self._ocr(sharp)]
        return {
            "height_px": float(each.box[3] - each.box[1]),
            "found": bool(inside.all(1).any()),
            "ppocr": each.text in texts,
            "line": self._says(sharp, each.box - corner, each.text),
            "part": self._says(sharp, part, each.text),
            "context": self._says(small, part / REDUCED, each.text),
        }

    def _says(self, picture: Image, box: NDArray[np.float32], text: str) -> bool:
        return plain(self._read(cut(picture, box))[0]) == text

    def _found(self, scene: WholePitchScene, seed: int, index: int) -> NDArray[np.float32]:
        """Return the middles (n, 2) of the texts that the detector finds in the context."""
        if self._seen != (seed, index):
            out = np.empty((SIZE[1] // REDUCED, SIZE[0] // REDUCED, 3), np.uint8)
            scene.window(index, 0, 0, *SIZE, REDUCED, out)
            field = Geometry(width_px=SIZE[0], height_px=SIZE[1])
            frame = Frame(header=header(index, geometry=field), pixels=out, window=(0, 0, *SIZE))
            self._middles = centres(self._detector.on_frame(frame).boxes)
            self._seen = (seed, index)
        return self._middles


def legible(scene: WholePitchScene, index: int, seed: int) -> Iterator[Legible]:
    """Yield the numbers that the truth calls legible, with the boxes of their persons."""
    people = WholePitchScene(size_px=SIZE, seed=seed).truth(index)
    boxes = dict(zip(people.ids.tolist(), people.boxes.astype(np.float32), strict=True))
    shirts = scene.truth(index)
    for id_, label, box in zip(shirts.ids.tolist(), shirts.labels, shirts.boxes, strict=True):
        if label != ILLEGIBLE and id_ in boxes:
            yield Legible(text=label, box=box.astype(np.float32), person=boxes[id_])


def window(scene: WholePitchScene, index: int, left: int, top: int, reduce: int) -> Image:
    """Return what a window of `WINDOW` shows."""
    wide, high = WINDOW
    out = np.empty((high // reduce, wide // reduce, 3), np.uint8)
    scene.window(index, left, top, wide, high, reduce, out)
    return out


def share(has: list[bool]) -> float | None:
    """Return a share; None of nothing."""
    return round(sum(has) / len(has), 3) if has else None


def median(values: list[float]) -> float | None:
    """Return the median; None of nothing."""
    return round(float(np.median(values)), 1) if values else None


if __name__ == "__main__":
    main()
