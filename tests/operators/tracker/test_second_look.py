"""Where the policy shows its object elsewhere, a tracker looks there, too, and takes the surer."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from operators.tracker import CorrelationSettings, CorrelationTracker
from operators.tracker.following import Following, Proposal, Rules
from operators.tracker.look import Streams
from pipeline import SettingsError
from pipeline.boxes import centres, iou
from pipeline.testing import header
from tests.operators.tracker.made_up import World

WORLD = World(seed=11)
OTHER = WORLD.other_box()
PATIENT = {"lost_after": 100, "drift_after": 100, "switch_after": 100, "hidden_after": 100}


def tracker(**settings: float) -> CorrelationTracker:
    subject = CorrelationTracker(CorrelationSettings(**(PATIENT | settings)))  # type: ignore[arg-type]
    subject.open()
    subject.on_stream(header(0))
    return subject


def play(
    subject: CorrelationTracker, frames: range, *, hidden: range = range(0),
    shown: NDArray[np.float32] | None = None,
) -> list[bool]:  # fmt: skip
    """Play frames, the object shown where it is, or `shown`; whether each answer is on it."""
    found = []
    for k in frames:
        subject.on_scanpath(**WORLD.scanpath(k - 1, object_id=3, box=shown))
        at = None if shown is None else centres(shown)
        percept = subject.on_context_roi(**WORLD.frames(k, hidden=k in hidden, at=at))
        box = WORLD.box(k)[None]
        found.append(bool(len(percept.boxes)) and bool(iou(percept.boxes, box)[0, 0] > 0.5))
    return found


@pytest.mark.parametrize(("cue_margin", "again"), [(0.1, True), (1.0, False)])
def test_a_lost_object_is_found_again_where_the_policy_shows_it(
    cue_margin: float, again: bool
) -> None:
    subject = tracker(cue_margin=cue_margin)

    found = play(subject, range(40), hidden=range(6, 34))

    assert all(found[:6])
    assert all(found[34:]) == again
    assert subject.summary()["tracker"]["cued"] == int(again)


def test_another_object_that_the_policy_shows_is_not_taken_for_its_own() -> None:
    subject = tracker(cue_margin=0.1)
    play(subject, range(6))

    play(subject, range(6, 20), shown=OTHER)

    box = subject.state().box
    assert iou(box, WORLD.box(19)[None])[0, 0] > 0.5
    assert subject.summary()["tracker"]["cued"] == 0


def test_a_second_look_that_is_not_taken_changes_nothing() -> None:
    looking, alone = tracker(cue_margin=0.1), tracker(cue_margin=1.0)
    for subject in (looking, alone):
        play(subject, range(6))
        play(subject, range(6, 10), shown=OTHER)

    for one, other in zip(looking.state().memory, alone.state().memory, strict=True):
        np.testing.assert_array_equal(one, other)


class ByPlace:
    """A method that finds everything where it looks, surer on the right than on the left."""

    patience_score = 0.2

    def start(self, streams: Streams, box: NDArray[np.float32]) -> None: ...

    def follow(
        self, streams: Streams, box: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float]:
        return box, 0.9 if box[0] > 1000 else 0.5

    def aligned(
        self, box: NDArray[np.float32], foreseen: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        return box

    def memory(self) -> tuple[()]:
        return ()

    def resume(self, memory: object) -> bool:
        return True


@pytest.mark.parametrize(("margin", "after"), [(0.3, 3), (0.45, 9)])
def test_while_it_finds_its_object_a_look_must_be_surer_several_times(
    margin: float, after: int
) -> None:
    rules = Rules(
        lost_score=0.2, lost_after=100, drift_after=100, switch_after=100, hidden_after=100,
        cue_margin=margin, cue_after=3,
    )  # fmt: skip
    subject = Following(ByPlace(), rules)
    subject.take(np.array([100, 100, 140, 140], np.float32))
    subject.restore(replace(subject.state(), prompted=False, begun=False))
    streams = Streams(**WORLD.frames(0))
    subject.step(streams, None)

    lefts = []
    for _ in range(8):
        subject.step(streams, Proposal(object_id=3, box=OTHER))
        lefts.append(int(subject.box[0, 0]))

    assert lefts == [100] * min(after - 1, 8) + [1200] * max(0, 9 - after)


def test_a_margin_out_of_range_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"cue_margin: must be within 0\.\.1, got 1\.5"):
        CorrelationSettings(cue_margin=1.5)
