"""The work of an evaluation, cut into units that are written as they are done: cases x clips."""

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, wait
from dataclasses import asdict, replace
from fractions import Fraction
from hashlib import sha256
from pathlib import Path
from time import monotonic
from typing import Any

import cv2
from tqdm import tqdm

from bench.tracking.budgets import acquisition
from bench.tracking.cases import Case, Protocol
from bench.tracking.clip import ClipName, read
from bench.tracking.episode import Loop, run
from bench.tracking.replaced import Replaced
from bench.tracking.stages import NEEDED, Camera, Stages, watched
from bench.tracking.targets import Target, starts, targets
from drivers.simulated.readout import Window
from operators.training.workers import pool_of
from pipeline.fleet.allow import code_digest, file_digest
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Node
from pipeline.messages import Geometry, Tracks

LOOK_S = 1.0  # between looks at what is done
KEEP_S = 20.0  # between writings of a unit that is not finished: what an interruption may cost
PLANNED = ("foveated", "round_robin")  # by the graph's own networks; the others need none of them
OPERATORS = Path(__file__).parents[2] / "operators"
CODE = (  # what figures come from, beside the operators that a case needs
    *("drivers", "pipeline.boxes", "pipeline.inference", "pipeline.messages"),
    *(f"bench.tracking.{name}" for name in ("budgets", "clip", "episode", "replaced")),
    *(f"bench.tracking.{name}" for name in ("stages", "targets", "units")),
)


Gazes = dict[tuple[int, int], Sequence[Window]]  # by target and start, exposure by exposure
Episode = dict[str, Any]  # start, iou, kept, shown, state, read_px, full_px
Unit = dict[str, Any]  # clip, case, target, kind, episodes


def measured(
    clips: Sequence[ClipName],
    cases: Sequence[Case],
    protocol: Protocol,
    folder: Path,
    *,
    jobs: int,
) -> list[Unit]:
    """All units, from the folder where they are known, from work where they are not."""
    folder.mkdir(parents=True, exist_ok=True)
    keys = [key(case, protocol) for case in cases]
    places = {clip: [_place(folder, clip, told) for told in keys] for clip in clips}
    with (
        pool_of(jobs) as pool,
        tqdm(total=len(clips) * len(cases), desc="units", unit="unit", smoothing=0) as bar,
    ):
        bar.initial = _finished(places)
        waiting = {
            pool.submit(_measure, clip, tuple(cases), protocol, tuple(paths))
            for clip, paths in places.items()
            if not all(path.exists() for path in paths)
        }
        while waiting:
            done, waiting = wait(waiting, timeout=LOOK_S, return_when=FIRST_EXCEPTION)
            for job in done:
                job.result()
            bar.n = _finished(places)
            bar.refresh()
    return [unit for paths in places.values() for path in paths for unit in _units(path)]


def _finished(places: Mapping[ClipName, Sequence[Path]]) -> int:
    return sum(path.exists() for paths in places.values() for path in paths)


def _units(path: Path) -> list[Unit]:
    found: list[Unit] = json.loads(path.read_text())
    return found


def _measure(
    clip_name: ClipName, cases: Sequence[Case], protocol: Protocol, paths: Sequence[Path]
) -> None:
    """All cases of one clip, each written when it is done."""
    cv2.setNumThreads(1)
    clip = read(clip_name, protocol.frames)
    seed = protocol.seed + max(clip_name.seed, 0)
    subjects = targets(clip.truths, protocol.kinds, players=protocol.players, seed=seed)
    seen: dict[tuple[tuple[int, int], Geometry, bool], list[Tracks]] = {}
    looked: dict[Case, Gazes] = {}
    for changes in sorted({case.changes for case in cases}):
        with Stages(Path(protocol.graph), changes) as stages:
            for case, path in zip(cases, paths, strict=True):
                if case.changes != changes or path.exists():
                    continue
                how = acquisition(case.strategy, Fraction(case.budget), clip.size_px)
                camera = Camera(clip, how)
                replaced = Replaced(parts=frozenset(case.replaced), truths=clip.truths)
                # tracks carry the geometry of the ROI, by which the graph plans its windows
                context = (how.sampling.context_px, how.geometry, "detections" in replaced.parts)
                if case.strategy in PLANNED and context not in seen:
                    seen[context] = watched(camera, stages, len(clip.truths), replaced)
                gaze = looked.setdefault(_same_gaze(case), {})
                draft = Draft(path.with_suffix(".part"))
                loop = Loop(
                    camera=camera,
                    stages=stages,
                    tracks=seen.get(context, ()),
                    rules=case.rules,
                    replaced=replaced,
                )
                done = [_followed(loop, target, protocol.every, gaze, draft) for target in subjects]
                for unit in done:
                    unit |= {"clip": str(clip_name), "case": case.name, "budget": case.budget}
                draft.finish(done, path)


