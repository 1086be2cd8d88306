"""Rules of the policies are left out one at a time, and the others are as they were."""

import json
from importlib import import_module
from operator import attrgetter
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from bench.options import ROOT
from bench.policy_rules import RULES, Rule, without
from bench.rules import ALL, FIGURES, Watch, asked, beside, main, on_it, right, rows
from pipeline.errors import RunError
from pipeline.messages import Frame, Percept, Truth
from pipeline.testing import header


def part(place: str) -> Any:
    module, _, name = place.partition(":")
    return attrgetter(name)(import_module(f"operators.policy.{module}"))


@pytest.mark.parametrize(
    ("policy", "name"),
    [(policy, name) for policy, of in RULES.items() for name, rule in of.items() if rule.parts],
)
def test_a_rule_is_replaced_only_while_it_is_left_out(policy: str, name: str) -> None:
    rule = RULES[policy][name]
    before = [part(place) for place, _ in rule.parts]
    with without(rule):
        assert [part(place) for place, _ in rule.parts] == [other for _, other in rule.parts]
    assert [part(place) for place, _ in rule.parts] == before


@pytest.mark.parametrize("place", ["target:gone", "target:Gone.wanted"])
def test_a_rule_that_is_no_more_is_refused(place: str) -> None:
    with (
        pytest.raises(RunError, match=f"{place}: expected a rule"),
        without(Rule(parts=((place, 0),))),
    ):
        pass


def watched(*, box: tuple[int, int, int, int], window: tuple[int, int, int, int]) -> Watch:
    """A target at 10..20; window and answer are known in the second of two frames."""
    watch = Watch(kind="ball")
    for seq in (0, 1):
        truth = Truth(
            header=header(seq), boxes=np.array([[10, 10, 20, 20]], np.float32),
            ids=np.array([7], np.int32), labels=("ball",), visibility=np.ones(1, np.float32),
        )  # fmt: skip
        watch.hear("capture.truth", truth)
    roi = Frame(header=header(1), pixels=np.zeros((1, 1, 3), np.uint8), window=window)
    watch.hear("capture.roi", roi)
    answer = Percept(
        header=header(1), boxes=np.array([box], np.float32), ids=np.zeros(1, np.int32),
        scores=np.ones(1, np.float32),
    )  # fmt: skip
    watch.hear("tracker", answer)
    watch.judge()
    return watch


def test_frames_without_an_answer_count_as_missed() -> None:
    watch = watched(box=(10, 10, 20, 20), window=(0, 0, 15, 40))

    assert watch.values == {FIGURES[0]: [0, 0.5], FIGURES[1]: [0, 1]}
    assert watch.answered == [False, True]


@pytest.mark.parametrize(
    ("window", "shown"),
    [((40, 0, 90, 40), 1), ((0, 0, 30, 40), 0)],  # the second one, the first
)
def test_of_a_class_any_object_may_be_followed_but_one_counts_in_both_figures(
    window: tuple[int, int, int, int], shown: float
) -> None:
    watch = Watch(kind="referee")
    truth = Truth(
        header=header(1), boxes=np.array([[0, 0, 9, 9], [50, 0, 60, 10]], np.float32),
        ids=np.array([1, 2], np.int32), labels=("referee", "referee"),
        visibility=np.ones(2, np.float32),
    )  # fmt: skip
    answer = Percept(
        header=header(1), boxes=truth.boxes[1:], ids=np.zeros(1, np.int32),
        scores=np.ones(1, np.float32),
    )  # fmt: skip
    roi = Frame(header=header(1), pixels=np.zeros((1, 1, 3), np.uint8), window=window)
    for name, message in (("capture.truth", truth), ("capture.roi", roi), ("tracker", answer)):
        watch.hear(name, message)

    watch.judge()

    assert watch.values == {FIGURES[0]: [shown], FIGURES[1]: [1]}


def test_what_is_lost_without_a_rule_is_told_beside_its_figure() -> None:
    usual = {("a", 1): watched(box=(10, 10, 20, 20), window=(0, 0, 40, 40))}
    worse = {("a", 1): watched(box=(10, 10, 20, 15), window=(0, 0, 40, 40))}

    found = list(rows({("learned", "ball", ALL): usual, ("learned", "ball", "a rule"): worse}))

    assert [row[FIGURES[1]] for row in found] == [0.5, 0.25]
    assert found[1][f"{FIGURES[1]}: gained without"] == "-0.250"
    assert found[1][f"{FIGURES[0]}: gained without"] == "+0.000"


def test_players_of_one_clip_depend_on_one_another_and_give_no_interval() -> None:
    usual = {("a", k): watched(box=(10, 10, 20, 20), window=(0, 0, 40, 40)) for k in range(9)}
    worse = {("a", k): watched(box=(10, 10, 20, 15), window=(0, 0, 40, 40)) for k in range(9)}
    apart = (
        {(str(k), k): watch for (_, k), watch in usual.items()},
        {(str(k), k): watch for (_, k), watch in worse.items()},
    )

    for (all_rules, one_less), ends in (((usual, worse), 0), (apart, 1)):
        found = list(rows({("a", "ball", ALL): all_rules, ("a", "ball", "a rule"): one_less}))

        assert found[1][f"{FIGURES[1]}: gained without"].count("..") == ends
        assert found[1]["targets"] == 9


