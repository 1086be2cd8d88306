"""Render procedural scenes once, as examples on disk: seeds -> one pair of files a scene.

A picture is rendered at full size and shrunk by area, as the sensor shrinks its context. What
fovea ships is trained on scenes alone; `python -m operators.saliency.render --footage FOLDER
--frames A-B --out FOLDER` turns a SoccerNet sequence into examples, for those who adapt a detector
to a place of their own.
"""

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.datasets.sequence import span
from drivers.datasets.soccernet import SoccerNetSequence
from drivers.scenes.soccer import SoccerScene
from drivers.source import CLASS_OF_ROLE, LEAST_VISIBLE, FrameSource
from operators.saliency.crops import crop, drawn_scale
from operators.saliency.difference import FrameDifference
from operators.saliency.example import CONTEXT_PX, NAMES, Example
from operators.training.arrays import outdated, write
from operators.training.command_line import in_a_sentence
from operators.training.identity import Identity, of_code
from operators.training.progress import tracked
from operators.training.workers import pool_of
from pipeline.errors import DriverError, SettingsError

FULL_PX = (1920, 1080)
RATE_HZ = 25.0


def whole(source: FrameSource, index: int) -> Example:
    """One picture of a source with its objects; raises `DriverError` if it does not know them."""
    truth = source.truth(index)
    if truth is None:
        raise DriverError(f"frame {index}: expected a source that knows the truth, got none")
    known = np.array([label in CLASS_OF_ROLE for label in truth.labels], np.bool_)
    labels = [NAMES.index(CLASS_OF_ROLE[label]) for label in truth.labels if label in CLASS_OF_ROLE]
    return Example(
        picture=source.picture(index).copy(),  # a source may draw the next one in its place
        boxes=truth.boxes[known],
        labels=np.array(labels, np.int64),
        ignored=truth.visibility[known] < LEAST_VISIBLE,
    )


def example(source: FrameSource, index: int) -> Example:
    """One picture at context size with its objects and what changed since the frame before."""
    return as_context(whole(source, index), source, index)


def as_context(picture: Example, source: FrameSource, index: int) -> Example:
    """A whole picture of a source as the context shows it, with its difference."""
    height, width = picture.picture.shape[:2]
    gain = np.array([CONTEXT_PX[0] / width, CONTEXT_PX[1] / height] * 2, np.float32)
    shown = replace(picture, picture=shrunk(picture.picture), boxes=picture.boxes * gain)
    if not index:
        return shown
    difference = FrameDifference()
    difference.of(shrunk(source.picture(index - 1)))
    return replace(shown, difference=difference.of(shown.picture).astype(np.float32))


def cut_out(picture: Example, count: int, rng: np.random.Generator) -> list[Example]:
    """Parts of a whole picture as ROIs show them, mostly around an object; without a difference."""
    return [crop(picture, rng, CONTEXT_PX, scale=drawn_scale(rng)) for _ in range(count)]


