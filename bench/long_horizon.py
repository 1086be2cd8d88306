"""Compare long plans: `python -m bench.long_horizon --data FOLDER [--policy FILE] [--json FILE]`.

FOLDER holds clips that `fovea train tracking --set association.horizon=200` recorded. Each policy
follows the same targets through the same clips, with the prototype's timing: a plan takes effect
after `--delay` frames and is replaced after `--replan`. Prints the share of the target's true box
inside the ROI, by class: of the network, of the rule `pursuit`, of windows that stay where the
target was last seen (`hold`), and of an oracle. Dispatch, tracks and prompts are the same for all.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console

from bench.machine import facts
from bench.options import JSON, Bench
from bench.prototype import table
from operators.dispatch import plan_windows
from operators.policy.data import Recording
from operators.policy.decision import Rules
from operators.policy.gaze_plan import GazePlan, row_of, stay
from operators.policy.network import PolicyNetwork
from operators.policy.pursuit import PursuitPolicySettings, PursuitState, pursue
from operators.policy.rollout import Episode, Task, roll, tasks
from operators.policy.target import TargetSpec
from operators.policy.tokens import Array, Objects
from pipeline import Tracks
from pipeline.boxes import centres, covered, roi_window
from pipeline.errors import RunError

Planner = Callable[[Tracks, int], GazePlan]  # tracks, frame of the clip
Rule = Callable[[Recording, Task], Planner]
DRAWS = 1000  # of the bootstrap


@click.command(cls=Bench)
@click.option("--data", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--policy", "weights", type=click.Path(path_type=Path, exists=True))
@click.option("--episodes", default=60, show_default=True, type=click.IntRange(1))
@click.option("--frames", default=400, show_default=True, type=click.IntRange(2))
@click.option("--delay", default=32, show_default=True, type=click.IntRange(0))
@click.option("--replan", default=180, show_default=True, type=click.IntRange(1))
@click.option("--first-clip", default=40_000, show_default=True, help="Lowest number of a clip.")
@click.option("--seed", default=8, show_default=True)
@JSON
def main(
    data: Path, weights: Path | None, episodes: int, frames: int, delay: int, replan: int,
    first_clip: int, seed: int, path: Path | None,
) -> None:  # fmt: skip
    """Compare policies over a long horizon on recorded clips."""
    files = [f for f in sorted(data.glob("*.npz")) if int(f.stem) >= first_clip]
    if not files:
        raise RunError(f"{data}: expected clips from {first_clip} on, got none")
    recordings = [Recording(file) for file in files]
    chosen = [
        Task(clip=t.clip, start=t.start, target=t.target, replan=replan, delay=delay)
        for t in tasks(recordings, episodes, frames=frames, seed=seed, late=None)
    ]
    found = {
        name: [followed(recordings[t.clip], t, frames, make) for t in chosen]
        for name, make in RULES.items()
    }
    if weights:
        found["network"] = learned(recordings, chosen, frames, weights)
    labels = [recordings[t.clip].people_and_ball[t.target] for t in chosen]
    rows = [row(name, labels, shares, seed, found["pursuit"]) for name, shares in found.items()]
    Console().print(table(f"share of the target in the ROI, delay {delay}, Ta {replan}", rows))
    if path:
        result = {
            "bench": "long_horizon", **facts(), "seed": seed, "clips": len(files),
            "episodes": episodes, "frames": frames, "delay_frames": delay,
            "replan_frames": replan, "policy": weights.name if weights else "", "rows": rows,
        }  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1) + "\n")


def learned(
    recordings: Sequence[Recording], chosen: Sequence[Task], frames: int, weights: Path
) -> list[list[float]]:
    """Return what the ROI showed under the network, episode by episode, frame by frame."""
    network = PolicyNetwork(weights)
    rules = Rules(roi_channels=network.roi_channels)
    running = [Episode(recordings[t.clip], t, rules) for t in chosen]

    def choose(moments: Sequence[Objects], conditions: Sequence[Array]) -> Sequence[Array]:
        return [network(m, c) for m, c in zip(moments, conditions, strict=True)]

    roll(running, choose, frames=frames, how="argmax", rng=np.random.default_rng(0), keep=0)
    # before the first plan takes effect the window is where the prompt said
    return [episode.shown[1 + t.delay :] for episode, t in zip(running, chosen, strict=True)]


def followed(recording: Recording, task: Task, frames: int, make: Rule) -> list[float]:
    """Return what the ROI showed under a rule, from the first plan's effect on."""
    planner, geometry = make(recording, task), recording.geometry
    truth, visible = recording.path_of(task.target)
    window = roi_window(centres(truth[task.start]), geometry)
    commanded: dict[int, tuple[int, int, int, int]] = {}
    planned, shown = task.start - task.replan, []
    for frame in range(task.start, min(task.start + frames, len(recording) - 1)):
        window = commanded.pop(frame, window)
        if visible[frame] > 0:
            inside = covered(truth[frame][None], np.array(window, np.float32))
            shown.append(float(inside[0]))
        plan = planner(recording.moment(frame).tracks, frame)
        if not len(plan.boxes) or frame - planned < task.replan:
            continue
        planned = frame
        windows = plan_windows(plan.boxes, frame + 1, geometry, fill="hold", held=window)
        for row_, sides in enumerate(windows[task.delay :], task.delay):
            left, top, right, bottom = (int(side) for side in sides)
            commanded[frame + 1 + row_] = (left, top, right, bottom)
    return shown[1 + task.delay :]


