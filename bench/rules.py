"""Leave out each rule of the policies once: `python -m bench.rules [GRAPH] [--json FILE]`.

Runs the graph in line on drawn clips, or on the source of `--source`: a target asked for by its
class, as the ball, or by the box that it has in the first frame, as referees and players. In each
run one rule is replaced by what would be there without it, or its setting by the value that makes
it do nothing. Prints the share of the target inside the ROI and the tracker's IoU, over all frames
in which the target is visible (of a class any object may be the one that is followed), and the
difference to the run with all rules, paired by the target: what loses nothing can go. The policies
with all rules stand beside each other, too, and tell how often the tracker is on the target where
the ROI shows it, and where it has a box.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import click
import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from bench.machine import facts
from bench.options import JSON, ROOT, Bench, file_name, on_graph, told_changes
from bench.overlap import best_of
from bench.policy_rules import RULES, Rule, without
from bench.prototype import table
from bench.tracking.classes import planned
from bench.tracking.intervals import METHOD, Block, add, difference, mean
from drivers.source import CLASS_OF_ROLE, LEAST_VISIBLE
from pipeline.errors import RunError
from pipeline.graph.plan import Plan
from pipeline.messages import Frame, Message, Percept, Truth
from pipeline.run.inline import InlineRunner

ALL = "all rules"
FIRST_CLIP = 50_000  # seeds on which rules may be chosen; figures of tables begin at 70,000
POLICIES = {  # as `planned` takes them
    "learned": str(ROOT / "operators" / "policy" / "policy.onnx"), "pursuit": "pursuit",
    "of the graph": "",
}  # fmt: skip
FIGURES = ("share in the ROI", "IoU")
TRACKER = "tracker"  # the node
ON_IT = "tracker on it where the ROI shows it"
RIGHT = "tracker on it where it answers"
SHOWN, ON = 0.5, 0.2  # share of the target in the ROI, IoU
NOWHERE = np.zeros((0, 4), np.float32)


@dataclass(kw_only=True, eq=False)
class Watch:
    """What became of one target in one run; values of frames in which it is visible."""

    kind: str
    object_id: int = -1  # -1: any of the class
    values: dict[str, list[float]] = field(default_factory=lambda: {f: [] for f in FIGURES})
    answered: list[bool] = field(default_factory=list)  # of these frames
    runs: int = 1
    _windows: dict[int, tuple[int, int, int, int]] = field(default_factory=dict)  # by frame
    _answers: dict[int, Any] = field(default_factory=dict)
    _truths: dict[int, Truth] = field(default_factory=dict)

    def hear(self, output: str, message: Message) -> None:
        """Take a message of the graph."""
        if isinstance(message, Frame) and output == "capture.roi":
            self._windows[message.header.seq] = message.window
        elif isinstance(message, Percept) and output.partition(".")[0] == TRACKER:
            if len(message.boxes):
                self._answers[message.header.seq] = message.boxes
        elif isinstance(message, Truth) and output == "capture.truth":
            self._truths[message.header.seq] = message

    def judge(self) -> None:
        """Compare what was heard with the truth, when a run has ended."""
        for seq, truth in self._truths.items():
            boxes = self._meant(truth)
            if not len(boxes):
                continue
            window = np.array(self._windows.get(seq, (0, 0, 0, 0)))
            answer = self._answers.get(seq, NOWHERE)
            self.answered.append(len(answer) > 0)
            best = best_of(boxes, window, answer)
            for figure, value in zip(FIGURES, best, strict=True):
                self.values[figure].append(value)

    def join(self, other: "Watch") -> None:
        """Add a run with the same target from another start, which overlaps this one."""
        self.runs += other.runs
        self.answered += other.answered
        for figure in FIGURES:
            self.values[figure] += other.values[figure]

    def _meant(self, truth: Truth) -> NDArray[np.float32]:
        """Return the object asked for, or all of the class, where it is visible: (n, 4)."""
        rows = [
            row
            for row, label in enumerate(truth.labels)
            if CLASS_OF_ROLE.get(label, label) == self.kind
            and truth.visibility[row] >= LEAST_VISIBLE
            and self.object_id in (-1, int(truth.ids[row]))
        ]
        return truth.boxes[rows]


Targets: TypeAlias = dict[tuple[str, int], Watch]  # clip and object -> what became of it


def rules_of(plan: Plan) -> Mapping[str, Rule]:
    """Return the rules of a graph's policy by what they say; none of one without such."""
    classes = {node.name: node.operator.partition(":")[2] for node in plan.nodes}
    return RULES.get(classes.get("policy", "").removesuffix("Policy").lower(), {})


