"""`fovea eval tracking`: strategies of acquisition at equal pixel budgets, by a frozen tracker.

Short protocol: a tracker is started on the truth every few frames in which the target is visible,
and followed for at most 64 frames. Long protocol: it is started once and followed to the end of
the clip. A figure is the mean IoU over all frames of all starts in which the target is in the
truth; the frames in which a tracker gets the true box are not scored. For a strategy that leaves
frames out, the frames that it keeps count, as in the paper; the mean over all frames, in which the
last box is kept, is in another column. A strategy with a ROI begins with the ROI on the target and
the target's box as prompt; `centred` stays in the middle.

By default the tracker hears no policy and never gives up, as in the paper. With `--cue reference`
it is the one that ships: it hears a scanpath, gives up what it does not find and starts again on
what the scanpath shows. That is the same for all strategies of a budget: the pursuit rule's, from
the context that a foveated row has. One inequality remains: a tracker with a ROI starts again only
where the ROI shows the object, one without anywhere. The tracker sees the context where the ROI
shows nothing, as in the shipped loop; with `--sees each` a second row is of a tracker that sees the
ROI alone, and with `--sees all` a third one of a tracker whose state is in coordinates of the ROI
and moves with it, which is how the paper's figures read (its oracle beats full resolution, and a
window in the middle is worth 1.7 % of it).
"""

import json
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.text import Text

from bench.machine import facts
from bench.options import MOST_CLIPS, graph_option
from bench.outputs import STANDARD_OUTPUT
from bench.tracking.budgets import acquisition
from bench.tracking.cases import CUES, PROTOCOLS, SEES, Case, Protocol, cases
from bench.tracking.classes import TRACKER, TRACKERS, check_prompted, planned
from bench.tracking.clip import ClipName, frames_of, is_development, names, size_of
from bench.tracking.conclusions import sentences
from bench.tracking.episode import Rules
from bench.tracking.intervals import METHOD
from bench.tracking.many import LOOKS, wanted_of
from bench.tracking.many_clips import scored_clips
from bench.tracking.many_tables import (
    markdown_of_many,
    means_of_many,
    paired_of_many,
    table_of_many,
)
from bench.tracking.metrics import need_trackeval
from bench.tracking.options import ALL, GRAPH, WHOLE, Options, options_of, refuse_too_late
from bench.tracking.plots import plot
from bench.tracking.replaced import PARTS
from bench.tracking.report import Row, paired, rows
from bench.tracking.stages import Stages
from bench.tracking.stock import giver
from bench.tracking.tables import asked_rows, markdown, table
from bench.tracking.units import measured
from pipeline.errors import DriverError, FoveaError
from pipeline.extras import need
from pipeline.whole_file import write_whole

SCENE_FRAMES = 96
FOLLOWS = f"{', '.join(TRACKERS)}, or one of them as NAME=FILE.onnx; else the graph's own"
VIEWS = (
    "the tracker: ROI over context (both), the ROI alone (roi), in coordinates of the ROI as in "
    "the paper (coordinates), a row of both and roi (each), a row of every one (all)"
)
HEARS = "the tracker hears a scanpath, the same in all rows (reference), does not (none), or each"
FOLLOWED = "starts every few frames (short), one to the end of the clip (long), or both"


