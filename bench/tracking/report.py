"""Units into rows, tables and a plot."""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.tracking.cases import ROI_ALONE, Case
from bench.tracking.intervals import Block, block_of, difference, mean
from bench.tracking.kept import Unit
from bench.tracking.targets import HELD
from drivers.simulated.strategies import WITH_ROI

Row = dict[str, Any]
Key = tuple[str, str, str]  # target, strategy, budget
# IoU in the paper: Table 1, "Additional results … object tracking" and the budget sweep
PAPER: Mapping[Key, float] = {
    ("ball", "full", "1"): 0.281,
    ("ball", "oracle", "1/8"): 0.405,
    ("ball", "exposure", "1/8"): 0.098,
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
NOT_HELD = "ball, free or still"


def rows(units: Sequence[Unit], *, seed: int) -> list[Row]:
    """One row per clip, target, strategy and budget, and one over all clips."""
    found: list[Row] = []
    clips = sorted({unit["clip"] for unit in units})
    groups = [*([(c, [c]) for c in clips] if len(clips) > 1 else []), ("all", clips)]
    for name, members in groups:
        chosen = [unit for unit in units if unit["clip"] in members]
        for key, blocks in gathered(chosen, kept_only=True).items():
            target, strategy, budget = key
            figures = mean(blocks, seed=seed)
            row: Row = {
                "clip": name if len(clips) > 1 else clips[0],
                "target": target,
                "strategy": strategy,
                "budget": budget,
                "iou": _round(figures.iou),
                "ci95": [_round(figures.low), _round(figures.high)],
                "frames": figures.frames,
                "starts": figures.starts,
            }
            if strategy in ("temporal", "exposure"):
                every = mean(gathered(chosen, kept_only=False)[key], seed=seed)
                row["iou_all_frames"] = _round(every.iou)
            if (share := shown(chosen, key)) is not None:
                row["roi_coverage"] = _round(share)
            paper = PAPER.get((target, strategy.removesuffix(ROI_ALONE), budget))
            if name == "all" and paper is not None:
                row["paper"] = paper
            found.append(row)
    return found


def paired(units: Sequence[Unit], cases: Sequence[Case], *, seed: int) -> list[Row]:
    """Differences between rows at the same budget (and to what has none), paired by block.

    Each row of the policy is told against what is none of it, and against those that `varies`
    finds: all against all would be read by nobody.
    """
    blocks = gathered(units, kept_only=True)
    planned = {case.name: case for case in cases if case.strategy == "foveated"}
    first = next(iter(planned.values()), None)
    found = []
    for (target, strategy, budget), own in blocks.items():
        for (other_target, other, other_budget), theirs in blocks.items():
            if strategy not in planned or other_target != target or strategy == other:
                continue
            if other_budget not in (budget, "1") or not own.keys() & theirs.keys():
                continue
            alone = (strategy.endswith(ROI_ALONE), other.endswith(ROI_ALONE))
            if other.startswith(WITH_ROI) and alone[0] != alone[1]:
                continue
            if first and other in planned and not varies(planned[strategy], planned[other], first):
                continue
            middle, low, high = difference(own, theirs, seed=seed)
            found.append(
                {
                    "target": target,
                    "budget": budget,
                    "strategy": strategy,
                    "against": other,
                    "difference": _round(middle),
                    "ci95": [_round(low), _round(high)],
                }
            )
    return found


def varies(case: Case, other: Case, first: Case) -> bool:
    """Whether `other` differs from `case` in one thing, in which `case` is as the `first` row."""
    ours, theirs, plain = (
        (c.changes, c.replaced, c.rules.delay, c.rules.replan, c.rules.prediction)
        for c in (case, other, first)
    )
    differ = [k for k, value in enumerate(ours) if value != theirs[k]]
    return len(differ) == 1 and ours[differ[0]] == plain[differ[0]]


def gathered(units: Iterable[Unit], *, kept_only: bool) -> dict[Key, dict[str, Block]]:
    """Sums by row and block; the ball counts whole, by state, and as free or still."""
    units = list(units)
    alone = len({unit["clip"] for unit in units}) == 1
    sums: dict[Key, dict[str, list[float]]] = {}
    for unit in units:
        for episode in unit["episodes"]:
            block = block_of(unit["clip"], episode["start"], alone)
            for name, values in split(unit["kind"], episode, kept_only).items():
                if values:
                    key = (name, unit["case"], unit["budget"])
                    entry = sums.setdefault(key, {}).setdefault(block, [0.0, 0, 0])
                    entry[0] += sum(values)
                    entry[1] += len(values)
                    entry[2] += 1
    return {
        key: {
            name: Block(total=total, frames=int(frames), starts=int(count))
            for name, (total, frames, count) in blocks.items()
        }
        for key, blocks in sums.items()
    }


def split(
    kind: str, episode: Mapping[str, Any], kept_only: bool, figure: str = "iou"
) -> dict[str, list[float]]:
    """A figure of one start's frames, under each name that they count for."""
    frames = [
        (value, state)
        for value, kept, state in zip(
            episode[figure], episode["kept"], episode["state"], strict=True
        )
        if value is not None and (kept or not kept_only)
    ]
    found = {kind: [value for value, _ in frames]}
    if kind == "ball":
        found[NOT_HELD] = [value for value, state in frames if state != HELD]
        for name in ("free", "still", "held"):
            found[f"ball, {name}"] = [value for value, state in frames if state == name]
    return found


def shown(units: Iterable[Unit], key: Key) -> float | None:
    """Mean share of the target inside the ROI, None for strategies without."""
    target, strategy, budget = key
    values = [
        value
        for unit in units
        if (unit["case"], unit["budget"]) == (strategy, budget)
        for episode in unit["episodes"]
        for value in split(unit["kind"], episode, True, "shown").get(target, ())
    ]
    return sum(values) / len(values) if values else None


def markdown(report: Mapping[str, Any]) -> str:
    """The aggregate rows as a table, the paper's figure beside ours, and the paired differences."""
    lines = [
        "| target | budget | strategy | IoU | 95 % | all frames | in ROI | paper "
        "| starts | frames |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    last = [r for r in report["rows"] if r["clip"] == "all" or len(report["clips"]) == 1]
    for row in sorted(last, key=lambda r: (r["target"], _budget(r["budget"]), r["strategy"])):
        cells = [
            row["target"],
            row["budget"],
            row["strategy"],
            _show(row["iou"]),
            " – ".join(_show(v) for v in row["ci95"]),
            _show(row.get("iou_all_frames")),
            _show(row.get("roi_coverage")),
            _show(row.get("paper")),
            str(row["starts"]),
            str(row["frames"]),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    lines += [
        "",
        "| target | budget | strategy | against | IoU | 95 % |",
        "|---|---|---|---|---|---|",
    ]
    for row in report["paired"]:
        low, high = row["ci95"]
        lines.append(
            f"| {row['target']} | {row['budget']} | {row['strategy']} | {row['against']} "
            f"| {row['difference']:+.3f} | {low:+.3f} – {high:+.3f} |"
        )
    return "\n".join(lines) + "\n"


def plot(found: Sequence[Row], path: Path) -> None:
    """IoU over budget with intervals, one panel a target."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    kinds = [k for k in (NOT_HELD, "referee", "player") if any(r["target"] == k for r in found)]
    if not kinds:
        return
    figure, axes = pyplot.subplots(1, len(kinds), figsize=(4.4 * len(kinds), 3.6), squeeze=False)
    for place, kind in zip(axes[0], kinds, strict=True):
        own = [r for r in found if r["target"] == kind and r["iou"] is not None]
        for name in sorted({r["strategy"] for r in own}):
            points = sorted((_budget(r["budget"]), r) for r in own if r["strategy"] == name)
            x = [share for share, _ in points]
            y = [r["iou"] for _, r in points]
            spread = [
                [r["iou"] - r["ci95"][0] for _, r in points],
                [r["ci95"][1] - r["iou"] for _, r in points],
            ]
            place.errorbar(x, y, spread, marker="o", capsize=3, label=name)
        place.set_xscale("log", base=2)
        place.set(title=kind, xlabel="pixel budget", ylabel="IoU")
    axes[0, -1].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=140)
    pyplot.close(figure)


def _budget(text: str) -> float:
    above, _, below = text.partition("/")
    return float(above) / float(below or 1)


def _round(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 4)


def _show(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"
