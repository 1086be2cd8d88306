"""Leave out each rule while targets are followed from many starts, as `fovea eval tracking` does.

`python -m bench.rules_from_starts --data FOLDER --every 16 …`: options that are not its own are
those of `fovea eval tracking`. `bench.rules` asks for a target in the first frame of a clip; here
the prompt is the true box, given every few frames of it, so that one clip has many starts and the
ball has rows for each of its states. Prints the share of the target inside the ROI and the
tracker's IoU, with the difference to the run with all rules, paired by clip.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
from rich.console import Console
from rich.progress import track

from bench.machine import facts
from bench.options import JSON, Bench
from bench.policy_rules import RULES, Rule, without
from bench.prototype import table
from bench.rules import ALL, FIGURES, POLICIES, worded
from bench.tracking import evaluate
from bench.tracking.intervals import METHOD, Block, difference, mean
from bench.tracking.job import follow
from bench.tracking.options import Options, options_of
from bench.tracking.report import gathered
from bench.tracking.store import Unit, units
from pipeline.errors import RunError

STRATEGIES = {"learned": "foveated", "pursuit": "pursuit"}  # of `fovea eval tracking`, by policy
Key = tuple[str, str]  # target, budget
Blocks = Mapping[str, Mapping[str, Block]]  # figure -> clip -> its share


def measured(options: Options, rule: Rule | None) -> list[Unit]:
    """Return what became of each target of each clip, with all rules but one."""
    cases, protocol, clips = evaluate.asked(options)
    if rule:
        cases = [replace(case, changes=(*case.changes, *rule.changes)) for case in cases]
    found: list[Unit] = []
    with TemporaryDirectory() as folder:
        for number, clip in enumerate(clips):
            work = [
                (case, Path(folder) / f"{number} {place}.json") for place, case in enumerate(cases)
            ]
            with without(rule) if rule else ExitStack():
                follow(clip, work, protocol, Path(folder) / "warnings.log")
            found += [unit for _, path in work for unit in units(path)]
    return found


def blocks(found: Sequence[Unit]) -> Mapping[Key, Blocks]:
    """Return the figures of each target, by clip."""
    shares: dict[Key, dict[str, dict[str, Block]]] = {}
    for clip in sorted({unit["clip"] for unit in found}):
        for (target, _, budget), tally in gathered([u for u in found if u["clip"] == clip]).items():
            figures = shares.setdefault((target, budget), {name: {} for name in FIGURES})
            figures[FIGURES[0]][clip] = Block(
                total=sum(tally.shown), frames=len(tally.shown), starts=len(tally.figures)
            )
            figures[FIGURES[1]][clip] = tally.kept[clip]
    return shares


def rows(policy: str, found: Mapping[str, Mapping[Key, Blocks]]) -> Iterator[dict[str, Any]]:
    """Yield the figures of each rule (`ALL` among them) and target."""
    for name, targets in found.items():
        for (target, budget), own in targets.items():
            usual = found[ALL][target, budget]
            row: dict[str, Any] = {
                "policy": policy, "target": target, "budget": budget, "without": name,
            }  # fmt: skip
            for figure in FIGURES:
                row[figure] = round(mean(own[figure]).iou, 3)
                lost = worded(*difference(own[figure], usual[figure]))
                row[f"{figure}: gained without"] = "" if name == ALL else lost
            whole = mean(own[FIGURES[1]])
            yield row | {"clips": len(own[FIGURES[1]]), "starts": whole.starts, "n": whole.frames}


def options_for(policy: str, given: Sequence[str]) -> Options:
    """Return the options of `fovea eval tracking` for a policy."""
    line = [*given, "--strategies", STRATEGIES[policy]]
    return options_of(evaluate.command.make_context("fovea eval tracking", line).params)


@click.command(cls=Bench, context_settings={"ignore_unknown_options": True})
@click.option("--policies", default=",".join(POLICIES), show_default=True)
@JSON
@click.argument("given", nargs=-1, type=click.UNPROCESSED)
def main(policies: str, path: Path | None, given: tuple[str, ...]) -> None:
    """Leave out each rule once."""
    result: list[dict[str, Any]] = []
    for policy in policies.split(","):
        if policy not in POLICIES:
            known = ", ".join(POLICIES)
            raise RunError(f"--policies: expected some of {known}, got {policy[:40]!r}")
        cases: dict[str, Rule | None] = {ALL: None, **RULES[policy]}
        found = {
            name: blocks(measured(options_for(policy, given), rule))
            for name, rule in track(cases.items(), policy, console=Console(stderr=True))
        }
        result += rows(policy, found)
    Console().print(table("rules left out once, from many starts", result))
    if path:
        options = options_for(policies.split(",")[0], given)
        report = facts() | {
            "bench": "rules_from_starts", "data": Path(options.data).name, "seed": options.seed,
            "every": options.every, "longest": options.longest, "cue": options.cue,
            "interval": METHOD, "rows": result,
        }  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
