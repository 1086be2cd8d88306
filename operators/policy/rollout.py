"""Roll-outs of the policy on recorded clips: its inputs, and the utility of each choice.

A recording contains everything that does not depend on the ROI; a roll-out adds the ROI features
that its windows reveal. It is the loop itself without pictures, with the same observing, deciding
and dispatching, so that the network learns from situations that it causes itself.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from drivers.source import CLASS_OF_ROLE
from operators.dispatch import plan_windows
from operators.policy.data import Recording
from operators.policy.decision import (
    PolicyState,
    Rules,
    Selection,
    decide,
    observe,
    pick,
    with_prior,
    without_candidates,
)
from operators.policy.gaze_plan import GazePlan
from operators.policy.memory import remember
from operators.policy.target import TargetSpec
from operators.policy.tokens import Array, Objects
from operators.policy.utility import UTILITIES
from pipeline import RoiFeatures, Tracks
from pipeline.boxes import centres, covered, roi_window
from pipeline.errors import RunError, SettingsError

INSIDE = 0.5  # share of a box that the ROI must show, as operators.roi_features has it
BY_CLASS = ("ball", "main referee")  # classes with a single object
TARGETS = (*BY_CLASS, "player")  # labels of the truth that episodes follow
MOST_MISSES = 5_000  # draws of a target, one after another, that no clip shows
Choose = Callable[[Sequence[Objects], Sequence[Array]], Sequence[Array]]  # -> (N, Tp) each
Window = tuple[int, int, int, int]


@dataclass(frozen=True, kw_only=True)
class Late:
    """Delays and replanning intervals of half of the episodes; the others have neither."""

    delays: tuple[int, ...] = (1, 2, 4)  # frames
    replans: tuple[int, ...] = (4, 8)  # Ta

    def __post_init__(self) -> None:
        for name, least in (("delays", 0), ("replans", 1)):
            if min(getattr(self, name), default=-1) < least:
                raise SettingsError(
                    f"{name}: expected frames from {least} on, got {getattr(self, name)}"
                )


@dataclass(frozen=True, kw_only=True)
class Task:
    """One episode: clip, first frame, target, prompt and timing."""

    clip: int
    start: int  # frame, counted from 0
    target: int  # id in the truth
    prompt: Literal["box", "class"] = "box"
    replan: int = 1  # Ta
    delay: int = 0  # delay of a plan in frames


@dataclass(frozen=True, kw_only=True, eq=False)
class Sample:
    """One moment of an episode."""

    candidates: Objects
    condition: Array  # (CONDITION,)
    worth: Array  # (N, Tp)


class Episode:
    """One task in progress, frame by frame."""

    def __init__(
        self, recording: Recording, task: Task, rules: Rules, utility: str = "geometric"
    ) -> None:
        self.recording, self.task, self._rules = recording, task, rules
        self._utility = UTILITIES[utility]
        self.label = recording.people_and_ball[task.target]
        self.truth, self.visible = recording.path_of(task.target)
        first = self.truth[task.start]
        if task.prompt == "box":
            left, top, right, bottom = (float(side) for side in first)
            spec = TargetSpec(box=(left, top, right, bottom))
        else:
            spec = TargetSpec(label=CLASS_OF_ROLE[self.label])
        field = recording.geometry
        middle = np.array([field.width_px / 2, field.height_px / 2], np.float32)
        self._window = roi_window(
            centres(first) if task.prompt == "box" else middle, recording.geometry
        )
        self._commanded: dict[int, Window] = {}
        self._planned = -task.replan
        self._state = PolicyState(spec=spec)
        self.frame = task.start
        self.shown: list[float] = []  # share of the target that the ROI showed, frame by frame

    @property
    def over(self) -> bool:
        """Whether the clip has no further frame with a future."""
        return self.frame + 1 >= len(self.recording)

    def look(self) -> tuple[Objects, Array]:
        """Return the candidates and the condition of this frame."""
        moment = self.recording.moment(self.frame)
        self._window = self._commanded.pop(self.frame, self._window)
        if self.visible[self.frame] > 0:
            window = np.array(self._window, np.float32)
            self.shown.append(float(covered(self.truth[self.frame][None], window)[0]))
        self._tracks = moment.tracks
        self._state, self._candidates, condition = observe(self._state, moment.tracks, self._rules)
        # in the loop too the plan is made before this frame's ROI has been encoded
        seen = within(moment.seen, moment.tracks, self._window)
        memory = remember(self._state.memory, seen, moment.tracks.boxes.shape[1])
        self._state = replace(self._state, memory=memory)
        return self._candidates, condition

    def worth(self) -> Array:
        """Return the utility of each candidate: (N, Tp)."""
        horizon = self._candidates.path.shape[1]
        ahead = self.truth[self.frame + 1 : self.frame + 1 + horizon]
        ahead = np.concatenate([ahead, np.zeros((horizon - len(ahead), 4), np.float32)])
        return self._utility(self._candidates.path, ahead, self.recording.geometry)

    def act(self, probability: Array, how: Selection, rng: np.random.Generator) -> None:
        """Look where the policy decides, and advance by one frame."""
        if len(self._candidates.ids):
            probability = with_prior(
                probability, self._candidates, self._state.target, self._rules.target_prior
            )
            picked = pick(probability, how, rng)
            plan, self._state = decide(
                self._state, self._tracks, self._candidates, probability, picked
            )
        else:
            plan = without_candidates(self._state, self._tracks, self._tracks.predicted.shape[1])
        self._dispatch(plan)
        self.frame += 1

    def _dispatch(self, plan: GazePlan) -> None:
        if self.frame - self._planned < self.task.replan:
            return
        self._planned = self.frame
        first = self.frame + 1
        windows = plan_windows(
            plan.boxes, first, self.recording.geometry, fill="hold", held=self._window
        )
        for row in range(self.task.delay, len(windows)):
            left, top, right, bottom = (int(side) for side in windows[row])
            self._commanded[first + row] = (left, top, right, bottom)


def within(seen: RoiFeatures, tracks: Tracks, window: Window) -> RoiFeatures:
    """Return the features of objects inside a ROI at `window`."""
    shares = covered(tracks.boxes[:, -1], np.array(window, np.float32))
    kept = np.isin(seen.ids, tracks.ids[shares >= INSIDE])
    return replace(
        seen, ids=seen.ids[kept], features=seen.features[kept], genuine=seen.genuine[kept]
    )


def roll(
    episodes: Sequence[Episode],
    choose: Choose,
    *,
    frames: int,
    how: Selection,
    rng: np.random.Generator,
    keep: float = 1.0,
) -> list[Sample]:
    """Run all episodes in parallel for `frames` frames; return a share `keep` of the moments.

    Moments without any utility are left out, as they teach nothing.
    """
    samples: list[Sample] = []
    for _ in range(frames):
        running = [episode for episode in episodes if not episode.over]
        if not running:
            break
        moments = [episode.look() for episode in running]
        chances = choose([c for c, _ in moments], [condition for _, condition in moments])
        for episode, moment, probability in zip(running, moments, chances, strict=True):
            candidates, condition = moment
            if len(candidates.ids) and rng.random() < keep:
                worth = episode.worth()
                if worth.any():
                    samples.append(Sample(candidates=candidates, condition=condition, worth=worth))
            episode.act(probability, how, rng)
    return samples


def teacher(episodes: Sequence[Episode], noise: float, rng: np.random.Generator) -> Choose:
    """Return a teacher that knows the truth, except with probability `noise` per frame."""

    def choose(moments: Sequence[Objects], _: Sequence[Array]) -> Sequence[Array]:
        running = [episode for episode in episodes if not episode.over]
        answers = []
        for episode, candidates in zip(running, moments, strict=True):
            worth = episode.worth() + 1e-3 * rng.random((len(candidates.ids), 1))
            if len(candidates.ids) and rng.random() < noise:
                worth = rng.random((len(candidates.ids), 1)) * np.ones_like(worth)
            best = worth == worth.max(0, keepdims=True) if len(worth) else worth
            answers.append(np.asarray(best, np.float32))
        return answers

    return choose


def tasks(
    recordings: Sequence[Recording], count: int, *, frames: int, seed: int, late: Late | None
) -> list[Task]:
    """Return `count` episodes: half of them follow the ball, the others the referee or a player.

    Every episode starts on a visible target. Most prompts are boxes; some for the ball or the
    referee only name the class. `late` sets delays and replanning intervals; with None, all
    prompts are boxes and every frame is planned without delay. Raises `RunError` for clips that
    show no such target.
    """
    rng = np.random.default_rng([seed, 5])
    found: list[Task] = []
    misses = 0
    while len(found) < count:
        if misses == MOST_MISSES:
            labels = {label for clip in recordings for label in clip.people_and_ball.values()}
            raise RunError(
                f"{recordings[0].path.parent}: expected clips in whose first part a "
                f"{', a '.join(TARGETS[:-1])} or a {TARGETS[-1]} is visible, got "
                f"{', '.join(sorted(labels)[:8]) or 'nothing'}; give another scene, or longer clips"
            )
        misses += 1
        clip = int(rng.integers(len(recordings)))
        recording = recordings[clip]
        label = str(rng.choice(TARGETS, p=[0.5, 0.2, 0.3]))
        able = [i for i, own in recording.people_and_ball.items() if own == label]
        if not able:
            continue
        target = int(rng.choice(able))
        _, visible = recording.path_of(target)
        starts = np.flatnonzero(visible[: max(1, len(recording) - frames // 2)] >= INSIDE)
        if not len(starts):
            continue
        start, misses = int(rng.choice(starts)), 0
        if late is None:
            found.append(Task(clip=clip, start=start, target=target))
            continue
        by_class = label in BY_CLASS and rng.random() < 0.3
        found.append(
            Task(
                clip=clip,
                start=start,
                target=target,
                prompt="class" if by_class else "box",
                replan=1 if rng.random() < 0.5 else int(rng.choice(late.replans)),
                delay=0 if rng.random() < 0.5 else int(rng.choice(late.delays)),
            )
        )
    return found
