"""Every object of the prototype's world as the target in turn: prompts by box, shares by object."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.prototype_cycles import Cycle, Recording, shares
from bench.prototype_run import Ask
from drivers.source import CLASS_OF_ROLE, FrameSource

PREVIEW_FRAMES = 4  # from one preview to the next: 7.5 a second of 30 exposures
SHOWN = 0.5  # share inside the ROI, mean of a burst, from which the burst shows an object


@dataclass(kw_only=True)
class Prompter:
    """Prompts the policy with another object's box in every cycle, each object `each` times.

    The box is the true one in the preview that comes next, as a person's who points at what moves.
    It is repeated as long as the policy has found no object there. The first cycle, which is left
    out, has the first object.
    """

    world: FrameSource
    objects: Sequence[int]  # ids in the world's truth
    each: int
    asked: list[tuple[int, int]] = field(default_factory=list)  # preview, object
    _bursts: int = -1  # when the target was changed last
    _locked: bool = False

    def watch(self, recording: Recording, ask: Ask) -> None:
        """Prompt where it is due."""
        newest, aim = recording.newest_preview, recording.newest_aim
        if newest < 0 or recording.recording:
            return
        if recording.bursts != self._bursts:
            self._bursts, self._locked = recording.bursts, False
        elif self._locked or aim <= self.asked[-1][0]:  # one more: that one's may have come before
            return
        elif recording.aimed_at >= 0:
            self._locked = True
            return
        own, at = self.object_of(recording.bursts), newest + PREVIEW_FRAMES
        truth = self.world.truth(at)
        if truth is None or own not in truth.ids:
            return
        box = [float(side) for side in truth.boxes[list(truth.ids).index(own)]]
        self.asked.append((at, own))
        ask({"target": "", "prompt_box": box})

    def object_of(self, bursts: int) -> int:
        """Return the object of the cycle after so many bursts; the first cycle is left out."""
        return self.objects[min(max(bursts - 1, 0) // self.each, len(self.objects) - 1)]

    def target_of(self, cycle: Cycle) -> int:
        """Return the object of the last prompt before a cycle's plan, -1: none."""
        before = [own for at, own in self.asked if at <= cycle.made_from]
        return before[-1] if before else -1


def objects_of(world: FrameSource) -> dict[int, str]:
    """Return the class of each of the world's objects by id; empty where the truth is unknown."""
    truth = world.truth(0)
    if truth is None:
        return {}
    names = [CLASS_OF_ROLE.get(label, label) for label in truth.labels]
    return {int(own): name for own, name in zip(truth.ids, names, strict=True)}


def class_rows(inside: Mapping[str, Sequence[Mapping[str, float]]]) -> list[dict[str, Any]]:
    """Return a row for each object of each target's class: its share in bursts that follow it.

    `inside` are the shares of every cycle by target.
    """
    found: dict[str, list[float]] = {}
    for target, cycles in inside.items():
        for name, share in (pair for cycle in cycles for pair in cycle.items()):
            if name.startswith(f"{target} "):
                found.setdefault(name, []).append(share)
    by_id = sorted(found, key=lambda name: int(name.rsplit(" ", 1)[1]))
    return [object_row(name, found[name]) for name in by_id]


def prompt_rows(
    prompter: Prompter, cycles: Iterable[Cycle], world: FrameSource
) -> list[dict[str, Any]]:
    """Return a row for each object that was prompted: its own share in the bursts after it."""
    found: dict[int, list[float]] = {}
    names = objects_of(world)
    for cycle in cycles:
        if (own := prompter.target_of(cycle)) in names:
            found.setdefault(own, []).append(shares(cycle, world)[f"{names[own]} {own}"])
    return [object_row(f"{names[own]} {own}", found[own]) for own in sorted(found)]


def object_row(name: str, inside: Sequence[float]) -> dict[str, Any]:
    """Return mean, least and greatest of an object's share over bursts, and how many showed it.

    >>> object_row("ball 1", [1.0, 0.5, 0.0])
    {'object': 'ball 1', 'mean': 0.5, 'min': 0.0, 'max': 1.0, 'bursts that show it': 2, 'bursts': 3}
    """
    values = np.array(inside)
    mean, low, high = np.round([values.mean(), values.min(), values.max()], 3).tolist()
    return {
        "object": name, "mean": mean, "min": low, "max": high,
        "bursts that show it": int((values >= SHOWN).sum()), "bursts": len(values),
    }  # fmt: skip
