"""Compare statistics of the procedural match with real footage, as a table.

`python -m bench.scene [--data FOLDER] [--seeds 4] [--frames 500] [--json FILE]`: FOLDER is a
SoccerNet sequence. Sizes and speeds are pixels of a picture 1920 wide, at 25 pictures a second.
"""

import argparse
import json
from collections import defaultdict

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.machine import facts
from bench.options import new_file
from drivers.datasets.soccernet import SoccerNetSequence
from drivers.scenes.soccer import SoccerScene
from drivers.source import Annotations, FrameSource
from operators.training.command_line import count
from pipeline.errors import FoveaError
from pipeline.whole_file import write_whole

RATE_HZ = 25.0
PICTURE_EVERY = 10  # frames between two whose pixels are measured
RING = 1.8  # side of the ball's surroundings, in box sides
Samples = dict[str, list[float]]


def measure(source: FrameSource, frames: int) -> Samples:
    """Return all measured quantities of the first frames of a source, by name."""
    found: Samples = defaultdict(list)
    last: NDArray[np.float32] | None = None
    for index in range(frames):
        truth = source.truth(index)
        if truth is None:
            continue
        _measure_people(found, truth)
        ball = ball_box(truth)
        found["ball in truth, share"].append(float(ball is not None))
        if ball is not None:
            found["ball width"].append(float(ball[2] - ball[0]))
            found["ball height"].append(float(ball[3] - ball[1]))
            if last is not None:
                step = (ball[:2] + ball[2:] - last[:2] - last[2:]) / 2
                found["ball speed, px/frame"].append(float(np.hypot(*step)))
        last = ball
        if index % PICTURE_EVERY == 0:
            _measure_pixels(found, source.picture(index), ball)
    return found


def ball_box(truth: Annotations) -> NDArray[np.float32] | None:
    """Return the box (4,) of the ball; None where it is hidden or absent."""
    for box, label, seen in zip(truth.boxes, truth.labels, truth.visibility, strict=True):
        if label == "ball" and seen > 0.3:
            return np.asarray(box)
    return None


def _measure_people(found: Samples, truth: Annotations) -> None:
    people = [i for i, label in enumerate(truth.labels) if label != "ball"]
    found["people in view"].append(float(len(people)))
    for i in people:
        x0, y0, x1, y1 = (float(v) for v in truth.boxes[i])
        if x0 > 2 and y0 > 2 and x1 < 1918 and y1 < 1078:
            found[f"{truth.labels[i]} height"].append(y1 - y0)
            found["people's width"].append(x1 - x0)


def _measure_pixels(
    found: Samples, picture: NDArray[np.uint8], ball: NDArray[np.float32] | None
) -> None:
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
    lower = picture[len(picture) * 2 // 5 :]
    hsv = cv2.cvtColor(lower, cv2.COLOR_RGB2HSV)
    grass = (hsv[..., 0] > 25) & (hsv[..., 0] < 80) & (hsv[..., 1] > 60)
    if grass.any():
        for name, channel in zip(("red", "green", "blue"), range(3), strict=True):
            found[f"grass {name}"].append(float(lower[grass][:, channel].mean()))
    found["sharpness (mean |Laplacian|)"].append(float(np.abs(cv2.Laplacian(grey, -1)).mean()))
    if ball is None:
        return
    x0, y0, x1, y1 = (round(float(v)) for v in ball)
    wide, high = round((x1 - x0) * (RING - 1) / 2), round((y1 - y0) * (RING - 1) / 2)
    top, left = max(0, y0 - high), max(0, x0 - wide)
    around = grey[top : y1 + high, left : x1 + wide]
    inside = grey[y0:y1, x0:x1]
    if inside.size and around.size > inside.size:
        ring = (around.sum() - inside.sum()) / (around.size - inside.size)
        found["ball luma less its ring's"].append(float(inside.mean() - ring))
        found["ball luma, brightest"].append(float(inside.max()))


def table(columns: dict[str, Samples]) -> str:
    """Return p5 / median / mean / p95 / max of every quantity, with a column for each source."""
    names = list(dict.fromkeys(name for samples in columns.values() for name in samples))
    lines = ["| p5 / p50 / mean / p95 / max | " + " | ".join(columns) + " |"]
    lines.append("|---" * (len(columns) + 1) + "|")
    for name in names:
        cells = [summary(samples.get(name, [])) for samples in columns.values()]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def summary(values: list[float]) -> str:
    """Return the statistics of one quantity.

    >>> summary([1, 2, 3])
    '1.1 / 2.0 / 2.0 / 2.9 / 3.0'
    """
    if not values:
        return "–"
    low, middle, high = np.percentile(values, [5, 50, 95])
    return f"{low:.1f} / {middle:.1f} / {np.mean(values):.1f} / {high:.1f} / {max(values):.1f}"


def main() -> None:
    """Print the table; write every quantity's mean and quantiles with --json."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", help="folder of a SoccerNet sequence")
    parser.add_argument("--seeds", type=count, default=4)
    parser.add_argument("--frames", type=count, default=500)
    parser.add_argument("--json", type=new_file)
    values = parser.parse_args()
    cv2.setNumThreads(1)
    columns: dict[str, Samples] = {}
    if values.data:
        try:
            real = SoccerNetSequence(path=values.data)
            columns["real"] = measure(real, min(values.frames, real.length or values.frames))
        except FoveaError as error:
            parser.error(str(error))
    columns["scene"] = defaultdict(list)
    for seed in range(values.seeds):
        scene = SoccerScene(rate_hz=RATE_HZ, seed=seed)
        for name, samples in measure(scene, values.frames).items():
            columns["scene"][name] += samples
        scene.close()
    print(table(columns))
    if values.json:
        text = {c: {n: summary(v) for n, v in s.items()} for c, s in columns.items()}
        found = {**facts(), "seeds": list(range(values.seeds)), "table": text}
        write_whole(values.json, json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
