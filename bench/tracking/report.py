"""Make rows of units: means over all starts of a strategy, and paired differences between rows."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from bench.tracking.budgets import PURSUIT
from bench.tracking.cases import LONG, NO_CUE, ROI_ALONE, ROI_COORDINATES, Case
from bench.tracking.figures import Figures, figures_of
from bench.tracking.intervals import LEAST_BLOCKS, Block, add, difference, mean
from bench.tracking.store import Unit
from bench.tracking.targets import CARRIED
from drivers.simulated.strategies import WITH_ROI

Row = dict[str, Any]
Key = tuple[str, str, str]  # target, strategy, budget
# IoU in the paper: Table 1, "Additional results … object tracking", the budget sweep, the longer
# exposure of "Alternative Acquisition Baselines"; the system-level ablations give shares of `full`
PAPER: Mapping[Key, float] = {
    ("ball", "full", "1"): 0.281,
    ("ball", "oracle", "1/8"): 0.405,
    ("ball", "exposure", "1/8"): 0.098,
    ("ball", "centred", "1/8"): 0.0048,  # 1.7 % of full resolution
    ("ball", "round_robin", "1/8"): 0.0098,  # 3.5 % of it
    **{("ball", "spatial", b): v for b, v in (("1/4", 0.212), ("1/8", 0.122), ("1/16", 0.048))},
    **{("ball", "temporal", b): v for b, v in (("1/4", 0.159), ("1/8", 0.148), ("1/16", 0.144))},
    **{("ball", "foveated", b): v for b, v in (("1/4", 0.287), ("1/8", 0.283), ("1/16", 0.276))},
    ("referee", "full", "1"): 0.494,
    ("referee", "oracle", "1/8"): 0.602,
    ("referee", "spatial", "1/8"): 0.474,
    ("referee", "temporal", "1/8"): 0.456,
    ("referee", "foveated", "1/8"): 0.583,
    ("player", "full", "1"): 0.457,
    ("player", "oracle", "1/8"): 0.552,
    ("player", "spatial", "1/8"): 0.268,
    ("player", "temporal", "1/8"): 0.402,
    ("player", "foveated", "1/8"): 0.513,
}
NOT_CARRIED = "ball, free or still"


@dataclass(kw_only=True)
class Tally:
    """Sums over all starts of a row."""

    kept: dict[str, Block] = field(default_factory=dict)  # frames that the strategy exposed
    every: dict[str, Block] = field(default_factory=dict)  # all frames with truth
    shown: list[float] = field(default_factory=list)  # share of the target inside the ROI
    figures: list[Figures] = field(default_factory=list)  # of each start
    read_px: int = 0
    full_px: int = 0


def rows(units: Sequence[Unit]) -> list[Row]:
    """Return one row per clip, target, strategy and budget, and one over all clips."""
    found: list[Row] = []
    clips = sorted({unit["clip"] for unit in units})
    groups = [*([(c, [c]) for c in clips] if len(clips) > 1 else []), ("all", clips)]
    for name, members in groups:
        chosen = [unit for unit in units if unit["clip"] in members]
        for key, tally in gathered(chosen).items():
            row = _row(key, tally)
            if name == "all" and (paper := _paper(key)) is not None:
                row["paper"] = paper
            found.append({"clip": name if len(clips) > 1 else clips[0], **row})
    return found


def _row(key: Key, tally: Tally) -> Row:
    target, strategy, budget = key
    figures = mean(tally.kept)
    row: Row = {
        "target": target,
        "strategy": strategy,
        "budget": budget,
        "iou": _round(figures.iou),
        "clips": len(tally.kept),
        "ci95": interval(tally.kept, figures.low, figures.high),
        "frames": figures.frames,
        "starts": figures.starts,
        "pixels": _round(tally.read_px / tally.full_px),
        "protocol": "long" if strategy.endswith(LONG) else "short",
        "cue": "reference" if has_cue(strategy) else "none",
        **{name: _round(value) for name, value in over(tally.figures).items()},
    }
    if strategy.startswith(("temporal", "exposure")):
        row["iou_all_frames"] = _round(mean(tally.every).iou)
    if tally.shown:
        row["roi_coverage"] = _round(sum(tally.shown) / len(tally.shown))
    return row


def _paper(key: Key) -> float | None:
    target, strategy, budget = key
    if strategy.endswith(LONG):
        return None
    for end in (NO_CUE, ROI_ALONE, ROI_COORDINATES):
        strategy = strategy.removesuffix(end)
    return PAPER.get((target, strategy, budget))


def over(figures: Sequence[Figures]) -> dict[str, float]:
    """Return success, precision and the frames until lost (median) over starts."""
    frames = sum(each.frames for each in figures)
    if not frames:
        return {}
    return {
        "success": sum(each.hits for each in figures) / frames,
        "precision": sum(each.near for each in figures) / frames,
        "until_lost": float(median(each.until_lost for each in figures)),
        "lost": sum(each.lost for each in figures) / len(figures),
    }


def paired(units: Sequence[Unit], cases: Sequence[Case]) -> list[Row]:
    """Return differences between rows at the same budget (and to `full`), paired by block.

    Each row of the policy is compared with rows of other strategies, and with those of the policy
    that `varies` accepts; a comparison of all rows would be too long. The round robin's plans must
    come as late as the policy's.
    """
    tallies = gathered(units)
    blocks = {key: tally.kept for key, tally in tallies.items()}
    planned = {case.name: case for case in cases if case.strategy == "foveated"}
    toured = {case.name: case for case in cases if case.strategy == "round_robin"}
    first = next(iter(planned.values()), None)
    found = []
    for (target, strategy, budget), own in blocks.items():
        for (other_target, other, other_budget), theirs in blocks.items():
            if strategy not in planned or other_target != target or strategy == other:
                continue
            if other_budget not in (budget, "1") or not own.keys() & theirs.keys():
                continue
            if not same_help(strategy, other):
                continue
            if first and other in planned and not varies(planned[strategy], planned[other], first):
                continue
            if other in toured and plans_of(planned[strategy]) != plans_of(toured[other]):
                continue
            middle, low, high = difference(own, theirs)
            both = own.keys() & theirs.keys()
            found.append(
                {
                    "target": target,
                    "budget": budget,
                    "strategy": strategy,
                    "against": other,
                    "difference": _round(middle),
                    "clips": len(both),
                    "ci95": interval(both, low, high),
                }
            )
    return found


def same_help(strategy: str, other: str) -> bool:
    """Whether two rows, by their names, differ in what was read and not in their tracker's help.

    A tracker in coordinates of the ROI has no cue; a strategy without a ROI has one view.

    >>> same_help("foveated, ROI alone", "full"), same_help("foveated, no cue", "full")
    (True, False)
    >>> same_help("foveated, ROI coordinates", "full, no cue"), same_help("pursuit, long", "full")
    (True, False)
    """
    if strategy.endswith(LONG) != other.endswith(LONG):
        return False
    ours, theirs = (
        (ROI_COORDINATES in name, ROI_ALONE in name, has_cue(name)) for name in (strategy, other)
    )
    looks = other.startswith((*WITH_ROI, PURSUIT))
    return ours[2] == theirs[2] and (not looks or ours[:2] == theirs[:2])


def has_cue(strategy: str) -> bool:
    """Whether the tracker of a row, by its name, hears a scanpath.

    >>> has_cue("foveated, ROI alone, long"), has_cue("full, no cue"), has_cue("oracle")
    (True, False, True)
    """
    return NO_CUE not in strategy and ROI_COORDINATES not in strategy


def interval(clips: Collection[str], low: float, high: float) -> list[float | None] | None:
    """Return the interval of 95 %; None over fewer clips than it needs to hold its level.

    Frames of one clip are not independent: an interval over them would be far too narrow.
    """
    return [_round(low), _round(high)] if len(clips) >= LEAST_BLOCKS else None


def is_asked(row: Row, report: Mapping[str, Any]) -> bool:
    """Whether a row's target is asked for; the ball's states count only with `--states`."""
    kind, comma, _state = row["target"].partition(",")
    return kind in report["targets"] and (not comma or report["states"])


def share(budget: str) -> float:
    """Return a budget as a number.

    >>> share("1/8"), share("1")
    (0.125, 1.0)
    """
    above, _, below = budget.partition("/")
    return float(above) / float(below or 1)


def varies(case: Case, other: Case, first: Case) -> bool:
    """Whether `other` differs from `case` in one option, in which `case` equals the `first` row."""
    ours, theirs, plain = (
        ((c.changes, c.policy), c.replaced, *plans_of(c)) for c in (case, other, first)
    )
    differ = [k for k, value in enumerate(ours) if value != theirs[k]]
    return len(differ) == 1 and ours[differ[0]] == plain[differ[0]]


def plans_of(case: Case) -> tuple[int, int, bool]:
    """Return how late and how often a case plans, and whether by predicted boxes."""
    return case.rules.delay, case.rules.replan, case.rules.prediction


def gathered(units: Sequence[Unit]) -> dict[Key, Tally]:
    """Return sums by row and block; the ball counts whole, by state, and as free or still."""
    found: dict[Key, Tally] = {}
    for unit in units:
        for episode in unit["episodes"]:
            every, kept, shown = (
                split(unit["kind"], episode, figure, kept_only=only)
                for figure, only in (("iou", False), ("iou", True), ("shown", True))
            )
            for name in every:
                tally = found.setdefault((name, unit["case"], unit["budget"]), Tally())
                if kept[name]:
                    away = split(unit["kind"], episode, "away_px", kept_only=True)[name]
                    tally.figures.append(figures_of(kept[name], away))
                add(tally.every, unit["clip"], every[name])
                add(tally.kept, unit["clip"], kept[name])
                if kept[name]:
                    tally.shown += shown[name]
                    tally.read_px += episode["read_px"]
                    tally.full_px += episode["full_px"]
    return {key: tally for key, tally in found.items() if tally.kept}


def split(
    kind: str, episode: Mapping[str, Any], figure: str, *, kept_only: bool
) -> dict[str, list[float]]:
    """Return a figure of one start's frames, under each name that they count for."""
    frames = [
        (value, state)
        for value, kept, state in zip(
            episode[figure], episode["kept"], episode["state"], strict=True
        )
        if value is not None and (kept or not kept_only)
    ]
    found = {kind: [value for value, _ in frames]}
    if kind == "ball":
        found[NOT_CARRIED] = [value for value, state in frames if state != CARRIED]
        for name in ("free", "still", "carried"):
            found[f"ball, {name}"] = [value for value, state in frames if state == name]
    return found


def _round(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 4)
