"""How long the whole pitch takes to draw where a sensor looks, on one core, and what it keeps.

`python -m bench.whole_pitch [--frames 300] [--endure 1000] [--seed 7] [--json FILE]`. An exposure
is the truth, a region of interest on the ball or anywhere, and the whole field as a context of as
many pixels. Times are the processor's, of one thread, so that other work on the machine does not
count. The first exposure, which draws what is kept, is told apart.
"""

import argparse
import json
import math
import time
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import psutil
from numpy.typing import NDArray

from bench.machine import facts
from bench.options import new_file
from bench.results.markdown import table_of
from drivers.readout import scaled
from drivers.scenes import WholePitchScene
from drivers.simulated.windows import WindowedPicture
from pipeline.whole_file import write_whole

Size = tuple[int, int]
PARTS = ("place", "roi", "context", "all")
SIZES: tuple[Size, ...] = ((7680, 4320), (7680, 1920), (16320, 9184))
SHARES = (16, 32, 36, 64)  # context and region have one pixel in so many each; 32 is not whole
USUAL = ("main", "sun", "dry")
WORST = ("behind_goal", "floodlight", "rain")


@dataclass(frozen=True, kw_only=True)
class Case:
    """One kind of exposure."""

    size_px: Size
    share: int
    options: tuple[str, str, str]  # view, light, weather
    jumps: bool = False  # the region is anywhere, not on the ball

    def __str__(self) -> str:
        what = " ".join(self.options)
        jumps = ", region anywhere" if self.jumps else ""
        return f"{self.size_px[0]}x{self.size_px[1]}, 1/{self.share}, {what}{jumps}"


CASES = (
    *(Case(size_px=SIZES[0], share=share, options=USUAL) for share in SHARES),
    Case(size_px=SIZES[0], share=16, options=USUAL, jumps=True),
    Case(size_px=SIZES[0], share=16, options=WORST),
    *(Case(size_px=size, share=share, options=USUAL) for size in SIZES[1:] for share in (16, 64)),
)


def measure(case: Case, frames: int, seed: int) -> dict[str, Any]:
    """Return processor times in ms by part: the first exposure, quantiles of the others."""
    began = time.thread_time()
    view, light, weather = case.options
    scene = WholePitchScene(
        size_px=case.size_px, seed=seed, view=view, light=light, weather=weather
    )
    opened_s = time.thread_time() - began
    side = math.sqrt(1 / case.share)
    context, roi = (_memory(scaled(case.size_px, side)) for _ in range(2))
    rng = np.random.default_rng(seed) if case.jumps else None
    times = [_exposure(scene, index, rng, context, roi) for index in range(frames)]
    later = np.array(times[1:]) * 1e3
    spread = {
        f"{part}_p{q}_ms": round(float(np.percentile(later[:, column], q)), 2)
        for column, part in enumerate(PARTS)
        for q in (50, 99)
    }
    return {
        "case": str(case), "context_px": "{1}x{0}".format(*context.shape), "n": len(later),
        **spread, "max_ms": round(float(later[:, -1].max()), 2),
        "first_ms": round(times[0][-1] * 1e3, 1), "open_s": round(opened_s, 2),
        "kept_mb": round(scene.kept_bytes / 2**20, 1),
    }  # fmt: skip


def _exposure(
    scene: WholePitchScene,
    index: int,
    rng: np.random.Generator | None,
    context: NDArray[np.uint8],
    roi: NDArray[np.uint8],
) -> tuple[float, ...]:
    """Draw one exposure; return the seconds of its parts."""
    marks = [time.thread_time()]
    truth = scene.truth(index)
    marks.append(time.thread_time())
    size = np.array(roi.shape[1::-1])
    room = np.array(scene.size_px) - size
    ball = truth.boxes[-1].reshape(2, 2).mean(0)
    at = np.clip(ball - size / 2, 0, room) if rng is None else rng.integers(0, room + 1)
    left, top = (int(v) for v in at)
    picture = WindowedPicture(source=scene, index=index)
    picture.read((left, top, left + int(size[0]), top + int(size[1])), roi)
    marks.append(time.thread_time())
    picture.read((0, 0, *scene.size_px), context)
    marks.append(time.thread_time())
    return (*np.diff(marks).tolist(), marks[-1] - marks[0])


def endure(frames: int, seed: int) -> list[dict[str, Any]]:
    """Return the memory of the process and of the scene, every quarter of so many exposures."""
    scene = WholePitchScene(seed=seed)
    context, roi = _memory((1920, 1080)), _memory((1920, 1080))
    process, found = psutil.Process(), []
    for index in range(frames):
        _exposure(scene, index, None, context, roi)
        if (index + 1) % max(1, frames // 4) == 0:
            resident = round(process.memory_info().rss / 2**20)
            kept = round(scene.kept_bytes / 2**20)
            found.append({"frames": index + 1, "process_mb": resident, "scene_mb": kept})
    return found


def _memory(size_px: Size) -> NDArray[np.uint8]:
    return np.empty((size_px[1], size_px[0], 3), np.uint8)


def main() -> None:
    """Print the tables; write them with --json."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=300, help="exposures of each kind")
    parser.add_argument("--endure", type=int, default=1000, help="exposures for the memory")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--json", type=new_file)
    values = parser.parse_args()
    if values.frames < 3 or values.endure < 4 or values.seed < 0:
        parser.error("expected --frames of at least 3, --endure of at least 4 and --seed from 0 on")
    cv2.setNumThreads(1)
    rows = []
    for case in CASES:
        print(case, flush=True)
        rows.append(measure(case, values.frames, values.seed))
    memory = endure(values.endure, values.seed)
    print(table_of(rows), table_of(memory), sep="\n\n")
    if values.json:
        found = {"bench": "whole_pitch", "seed": values.seed, "rows": rows, "memory": memory}
        write_whole(values.json, json.dumps({**facts(), **found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
