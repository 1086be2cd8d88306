"""Long starts, no cue and coordinates of the ROI: what is scored, and which rows are compared."""

import itertools
from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.tracking.budgets import acquisition
from bench.tracking.camera import Camera
from bench.tracking.cases import CUES, rules_of
from bench.tracking.clip import Clip, ClipName, read
from bench.tracking.episode import Loop, Outcome, Rules, exposures, run
from bench.tracking.figures import figures_of
from bench.tracking.report import same_help
from bench.tracking.stages import Stages
from bench.tracking.targets import targets
from operators.policy import LearnedPolicy
from operators.tracker import TrackerState
from pipeline import Input, Percept
from pipeline.boxes import iou
from pipeline.errors import GraphError
from pipeline.messages import Header, Message, Scanpath

GRAPH = Path(__file__).resolve().parents[2] / "graphs" / "learned.yaml"
TRACKING = GRAPH.with_name("tracking.yaml")
FRAMES = 14
STRATEGIES = (
    *("full", "spatial", "temporal", "exposure", "context"),
    *("foveated", "centred", "round_robin", "oracle"),
)


@pytest.fixture(scope="module")
def clip() -> Clip:
    return read(ClipName(seed=70_003), (1, FRAMES))


@pytest.fixture(scope="module")
def stages() -> Iterator[Stages]:
    with Stages(GRAPH, ("policy.weights=",), policy="pursuit") as stages:
        yield stages


class Heard:
    """The stages, noting what the tracker is told and when."""

    def __init__(self, stages: Stages) -> None:
        self._stages = stages
        self.plan = stages.plan
        self.settings: dict[str, Any] = {}
        self.scanpaths: list[int] = []

    def begin(self, header: Header, *names: str, **settings: Mapping[str, Any]) -> None:
        self.settings = dict(settings.get("tracker", self.settings))
        self._stages.begin(header, *names, **settings)

    def call(self, name: str, **messages: Message) -> Any:
        if name == "tracker" and "scanpath" in messages:
            self.scanpaths.append(messages["scanpath"].first_seq)  # type: ignore[attr-defined]
        return self._stages.call(name, **messages)


def followed(
    clip: Clip, stages: Stages, strategy: str, rules: Rules, start: int = 0
) -> tuple[Outcome, Heard]:
    (ball,) = targets(clip.truths, ["ball"], players=1, seed=0, width_px=clip.size_px[0])
    heard = Heard(stages)
    camera = Camera(clip, acquisition(strategy, Fraction("1/4"), clip.size_px))
    loop = Loop(camera=camera, stages=cast(Stages, heard), rules=rules)
    return run(loop, ball, start), heard


@pytest.mark.lengthy
def test_a_cue_brings_a_tracker_to_what_the_policy_shows(clip: Clip, stages: Stages) -> None:
    state = TrackerState(box=np.array([[100, 100, 120, 120]], np.float32))
    camera = Camera(clip, acquisition("full", Fraction(1), clip.size_px))
    stages.begin(camera.header(0), "tracker")
    stages.restore("tracker", state)
    (ball,) = targets(clip.truths, ["ball"], players=1, seed=0, width_px=clip.size_px[0])
    answers = []

    for frame in range(3):
        shown = Scanpath(
            header=camera.header(frame), ids=np.array([5], np.int32),
            probability=np.ones((1, 1), np.float32), choice=np.array([5], np.int32),
            boxes=ball.boxes[frame][None], first_seq=frame,
        )  # fmt: skip
        stages.call("tracker", scanpath=shown)
        context, roi = camera.expose(frame, frame, (0, 0, 0, 0))
        answers.append(stages.call("tracker", context=context, roi=roi).boxes)

    assert iou(answers[0], ball.boxes[:1])[0, 0] == 0
    assert iou(answers[2], ball.boxes[2:3])[0, 0] > 0.9  # after two frames beside it


@pytest.mark.lengthy
@pytest.mark.parametrize("strategy", ["full", "oracle"])
def test_without_a_cue_the_tracker_hears_no_policy_and_never_gives_up(
    clip: Clip, stages: Stages, strategy: str
) -> None:
    outcome, heard = followed(clip, stages, strategy, Rules())

    assert heard.scanpaths == []
    assert heard.settings["lost_after"] > FRAMES
    assert np.isfinite(outcome.away_px).all()


@given(
    strategy=st.sampled_from(STRATEGIES),
    budget=st.sampled_from(["1/2", "1/3", "1/4", "1/8", "1/16"]),
    start=st.integers(0, 60),
    last=st.integers(0, 90),
)
@settings(max_examples=80, deadline=None)
def test_exposures_begin_at_the_start_and_hold_no_frame_before_it(
    strategy: str, budget: str, start: int, last: int
) -> None:
    how = acquisition(strategy, Fraction(budget), (1920, 1080))
    camera = cast(Camera, type("Still", (), {"how": how}))

    found = exposures(camera, start, last)

    step = how.sampling.interval
    covers = step if how.sampling.averaged else 1
    assert all(start <= frame - covers + 1 and frame <= last for frame in found)
    assert all(b - a == step for a, b in itertools.pairwise(found))
    assert bool(found) == (start + covers - 1 <= last)


@pytest.mark.lengthy
def test_in_coordinates_of_the_roi_the_box_moves_with_the_window(
    clip: Clip, stages: Stages
) -> None:
    outcome, heard = followed(clip, stages, "oracle", Rules(context=False, local=True))
    (ball,) = targets(clip.truths, ["ball"], players=1, seed=0, width_px=clip.size_px[0])
    left, top, *_ = outcome.windows[0]

    given_box = heard.settings["init_box"]

    assert given_box == pytest.approx(tuple(ball.boxes[0] - np.array([left, top, left, top])))


