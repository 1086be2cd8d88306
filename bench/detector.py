"""Score a detector on labelled pictures: `python -m bench.detector FOLDER [--split test]`.

FOLDER holds `images/` and, in `labels/`, a text of the same name for each: rows of class number,
centre and size as shares of the picture, as YOLO trainings read them. Every picture is shrunk to
the context's size first. Prints and writes, by class and by match (the first part of a file's
name), precision and recall, average precision, the confidence of the greatest F1 here, a ball by
its centre and among the best three, and the time of one picture. The operating point is the
detector's own confidence, or with `--choose-on` that of the greatest F1 on other pictures.
"""

import json
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import track
from rich.table import Table

from bench.detector_scoring import BEST, Looker, Marks, figures, spread, thresholds_of
from bench.machine import facts
from bench.options import JSON, Bench, file_name
from operators.saliency.judging import FLOOR
from operators.training.splits import DEVELOPMENT, HELD_OUT, TEST
from operators.training.stills import class_names, labelled, pictures_of
from pipeline.errors import SettingsError
from pipeline.whole_file import write_whole

TRAINING = "training"  # on which a detector's figures say nothing
SPLITS = {"all": ("",), "test": TEST, "development": DEVELOPMENT}
# what the shipped detector's classes are called where labels know fewer, or have other names
KNOWN = {"goalkeeper": "player", "sports ball": "ball"}
COLUMNS = {
    "class": "class", "present": "there", "confidence": "at", "precision": "prec.",
    "recall": "recall", "average_precision": "AP", "best_confidence": "best at",
    f"among_{BEST}": f"in {BEST}",
}  # fmt: skip
PERSON = {"player": "person", "referee": "person", "ball": "ball"}


@click.command(cls=Bench)
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--classes", default="", help="NUMBER=NAME,…: labels' class and the detector's.")
@click.option("--weights", default="yolox_nano", show_default=True, help="As saliency.weights.")
@click.option("--scale", default=0.25, show_default=True, type=click.FloatRange(0.01, 1))
@click.option("--every", default=1, show_default=True, type=click.IntRange(1), help="Pictures.")
@click.option("--split", default="all", show_default=True, type=click.Choice([*SPLITS]))
@click.option("--choose-on", type=click.Choice([*SPLITS]), help="Choose confidences there.")
@click.option("--threads", default=1, show_default=True, type=click.IntRange(1))
@JSON
def main(
    folder: Path, classes: str, weights: str, scale: float, every: int, split: str,
    choose_on: str | None, threads: int, path: Path | None,
) -> None:  # fmt: skip
    """Score a detector on labelled pictures."""
    report = facts() | scored(
        folder,
        weights,
        scale=scale,
        split=split,
        choose_on=choose_on or "",
        threads=threads,
        classes=classes,
        every=every,
    )
    if path:
        write_whole(path, json.dumps(report, indent=1) + "\n")
    Console().print(shown(report))


def scored(
    folder: Path, weights: str, *, scale: float, split: str, choose_on: str, threads: int = 1,
    classes: str = "", every: int = 1, input_px: tuple[int, int] = (0, 0),
) -> dict[str, Any]:  # fmt: skip
    """Return the report on a detector and a folder; raises `SettingsError`, `WeightsError`."""
    wanted, names = _classes(folder, classes)
    low = Looker(weights, names, scale, threads, confidence=FLOOR, input_px=input_px)
    wanted = {number: low.known(name) for number, name in wanted.items()}
    files = of_split(folder, split)[::every]
    chosen: Mapping[str, float] = {}
    if choose_on:
        known = sum(_marked(of_split(folder, choose_on), wanted, low, "choose").values(), Marks())
        chosen = thresholds_of(known.tallies)
    marks = _marked(files, wanted, low, "score")
    whole = sum(marks.values(), Marks())
    own = {name: chosen.get(name, low.confidence_of(name)) for name in whole.tallies}
    return {
        "bench": "detector", "weights": file_name(low.path), "data": folder.name,
        "split": split, "chosen_on": choose_on, "pictures": len(files), "scale": scale,
        "input_px": list(low.input_px), "threads": threads,
        "ms": spread(low.wall_ms), "processor_ms": spread(low.processor_ms),
        "classes": figures(whole, own),
        "matches": {match: figures(part, own) for match, part in marks.items()},
    }  # fmt: skip


def of_split(folder: Path, split: str) -> list[Path]:
    """Return the pictures of a part; raises `SettingsError` where a folder has none of it.

    `split` is one of `SPLITS`, or `TRAINING`.
    """
    found = [
        p
        for p in pictures_of(folder)
        if (
            not p.name.startswith(HELD_OUT)
            if split == TRAINING
            else p.name.startswith(SPLITS[split])
        )
    ]
    if not found:
        raise SettingsError(f"{folder}: expected pictures of the {split} split, got none")
    return found


def _classes(folder: Path, text: str) -> tuple[dict[int, str], dict[str, str]]:
    """Return the detector's class of each class of the labels, and names to report classes by.

    Without a text they are those of a soccer match, which `data.yaml` names.
    """
    if text:
        return classes_of(text), {}
    known = class_names(folder / "data.yaml")
    wanted = {number: KNOWN.get(name, name) for number, name in known.items()}
    return wanted, PERSON if "person" in wanted.values() else {}


def classes_of(text: str) -> dict[int, str]:
    """Return the detector's class of each class of the labels; raises `SettingsError`.

    >>> classes_of("0=sports ball,2=person")
    {0: 'sports ball', 2: 'person'}
    """
    found = {}
    for part in text.split(","):
        number, equals, name = part.strip().partition("=")
        if not (equals and number.isdecimal() and len(number) < 6):
            raise SettingsError(f"classes: expected NUMBER=NAME, got {part[:40]!r}")
        found[int(number)] = name
    return found


def _marked(
    files: list[Path], wanted: Mapping[int, str], looker: Looker, what: str
) -> dict[str, Marks]:
    """Look at pictures; what was found in those of each match."""
    marks: dict[str, Marks] = defaultdict(Marks)
    for file in track(files, what, console=Console(stderr=True)):
        marks[file.stem.partition("_")[0]].add(looker, labelled(file), wanted)
    return dict(marks)


def shown(report: dict[str, Any]) -> Table:
    """Return the figures for a terminal: all pictures, then those of each match."""
    low, middle, high = (report["processor_ms"][name] for name in ("p05", "median", "p95"))
    table = Table(
        title=f"{report['weights']} on {report['pictures']} pictures of {report['data']} at "
        f"{report['scale']:g}; {middle:g} ms of a processor each ({low:g}–{high:g})"
    )
    for column in ("match", *COLUMNS.values()):
        table.add_column(column)
    parts = {"": report["classes"]}
    if len(report["matches"]) > 1:
        parts |= report["matches"]
    for match, rows in parts.items():
        for row in rows:
            table.add_row(match or "all", *(str(row.get(name, "")) for name in COLUMNS))
    return table


if __name__ == "__main__":
    main()