def test_several_objects_of_a_class_are_asked_for_one_by_one() -> None:
    truth = Truth(
        header=header(0), boxes=np.array([[i, 0, i + 5, 9] for i in range(4)], np.float32),
        ids=np.arange(4, dtype=np.int32), labels=("player", "ball", "player", "player"),
        visibility=np.array([1, 1, 0, 1], np.float32),
    )  # fmt: skip

    found = [
        (w.kind, w.object_id, set_) for w, set_ in asked(truth, ("ball", "player"), ("player",), 3)
    ]

    assert found == [
        ("ball", -1, ("policy.target=ball",)),
        ("player", 0, ("policy.target=", "policy.prompt_box=[0.0, 0.0, 5.0, 9.0]")),
        ("player", 3, ("policy.target=", "policy.prompt_box=[3.0, 0.0, 8.0, 9.0]")),
    ]
    assert len(list(asked(truth, ("player",), ("player",), 1))) == 1


def test_a_policy_stands_beside_the_first_one_paired_by_the_target() -> None:
    half = {("a", 1): watched(box=(10, 10, 20, 20), window=(0, 0, 15, 40))}
    full = {("a", 1): watched(box=(10, 10, 20, 20), window=(0, 0, 40, 40))}
    runs = {("learned", "ball", ALL): half, ("learned", "ball", "a rule"): full}

    found = list(beside({**runs, ("pursuit", "ball", ALL): full}))

    assert [(row["policy"], row[FIGURES[0]]) for row in found] == [
        ("learned", 0.25),
        ("pursuit", 0.5),
    ]
    above = f"{FIGURES[0]}: above learned"
    assert [row[above] for row in found] == ["", "+0.250"]


def test_the_tracker_is_on_the_target_only_where_the_roi_shows_it() -> None:
    shown = watched(box=(10, 10, 20, 20), window=(0, 0, 40, 40))
    values = {FIGURES[0]: [1.0, 0.6, 0.4, 1.0], FIGURES[1]: [0.5, 0.1, 0.9, 0.3]}
    shown.values = values

    assert on_it([shown]) == 0.667  # the third frame hardly shows it
    shown.values = {name: [] for name in FIGURES}
    assert on_it([shown]) == ""


def test_the_tracker_is_right_in_a_share_of_the_frames_in_which_it_has_a_box() -> None:
    seen = watched(box=(10, 10, 20, 20), window=(0, 0, 40, 40))
    seen.values = {FIGURES[0]: [1.0, 0.0, 1.0, 1.0], FIGURES[1]: [0.5, 0.3, 0.1, 0.0]}
    seen.answered = [True, True, True, False]

    assert right([seen]) == 0.667
    seen.join(seen)
    assert right([seen]) == 0.667
    seen.answered = [False] * len(seen.answered)
    assert right([seen]) == ""


def test_targets_that_no_clip_shows_are_refused() -> None:
    line = ["tracking", "--whole", "--clips", "1", "--frames", "2", "--targets", "cat"]

    told = CliRunner().invoke(main, [*line, "--boxed", "cat"])

    assert told.exit_code == 1
    assert "--targets: expected what the first frames show, got 'cat'" in told.output


def test_a_graph_without_a_tracker_is_refused() -> None:
    result = CliRunner().invoke(main, [str(ROOT / "graphs" / "many.yaml"), "--policies", "pursuit"])

    assert result.exit_code == 1
    assert "many: expected a graph with a node tracker to judge, got none" in result.output


def test_a_target_that_is_never_visible_has_no_figures() -> None:
    unseen = {("a", -1): Watch(kind="dog")}
    both = {("one", "dog", ALL): unseen, ("other", "dog", ALL): unseen}

    (_, row) = beside(both)

    assert [row[figure] for figure in FIGURES] == ["", ""]
    assert json.dumps([row, *rows(both)], allow_nan=False)


def test_runs_from_several_starts_of_a_clip_are_one_target() -> None:
    inside = watched(box=(0, 0, 10, 10), window=(0, 0, 20, 20))
    (alone,) = beside({("learned", "ball", ALL): {("the source", -1): inside}})
    inside.join(watched(box=(0, 0, 10, 10), window=(50, 50, 60, 60)))

    (row,) = beside({("learned", "ball", ALL): {("the source", -1): inside}})

    assert row["share in the ROI"] == alone["share in the ROI"] / 2
    assert (row["targets"], row["runs"]) == (1, 2)


def test_starts_without_a_source_are_refused() -> None:
    result = CliRunner().invoke(main, ["--starts", "3"])

    assert result.exit_code != 0
    assert "--starts: expected with --source" in result.output
