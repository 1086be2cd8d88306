"""`fovea tune`: threads and providers that keep a graph's rate with the least processor time."""

import os
import shlex
from collections.abc import Mapping
from dataclasses import asdict
from math import floor
from pathlib import Path
from typing import Any

import click
import msgspec
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from pipeline import terminal
from pipeline.cli.arguments import JSON, Finite, print_json
from pipeline.cli.files import try_report, write_text
from pipeline.cli.overlaid import GRAPH, load_overlaid, overlaid
from pipeline.cli.running import built_settings
from pipeline.cores import available_cores
from pipeline.errors import RunError, SettingsError
from pipeline.graph.overlay import read_settings
from pipeline.graph.plan import Plan
from pipeline.inference import available
from pipeline.planner.machine import this_machine
from pipeline.planner.planner import examine
from pipeline.planner.thread_plan import Choice, Way, choose_all, cores_needed
from pipeline.providers import AUTO, CPU, NOT_AUTOMATIC
from pipeline.run.stage_times import Recorded, record, replayed, tunable

MOST_THREADS = 16
LIMIT_S = 60.0  # of recording
HEAD = ["node", "now", "ms", "CPU ms", "proposed", "ms", "CPU ms", "in time"]
console = terminal.console()


@click.command()
@GRAPH
@overlaid
@click.option("--rate", "rate_hz", type=Finite(0.1, 10_000), help="Hz; else the source's.")
@click.option("--frames", default=40, show_default=True, type=click.IntRange(5, 1000))
@click.option("--threads", type=click.IntRange(1, MOST_THREADS), help="Try 1 to so many.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write settings here.")
@JSON
def tune(
    graph: Path, rate_hz: float | None, frames: int, threads: int | None, out: Path | None,
    as_json: bool, **laid: Any,
) -> None:  # fmt: skip
    """Measure each network with more threads and other providers; propose the cheapest settings."""
    if out:
        try_report(out, "--out")
    plan, given = load_overlaid(graph, **laid), laid.pop("settings")
    rate = rate_hz or rate_of(plan)
    most = threads or min(MOST_THREADS, max(1, floor(available_cores())))
    choices, others_ms = measured(plan, rate, frames, most)
    needed, cores = cores_needed(others_ms, choices, rate), available_cores()
    settings = changes_of(choices)
    if out:
        whole = yaml_of(with_given(settings, given), plan.name, rate)
        unwritten = write_text(out, whole, "--out")
        if unwritten:
            raise RunError(unwritten)
    if as_json:
        print_json({
            "graph": plan.name, "rate_hz": rate, "cores": cores, "cores_needed": round(needed, 3),
            "others_cpu_ms": round(others_ms, 3), "settings": settings,
            "nodes": {name: asdict(choice) for name, choice in choices.items()},
        })  # fmt: skip
        return
    console.print(table_of(choices, rate))
    for sentence in verdict(choices, rate, needed, cores):
        console.print(sentence)
    if out:
        _print_whole(f"{out}: {command_with(graph, out, **laid)}")
    elif settings:
        told = [f"{node}.{k}={v}" for node, each in settings.items() for k, v in each.items()]
        _print_whole("to have it: " + shlex.join(word for each in told for word in ("--set", each)))


def with_given(
    settings: Mapping[str, Mapping[str, Any]], given: Path | None
) -> dict[str, dict[str, Any]]:
    """Return settings by node, beside those of a file that `--settings` gave."""
    found: dict[str, dict[str, Any]] = {}
    for node, name, value in read_settings(given) if given else ():
        found.setdefault(node, {})[name] = value
    for node, each in settings.items():
        found[node] = {**found.get(node, {}), **each}
    return found


def command_with(
    graph: Path, out: Path, *, source: Path | None, changes: tuple[str, ...], clock: str | None,
    wanted: tuple[str, ...],
) -> str:  # fmt: skip
    """Return the command that runs the graph as it was tuned, for a shell."""
    words = ["fovea", "run", str(graph), *(["--source", str(source)] if source else [])]
    words += [word for change in changes for word in ("--set", change)]
    words += [word for node in wanted for word in ("--with", node)]
    words += ["--clock", clock] if clock else []
    return shlex.join([*words, "--settings", str(out)])


def _print_whole(text: str) -> None:
    """Print a command to be copied: a line of its own, however narrow the terminal is."""
    console.print(Text(text), soft_wrap=True)


def rate_of(plan: Plan) -> float:
    """Return the rate of the plan's source; raises `SettingsError` where it is not known."""
    found = examine(plan, built_settings(plan), this_machine())
    rates = [stream.rate_hz for stream in found.streams if stream.made and stream.rate_hz]
    if not rates:
        raise SettingsError(f"{plan.name}: its source tells no rate before it runs: give --rate")
    return max(rates)