@click.command(
    help=(__doc__ or "").split("\n", 1)[0],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--data", required=True, help="a SoccerNet sequence, a folder of them, procedural")
@click.option("--frames", default="", help="A-B, counted from 1; of a scene 1-96")
@click.option("--clips", default=30, help=f"procedural clips, up to {MOST_CLIPS}")
@click.option("--strategies", default="all", help="all, or some of " + ",".join(ALL))
@click.option("--budgets", "--budget", default="1/4,1/8,1/16", help="shares of the full pixel rate")
@click.option("--targets", default="ball,referee,player")
@click.option("--players", default=1, help="players of a clip, drawn by the seed")
@click.option("--every", default=8, help="frames between starts")
@click.option("--longest", default=Rules.longest, help="frames for which a start is followed")
@graph_option(GRAPH)
@click.option("--set", "changes", multiple=True, help="node.setting=value of the graph")
@click.option("--tracker", default="", help=FOLLOWS)
@click.option("--sees", default="both", type=click.Choice(list(SEES)), help=VIEWS)
@click.option("--cue", default="none", type=click.Choice(list(CUES)), help=HEARS)
@click.option("--protocol", default="short", type=click.Choice(list(PROTOCOLS)), help=FOLLOWED)
@click.option("--many", is_flag=True, help="HOTA, AssA and IDF1 of the graph's tracks instead")
@click.option("--missed", default=0.0, help="with --many: share of detections left out")
@click.option("--states", is_flag=True, help="rows of the free, still and carried ball, too")
@click.option("--policy", multiple=True, help="[NAME=]FILE.onnx, or pursuit; more give more rows")
@click.option("--delay", default="0", help="frames by which plans come late, e.g. 0,2,13")
@click.option("--replan", default="1", help="Ta: frames between plans, e.g. 1,4,8")
@click.option("--prediction", default="kalman", type=click.Choice(["kalman", "hold", "both"]))
@click.option("--replace", multiple=True, help="part known from the truth: " + ", ".join(PARTS))
@click.option("--jobs", default=2, help="processes")
@click.option("--seed", default=0)
@click.option("--report", type=Path, help="JSON")
@click.option("--markdown", type=Path, help="the table as Markdown; - prints it")
@click.option("--plot", type=Path, help="IoU over budget: PNG, PDF or SVG")
@click.option("--work", type=Path, help="folder for finished units; else beside the report")
def command(**given: Any) -> None:
    """See the module."""
    try:
        evaluate(options_of(given))
    except FoveaError as error:
        click.echo(f"fovea eval tracking: {error}", err=True)
        sys.exit(2)


def evaluate(options: Options) -> None:
    """Measure what is asked for and write it; raises `FoveaError`."""
    if options.plot:
        need("matplotlib", "--plot")
    if options.many:
        need_trackeval("--many")
        score_many(options)
        return
    wanted, protocol, clips = asked(options)
    options.make_room()
    try_out(wanted, protocol)
    units = measured(clips, wanted, protocol, options.folder, jobs=options.jobs)
    if not any(unit["episodes"] for unit in units):
        raise DriverError(
            f"{options.data}: nothing to follow: no {' or '.join(options.targets)} can be seen in "
            "the frames asked for"
        )
    scored = rows(units)
    refuse_unscored(wanted, scored, options)
    seed = protocol.seed
    found = {
        **facts(),
        "graph": Path(protocol.graph).name,
        "tracker": tracker_of(protocol, options),
        "changes": sorted({change for case in wanted for change in case.changes}),
        "policies": sorted({case.policy for case in wanted if case.policy}),
        "weighting": "frames: every frame of every start with truth counts once",
        "longest": options.longest,
        "protocol": options.protocol,
        "cue": options.cue,
        "interval": METHOD,
        "development": [str(clip) for clip in clips if is_development(clip)],
        "targets": list(options.targets),
        "states": options.states,
        "players": protocol.players,
        "clips": [str(clip) for clip in clips],
        "frames": list(protocol.frames),
        "every": protocol.every,
        "budgets": [str(budget) for budget in options.budgets],
        "seed": seed,
        "rows": scored,
        "paired": paired(units, wanted),
    }
    if options.report:
        write_whole(options.report, json.dumps(found, indent=1) + os.linesep)
    if options.plot:
        plot(asked_rows(found), options.plot)
    tell(found, options.markdown)


def refuse_unscored(wanted: Sequence[Case], scored: Sequence[Row], options: Options) -> None:
    """Tell strategies that have a figure in no frame; raises `DriverError` if none has one."""
    known = {(row["strategy"], row["budget"]) for row in scored}
    none = [f"{c.name} at {c.budget}" for c in wanted if (c.name, c.budget) not in known]
    if not none:
        return
    said = f"no frame can be scored of {', '.join(none)}: expected longer clips (--frames)"
    if not known:
        raise DriverError(f"{options.data}: {said}")
    click.echo(f"fovea eval tracking: {said}", err=True)


def score_many(options: Options) -> None:
    """Measure the graph's tracks of all objects and write them; raises `FoveaError`."""
    options, clips = data_of(options)
    wanted, protocol = wanted_of(options), protocol_of(options)
    _refuse_unmet(product(wanted, options.budgets), clips)
    options.make_room()
    rows_of_clips = scored_clips(options, clips, protocol)
    found = {
        **facts(),
        "bench": "many",
        "graph": Path(protocol.graph).name,
        "changes": list(options.changes),
        "clips": [str(clip) for clip in clips],
        "frames": list(protocol.frames),
        "seed": protocol.seed,
        "development": [str(clip) for clip in clips if is_development(clip)],
        "missed": options.missed,
        "interval": METHOD,
        "means": means_of_many(rows_of_clips),
        "paired": paired_of_many(rows_of_clips),
        "rows": rows_of_clips,
    }
    if options.report:
        write_whole(options.report, json.dumps(found, indent=1) + os.linesep)
    shown = rows_of_clips if len(clips) == 1 else found["means"]
    if options.markdown and options.markdown != STANDARD_OUTPUT:
        write_whole(options.markdown, markdown_of_many(shown))
    if options.markdown == STANDARD_OUTPUT:
        click.echo(markdown_of_many(shown))
    else:
        Console().print(table_of_many(shown))


def tell(found: Mapping[str, Any], target: Path | None) -> None:
    """Print the table and conclusions; write Markdown to a file, or print it instead of both."""
    text = markdown(found) if target else ""
    if target == STANDARD_OUTPUT:
        click.echo(text)
        return
    if target:
        write_whole(target, text)
    console = Console()
    console.print(table(found), "", sep="\n")
    for sentence in sentences(found):
        console.print(Text(sentence), soft_wrap=not console.is_terminal)


def asked(options: Options) -> tuple[list[Case], Protocol, list[ClipName]]:
    """Return cases, protocol and clips; raises `FoveaError` before anything is measured."""
    options, clips = data_of(options)
    wanted = cases(options)
    _refuse_unmet(((case.strategy, Fraction(case.budget)) for case in wanted), clips)
    planned(Path(options.graph), options.changes, options.tracker)  # raises without one
    for parts in {case.parts for case in wanted if case.strategy == "foveated"}:
        check_prompted(planned(Path(options.graph), *parts))
    if late := max(options.delay):
        for parts in {case.parts for case in wanted if case.rules.delay}:
            stages = Stages(Path(options.graph), *parts)
            refuse_too_late(late, stages.settings("policy").horizon)
    return wanted, protocol_of(options), clips


def data_of(options: Options) -> tuple[Options, list[ClipName]]:
    """Return the options with the frames that count, and the clips; raises `FoveaError`."""
    clips = names(options.data, options.clips)
    if options.frames == WHOLE and not clips[0].folder:
        options = replace(options, frames=(1, SCENE_FRAMES))
    for clip in clips:
        frames_of(clip, options.frames)  # raises for frames that a clip does not have
    return options, clips


def protocol_of(options: Options) -> Protocol:
    """Return what all rows have in common."""
    return Protocol(
        graph=options.graph,
        frames=options.frames,
        kinds=options.targets,
        every=options.every,
        players=options.players,
        seed=options.seed,
    )


def _refuse_unmet(shares: Iterable[tuple[str, Fraction]], clips: Sequence[ClipName]) -> None:
    """Raise `SettingsError` for a budget that a strategy cannot meet."""
    own = dict.fromkeys(("foveated" if name in LOOKS else name, b) for name, b in shares)
    for (strategy, budget), size_px in product(own, {size_of(clip) for clip in clips}):
        acquisition(strategy, budget, size_px)


def try_out(wanted: Sequence[Case], protocol: Protocol) -> None:
    """Open every graph that is asked for; raises `FoveaError` for a network that does not fit."""
    givers = [giver(case) for case in wanted if case.rules.cue]
    for parts in dict.fromkeys(case.parts for case in (*wanted, *givers)):
        with Stages(Path(protocol.graph), *parts):
            pass


def tracker_of(protocol: Protocol, options: Options) -> str:
    """Return the class of the tracker, and its weights if they were named."""
    node = planned(Path(protocol.graph), options.changes, options.tracker).node(TRACKER)
    weights = node.settings.get("weights", "")
    return f"{node.operator} {weights}".strip()


if __name__ == "__main__":
    command()
