"""The evaluation uses the tracker and the policy that were named, whatever is installed."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from bench.tracking.cases import Case, Protocol, cases
from bench.tracking.classes import TRACKERS, planned
from bench.tracking.episode import Rules
from bench.tracking.evaluate import command
from bench.tracking.key import key
from bench.tracking.options import GRAPH, policy_files
from bench.tracking.stages import Stages
from pipeline.contract import Operator
from pipeline.errors import SettingsError
from pipeline.graph.plan import load_operator
from tests.bench.test_tracking_options import read


@pytest.fixture(autouse=True)
def bare_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))


def test_by_default_the_graphs_own_class_measures_with_the_graphs_settings() -> None:
    node = planned(GRAPH, ("tracker.lost_after=9",), "").node("tracker")

    assert node.operator == "operators.tracker:TemplateTracker"
    assert node.settings == {"lost_after": 9}


@pytest.mark.parametrize("name", TRACKERS)
def test_a_named_class_replaces_it_with_weights_and_settings_of_its_own(name: str) -> None:
    word = name if name == "correlation" else f"{name}=mine.onnx"

    plan = planned(GRAPH, ("tracker.lost_after=9", "policy.horizon=8"), word)

    own = {} if name == "correlation" else {"weights": "mine.onnx"}
    assert plan.node("tracker").operator == TRACKERS[name]
    assert plan.node("tracker").settings == {"lost_after": 9, **own}
    assert plan.node("policy").settings["horizon"] == 8
    assert issubclass(load_operator(TRACKERS[name]), Operator)


def test_settings_of_another_tracker_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"tracker\.renew_every: no such setting"):
        planned(GRAPH, ("tracker.renew_every=3",), "vittrack")


@pytest.mark.parametrize("tracker", ["vittrack", "vittrack=none.onnx", "mixformer=none.onnx"])
def test_missing_weights_are_refused_before_any_work(tracker: str, tmp_path: Path) -> None:
    words = ["--data", "procedural", "--work", str(tmp_path / "work"), "--tracker", tracker]

    result = CliRunner().invoke(command, words)

    assert result.exit_code == 2
    assert "weights" in result.output
    assert ("fovea weights pull vittrack" in result.output) == ("vittrack" in tracker)
    assert list((tmp_path / "work").iterdir()) == []


def test_units_of_different_trackers_have_different_keys() -> None:
    protocol = Protocol(graph=str(GRAPH), frames=(1, 16), kinds=("ball",))
    own, same, other = (
        key(Case(strategy="spatial", budget="1/4", name="", rules=Rules(), tracker=t), protocol)
        for t in ("", "template", "vittrack")
    )

    assert own == same
    assert own != other


def test_every_row_is_measured_by_the_tracker_that_was_asked_for() -> None:
    assert {case.tracker for case in cases(read("--tracker", "vittrack"))} == {"vittrack"}


def test_the_parts_of_an_evaluation_are_those_of_the_plan() -> None:
    with Stages(GRAPH, (), "correlation", "pursuit") as stages:
        assert type(stages.settings("tracker")).__name__ == "CorrelationSettings"


def test_a_policy_that_is_asked_for_keeps_the_settings_that_both_classes_have() -> None:
    changes = ("policy.horizon=8", "policy.target_prior=1", "policy.confirm=5")

    node = planned(GRAPH, changes, policy="pursuit").node("policy")

    assert node.operator == "operators.policy:PursuitPolicy"
    assert node.settings == {"target": "ball", "horizon": 8, "confirm": 5}
    assert planned(GRAPH, (), policy="own.onnx").node("policy").settings["weights"] == "own.onnx"


def test_wrong_settings_of_a_policy_that_is_asked_for_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"policy\.dwell: no such setting"):
        planned(GRAPH, ("policy.dwell=3",), policy="pursuit")
    with pytest.raises(SettingsError, match=r"policy\.observed: .* got 'x'"):
        planned(GRAPH, ("policy.observed=x",), policy="pursuit")


def test_a_foveated_row_needs_a_policy_that_can_be_given_its_target(tmp_path: Path) -> None:
    graph = tmp_path / "centred.yaml"
    text = GRAPH.read_text().replace("policy:LearnedPolicy", "policy:CentredPolicy")
    graph.write_text(text.replace("    settings: {target: ball}\n", ""))
    words = ["--data", "procedural", "--graph", str(graph), "--strategies", "foveated"]

    result = CliRunner().invoke(command, words)

    said = "policy.operator: expected a class with a setting prompt_box, got operators.policy:Cen"
    assert result.exit_code == 2
    assert said in result.output


def test_the_old_name_pursue_is_refused_with_the_new_name() -> None:
    with pytest.raises(SettingsError, match="policy: pursue: renamed; expected pursuit"):
        policy_files(("pursue",))


def test_weights_that_an_operator_knows_by_name_are_told_apart_from_its_others() -> None:
    protocol = Protocol(graph=str(GRAPH), frames=(1, 16), kinds=("ball",))
    own, quantised = (
        key(Case(strategy="foveated", budget="1/4", name="", rules=Rules(), changes=c), protocol)
        for c in ((), ("saliency.weights=eight_bits",))
    )

    assert own != quantised
