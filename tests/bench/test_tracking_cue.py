"""With a cue, the trackers of all rows hear the same, whatever the strategy, and are what ships."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.tracking.cases import Case, Protocol, cases
from bench.tracking.clip import Clip, ClipName, read
from bench.tracking.episode import Outcome, Rules, exposures, run
from bench.tracking.key import key
from bench.tracking.options import Options
from bench.tracking.stages import Stages
from bench.tracking.stock import Stock, giver
from bench.tracking.targets import Target, targets
from operators.tracker import TrackerState
from pipeline.errors import SettingsError
from pipeline.messages import Frame, Message, RoiFeatures, Scanpath, Tracks
from tests.bench.test_tracking_options import read as asked

GRAPH = Path(__file__).resolve().parents[2] / "graphs" / "learned.yaml"
FRAMES = 24
START = 2
CUED = Rules(cue=True, to_end=True)
Told = dict[int, tuple[list[int], NDArray[np.float32]]]  # by exposure: choice and boxes


@pytest.fixture(scope="module")
def clip() -> Clip:
    return read(ClipName(seed=70_003), (1, FRAMES))


@pytest.fixture(scope="module")
def stock(clip: Clip) -> Iterator[Stock]:
    with Stock(clip, GRAPH) as stock:
        yield stock


@pytest.fixture(scope="module")
def player(clip: Clip, stock: Stock) -> Target:
    """Return a player whom the shipped detector finds, so that the cue has something to show."""
    for found in targets(clip.truths, ["player"], players=99, seed=0, width_px=clip.size_px[0]):
        cue = stock.cue(row("spatial"), found, START) if found.boxes[START].any() else None
        if cue and min(plan.choice[0] for plan in cue.plans[:9]) >= 0:
            return found
    raise AssertionError("no player is found in the context")


class Heard:
    """The stages, noting what the tracker and the policy are told and what the policy plans."""

    def __init__(self, stages: Stages) -> None:
        self._stages = stages
        self.plan = stages.plan
        self.told: Told = {}
        self.planned: dict[int, Scanpath] = {}
        self.tracker: dict[str, Any] = {}
        self.states: list[TrackerState] = []
        self._last: Scanpath | None = None

    def begin(self, header: Any, *names: str, **settings: Any) -> None:
        self.tracker = settings.get("tracker", self.tracker)
        self._stages.begin(header, *names, **settings)

    def restore(self, name: str, state: TrackerState) -> None:
        self.states.append(state)
        self._stages.restore(name, state)

    def looks(self, roi: Frame, tracks: Tracks) -> RoiFeatures:
        return self._stages.looks(roi, tracks)

    def call(self, name: str, **messages: Message) -> Any:
        answer = self._stages.call(name, **messages)
        if name == "policy" and "tracks" in messages:
            self.planned[answer.first_seq - 1] = answer
        if name == "tracker" and "scanpath" in messages:
            self._last = cast(Scanpath, messages["scanpath"])
        elif name == "tracker" and self._last is not None:
            seq = messages["context"].header.seq
            self.told[seq] = (self._last.choice.tolist(), self._last.boxes)
            self._last = None
        return answer


def row(strategy: str, budget: str = "1/8", rules: Rules = CUED, **more: Any) -> Case:
    policy = more.pop("policy", "pursuit")
    return Case(strategy=strategy, budget=budget, name="", rules=rules, policy=policy, **more)


def followed(stock: Stock, target: Target, case: Case) -> tuple[Outcome, Heard, list[int]]:
    loop = stock.loop(case)
    heard = Heard(loop.stages)
    cue = stock.cue(case, target, START)
    found = run(replace(loop, stages=cast(Stages, heard), cue=cue), target, START)
    return found, heard, exposures(loop.camera, START, FRAMES - 1)


ROWS = {
    "full": row("full"),
    "spatial": row("spatial"),
    "context": row("context"),
    "temporal": row("temporal"),
    "exposure": row("exposure"),
    "oracle": row("oracle"),
    "centred": row("centred"),
    "round robin": row("round_robin", policy="round_robin"),
    "foveated": row("foveated", policy=""),
    "pursuit": row("foveated"),
    "ROI alone": row("oracle", rules=replace(CUED, context=False)),
    "kept plans": row("foveated", rules=replace(CUED, replan=4, prediction=False)),
    "true parts": row("foveated", replaced=("detections", "association", "policy")),
}


@pytest.mark.parametrize("name", ROWS)
def test_every_row_hears_the_identical_cue_in_every_exposure_after_the_first_plan(
    stock: Stock, player: Target, name: str
) -> None:
    reference, first, _ = followed(stock, player, ROWS["full"])

    outcome, heard, exposed = followed(stock, player, ROWS[name])

    assert sorted(first.told) == list(range(START + 1, FRAMES))
    assert sorted(heard.told) == [frame for frame in exposed if frame > START]
    for frame, (choice, boxes) in heard.told.items():
        assert choice == first.told[frame][0]
        np.testing.assert_array_equal(boxes, first.told[frame][1])
    assert heard.tracker == first.tracker  # the same settings, too
    assert reference.first <= outcome.first


def test_all_rows_of_a_budget_have_their_cue_from_the_same_tracks_and_rule() -> None:
    assert {giver(case) for case in ROWS.values()} == {giver(ROWS["spatial"])}
    assert giver(row("spatial", "1/16")) != giver(ROWS["spatial"])


@pytest.mark.parametrize("name", ["exposure", "true parts"])
def test_a_cue_does_not_depend_on_the_row_that_was_followed_before_it(
    clip: Clip, stock: Stock, player: Target, name: str
) -> None:
    with Stock(clip, GRAPH) as fresh:
        followed(fresh, player, replace(ROWS[name], rules=Rules(to_end=True)))
        after = fresh.cue(ROWS[name], player, START)
    shared = stock.cue(ROWS["spatial"], player, START)

    assert after is not None
    assert shared is not None
    assert len(after.plans) == FRAMES - START
    for a, b in zip(after.plans, shared.plans, strict=True):
        assert (a.first_seq, a.choice.tolist()) == (b.first_seq, b.choice.tolist())
        np.testing.assert_array_equal(a.boxes, b.boxes)


def test_the_cue_is_what_the_tracker_of_the_loop_with_the_pursuit_rule_hears(
    stock: Stock, player: Target
) -> None:
    _, heard, _ = followed(stock, player, ROWS["pursuit"])

    for frame, (choice, boxes) in heard.told.items():
        own = heard.planned[frame - 1]  # of the row's own policy, one frame before
        assert choice == own.choice.tolist()
        np.testing.assert_array_equal(boxes, own.boxes)
    assert len({boxes.tobytes() for _, boxes in heard.told.values()}) > FRAMES / 2


def test_the_cue_begins_where_the_true_box_is(stock: Stock, player: Target) -> None:
    cue = stock.cue(row("temporal"), player, START)

    assert cue is not None
    assert cue.heard(START) is None
    plan = cue.heard(START + 1)
    assert plan is not None
    assert plan.first_seq == START + 1
    assert np.abs(plan.boxes[0] - player.boxes[START + 1]).max() < 40
    assert stock.cue(row("temporal", rules=Rules()), player, START) is None


def test_a_late_cue_is_late_for_every_row_by_as_many_frames(stock: Stock, player: Target) -> None:
    late = replace(CUED, cue_delay=3)

    told = [
        followed(stock, player, row(name, rules=replace(late, delay=delay)))[1].told
        for name, delay in (("spatial", 0), ("foveated", 3))
    ]
    prompt = followed(stock, player, row("spatial"))[1].told

    assert sorted(told[0]) == sorted(told[1]) == list(range(START + 4, FRAMES))
    for frame, (choice, _) in told[0].items():
        assert choice == told[1][frame][0] == prompt[frame - 3][0]


def test_the_tracker_of_a_row_with_a_cue_is_the_graphs_with_two_rules_off(
    stock: Stock, player: Target
) -> None:
    _, heard, _ = followed(stock, player, ROWS["centred"])

    (state,) = heard.states
    assert list(heard.tracker) == ["hidden_after", "place_after"]
    assert heard.tracker["hidden_after"] > FRAMES
    assert heard.tracker["place_after"] == 0
    assert (state.prompted, state.begun) == (False, False)  # so that it listens
    np.testing.assert_array_equal(state.box, player.boxes[START][None])


def options(**more: Any) -> Options:
    words = {
        "strategies": "full,spatial,foveated",
        "budgets": "1/8,1/16",
        "cue": "reference",
    } | more
    return asked(*(f"--{name}={value}" for name, value in words.items()))


def test_full_resolution_has_a_row_for_the_cue_of_each_budget() -> None:
    rows = [(case.strategy, case.budget) for case in cases(options())]
    each = [(case.name, case.budget) for case in cases(options(cue="each", strategies="full"))]

    assert rows == [(s, b) for s in ("full", "spatial", "foveated") for b in ("1/8", "1/16")]
    assert each == [("full", "1/8"), ("full, no cue", "1"), ("full", "1/16")]


def test_all_rows_hear_late_plans_late_and_several_delays_are_refused() -> None:
    late = {(case.strategy, case.rules.cue_delay) for case in cases(options(delay="2"))}

    assert late == {("full", 2), ("spatial", 2), ("foveated", 2)}
    with pytest.raises(SettingsError, match="delay: expected one with --cue reference"):
        options(delay="0,2")
    assert options(delay="0,2", cue="none").delay == (0, 2)


def test_other_settings_of_the_rule_or_the_detector_make_another_unit_of_every_row_with_a_cue() -> (
    None
):
    protocol = Protocol(graph=str(GRAPH), frames=(1, 9), kinds=("ball",))

    def keyed(rules: Rules, *changes: str) -> str:
        return key(row("spatial", rules=rules, changes=changes), protocol)

    for change in ("saliency.confidence=0.9", "policy.horizon=8"):
        assert keyed(CUED, change) != keyed(CUED)
        assert keyed(Rules(), change) == keyed(Rules())