def measured(
    plan: Plan, rate_hz: float, frames: int, most_threads: int
) -> tuple[dict[str, Choice], float]:
    """Return a choice by node, and the processor time of everything else, ms a frame."""
    nodes = tunable(plan)
    if not nodes:
        raise RunError(f"{plan.name}: expected a node with a setting `threads`, got none")
    jobs = {name: ways_of(settings, most_threads) for name, settings in nodes.items()}
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()
    with Progress(*columns, console=terminal.console(stderr=True), transient=True) as shown:
        task = shown.add_task("run the graph", total=frames)
        kept = record(plan, nodes, frames, LIMIT_S, lambda: shown.advance(task))
        task = shown.add_task("measure", total=sum(len(ways) for ways in jobs.values()))
        found: dict[str, tuple[Way, list[Way]]] = {}
        for name, ways in jobs.items():
            shown.update(task, description=name)
            own = nodes[name]
            provider = getattr(own, "provider", "")
            now = _measured(plan, kept, name, {}, own.threads, provider)
            others = []
            for number, settings in ways:
                other = settings.get("provider", provider)
                others.append(_measured(plan, kept, name, settings, number, other))
                shown.advance(task)
            found[name] = (now, others)
    others_ms = max(0.0, kept.cpu_ms - sum(now.cpu_ms for now, _others in found.values()))
    return choose_all(found, others_ms, rate_hz, available_cores()), others_ms


def ways_of(settings: Any, most_threads: int) -> list[tuple[int, dict[str, Any]]]:
    """Return what to try: numbers of threads of the CPU, and each other provider that is here."""
    provider = getattr(settings, "provider", "")
    on_cpu = {"provider": CPU} if provider not in ("", AUTO, CPU) else {}
    found: list[tuple[int, dict[str, Any]]] = [
        (number, {"threads": number, **on_cpu}) for number in range(1, most_threads + 1)
        if number != settings.threads or on_cpu
    ]  # fmt: skip
    if provider:
        here = [name for name in available() if name != CPU and name != provider]
        automatic = here if provider != AUTO else [n for n in here if n in NOT_AUTOMATIC]
        found += [(settings.threads, {"provider": name}) for name in automatic]
    return found


def _measured(
    plan: Plan, kept: Recorded, name: str, settings: dict[str, Any], threads: int, provider: str
) -> Way:
    took = replayed(plan.node(name), settings, kept.calls[name])
    return Way(threads=threads, provider=provider, wall_ms=took.wall_ms, cpu_ms=took.cpu_ms)


def changes_of(choices: dict[str, Choice]) -> dict[str, dict[str, Any]]:
    """Return the settings to change, by node."""
    found: dict[str, dict[str, Any]] = {}
    for name, choice in choices.items():
        if choice.changed:
            found[name] = {"threads": choice.chosen.threads}
            if choice.chosen.provider and choice.chosen.provider != choice.now.provider:
                found[name]["provider"] = choice.chosen.provider
    return found


def yaml_of(settings: dict[str, dict[str, Any]], graph: str, rate_hz: float) -> str:
    """Return the settings as `fovea run --settings FILE` takes them; JSON values are YAML, too."""
    lines = [f"# fovea tune {graph}, {rate_hz:g} Hz, {os.cpu_count()} cores"]
    lines += [f"{node}: {msgspec.json.encode(each).decode()}" for node, each in settings.items()]
    return "\n".join([*lines, "" if settings else "{}\n"])


def table_of(choices: dict[str, Choice], rate_hz: float) -> Table:
    """Return the table: before and after by node."""
    found = Table(*HEAD, title=f"{1000 / rate_hz:.1f} ms between frames")
    for name, choice in choices.items():
        now, new = choice.now, choice.chosen
        rest = [new.told, f"{new.wall_ms:.1f}", f"{new.cpu_ms:.1f}"] if choice.changed else [""] * 3
        in_time = "yes" if choice.in_time else "no"
        found.add_row(name, now.told, f"{now.wall_ms:.1f}", f"{now.cpu_ms:.1f}", *rest, in_time)
    return found


def verdict(choices: dict[str, Choice], rate_hz: float, needed: float, cores: float) -> list[str]:
    """Return sentences: what is too slow, and whether the cores suffice."""
    late = [name for name, choice in choices.items() if not choice.in_time]
    none = "too slow for" if needed > cores else "no way answers within"
    found = [f"{name}: {none} {1000 / rate_hz:.1f} ms" for name in late]
    fits = "enough" if needed <= cores else "too few"
    found.append(f"a frame's work keeps {needed:.2f} of {cores:g} cores busy: {fits}")
    if (load := os.getloadavg()[0]) > 1:
        found.append(
            f"other work ran on this machine (load {load:.1f}): its times are longer for it"
        )
    if not any(choice.changed for choice in choices.values()):
        found.append("nothing to change: the graph has the cheapest settings that were tried")
    return found
