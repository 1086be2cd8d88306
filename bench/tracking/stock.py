"""What the cases of one clip use jointly, each made once: stages, pictures, tracks and cues."""

from collections import OrderedDict
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

from bench.tracking.budgets import PLANNED, PURSUIT, acquisition
from bench.tracking.camera import Camera, Kept
from bench.tracking.cases import Case
from bench.tracking.clip import Clip
from bench.tracking.cue import Cue, cue_of
from bench.tracking.episode import Loop, Rules
from bench.tracking.key import contents
from bench.tracking.replaced import Replaced
from bench.tracking.sight import PERCEPTION, watched
from bench.tracking.stages import KITS, Stages
from bench.tracking.targets import Target
from pipeline.messages import Tracks

MOST_PLANS = 40_000  # of the cues that are kept; of one with 25 objects about 3 kB


class Stock:
    """Use it as a context manager; nothing is opened or made before it is asked for."""

    def __init__(self, clip: Clip, graph: Path) -> None:
        self.clip = clip
        self._graph = graph
        self._kept = Kept()
        self._stages: dict[tuple[tuple[str, ...], str, str], Stages] = {}
        self._open = ExitStack()
        self._tracks: dict[object, Mapping[int, Tracks]] = {}
        self._cues: OrderedDict[object, Cue] = OrderedDict()

    def __enter__(self) -> "Stock":
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def loop(self, case: Case) -> Loop:
        """Return what a case's episodes run in, with the tracks that it plans by, without a cue."""
        parts = case.parts
        if parts not in self._stages:
            self._stages[parts] = self._open.enter_context(Stages(self._graph, *parts))
        how = acquisition(case.strategy, Fraction(case.budget), self.clip.size_px)
        loop = Loop(
            camera=Camera(self.clip, how, self._kept),
            stages=self._stages[parts],
            rules=case.rules,
            replaced=Replaced(parts=frozenset(case.replaced), truths=self.clip.truths),
        )
        if case.strategy not in PLANNED:
            return loop
        # changes may affect any stage; tracks carry the geometry of the ROI, by which a policy
        # plans, and not its place
        seen = contents(loop.stages.plan, (*PERCEPTION, KITS))
        key = (seen, how.sampling.context_px, how.geometry, "detections" in case.replaced)
        if key not in self._tracks:
            frames = len(self.clip.truths)
            self._tracks[key] = watched(loop.camera, loop.stages, frames, loop.replaced)
        return replace(loop, tracks=self._tracks[key])

    def cue(self, case: Case, target: Target, start: int) -> Cue | None:
        """Return the cue of a start, of whatever strategy the case is; None: it has none."""
        if not case.rules.cue:
            return None
        last = case.rules.last(start, len(self.clip.truths))
        key = (case.changes, case.budget, target.id, start, last)
        if key not in self._cues:
            loop = self.loop(giver(case))
            header = loop.camera.header(start)
            self._cues[key] = cue_of(loop.stages, loop.tracks, header, target, last)
            while sum(len(each.plans) for each in self._cues.values()) > MOST_PLANS:
                self._cues.popitem(last=False)
        return self._cues[key]


def giver(case: Case) -> Case:
    """Return the case whose context, tracks and policy give a case its cue.

    It is the pursuit rule of the budget, whatever the strategy, the policy, the late plans and the
    parts known from the truth of the case are.
    """
    return Case(
        strategy="foveated",
        budget=case.budget,
        name="",
        rules=Rules(),
        changes=case.changes,
        tracker=case.tracker,
        policy=PURSUIT,
    )