def _followed(loop: Loop, target: Target, every: int, gaze: Gazes, draft: "Draft") -> Unit:
    episodes = []
    for start in starts(target, every):
        if episode := draft.known(target.id, start):
            episodes.append(episode)
            continue
        outcome = run(loop, target, start, gaze.get((target.id, start), ()))
        gaze[target.id, start] = outcome.windows
        if outcome.iou:
            episode = {
                "start": start,
                "iou": [round(v, 4) if v == v else None for v in outcome.iou],
                "kept": outcome.kept,
                "shown": [round(v, 3) if v == v else None for v in outcome.shown],
                "state": list(target.state[start + 1 : start + 1 + len(outcome.iou)]),
                "read_px": outcome.read_px,
                "full_px": outcome.full_px,
            }
            episodes.append(episode)
            draft.add(target.id, episode)
    return {"target": target.id, "kind": target.kind, "episodes": episodes}


class Draft:
    """The episodes of a unit that is not finished, in a file beside it."""

    def __init__(self, path: Path) -> None:
        self._path, self._written_s = path, monotonic()
        self._episodes: dict[str, Episode] = {}
        if path.exists():
            self._episodes = json.loads(path.read_text())

    def known(self, target: int, start: int) -> Episode | None:
        """What an interrupted run found out about a start; None: nothing."""
        return self._episodes.get(f"{target} {start}")

    def add(self, target: int, episode: Episode) -> None:
        """Take one in, and write all of them now and then."""
        self._episodes[f"{target} {episode['start']}"] = episode
        if monotonic() - self._written_s >= KEEP_S:
            _write(self._path, self._episodes)
            self._written_s = monotonic()

    def finish(self, done: Sequence[Unit], path: Path) -> None:
        """Write the finished unit; what was kept of it is needed no more."""
        _write(path, done)
        self._path.unlink(missing_ok=True)


def _write(path: Path, content: Any) -> None:
    """Whole or not at all."""
    unfinished = path.with_suffix(f"{path.suffix}.new")
    unfinished.write_text(json.dumps(content))
    unfinished.rename(path)


def _same_gaze(case: Case) -> Case:
    """What cases have in common whose ROI is at the same places."""
    return replace(case, name="", rules=replace(case.rules, context=True))


def key(case: Case, protocol: Protocol) -> str:
    """Tells units of a clip apart: all that their figures come from, by content.

    Other settings, networks or code make another key, as far as the case needs the parts: a
    strategy that plans nothing needs the tracker alone.
    """
    plan = load(Path(protocol.graph), Overlay(changes=case.changes, clock="lockstep"))
    wanted = NEEDED if case.strategy in PLANNED else ("tracker",)
    nodes = [node for node in plan.nodes if node.name in wanted]
    parts = [
        [node.name, node.settings, code_digest(node.operator), *_networks(node)] for node in nodes
    ]
    code = [code_digest(module) for module in CODE]
    common = asdict(replace(protocol, graph=""))  # of the graph, its parts count
    whole = [asdict(case), common, code, parts, file_digest(OPERATORS / "weights.toml")]
    return json.dumps(whole, sort_keys=True, default=str)


def _networks(node: Node) -> list[str]:
    """Digests of the networks that lie beside a part's code, and of those its settings name."""
    folder = OPERATORS / Path(*node.operator.partition(":")[0].split(".")[1:])
    named = [Path(v) for v in node.settings.values() if isinstance(v, str) and v.endswith(".onnx")]
    files = [*sorted(folder.glob("*.onnx")), *(path for path in named if path.is_file())]
    return [file_digest(path) for path in files]


def _place(folder: Path, clip: ClipName, key: str) -> Path:
    """Where a unit is kept."""
    digest = sha256(f"{key} {clip.seed} {clip.folder}".encode()).hexdigest()
    return folder / f"{clip}-{digest[:16]}.json"