def test_a_long_start_ends_with_the_clip_and_a_short_one_after_its_frames() -> None:
    assert Rules(to_end=True, longest=5).last(3, 100) == 99
    assert [Rules(longest=5).last(3, frames) for frames in (100, 6)] == [8, 5]


def test_rows_of_other_help_or_another_protocol_are_not_compared() -> None:
    assert same_help("foveated", "oracle")
    assert same_help("foveated, ROI alone, no cue", "spatial, no cue")
    assert not same_help("foveated", "oracle, no cue")
    assert not same_help("foveated, long", "oracle")
    assert not same_help("foveated, ROI alone", "pursuit")
    assert not same_help("foveated, ROI coordinates", "full")


def test_a_tracker_in_coordinates_of_the_roi_has_no_cue() -> None:
    options: Any = type(
        "Asked",
        (),
        {
            "prediction": "kalman", "protocol": "both", "delay": (0,), "replan": (1,),
            "sees": "all", "cue": "each", "longest": 64,
        },
    )  # fmt: skip

    found = rules_of(options)

    assert len(found) == 2 * (2 * len(CUES["each"]) + 1)
    assert not any(rule.cue for rule in found if rule.local)


def test_frames_without_an_answer_are_lost_and_not_near() -> None:
    found = figures_of([0.9] * 5 + [0.0] * 20 + [0.9] * 5, [1.0] * 5 + [np.inf] * 20 + [1.0] * 5)

    assert (found.until_lost, found.lost, found.hits, found.near) == (5, True, 10, 10)


class Listening(LearnedPolicy):
    """A policy that hears the tracker."""

    percept = Input(Percept, join=False)

    def on_percept(self, percept: Percept) -> None:
        """Hear it."""


def test_a_policy_that_hears_the_tracker_is_refused(tmp_path: Path) -> None:
    graph = tmp_path / "fed_back.yaml"
    known = GRAPH.read_text().replace("operators.policy:LearnedPolicy", f"{__name__}:Listening")
    graph.write_text(
        known.replace("features: roi_features}", "features: roi_features, percept: tracker}")
    )

    with pytest.raises(GraphError, match=r"policy\.percept: expected a policy that hears no"):
        Stages(graph)


def test_a_verifier_without_its_detector_is_refused(tmp_path: Path) -> None:
    graph = tmp_path / "renamed.yaml"
    known = GRAPH.with_stem("tracking").read_text()
    graph.write_text(known.replace("  closer: #", "  nearer: #").replace(": closer", ": nearer"))

    with pytest.raises(GraphError, match=r"tracking is evaluated on .*; no closer"):
        Stages(graph)


def test_features_that_are_not_played_are_refused(tmp_path: Path) -> None:
    graph = tmp_path / "filtered.yaml"
    known = GRAPH.read_text().replace("features: roi_features}", "features: sorted}")
    graph.write_text(
        f"{known}  sorted:\n    operator: operators.verify:Verify\n    inputs: {{features: "
        "roi_features, closer: saliency, tracks: association, roi: capture.roi}\n"
    )

    with pytest.raises(GraphError, match=r"policy\.features: expected roi_features or verify"):
        Stages(graph)


def test_detections_that_are_not_played_are_refused(tmp_path: Path) -> None:
    graph = tmp_path / "retold.yaml"
    known = TRACKING.read_text()
    graph.write_text(known.replace("  kits: #", "  worn: #").replace(": kits", ": worn"))

    with pytest.raises(GraphError, match=r"association\.detections: expected saliency or kits"):
        Stages(graph)


def test_a_picture_of_association_that_is_not_played_is_refused(tmp_path: Path) -> None:
    graph = tmp_path / "large.yaml"
    known = TRACKING.read_text()
    graph.write_text(known.replace("kits, frame: downsample}", "kits, frame: capture.context}"))

    with pytest.raises(GraphError, match=r"association\.frame: expected downsample"):
        Stages(graph)


def test_association_is_shown_the_picture_where_its_graph_shows_it(tmp_path: Path) -> None:
    clip = read(ClipName(seed=52_000), (1, 2))
    camera = Camera(clip, acquisition("full", Fraction(1, 16), clip.size_px))
    unseen = tmp_path / "unseen.yaml"
    unseen.write_text(TRACKING.read_text().replace("kits, frame: downsample}", "kits}"))
    known = []

    for graph in (TRACKING, unseen):
        with Stages(graph) as stages:
            stages.begin(camera.header(0), "downsample", "saliency", "association")
            picture = stages.call("downsample", frame=camera.context(0))
            stages.tracks(stages.finds(picture), picture)
            known.append(~np.isnan(stages.state("association").colours).all())

    assert known == [True, False]


def test_a_graph_with_kits_is_played_with_kits() -> None:
    clip = read(ClipName(seed=52_000), (1, 2))
    camera = Camera(clip, acquisition("full", Fraction(1, 16), clip.size_px))
    with Stages(TRACKING) as stages:
        stages.begin(camera.header(0), "downsample", "saliency")
        picture = stages.call("downsample", frame=camera.context(0))
        seen = stages.call("saliency", frame=picture)

        found = stages.finds(picture)

    told = stages.call("kits", detections=seen, frame=picture)
    assert found.labels.tolist() == told.labels.tolist()
    assert len(found.labels) <= len(seen.labels)
