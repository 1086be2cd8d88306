"""`fovea eval tracking`: strategies of acquisition at equal pixel budgets, by a frozen tracker.

Every few frames in which the target can be seen a tracker is started on the truth and followed for
at most 64 frames; a figure is the mean IoU over all frames of all starts in which the truth knows
the target. Of a strategy that leaves frames out, the frames it kept count, as in the paper; what
all frames would give stands beside it (the last box holds). A strategy with a ROI begins with the
ROI on the target and the target's box as prompt; the middle is the middle. Of it there are two
rows: the tracker sees the context where the ROI shows nothing, as the shipped loop has it; or the
ROI alone, which is what the paper's figures suggest (its oracle beats full resolution, and a
window in the middle is worth 1.7 % of it).
"""

import json
import os
import sys
from collections.abc import Sequence
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import Any

import click

from bench.machine import facts
from bench.tracking import report as reporting
from bench.tracking.budgets import acquisition, parsed
from bench.tracking.clip import FULL_PX, ClipName, names
from bench.tracking.episode import Rules
from bench.tracking.replaced import PARTS, Replaced
from bench.tracking.report import ROI_ALONE
from bench.tracking.stages import Stages
from bench.tracking.targets import KINDS
from bench.tracking.units import Case, Protocol, measured
from drivers.simulated.strategies import WITH_ROI
from pipeline.errors import FoveaError, SettingsError
from pipeline.weights import find

ALL = ("full", "oracle", "foveated", "centred", "round_robin", "spatial", "temporal", "exposure")
GRAPH = Path(__file__).parents[2] / "graphs" / "tracking.yaml"
SCENE_FRAMES = 96
FOLLOWS = "auto, vittrack, correlation, or an ONNX file of ViTTrack or MixFormerV2"
SEES = "the tracker: ROI over context (both), the ROI alone as in the paper (roi), or a row of each"


def cases(
    strategies: Sequence[str],
    budgets: Sequence[Fraction],
    *,
    rules: Sequence[Rules],
    replaced: Sequence[tuple[str, ...]],
    policies: dict[str, str],
    changes: tuple[str, ...],
) -> list[Case]:
    """Every row that is asked for; what does not plan has one row a budget, `full` one in all."""
    found = []
    for strategy, budget in product(strategies, budgets):
        share = "1" if strategy == "full" else str(budget)
        if strategy == "full" and budget != budgets[0]:
            continue
        if strategy == "foveated":
            for (label, path), rule, parts in product(policies.items(), rules, replaced):
                name = "foveated" + (f" {label}" if label else "")
                name += f" + true {' and '.join(parts)}" if parts else ""
                name += told(rule, late=len({(r.delay, r.replan) for r in rules}) > 1)
                case = Case(
                    strategy=strategy,
                    budget=share,
                    name=name,
                    rules=rule,
                    replaced=parts,
                    changes=(*changes, *policy_changes(path)),
                )
                found.append(case)
            continue
        sees = {rule.context for rule in rules} if strategy in WITH_ROI else {True}
        longest = rules[0].longest
        plain = (*changes, *policy_changes("pursue"))  # whose horizon is for no other network
        for rule in (Rules(context=c, longest=longest) for c in sorted(sees, reverse=True)):
            name = strategy + told(rule, late=False)
            found.append(
                Case(strategy=strategy, budget=share, name=name, rules=rule, changes=plain)
            )
    return found


def told(rule: Rules, *, late: bool) -> str:
    """What a row is called, after its strategy."""
    name = ""
    if late or rule.delay or rule.replan != 1:
        name = f", delay {rule.delay}, Ta {rule.replan}"
    name += "" if rule.prediction else ", no prediction"
    return name + ("" if rule.context else ROI_ALONE)


def policy_files(given: Sequence[str]) -> dict[str, str]:
    """`--policy [NAME=]FILE|pursue` by name; nothing given is what the graph says."""
    found: dict[str, str] = {}
    for text in given:
        name, equals, path = text.rpartition("=")
        if path != "pursue" and not Path(path).is_file():
            raise SettingsError(f"policy: expected an ONNX file or pursue, got {path}")
        found[name if equals else ("" if len(given) == 1 else Path(path).stem)] = path
    return found or {"": ""}


