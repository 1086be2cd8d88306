"""The paper's tables for object tracking, made anew: `python -m bench.tables --out FOLDER`.

Studies, each written by itself and gone on with where it stopped: all strategies at all budgets on
held-out procedural clips and, with --soccernet, on real footage that nothing was trained on; late
and rare plans, with and without prediction; the loop with one part after the other replaced by the
truth; with --ablation NAME=FILE, policies that were not told everything; the time each part takes.
"""

import json
import statistics
import time
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import click

from bench.machine import facts
from bench.options import Bench
from bench.tracking.budgets import acquisition
from bench.tracking.clip import ClipName, read
from bench.tracking.evaluate import GRAPH, command
from bench.tracking.replaced import PARTS
from bench.tracking.stages import Camera, Stages
from drivers.simulated.readout import Window
from pipeline.boxes import centres, roi_window

PAPER_MS = {"saliency": 55.0, "roi_features": 6.2, "association": 0.5, "policy": 3.0}
TIMED_FRAMES, TIMED_SEED = 60, 70_000
NAMES = {
    "budgets": "Strategies at equal pixel budgets, held-out procedural clips",
    "soccernet": "The same, zero-shot on real footage",
    "late": "Late and rare plans (delay in frames, Ta), with and without prediction, at 1/8",
    "limits": "What limits the rest: one part after the other replaced by the truth, at 1/8",
    "ablation": "Inputs of the policy left out, at 1/8",
}


def studies(
    clips: int, soccernet: str, ablations: tuple[str, ...], policy: tuple[str, ...]
) -> dict[str, list[str]]:
    """Options of `fovea eval tracking` by study."""
    drawn = ["--data", "procedural", "--clips", str(clips)]
    few = ["--data", "procedural", "--clips", str(max(1, clips // 3)), "--budgets", "1/8"]
    own = [word for given in policy for word in ("--policy", given)]
    late = ["--strategies", "foveated", "--delay", "0,2,13,60", "--replan", "1,4,8"]
    parts = [word for part in PARTS for word in ("--replace", part)]
    found = {"budgets": [*drawn, *own]}
    if soccernet:
        found["soccernet"] = ["--data", soccernet, *own]
    found["late"] = [*few, *late, "--prediction", "both", *own]
    found["limits"] = [*few, "--strategies", "foveated,oracle,full", *parts, *own]
    if ablations:
        named = [word for given in ablations for word in ("--policy", given)]
        whole = ["--policy", f"whole={policy[0]}"] if policy else []
        pursue = ["--policy", "pursue=pursue"]
        wanted = ["--strategies", "foveated,centred,round_robin,full"]
        found["ablation"] = [*few, *wanted, *whole, *named, *pursue]
    return found


def run_time() -> dict[str, dict[str, float]]:
    """Milliseconds per call of each part on one thread, over a clip: p50, p99, objects told."""
    clip = read(ClipName(seed=TIMED_SEED), (1, TIMED_FRAMES))
    camera = Camera(clip, acquisition("foveated", Fraction(1, 8), clip.size_px))
    spent: dict[str, list[float]] = {}
    objects: list[int] = []
    with Stages(GRAPH) as stages:
        stages.begin(camera.header(0), "downsample", "saliency", "association", "roi_features")
        window: Window = roi_window(centres(clip.truths[0].boxes[0]), camera.how.geometry)
        for frame in range(TIMED_FRAMES):
            small = stages.tell("downsample", frame=camera.context(frame))
            found = _timed(stages, spent, "saliency", frame=small)
            tracks = _timed(stages, spent, "association", detections=found)
            objects.append(len(tracks.ids))
            scanpath = _timed(stages, spent, "policy", tracks=tracks)
            schedule = stages.tell("dispatch", scanpath=scanpath)
            roi = camera.roi(frame, window)
            looks = _timed(stages, spent, "roi_features", roi=roi, tracks=tracks)
            stages.tell("policy", features=looks)
            if schedule is not None:
                left, top, right, bottom = (int(side) for side in schedule.windows[0])
                window = (left, top, right, bottom)
    table = {name: _spread(values) for name, values in spent.items()}
    return {**table, "objects": _spread([float(count) for count in objects])}


def _timed(stages: Stages, spent: dict[str, list[float]], name: str, **messages: Any) -> Any:
    began_ns = time.perf_counter_ns()
    answer = stages.tell(name, **messages)
    spent.setdefault(name, []).append((time.perf_counter_ns() - began_ns) / 1e6)
    return answer


def _spread(values: list[float]) -> dict[str, float]:
    return {
        "p50": round(statistics.median(values), 2),
        "p99": round(statistics.quantiles(values, n=100)[-1], 2),
    }


def run_time_markdown(table: Mapping[str, Mapping[str, float]]) -> str:
    """The run-time table, the paper's figure beside ours."""
    lines = ["| part | ms p50 | ms p99 | the paper, i7-7700HQ |", "|---|---|---|---|"]
    for name, figures in table.items():
        paper = PAPER_MS.get(name, "")
        lines.append(f"| {name} | {figures['p50']} | {figures['p99']} | {paper} |")
    return "\n".join(lines) + "\n"


@click.command(cls=Bench, help=(__doc__ or "").split("\n", 1)[0])
@click.option("--out", type=click.Path(path_type=Path), required=True, help="a folder")
@click.option("--clips", default=30, show_default=True, help="held-out procedural clips")
@click.option("--soccernet", default="", help="a sequence's folder, or a folder of them")
@click.option("--policy", multiple=True, help="as fovea eval tracking has it; the graph's own")
@click.option("--ablation", multiple=True, help="NAME=FILE.onnx of operators.policy.train --use")
@click.option("--only", multiple=True, type=click.Choice([*NAMES, "run-time"]))
@click.option("--jobs", default=2, show_default=True)
def main(
    out: Path,
    clips: int,
    soccernet: str,
    policy: tuple[str, ...],
    ablation: tuple[str, ...],
    only: tuple[str, ...],
    jobs: int,
) -> None:
    """See the module."""
    out.mkdir(parents=True, exist_ok=True)
    texts = []
    for name, words in studies(clips, soccernet, ablation, policy).items():
        if only and name not in only:
            continue
        click.echo(f"{NAMES[name]}:", err=True)
        files = ["--report", out / f"{name}.json", "--markdown", out / f"{name}.md"]
        files += ["--work", out / "work", "--jobs", jobs, "--plot", out / f"{name}.png"]
        command.main([*words, *(str(word) for word in files)], standalone_mode=False)
        texts.append(f"## {NAMES[name]}\n\n{(out / f'{name}.md').read_text()}")
    if not only or "run-time" in only:
        table = run_time()
        (out / "run-time.json").write_text(json.dumps({**facts(), "ms": table}, indent=1) + "\n")
        texts.append(f"## Time of each part, one thread\n\n{run_time_markdown(table)}")
    (out / "tables.md").write_text("\n".join(texts))


if __name__ == "__main__":
    main()