def _pursuit(recording: Recording, task: Task) -> Planner:
    state = [PursuitState(spec=_spec(recording, task))]
    rules = PursuitPolicySettings(horizon=recording.sides["horizon"])

    def plan(tracks: Tracks, frame: int) -> GazePlan:
        found, state[0] = pursue(tracks, state[0], rules)
        return found

    return plan


def _hold(recording: Recording, task: Task) -> Planner:
    state = [PursuitState(spec=_spec(recording, task))]
    rules = PursuitPolicySettings(horizon=recording.sides["horizon"])

    def plan(tracks: Tracks, frame: int) -> GazePlan:
        horizon = recording.sides["horizon"]
        found, state[0] = pursue(tracks, state[0], rules)
        locked = row_of(tracks, state[0].locked)
        if locked >= 0:
            return stay(tracks.boxes[locked, -1], horizon)
        return stay(state[0].box, horizon) if state[0].seen_seq >= 0 else found

    return plan


def _oracle(recording: Recording, task: Task) -> Planner:
    truth, _ = recording.path_of(task.target)

    def plan(tracks: Tracks, frame: int) -> GazePlan:
        ahead = truth[frame + 1 : frame + 1 + recording.sides["horizon"]]
        return GazePlan(choice=np.full(len(ahead), -1, np.int32), boxes=ahead)

    return plan


RULES: Mapping[str, Rule] = {
    "pursuit": _pursuit, "hold": _hold, "oracle": _oracle,
}  # fmt: skip


def _spec(recording: Recording, task: Task) -> TargetSpec:
    truth, _ = recording.path_of(task.target)
    left, top, right, bottom = (float(side) for side in truth[task.start])
    return TargetSpec(box=(left, top, right, bottom))


def row(
    name: str,
    labels: Sequence[str],
    shares: Sequence[Sequence[float]],
    seed: int,
    base: Sequence[Sequence[float]],
) -> dict[str, Any]:
    """Return the mean share by class and of all episodes, and how far it is above `base`.

    Intervals are 95 % by bootstrap over episodes; the second one is of the paired differences.
    """
    means, usual = (
        np.array([np.mean(s) if len(s) else np.nan for s in each]) for each in (shares, base)
    )
    known = np.isfinite(means) & np.isfinite(usual)
    found: dict[str, Any] = {"policy": name}
    for label in sorted(set(labels)):
        own = known & (np.array(labels) == label)
        found[label] = round(float(means[own].mean()), 3) if own.any() else None
    return found | {
        "all": round(float(means[known].mean()), 3),
        "95 % interval": interval(means[known], seed),
        "above pursuit": round(float((means - usual)[known].mean()), 3),
        "its interval": interval((means - usual)[known], seed),
        "episodes": int(known.sum()),
    }


def interval(values: Array, seed: int) -> str:
    """Return the 95 % interval of a mean.

    >>> interval(np.ones(9, np.float32), 1)
    '1.000 .. 1.000'
    """
    drawn = np.random.default_rng(seed).choice(values, (DRAWS, len(values))).mean(1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{low:.3f} .. {high:.3f}"


if __name__ == "__main__":
    main()
