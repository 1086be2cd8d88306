"""A rule that reads: Tracks and what was read -> the windows that promise most new readings.

A track promises the more, the larger its text is than it was when it was last shown, and the longer
ago that was. One window may show several texts. What was read is verified while nothing else is to
be read, as a reader is sure of wrong readings, too. While no track promises anything, the whole
field is searched for texts that the detector misses in the context.
"""

from dataclasses import dataclass

import numpy as np

from operators.policy.gaze_plan import PLACE, GazePlan, future, scanpath
from operators.policy.looks import Looks
from operators.policy.readability import chances, heights
from operators.policy.reading.gain import RETRY, SEARCH, VERIFY, gains
from operators.policy.reading.inputs import (
    TextPolicy,
    TextPolicySettings,
    brought_up,
    planned,
)
from operators.policy.reading.windows import around
from operators.policy.search import search
from pipeline import Scanpath, SettingsError, Tracks
from pipeline.boxes import Array, from_centres


@dataclass(frozen=True, kw_only=True)
class GreedyReadingPolicySettings(TextPolicySettings):
    """What a graph may set."""

    retry: float = RETRY  # gain of a second look after MOST_AGE frames, of that of the first
    verify: float = VERIFY  # gain of a text that was read, of that of one that was not
    least_gain: float = SEARCH  # below it, the field is searched instead

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("retry", "verify", "least_gain"):
            if not 0 <= getattr(self, name) <= 1:
                raise SettingsError(f"{name}: expected 0 to 1, got {getattr(self, name)}")


class GreedyReadingPolicy(TextPolicy[GreedyReadingPolicySettings]):
    """Plans are windows, not texts; the probability of a track is its share of the gain."""

    def on_tracks(self, tracks: Tracks) -> Scanpath:
        """Plan the frames after this one."""
        s = self.settings
        state, looks = brought_up(self._state, tracks, s.delay)
        plan = greedy_plan(tracks, looks, s)
        self._state = planned(state, tracks, plan.boxes, s.delay)
        return scanpath(tracks, plan)


def greedy_plan(tracks: Tracks, looks: Looks, s: GreedyReadingPolicySettings) -> GazePlan:
    """Return the plan; each of its frames counts what the frames before it will have shown.

    The first `delay` frames, for which it comes too late, are searches that no sensor follows.
    """
    count, first = len(tracks.ids), tracks.header.seq + 1
    geometry = tracks.header.geometry
    boxes = search(geometry, None, np.arange(first, first + s.horizon))
    probability = np.zeros((s.horizon, count), np.float32)
    choice = np.full(s.horizon, PLACE, np.int32)
    if not count:
        return GazePlan(choice=choice, boxes=boxes, probability=probability)
    size: Array = np.array([geometry.roi_width_px, geometry.roi_height_px], np.float32)
    unread = np.where(looks.read[:count] < s.sure, 1, s.verify)
    tried, shown_seq = looks.tried[:count].copy(), looks.shown_seq[:count].copy()
    ahead = np.stack([future(tracks, row, s.horizon) for row in range(count)], axis=1)
    for step in range(s.delay, s.horizon):
        chance = chances(heights(ahead[step]))
        gain = unread * gains(chance, tried, first + step - shown_seq, s.retry)
        gain = np.where(gain >= s.least_gain, gain, 0)
        if not gain.any():
            continue
        places, shows = around(ahead[step], gain, geometry)
        best = int((shows @ gain).argmax())
        boxes[step], inside = from_centres(places[best], size), shows[best]
        probability[step] = gain / gain.sum()
        tried[inside] = np.maximum(tried, chance)[inside]
        shown_seq[inside] = first + step
    return GazePlan(choice=choice, boxes=boxes, probability=probability)
