"""The cue that trackers of all strategies hear: tracks of a context -> a scanpath for each frame.

The pursuit rule, with the graph's settings, is prompted with the true box of the first frame and
plans from the tracks of the context that a foveated row of the same budget has, in every frame. So
the cue does not depend on the row that hears it: neither on its strategy, nor on its pictures,
windows, exposures and tracker. The loop's own latency holds for all: in a frame a tracker hears
what was planned one frame before it, or `delay` frames earlier still.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.tracking.stages import Stages
from bench.tracking.targets import Target
from pipeline.messages import Header, Scanpath, Tracks


@dataclass(frozen=True, kw_only=True, eq=False)
class Cue:
    """What the rule plans from one start on."""

    start: int  # the frame of the first plan
    plans: Sequence[Scanpath]  # one a frame

    def heard(self, frame: int, delay: int = 0) -> Scanpath | None:
        """Return the scanpath that a tracker hears in a frame; None: nothing was planned yet.

        Raises `IndexError` for a frame after the last plan has been heard.
        """
        row = frame - 1 - delay - self.start
        return self.plans[row] if row >= 0 else None


def cue_of(
    stages: Stages, tracks: Mapping[int, Tracks], header: Header, target: Target, last: int
) -> Cue:
    """Return the plans for the frames from that of `header` up to `last`.

    The stages' policy is the pursuit rule; `tracks` has those frames. An object that tracks do not
    have is waited for.
    """
    start = header.seq
    prompt: Mapping[str, Any] = {
        "target": "",
        "prompt_box": tuple(float(v) for v in target.boxes[start]),
    }
    stages.begin(header, "policy", policy=prompt)
    frames = range(start, last + 1)
    return Cue(start=start, plans=[stages.call("policy", tracks=tracks[k]) for k in frames])
