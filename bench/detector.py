"""Score a detector on labelled pictures: `python -m bench.detector FOLDER --classes 0=person,…`.

FOLDER holds `images/` and, in `labels/`, a text of the same name for each: rows of class number,
centre and size as shares of the picture, as YOLO trainings read them. Every picture is shrunk to
the context's size first. Prints and writes, by class, precision and recall at the detector's own
confidence, average precision, the confidence of the greatest F1 here, and the time of one picture.
"""

import json
import time
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
from bench.options import JSON, Bench, file_name
from operators.saliency import SaliencySettings
from operators.saliency.detector import Detector
from operators.saliency.judging import (
    FLOOR,
    Tally,
    at_threshold,
    average_precision,
    best_threshold,
    find_hits,
)
from operators.saliency.stills import labelled, pictures_of
from pipeline.errors import SettingsError
from pipeline.whole_file import write_whole

Array = NDArray[np.float32]


@click.command(cls=Bench)
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--classes", required=True, help="NUMBER=NAME,…: labels' class and the detector's.")
@click.option("--weights", default="yolox_nano", show_default=True, help="As saliency.weights.")
@click.option("--scale", default=0.25, show_default=True, type=click.FloatRange(0.01, 1))
@click.option("--every", default=1, show_default=True, type=click.IntRange(1), help="Pictures.")
@click.option("--threads", default=1, show_default=True, type=click.IntRange(1))
@JSON
def main(
    folder: Path, classes: str, weights: str, scale: float, every: int, threads: int,
    path: Path | None,
) -> None:  # fmt: skip
    """Score a detector on labelled pictures."""
    low = Detector(SaliencySettings(weights=weights, confidence=FLOOR, threads=threads))
    own = Detector(SaliencySettings(weights=weights, threads=threads))
    wanted = classes_of(classes, own.names)
    files = pictures_of(folder)[::every]
    rows: dict[str, list[tuple[Array, NDArray[np.bool_]]]] = {n: [] for n in wanted.values()}
    present = dict.fromkeys(rows, 0)
    wall_ms, cpu_ms = [], []
    for file in track(files, "score", console=Console(stderr=True)):
        item = labelled(file)
        found, (wall, cpu) = look(low, item.picture, scale)
        wall_ms.append(wall)
        cpu_ms.append(cpu)
        for name in rows:
            true = np.isin(item.numbers, [n for n, of in wanted.items() if of == name])
            scores, hits = marked(found[name], item.boxes[true])
            rows[name].append((scores, hits))
            present[name] += int(true.sum())
    tallies = {
        name: Tally(
            scores=np.concatenate([s for s, _ in parts]),
            hits=np.concatenate([h for _, h in parts]),
            present=present[name],
        )
        for name, parts in rows.items()
    }
    report = {
        "bench": "detector", **facts(), "weights": file_name(own.path), "data": folder.name,
        "pictures": len(files), "scale": scale, "input_px": list(low.size_px), "threads": threads,
        "ms": spread(wall_ms), "processor_ms": spread(cpu_ms),
        "classes": [figures(name, t, own.confidence_of(name)) for name, t in tallies.items()],
    }  # fmt: skip
    if path:
        write_whole(path, json.dumps(report, indent=1) + "\n")
    Console().print(shown(report))


def classes_of(text: str, names: tuple[str, ...]) -> dict[int, str]:
    """Return the detector's class of each class of the labels; raises `SettingsError`.

    >>> classes_of("0=sports ball,2=person", ("person", "sports ball"))
    {0: 'sports ball', 2: 'person'}
    """
    found = {}
    for part in text.split(","):
        number, equals, name = part.strip().partition("=")
        if not (equals and number.isdecimal() and len(number) < 6):
            raise SettingsError(f"classes: expected NUMBER=NAME, got {part[:40]!r}")
        if name not in names:
            raise SettingsError(f"classes: expected one of {', '.join(names)}, got {name[:40]!r}")
        found[int(number)] = name
    return found


def look(
    detector: Detector, picture: NDArray[np.uint8], scale: float
) -> tuple[dict[str, tuple[Array, Array]], tuple[float, float]]:
    """Return boxes in the picture's pixels and scores by class; milliseconds, of a processor too.

    The latter is what it takes on a machine that does nothing else.
    """
    size = (max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if scale < 1 else picture
    began, cpu = time.perf_counter(), time.process_time()
    found, at, _ = detector.look(np.asarray(small, np.uint8))
    taken_ms = (time.perf_counter() - began) * 1e3, (time.process_time() - cpu) * 1e3
    offset = np.array([at.left_px, at.top_px] * 2, np.float32)
    back = np.array([picture.shape[1] / size[0], picture.shape[0] / size[1]] * 2, np.float32)
    boxes = (found.boxes - offset) / np.float32(at.gain) * back
    named = [(name, found.classes == row) for row, name in enumerate(detector.names)]
    return {name: (boxes[mine], found.scores[mine]) for name, mine in named}, taken_ms


def marked(found: tuple[Array, Array], truth: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the scores of one class in one picture, best first, and which are hits."""
    boxes, scores = found
    hits, _ = find_hits(boxes, truth, np.zeros(len(truth), np.bool_))
    return scores, hits


def figures(name: str, tally: Tally, confidence: float) -> dict[str, Any]:
    """Return the row of a class."""
    at = at_threshold(tally, confidence)
    return {
        "class": name,
        "present": tally.present,
        "confidence": round(confidence, 3),
        "precision": round(at["precision"], 3),
        "recall": round(at["recall"], 3),
        "average_precision": round(average_precision(tally), 3),
        "best_confidence": best_threshold(tally),
    }


def spread(times_ms: list[float]) -> dict[str, float]:
    """Return median, 5th and 95th percentile."""
    low, middle, high = np.quantile(times_ms, (0.05, 0.5, 0.95))
    return {"median": round(middle, 1), "p05": round(low, 1), "p95": round(high, 1)}


def shown(report: dict[str, Any]) -> Table:
    """Return the figures for a terminal."""
    low, middle, high = (report["processor_ms"][name] for name in ("p05", "median", "p95"))
    table = Table(
        title=f"{report['weights']} on {report['pictures']} pictures of {report['data']} at "
        f"{report['scale']:g}; {middle:g} ms of a processor each ({low:g}–{high:g})"
    )
    for column in report["classes"][0]:
        table.add_column(column.replace("_", " "))
    for row in report["classes"]:
        table.add_row(*(str(value) for value in row.values()))
    return table


if __name__ == "__main__":
    main()