def policy_changes(path: str) -> tuple[str, ...]:
    """Changes to the graph for a policy by file, for pursue, or for what the graph says ("")."""
    if path == "pursue":
        return ("policy.strategy=pursue",)
    return (f"policy.weights={path}", "policy.strategy=learned") if path else ()


def interval(text: str) -> tuple[int, int]:
    """`A-B`, counted from 1, or nothing.

    >>> interval("1-375"), interval("")
    ((1, 375), (1, 0))
    """
    if not text:
        return 1, 0
    first, dash, last = text.partition("-")
    if not (dash and first.isdigit() and last.isdigit()):
        raise SettingsError(f"frames: expected A-B, counted from 1, got {text!r}")
    return int(first), int(last)


def numbers(name: str, text: str) -> tuple[int, ...]:
    """Whole numbers as they are typed."""
    try:
        found = tuple(int(part) for part in text.split(","))
    except ValueError:
        raise SettingsError(
            f"{name}: expected whole numbers such as 0,2,13, got {text!r}"
        ) from None
    if min(found) < 0:
        raise SettingsError(f"{name}: must not be negative, got {min(found)}")
    return found


@click.command(help=(__doc__ or "").split("\n", 1)[0])
@click.option("--data", required=True, help="a SoccerNet sequence, a folder of them, procedural")
@click.option("--frames", default="", help="A-B, counted from 1; of a scene 1-96")
@click.option("--clips", default=30, help="procedural clips")
@click.option("--strategies", default="all", help="all, or some of " + ",".join(ALL))
@click.option("--budgets", default="1/4,1/8,1/16", help="shares of the full pixel rate")
@click.option("--targets", default="ball,referee,player")
@click.option("--players", default=1, help="players of a clip, drawn by the seed")
@click.option("--every", default=8, help="frames between starts")
@click.option("--longest", default=Rules.longest, help="frames for which a start is followed")
@click.option("--graph", default=str(GRAPH), help="the loop")
@click.option("--set", "changes", multiple=True, help="node.setting=value of the graph")
@click.option(
    "--tracker",
    default="auto",
    help=FOLLOWS,
)
@click.option("--sees", default="each", type=click.Choice(["both", "roi", "each"]), help=SEES)
@click.option("--policy", multiple=True, help="[NAME=]FILE.onnx, or pursue; more give more rows")
@click.option("--delay", default="0", help="frames by which plans come late, e.g. 0,2,13")
@click.option("--replan", default="1", help="Ta: frames between plans, e.g. 1,4,8")
@click.option("--prediction", default="kalman", type=click.Choice(["kalman", "hold", "both"]))
@click.option("--replace", multiple=True, help="part known from the truth: " + ", ".join(PARTS))
@click.option("--jobs", default=2, help="processes")
@click.option("--seed", default=0)
@click.option("--report", type=Path, help="JSON")
@click.option("--markdown", type=Path)
@click.option("--plot", type=Path, help="PNG of IoU over budget")
@click.option("--work", type=Path, help="folder for what is finished; beside the report")
def command(**given: Any) -> None:
    """See the module."""
    try:
        _evaluate(**given)
    except FoveaError as error:
        click.echo(f"fovea eval tracking: {error}", err=True)
        sys.exit(2)