def followed_in(plan: Plan) -> Plan:
    """Return a plan whose tracker can be judged; raises `RunError` for one without."""
    if TRACKER not in {node.name for node in plan.nodes}:
        raise RunError(f"{plan.name}: expected a graph with a node {TRACKER} to judge, got none")
    return plan


def first_truth(plan: Plan) -> Truth:
    """Return what the source knows of its first frame; raises `RunError` if it knows nothing."""
    found: list[Truth] = []

    def hear(output: str, message: Message) -> None:
        if isinstance(message, Truth) and output == "capture.truth":
            found.append(message)

    with InlineRunner(plan, watch=hear) as runner:
        for _ in runner.run(1):
            pass
    if not found:
        raise RunError(f"{plan.name}: expected a source that knows the truth, got none")
    return found[0]


def asked(
    truth: Truth, targets: Sequence[str], boxed: Sequence[str], objects: int
) -> Iterator[tuple[Watch, tuple[str, ...]]]:
    """Yield how targets are asked for in a clip: by class, or `objects` of one by first boxes."""
    for kind in targets:
        if kind not in boxed:
            yield Watch(kind=kind), (f"policy.target={kind}",)
            continue
        rows = [
            row
            for row, label in enumerate(truth.labels)
            if CLASS_OF_ROLE.get(label, label) == kind and truth.visibility[row] >= LEAST_VISIBLE
        ]
        for row in rows[:objects]:
            box = ", ".join(f"{side:.1f}" for side in truth.boxes[row])
            prompt = ("policy.target=", f"policy.prompt_box=[{box}]")
            yield Watch(kind=kind, object_id=int(truth.ids[row])), prompt


def run(plan: Plan, rule: Rule | None, watch: Watch, frames: int) -> None:
    """Run the graph with all rules but one."""
    left_out = without(rule) if rule else ExitStack()
    with left_out, InlineRunner(plan, watch=watch.hear) as runner:
        for _ in runner.run(frames):
            pass
    watch.judge()


def rows(found: Mapping[tuple[str, str, str], Targets]) -> Iterator[dict[str, Any]]:
    """Yield the figures of each policy, target and rule, over the targets of that kind."""
    for (policy, kind, name), clips in found.items():
        usual = found[policy, kind, ALL]
        row: dict[str, Any] = {"policy": policy, "target": kind, "without": name}
        for figure in FIGURES:
            own, all_rules = blocks(clips, figure), blocks(usual, figure)
            row[figure] = rounded(mean(own).iou)
            if name != ALL:
                row[f"{figure}: gained without"] = worded(*difference(own, all_rules))
            else:
                row[f"{figure}: gained without"] = ""
        yield row | {"targets": len(clips)}


def beside(found: Mapping[tuple[str, str, str], Targets]) -> Iterator[dict[str, Any]]:
    """Yield, of each target, the figures of each policy with all rules, above the first of them."""
    whole = {(policy, kind): clips for (policy, kind, name), clips in found.items() if name == ALL}
    first = next(iter(whole))[0]
    for (policy, kind), clips in whole.items():
        row: dict[str, Any] = {"target": kind, "policy": policy}
        for figure in FIGURES:
            own = blocks(clips, figure)
            row[figure] = rounded(mean(own).iou)
            above = difference(own, blocks(whole[first, kind], figure))
            row[f"{figure}: above {first}"] = "" if policy == first else worded(*above)
        row |= {ON_IT: on_it(clips.values()), RIGHT: right(clips.values())}
        yield row | {"targets": len(clips), "runs": sum(w.runs for w in clips.values())}


def on_it(clips: Iterable[Watch]) -> float | str:
    """Return the share of frames with the tracker on the target of those in which the ROI shows it.

    Empty where it never does.
    """
    pairs = [pair for w in clips for pair in zip(*w.values.values(), strict=True)]
    return share_on([overlap for shown, overlap in pairs if shown >= SHOWN])


def right(clips: Iterable[Watch]) -> float | str:
    """Return the share of frames with the tracker on the target of those in which it has a box.

    Frames in which the target is not visible do not count. Empty where it never has one.
    """
    pairs = [pair for w in clips for pair in zip(w.answered, w.values["IoU"], strict=True)]
    return share_on([overlap for answered, overlap in pairs if answered])


def share_on(overlaps: Sequence[float]) -> float | str:
    """Return the share of frames whose IoU says that the tracker is on the target."""
    return round(float((np.array(overlaps) > ON).mean()), 3) if overlaps else ""


def blocks(targets: Targets, figure: str) -> dict[str, Block]:
    """Return each clip's sum of a figure over its targets, which depend on one another."""
    found: dict[str, Block] = {}
    for (clip, _), watch in targets.items():
        add(found, clip, watch.values[figure])
    return found