def shrunk(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture of any size at the size of the context."""
    return np.asarray(cv2.resize(picture, CONTEXT_PX, interpolation=cv2.INTER_AREA), np.uint8)


def packed(picture: NDArray[np.uint8], difference: NDArray[np.float32]) -> NDArray[np.uint8]:
    """A picture with its difference, halved, as a fourth channel: (h, w, 4)."""
    halves = np.clip(np.rint(difference / 2) + 128, 0, 255).astype(np.uint8)
    return np.dstack([picture, halves])


def unpacked(
    picture: NDArray[np.uint8],
) -> tuple[NDArray[np.uint8], NDArray[np.float32] | None]:
    """The picture and the difference of what `packed` made; none of a picture without one."""
    if picture.shape[2] == 3:
        return np.array(picture), None
    halves = picture[..., 3].astype(np.float32) - 128
    return np.ascontiguousarray(picture[..., :3]), halves * 2


def moments(seed: int, count: int, span: int) -> list[int]:
    """`count` frame numbers of a scene, ascending, one in each equal part of `span` frames.

    >>> moments(3, 4, 40) == sorted(moments(3, 4, 40))
    True
    """
    parts = np.random.default_rng(seed).random(count) + np.arange(count)
    return [int(part * span / count) for part in parts]


def made_with(count: int, span: int, rois: int = 0) -> dict[str, str]:
    """What decides the pictures of a scene beside its seed."""
    code = of_code(
        "drivers.scenes.soccer", "operators.saliency.render", "operators.saliency.difference",
        "operators.saliency.example",
    )  # fmt: skip
    made = code | {"moments": str(count), "span": str(span)}
    if not rois:
        return made
    cutting = of_code("operators.saliency.crops", "operators.saliency.augment")
    return made | cutting | {"rois": str(rois)}


def render(
    seeds: Iterable[int], count: int, span: int, folder: Path, workers: int = 2,
    name: str = "draw scenes", rois: int = 0,
) -> None:  # fmt: skip
    """Render `count` moments of each seed's scene into `folder`; seeds already there are kept.

    Each moment is a context and `rois` parts at a ROI's scale. Those that are damaged, or were
    rendered with other settings or code, are rendered anew.
    """
    made = made_with(count, span, rois)
    folder.mkdir(parents=True, exist_ok=True)
    files = (folder / f"{seed}.npz" for seed in seeds)
    missing = outdated(files, made, print, with_pictures=True)
    with pool_of(workers) as pool:
        jobs = [pool.submit(_render_scene, path, count, span, made, rois) for path in missing]
        for job in tracked(jobs, name):
            job.result()


def _render_scene(path: Path, count: int, span: int, made: Identity, rois: int) -> None:
    cv2.setNumThreads(1)
    seed = int(path.stem)
    scene = SoccerScene(size_px=FULL_PX, rate_hz=RATE_HZ, seed=seed)
    rng, examples = np.random.default_rng([seed, rois]), list[Example]()
    for index in moments(seed, count, span):
        picture = whole(scene, index)
        examples += [as_context(picture, scene, index), *cut_out(picture, rois, rng)]
    scene.close()
    _write(examples, path, made)


def convert(footage: Path, frames: tuple[int, int], folder: Path) -> int:
    """Frames A-B (counted from 1, as their files are) of a sequence as examples; how many."""
    source = SoccerNetSequence(path=str(footage))
    first, last = frames
    if not 1 <= first <= last <= (source.length or 0):
        raise SettingsError(f"frames: expected 1 to {source.length}, got {first}-{last}")
    folder.mkdir(parents=True, exist_ok=True)
    examples = [example(source, k - 1) for k in tracked(range(first, last + 1), "read frames")]
    source.close()
    _write(examples, folder / f"{first}.npz", {})
    return len(examples)


def _write(examples: Sequence[Example], path: Path, made: Identity) -> None:
    none = np.zeros(CONTEXT_PX[::-1], np.float32)
    kept = [packed(e.picture, none if e.difference is None else e.difference) for e in examples]
    truth = {
        "known": np.array([e.difference is not None for e in examples]),  # if there is one
        "first": np.cumsum([0, *(len(e.labels) for e in examples)]),
        "boxes": np.concatenate([e.boxes for e in examples]),
        "labels": np.concatenate([e.labels for e in examples]),
        "ignored": np.concatenate([e.ignored for e in examples]),
    }
    write(path, truth, made, np.stack(kept))


@in_a_sentence()
def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Turn footage with truth into examples.")
    parser.add_argument("--footage", type=Path, required=True, help="a SoccerNet sequence")
    parser.add_argument("--frames", type=span, required=True, help="A-B, counted from 1")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    count = convert(given.footage, given.frames, given.out)
    print(f"{count} examples in {given.out}")


if __name__ == "__main__":
    main()
