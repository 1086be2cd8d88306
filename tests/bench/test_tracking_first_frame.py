"""The frame in which a tracker is given the true box is not scored, for any strategy."""

from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import pytest

from bench.tracking.budgets import acquisition
from bench.tracking.camera import Camera
from bench.tracking.clip import Clip, ClipName, read
from bench.tracking.episode import Loop, Rules, run
from bench.tracking.replaced import Replaced
from bench.tracking.sight import watched
from bench.tracking.stages import Stages
from bench.tracking.targets import targets
from pipeline.messages import Frame, Header, Message, RoiFeatures, Tracks

GRAPH = Path(__file__).resolve().parents[2] / "graphs" / "learned.yaml"
STRATEGIES = ("spatial", "temporal", "exposure", "foveated", "centred", "round_robin", "oracle")


@pytest.fixture(scope="module")
def clip() -> Clip:
    return read(ClipName(seed=70_003), (1, 14))


@pytest.fixture(scope="module")
def stages() -> Iterator[Stages]:
    with Stages(GRAPH, policy="pursuit") as stages:
        yield stages


class Initialised:
    """The stages, noting the frame in which the tracker gets the true box."""

    def __init__(self, stages: Stages) -> None:
        self._stages = stages
        self.frame = -1

    def begin(self, header: Header, *names: str, **settings: Mapping[str, Any]) -> None:
        if "tracker" in names:
            self.frame = -1
        self._stages.begin(header, *names, **settings)

    def restore(self, name: str, state: object) -> None:
        self._stages.restore(name, state)

    def looks(self, roi: Frame, tracks: Tracks) -> RoiFeatures:
        return self._stages.looks(roi, tracks)

    def call(self, name: str, **messages: Message) -> Any:
        if name == "tracker" and self.frame < 0:
            self.frame = messages["context"].header.seq
        return self._stages.call(name, **messages)


@pytest.mark.parametrize("budget", ["1/4", "1/8"])
@pytest.mark.parametrize("strategy", ["full", *STRATEGIES])
def test_no_frame_up_to_that_of_the_true_box_is_scored(
    clip: Clip, stages: Stages, strategy: str, budget: str
) -> None:
    (ball,) = targets(clip.truths, ["ball"], players=1, seed=0, width_px=clip.size_px[0])
    camera = Camera(clip, acquisition(strategy, Fraction(budget), clip.size_px))
    tracks = watched(camera, stages, 14, Replaced())
    noted = Initialised(stages)

    for start in (0, 1, 3):
        outcome = run(
            Loop(camera=camera, stages=cast(Stages, noted), tracks=tracks, rules=Rules()),
            ball,
            start,
        )

        assert outcome.first == noted.frame + 1
        assert len(outcome.iou) == 14 - outcome.first
        assert 1.0 not in outcome.iou


def test_an_exposure_over_several_frames_is_scored_from_the_next_one_on(
    clip: Clip, stages: Stages
) -> None:
    (ball,) = targets(clip.truths, ["ball"], players=1, seed=0, width_px=clip.size_px[0])
    camera = Camera(clip, acquisition("exposure", Fraction(1, 4), clip.size_px))

    outcome = run(Loop(camera=camera, stages=stages, rules=Rules()), ball, 2)

    assert outcome.first == 6
    assert outcome.kept == [(frame - 2) % 4 == 3 for frame in range(6, 14)]
