"""Reproduce the paper's tables: `python -m bench.tables --out FOLDER`.

The studies are: all strategies at all budgets on held-out procedural clips and, with --soccernet,
on real footage that no network was trained on, with eight players as a separate study; late and
rare plans, with and without prediction; the loop with one part at a time replaced by the truth;
with --ablation NAME=FILE, policies without some of their inputs; with --far FILE, a policy that was
trained for plans 60 frames late; the time of each part. Last comes one table of all tasks beside
the paper's: tracking as measured here, text and manipulation from the reports of `fovea eval`. A
study that cannot be measured is refused before the first one begins, and an interrupted study
continues.
Each study is written to files of its own with a plot; `tables.md` and `tables.json` hold all
studies of the folder. `--quick` tries everything on little data: its figures mean nothing.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from bench import all_tasks
from bench.machine import facts
from bench.options import Bench
from bench.outputs import make_folder
from bench.run_time import by_objects, by_objects_markdown, markdown, run_time
from bench.tracking.evaluate import asked, command, try_out
from bench.tracking.options import options_of, policy_files
from bench.tracking.replaced import PARTS
from operators.policy.network import SHIPPED
from pipeline.errors import FoveaError, SettingsError

TOGETHER = ("detections+association",)  # the policy's inputs with perfect perception
NAMES = {
    "budgets": "Strategies at equal pixel budgets, held-out procedural clips",
    "soccernet": "The same on real footage, a development clip",
    "players-soccernet": "The same of eight players on real footage",
    "long-soccernet": "One start, followed to the end, on real footage",
    "paper-soccernet": "Without a cue and in coordinates of the ROI, as the paper reads",
    "late": "Late and rare plans (delay in frames, Ta)",
    "late-soccernet": "The same on real footage",
    "late-hold": "The same at 1/8 without prediction: objects are foreseen where they are",
    "late-hold-soccernet": "The same on real footage",
    "far": "Plans 60 frames late, by a policy with a horizon of 200 frames",
    "far-soccernet": "The same on real footage",
    "far-hold": "The same at 1/8 without prediction",
    "far-hold-soccernet": "The same on real footage",
    "limits": "What limits the rest: one part after the other replaced by the truth, at 1/8",
    "limits-soccernet": "The same on real footage, eight players",
    "ablation": "Inputs of the policy left out, at 1/8",
    "run-time": "Time of each part, one thread",
    "all-tasks": "All tasks beside the paper's Table 1",
}
UNPLANNED = ("run-time", "all-tasks")  # no studies of `fovea eval tracking`
RESULTS = Path(__file__).with_name("results")
REPORTS = {"text": RESULTS / "reading.json", "manipulation": RESULTS / "manipulation.json"}
TARGET = "ball"  # of tracking, in the table of all tasks

BOTH = ("--sees", "each")  # a row with the context and one with the ROI alone, as in the paper
PAPERS = "full,oracle,foveated,centred,round_robin,spatial,temporal,exposure"
LATE = ("--strategies", "foveated", "--sees", "both", "--replan", "1,4,8")
CROWD = ("--players", "8", "--every", "24")
HOLD = ("--budgets", "1/8", "--prediction", "hold")
FAR = (  # the paper's long horizon, and episodes that are long enough for plans so late
    *("--delay", "0,60", "--replan", "1,4,8,180", "--longest", "240"),
    *("--set", "association.observed=10", "--set", "association.horizon=200"),
    *("--set", "policy.observed=10", "--set", "policy.horizon=200"),
)


def studies(
    clips: int,
    soccernet: str,
    ablations: tuple[str, ...],
    policies: tuple[str, ...],
    *,
    far: str = "",
    quick: bool = False,
) -> dict[str, list[str]]:
    """Return the options of `fovea eval tracking` for each study."""
    own = _policy(policies)
    short = ["--frames", "1-24"] if quick else []
    many = [*_drawn(1 if quick else clips), *short]
    few = [*(many if quick else _drawn(max(1, clips // 3))), "--budgets", "1/8"]
    parts = [word for part in (*PARTS, *TOGETHER) for word in ("--replace", part)]
    limits = ["--strategies", "foveated,oracle,full", "--sees", "both", *parts, *own]
    found = {"budgets": [*many, *BOTH, *own]}
    if soccernet:
        real = ["--data", soccernet, *BOTH, *own, *short]
        found["soccernet"] = real
        plain = ["--data", soccernet, *own, *short]
        found["long-soccernet"] = [*plain, "--protocol", "long", "--players", "4"]
        paper = ("--strategies", PAPERS, "--cue", "none", "--sees", "coordinates")
        found["paper-soccernet"] = [*plain, *paper, "--budgets", "1/8"]
        found["players-soccernet"] = [*real, "--targets", "player", *CROWD]
    found |= _late(clips, soccernet, own, far, short)
    found["limits"] = [*few, *limits]
    if soccernet:
        crowd = ["--budgets", "1/8", *CROWD, *short]
        found["limits-soccernet"] = ["--data", soccernet, *crowd, *limits]
    if ablations:
        wanted = ["--strategies", "foveated,centred,round_robin,full", "--sees", "roi"]
        whole = policies[0].rpartition("=")[2] if policies else str(SHIPPED)
        rows = (f"whole={whole}", *ablations, "pursuit=pursuit")
        found["ablation"] = [*few, *wanted, *_policy(rows)]
    return found


def _late(
    clips: int, soccernet: str, own: list[str], far: str, short: list[str]
) -> dict[str, list[str]]:
    """Return studies of late plans, on fewer clips and starts, as each delay and Ta runs anew."""
    found: dict[str, list[str]] = {}
    real = {"-soccernet": ["--data", soccernet]} if soccernet else {}
    drawn = {"": _drawn(1 if short else max(1, clips // 5))}
    long = {"": _drawn(1 if short else max(1, clips // 15))}
    for where, data in (drawn | real).items():
        words = [*data, *LATE, "--delay", "0,2,13", "--every", "24", *own, *short]
        found |= {f"late{where}": words, f"late-hold{where}": [*words, *HOLD]}
    for where, data in ((long | real) if far else {}).items():
        every = ["--every", "48"] if where else ["--every", "60", "--frames", "1-300"]
        words = [*data, *LATE, *FAR, *every, "--policy", far, *short]
        found |= {f"far{where}": words, f"far-hold{where}": [*words, *HOLD]}
    return found


def _drawn(clips: int) -> list[str]:
    return ["--data", "procedural", "--clips", str(clips)]


def _policy(given: Sequence[str]) -> list[str]:
    return [word for each in given for word in ("--policy", each)]


def check(planned: Mapping[str, Sequence[str]]) -> None:
    """Raise `click.UsageError` for a study that cannot be measured, before any of them begins."""
    opened: set[tuple[tuple[str, ...], str, str]] = set()
    for name, words in planned.items():
        try:
            with command.make_context(name, list(words)) as context:
                cases, protocol, _ = asked(options_of(context.params))
            fresh = [case for case in cases if case.parts not in opened]
            try_out(fresh, protocol)
        except FoveaError as error:
            raise click.UsageError(f"{name}: {error}") from error
        opened |= {case.parts for case in fresh}


def together(out: Path) -> None:
    """Write tables.md and tables.json of every study in the folder."""
    files = {name: out / (all_tasks.NAME if name == "all-tasks" else name) for name in NAMES}
    known = {name: file for name, file in files.items() if file.with_suffix(".json").exists()}
    whole = {n: json.loads(file.with_suffix(".json").read_text()) for n, file in known.items()}
    (out / "tables.json").write_text(json.dumps(whole, indent=1) + "\n")
    texts = [f"## {NAMES[n]}\n\n{file.with_suffix('.md').read_text()}" for n, file in known.items()]
    (out / "tables.md").write_text("\n".join(texts))


def check_reports(given: Mapping[str, Path | None]) -> None:
    """Raise `SettingsError` for a given report that is missing or not of its task."""
    for task, path in given.items():
        if path is None:
            continue
        if not path.is_file():
            raise SettingsError(f"{path}: expected a report of fovea eval, got no such file")
        all_tasks.cells_of(task, all_tasks.read_report(path), TARGET)


def reports_of(out: Path, given: Mapping[str, Path | None]) -> dict[str, Path]:
    """Return the report of each task: the one given, this folder's of tracking, the committed ones.

    What is not there is left out.
    """
    known = {"tracking": out / "budgets.json", **REPORTS}
    found = {task: given.get(task) or path for task, path in known.items()}
    return {task: path for task, path in found.items() if path.is_file()}


@click.command(cls=Bench, help=(__doc__ or "").split("\n", 1)[0])
@click.option("--out", type=click.Path(path_type=Path), required=True, help="a folder")
@click.option("--clips", default=30, show_default=True, help="held-out procedural clips")
@click.option("--soccernet", default="", help="a sequence's folder, or a folder of them")
@click.option("--policy", multiple=True, help="as for fovea eval tracking; else the graph's own")
@click.option("--ablation", multiple=True, help="NAME=FILE.onnx of operators.policy.train --use")
@click.option("--far", default="", help="FILE.onnx of a policy for late plans, or pursuit")
@click.option("--tracker", default="", help="as for fovea eval tracking; else the graph's own")
@click.option("--tracking", type=Path, help="of all tasks: another report than the folder's own")
@click.option("--text", type=Path, help="the same of fovea eval text; else the committed report")
@click.option("--manipulation", type=Path, help="the same of fovea eval manipulation")
@click.option("--only", multiple=True, type=click.Choice(list(NAMES)))
@click.option("--quick", is_flag=True, help="one short clip, to try whether everything works")
@click.option("--jobs", default=2, show_default=True)
def main(
    out: Path,
    clips: int,
    soccernet: str,
    policy: tuple[str, ...],
    ablation: tuple[str, ...],
    far: str,
    tracker: str,
    tracking: Path | None,
    text: Path | None,
    manipulation: Path | None,
    only: tuple[str, ...],
    quick: bool,
    jobs: int,
) -> None:
    """See the module."""
    make_folder("out", out)
    wanted = studies(clips, soccernet, ablation, policy, far=far, quick=quick)
    if missing := sorted(set(only) - set(wanted) - set(UNPLANNED)):
        raise click.UsageError(
            f"--only {missing[0]}: needs --soccernet, --ablation or --far; with what is given: "
            f"{', '.join([*wanted, *UNPLANNED])}"
        )
    reports = {"tracking": tracking, "text": text, "manipulation": manipulation}
    check_reports(reports)
    shared = ["--work", f"{out / 'work'}", "--jobs", str(jobs), "--tracker", tracker, "--states"]
    planned = {n: [*words, *shared] for n, words in wanted.items() if not only or n in only}
    check(planned)
    for name, words in planned.items():
        click.echo(f"{NAMES[name]}:", err=True)
        files = {"report": "json", "markdown": "md", "plot": "png"}
        outputs = [f"--{kind}={out / name}.{suffix}" for kind, suffix in files.items()]
        command.main([*words, *outputs], standalone_mode=False)
        together(out)
    if not only or "run-time" in only:
        own = policy_files(policy[:1]).popitem()[1]
        parts = run_time((), tracker=tracker, policy=own)
        crowds = by_objects((), policy=own)
        told = {**facts(), "ms": parts, "ms_by_objects": crowds}
        (out / "run-time.json").write_text(json.dumps(told, indent=1) + "\n")
        (out / "run-time.md").write_text(f"{markdown(parts)}\n{by_objects_markdown(crowds)}")
        together(out)
    if not only or "all-tasks" in only:
        all_tasks.write_table(reports_of(out, reports), TARGET, out)
        together(out)


if __name__ == "__main__":
    main()