def _evaluate(**given: Any) -> None:
    wanted, protocol, clips, budgets = asked(given)
    out: Path | None = given["report"]
    folder = given["work"] or (out.with_suffix(".work") if out else Path(".fovea-eval"))
    units = measured(clips, wanted, protocol, folder, jobs=given["jobs"])
    seed = protocol.seed
    found = {
        **facts(),
        "graph": Path(protocol.graph).name,
        "changes": sorted({change for case in wanted for change in case.changes}),
        "weighting": "frames: every frame of every start with truth counts once",
        "longest": given["longest"],
        "players": protocol.players,
        "clips": [str(clip) for clip in clips],
        "frames": list(protocol.frames),
        "every": protocol.every,
        "budgets": [str(budget) for budget in budgets],
        "seed": seed,
        "rows": reporting.rows(units, seed=seed),
        "paired": reporting.paired(units, wanted, seed=seed),
    }
    text = reporting.markdown(found)
    if out:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps(found, indent=1) + os.linesep)
    if given["markdown"]:
        given["markdown"].write_text(text)
    if given["plot"]:
        last = [r for r in found["rows"] if r["clip"] == "all" or len(clips) == 1]
        reporting.plot(last, given["plot"])
    click.echo(text)


def asked(
    given: dict[str, Any],
) -> tuple[list[Case], Protocol, list[ClipName], tuple[Fraction, ...]]:
    """What the options mean; raises `FoveaError` before anything is measured."""
    strategies = ALL if given["strategies"] == "all" else tuple(given["strategies"].split(","))
    budgets = parsed(given["budgets"])
    kinds = tuple(given["targets"].split(","))
    for kind in kinds:
        if kind not in KINDS:
            raise SettingsError(f"targets: expected {', '.join(KINDS)}, got {kind}")
    clips = names(given["data"], given["clips"])
    frames = interval(given["frames"])
    if not frames[1] and not clips[0].folder:
        frames = (1, SCENE_FRAMES)
    replaced = [(), *(tuple(text.split("+")) for text in given["replace"])]
    for parts in replaced:
        Replaced(parts=frozenset(parts))  # refuses what is no part
    for strategy, budget in product(strategies, budgets):
        acquisition(strategy, budget, FULL_PX)  # refuses what cannot be read
    protocol = Protocol(
        graph=given["graph"],
        frames=frames,
        kinds=kinds,
        every=given["every"],
        players=given["players"],
        seed=given["seed"],
    )
    wanted = cases(
        strategies,
        budgets,
        rules=rules_of(given),
        replaced=replaced,
        policies=policy_files(given["policy"]),
        changes=(*given["changes"], *tracker_changes(given["tracker"])),
    )
    for case in wanted:
        if not case.rules.delay:
            continue
        reach = Stages(Path(protocol.graph), case.changes).horizon
        if case.rules.delay >= reach:
            raise SettingsError(
                f"delay: plans reach {reach} frames, those {case.rules.delay} frames late are over "
                "before they hold; set association.horizon and policy.horizon, and name a policy "
                "that was trained for them"
            )
    return wanted, protocol, clips, budgets


def rules_of(given: dict[str, Any]) -> list[Rules]:
    """Every delay with every replanning interval, prediction or none, context or none."""
    sees = {"both": (True,), "roi": (False,), "each": (True, False)}[given["sees"]]
    predictions = {"kalman": (True,), "hold": (False,), "both": (True, False)}[given["prediction"]]
    delays, replans = (numbers(name, given[name]) for name in ("delay", "replan"))
    longest = given["longest"]
    if longest < 1:
        raise SettingsError(f"longest: must be at least 1 frame, got {longest}")
    return [
        Rules(delay=d, replan=ta, prediction=p, context=c, longest=longest)
        for d, ta, p, c in product(delays, replans, predictions, sees)
    ]


def tracker_changes(choice: str) -> tuple[str, ...]:
    """Changes to the graph for `--tracker`; auto is settled here, for it decides the figures."""
    if choice.endswith(".onnx"):
        return ("tracker.method=auto", f"tracker.weights={choice}")
    if choice not in ("auto", "vittrack", "correlation"):
        raise SettingsError(
            f"tracker: expected auto, vittrack, correlation or an ONNX file, got {choice}"
        )
    if choice == "auto":
        choice = "vittrack" if find("vittrack") else "correlation"
        click.echo(f"tracker: {choice}", err=True)
    return (f"tracker.method={choice}",)


def main() -> None:
    """Command line."""
    command()


if __name__ == "__main__":
    main()