def rounded(value: float) -> float | str:
    """Return a mean for the table; empty over no frames.

    >>> rounded(0.12345), rounded(float("nan"))
    (0.123, '')
    """
    return round(value, 3) if value == value else ""


def worded(middle: float, low: float, high: float) -> str:
    """Return a difference with its interval, if it has one; empty for none.

    >>> worded(0.1, 0.05, 0.15), worded(0.1, float("nan"), float("nan"))
    ('+0.100 (+0.050 .. +0.150)', '+0.100')
    """
    if middle != middle:
        return ""
    return f"{middle:+.3f}" + (f" ({low:+.3f} .. {high:+.3f})" if low == low else "")


@click.command(cls=Bench)
@on_graph
@click.option("--clips", default=8, show_default=True, type=click.IntRange(1))
@click.option("--frames", default=150, show_default=True, type=click.IntRange(2))
@click.option("--first-clip", default=FIRST_CLIP, show_default=True, type=click.IntRange(0))
@click.option("--targets", default="ball,referee,player", show_default=True)
@click.option(
    "--boxed",
    default="referee,player",
    show_default=True,
    help="Classes of which objects are asked for by their first box.",
)
@click.option(
    "--objects",
    default=1,
    show_default=True,
    type=click.IntRange(1),
    help="Objects of each boxed class in each clip that are asked for in turn.",
)
@click.option("--policies", default="learned,pursuit", show_default=True)
@click.option(
    "--starts",
    default=1,
    show_default=True,
    type=click.IntRange(1),
    help="Of a source: runs that begin every --every frames of it, as its option `first`.",
)
@click.option("--every", default=8, show_default=True, type=click.IntRange(1), help="Frames.")
@click.option("--whole", is_flag=True, help="Leave out nothing: only compare the policies.")
@JSON
def main(
    graph: Path, source: Path | None, changes: tuple[str, ...], clips: int, frames: int,
    first_clip: int, targets: str, boxed: str, objects: int, policies: str, starts: int, every: int,
    whole: bool, path: Path | None,
) -> None:  # fmt: skip
    """Leave out each rule once."""
    cv2.setNumThreads(1)
    if starts > 1 and not source:
        raise RunError("--starts: expected with --source, whose frames they are, got none")
    for name in policies.split(","):
        if name not in POLICIES:
            raise RunError(f"--policies: expected some of {', '.join(POLICIES)}, got {name[:40]!r}")
    cases = []
    for policy in policies.split(","):
        plan = followed_in(planned(graph, changes, policy=POLICIES[policy], source=source))
        rules = {} if whole else rules_of(plan)
        cases += [(policy, name, rule) for name, rule in {ALL: None, **rules}.items()]
    found: dict[tuple[str, str, str], Targets] = {}
    seeds = range(first_clip, first_clip + clips)
    worlds = {f"clip {seed}": [(*changes, f"capture.seed={seed}")] for seed in seeds}
    if source:
        firsts = range(0, starts * every, every) if starts > 1 else ()
        begun = [(*changes, f"capture.source_options.first={first}") for first in firsts]
        worlds = {"the source": begun or [changes]}
        first_truth(planned(graph, worlds["the source"][-1], source=source))  # has it so many?
    for clip, common in ((clip, common) for clip, of in worlds.items() for common in of):
        truth = first_truth(planned(graph, common, source=source))
        for policy, name, rule in track(cases, clip, console=Console(stderr=True)):
            for watch, prompt in asked(truth, targets.split(","), boxed.split(","), objects):
                laid = (*common, *prompt, *(rule.changes if rule else ()))
                plan = planned(graph, laid, policy=POLICIES[policy], source=source)
                run(plan, rule, watch, frames)
                of_rule = found.setdefault((policy, watch.kind, name), {})
                if before := of_rule.get((clip, watch.object_id)):
                    before.join(watch)
                else:
                    of_rule[clip, watch.object_id] = watch
    if not found:
        raise RunError(f"--targets: expected what the first frames show, got {targets[:80]!r}")
    result, policies_beside = list(rows(found)), list(beside(found))
    over = f"{len(worlds)} x {frames} frames"
    if starts > 1:
        over = f"up to {frames} frames from each of {starts} starts"
    if not whole:
        Console().print(table(f"rules left out once, {over}", result))
    Console().print(table(f"policies with all rules, {over}", policies_beside))
    if path:
        report = facts() | {
            "bench": "policies" if whole else "rules", "graph": file_name(graph),
            "changes": told_changes(changes),
            "source": file_name(source) if source else "", "boxed": boxed, "objects": objects,
            "seed": first_clip, "clips": len(worlds), "frames": frames, "targets": targets,
            "starts": starts, "every": every if starts > 1 else 0, "interval": METHOD,
            "rows": policies_beside if whole else result,
        }  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
