"""What a window gains the consumer: the change of its action by where the ROI looks.

python -m bench.manipulation.gain --consumer runs/act/act.onnx

The consumer acts at full resolution. In every tenth frame its action is compared with the one it
would have taken through the context and a window on the peg, the socket or a gripper, in the middle
of the field, through the best of them, and through the context alone.
"""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np

from bench.machine import facts
from bench.manipulation.evaluate import LIBRARIES
from bench.options import writable
from drivers.readout import geometry_of
from drivers.scenes.insertion import COMPLETE, STEPS, InsertionScene
from operators.manipulation.ensemble import Ensemble
from operators.manipulation.manipulation import SHIPPED, ActionChunkingSettings
from operators.manipulation.network import ActNetwork
from operators.manipulation.utility import NOTHING, Acquisition, Window, changes, view
from operators.training.command_line import in_a_sentence
from operators.training.progress import tracked
from pipeline.boxes import centres, roi_window
from pipeline.whole_file import write_whole

EVERY = 10  # frames
ROI_AREA = 0.0625
PHASES = {"approach": (0, 120), "take": (120, 220), "carry and insert": (220, STEPS)}
MIDDLE, NONE, BEST = "middle of the field", "context alone", "best of the windows"


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--consumer", type=Path, default=SHIPPED, help="an ONNX file; else the shipped one")
@click.option("--trials", default=10, show_default=True, type=click.IntRange(1, 10_000))
@click.option("--seed", default=50_000, show_default=True, type=click.IntRange(0))
@click.option(
    "--json", "report", type=click.Path(path_type=Path), callback=writable, help="write the figures"
)
def command(consumer: Path, trials: int, seed: int, report: Path | None) -> None:
    """Measure what a window gains the consumer."""
    with in_a_sentence():
        net = ActNetwork(consumer)
        found = [
            each for s in tracked(range(seed, seed + trials), "trials") for each in followed(net, s)
        ]
    rows = {name: told(found, *limits) for name, limits in {**PHASES, "all": (0, STEPS)}.items()}
    for phase, row in rows.items():
        click.echo(f"{phase}: " + ", ".join(f"{name} {value:.4f}" for name, value in row.items()))
    if report:
        what = {**facts(LIBRARIES), "trials": trials, "seed": seed, "every": EVERY, "change": rows}
        write_whole(report, json.dumps(what, indent=1) + os.linesep)


def followed(net: ActNetwork, seed: int) -> Iterator[tuple[int, dict[str, float]]]:
    """Yield frames of a trial at full resolution, with the change through each window."""
    scene = InsertionScene(seed=seed)
    grid = geometry_of(scene.size_px, roi_area=ROI_AREA)
    middle = np.array(scene.size_px, np.float32) / 2
    ensemble, how = Ensemble(ActionChunkingSettings.decay), Acquisition(context_scale=1.0)
    for step in range(STEPS):
        picture, joints = scene.picture(step), scene.joints()[0]
        if step % EVERY == 0:
            truth = scene.truth(step)
            places = dict(zip(truth.labels, centres(truth.boxes), strict=True)) | {MIDDLE: middle}
            windows: dict[str, Window] = {n: roi_window(at, grid) for n, at in places.items()}
            windows[NONE] = NOTHING
            apart = changes(net, picture, joints, [*windows.values()], Acquisition())
            row = dict(zip(windows, map(float, apart), strict=True))
            yield step, row | {BEST: min(value for name, value in row.items() if name != NONE)}
        ensemble.add(step, net(view(net, picture, NOTHING, how), joints))
        scene.act(step, ensemble.targets(step, 1))
        if scene.outcome()[0] == COMPLETE:
            break
    scene.close()


def told(found: list[tuple[int, dict[str, float]]], first: int, end: int) -> dict[str, Any]:
    """Return the mean change by window over the frames of a phase."""
    rows = [row for step, row in found if first <= step < end]
    return (
        {name: round(float(np.mean([row[name] for row in rows])), 5) for name in rows[0]}
        if rows
        else {}
    )


if __name__ == "__main__":
    command()
