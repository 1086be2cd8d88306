"""Roll-outs of the policy that reads, on recorded clips: its inputs, and what each choice reads.

As in `rollout.py`, it is the loop without pictures, with the same observing and deciding. What a
window shows is read by the simulated reader, and what was read returns to the policy.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from operators.policy.decision import Selection, pick
from operators.policy.memory import remember
from operators.policy.reading.decision import observe, plan_of
from operators.policy.reading.inputs import at_first, noted_reading, planned, shown_window
from operators.policy.reading.street import SimulatedReader, Street
from operators.policy.reading.tokens import Texts
from operators.policy.reading.utility import marginal
from operators.policy.rollout import Late, within
from operators.policy.tokens import Array
from operators.policy.utility import windows
from pipeline.boxes import roi_window

NOTHING = np.zeros((0, 0, 0), np.float32), np.zeros(0, np.float32)
SURE = 0.8  # as the settings of the policies have it
Choose = Callable[[Sequence[Texts], Sequence[Array]], Sequence[Array]]  # -> (N, Tp) each


@dataclass(frozen=True, kw_only=True)
class Task:
    """One episode: clip, first frame, timing, and the reader's luck."""

    clip: int
    start: int  # frame, counted from 0
    replan: int = 1  # Ta
    delay: int = 0  # delay of a plan in frames
    seed: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Sample:
    """One moment of an episode."""

    candidates: Texts
    condition: Array  # (CONDITION,)
    reads: Array  # (N, J, Tp) chance that the candidate's window reads a text not yet read
    left: Array  # (J,) chance that the text is still to be read when the plan takes effect
    worth: Array  # (N, Tp) what the candidate adds to the greedy plan


class Episode:
    """One task in progress, frame by frame."""

    def __init__(self, street: Street, task: Task, roi_channels: int, sure: float = SURE) -> None:
        self.street, self.task = street, task
        self._channels, self._sure = roi_channels, sure
        self.reader = SimulatedReader(street, task.seed)
        self.frame, self._state = task.start, at_first()
        field = street.geometry
        middle = np.array([field.width_px / 2, field.height_px / 2], np.float32)
        self._window: Array = np.array(roi_window(middle, field), np.float32)
        self._commanded: dict[int, Array] = {}
        self._planned = -task.replan

    @property
    def over(self) -> bool:
        """Whether the clip has no further frame with a future."""
        return self.frame + 1 >= len(self.street)

    def look(self) -> tuple[Texts, Array]:
        """Return the candidates and the condition of this frame."""
        self._moment = self.street.moment(self.frame)
        self._window = self._commanded.pop(self.frame, self._window)
        self._state, self._candidates, condition = observe(
            self._state,
            self._moment.tracks,
            sure=self._sure,
            delay=self.task.delay,
            roi_channels=self._channels,
        )
        return self._candidates, condition

    def reads(self) -> tuple[Array, Array]:
        """Return the chance that each candidate's window reads each unread text: (N, J, Tp).

        And the chance (J,) that no window that is commanded already reads the text.
        """
        path = self._candidates.path
        ahead = slice(self.frame + 1, self.frame + 1 + path.shape[1])
        steps = len(self.street.boxes[ahead])
        found = np.zeros((len(path), len(self.street.ids), path.shape[1]), np.float32)
        shown = windows(path[:, :steps], self.street.geometry)
        found[:, :, :steps] = self.street.shown(shown, ahead)
        found[:, :, : self.task.delay] = 0
        left = np.ones(len(self.street.ids), np.float32)
        for frame in range(self.frame, min(self.frame + 1 + self.task.delay, len(self.street))):
            window = self._commanded.get(frame, self._window)
            shows = self.street.shown(window[None, None], slice(frame, frame + 1))
            left = left * (1 - shows[0, :, 0])
        able = ~self.reader.read & found.any((0, 2))
        return found[:, able], left[able]

    def act(self, probability: Array, how: Selection, rng: np.random.Generator) -> None:
        """Look where the policy decides, read what this frame's window shows, and advance."""
        tracks, seq = self._moment.tracks, self._moment.tracks.header.seq
        plan = plan_of(tracks, self._candidates, probability, pick(probability, how, rng))
        self._state = planned(self._state, tracks, plan.boxes, self.task.delay)
        if self.frame - self._planned >= self.task.replan:
            self._planned = self.frame
            for row in range(self.task.delay, len(plan.boxes)):
                self._commanded[self.frame + 1 + row] = self._state.planned[row]
        window = tuple(int(side) for side in self._window)
        seen = within(self._moment.seen, tracks, window)  # type: ignore[arg-type]
        memory = remember(self._state.memory, seen, tracks.boxes.shape[1])
        state = shown_window(replace(self._state, memory=memory), self._window, seq)
        self._state = noted_reading(state, self.reader.look(self._window, self.frame))
        self.frame += 1


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

    Moments in which nothing can be read are left out, as they teach nothing.
    """
    samples: list[Sample] = []
    for _ in range(frames):
        running = [episode for episode in episodes if not episode.over]
        if not running:
            break
        moments = [episode.look() for episode in running]
        chances = choose([c for c, _ in moments], [condition for _, condition in moments])
        for episode, (candidates, condition), probability in zip(
            running, moments, chances, strict=True
        ):
            reads, left = episode.reads() if rng.random() < keep else NOTHING
            if reads.size:
                half = replace(
                    candidates,
                    roi=candidates.roi.astype(np.float16),
                    context=candidates.context.astype(np.float16),
                )
                worth = marginal(reads, left)
                samples.append(
                    Sample(
                        candidates=half, condition=condition, reads=reads, left=left, worth=worth
                    )
                )
            episode.act(probability, how, rng)
    return samples


def teacher(episodes: Sequence[Episode], noise: float, rng: np.random.Generator) -> Choose:
    """Return a teacher that knows the truth, except with probability `noise` per frame."""

    def choose(moments: Sequence[Texts], _: Sequence[Array]) -> Sequence[Array]:
        running = [episode for episode in episodes if not episode.over]
        answers = []
        for episode, candidates in zip(running, moments, strict=True):
            steps = candidates.path.shape[1]
            worth = marginal(*episode.reads()) + 1e-3 * rng.random((len(candidates.ids), steps))
            if rng.random() < noise:
                worth = np.repeat(rng.random((len(candidates.ids), 1)), steps, 1)
            answers.append((worth == worth.max(0, keepdims=True)).astype(np.float32))
        return answers

    return choose


def tasks(
    clips: Sequence[Street], count: int, *, frames: int, seed: int, late: Late | None
) -> list[Task]:
    """Return `count` episodes; `late` sets delays and replanning intervals of half of them."""
    rng = np.random.default_rng([seed, 7])
    found = []
    for number in range(count):
        clip = int(rng.integers(len(clips)))
        start = int(rng.integers(max(1, len(clips[clip]) - frames + 1)))
        replan, delay = 1, 0
        if late is not None:
            replan = int(rng.choice(late.replans)) if rng.random() < 0.5 else 1
            delay = int(rng.choice(late.delays)) if rng.random() < 0.5 else 0
        luck = seed * 10_000 + number
        found.append(Task(clip=clip, start=start, replan=replan, delay=delay, seed=luck))
    return found
