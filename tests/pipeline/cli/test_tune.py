"""`fovea tune` measures what a graph's nodes take, and writes settings that a run accepts."""

import json
import shlex
from pathlib import Path

import pytest

from pipeline.cli.tune import changes_of, command_with, ways_of, with_given, yaml_of
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay, read_settings
from pipeline.graph.shipped import graph_path
from pipeline.planner.thread_plan import Choice, Way
from pipeline.providers import NetworkSettings
from pipeline.run.stage_times import WARM_UP, record, replayed
from tests.commands import command
from tests.sample_graphs import CHAIN, together


@pytest.mark.lengthy
def test_every_network_is_measured_and_the_rest_counted() -> None:
    done = command("tune", "tracking", "--frames", "5", "--threads", "1", "--rate", "1", "--json")

    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert set(found["nodes"]) == {"saliency", "closer", "roi_features", "policy", "tracker"}
    assert all(node["in_time"] for node in found["nodes"].values())
    assert found["nodes"]["saliency"]["now"]["cpu_ms"] > 0.5
    assert found["cores_needed"] > 0
    assert found["settings"] == {}  # nothing else was tried


def test_a_node_is_replayed_on_what_the_graph_gave_it() -> None:
    plan = load(graph_path("tracking"))
    kept = record(plan, ["saliency", "tracker"], 4, 30)

    assert kept.frames == WARM_UP + 4
    assert all(len(calls) == kept.frames for calls in kept.calls.values())
    assert all(len(frame) == 1 for frame in kept.calls["saliency"])
    once = replayed(plan.node("saliency"), {"threads": 2}, kept.calls["saliency"])
    assert once.wall_ms > 0


def test_proposed_settings_are_a_file_that_a_graph_takes(tmp_path: Path) -> None:
    now, new = (
        Way(threads=threads, provider=provider, wall_ms=1, cpu_ms=1)
        for threads, provider in ((1, "auto"), (2, "openvino"))
    )
    choices = {"saliency": Choice(now=now, chosen=new, in_time=True)}
    path = tmp_path / "tuned.yaml"
    path.write_text(yaml_of(changes_of(choices), "tracking", 30))

    values = tuple(read_settings(path))

    assert values == (("saliency", "threads", 2), ("saliency", "provider", "openvino"))
    assert load(graph_path("tracking"), Overlay(values=values)).node("saliency").settings == {
        **load(graph_path("tracking")).node("saliency").settings,
        "threads": 2, "provider": "openvino",
    }  # fmt: skip


def test_a_run_takes_the_file(tmp_path: Path) -> None:
    good, bad = tmp_path / "good.yaml", tmp_path / "bad.yaml"
    good.write_text("policy: {target: player}\n")
    bad.write_text("\npolicy: player\n")

    assert command("check", "tracking", "--settings", str(good)).returncode == 0
    told = command("check", "tracking", "--settings", str(bad))
    assert told.returncode == 2
    assert f"{bad}:2: settings.policy: expected a mapping" in told.stderr


def test_the_command_that_is_told_can_be_copied() -> None:
    changes = ("capture.path=my clip.mp4", "policy.target=player")

    told = command_with(
        Path("g.yaml"), Path("tu ne.yaml"), source=Path("video.yaml"), changes=changes,
        clock="lockstep", wanted=("visualise",),
    )  # fmt: skip

    assert shlex.split(told) == [
        "fovea", "run", "g.yaml", "--source", "video.yaml", "--set", "capture.path=my clip.mp4",
        "--set", "policy.target=player", "--with", "visualise", "--clock", "lockstep",
        "--settings", "tu ne.yaml",
    ]  # fmt: skip


def test_settings_that_were_given_stay_beside_those_that_were_found(tmp_path: Path) -> None:
    given = tmp_path / "own.yaml"
    given.write_text("policy: {target: player}\nsaliency: {threads: 3, weights: corners}\n")

    assert with_given({"saliency": {"threads": 1}}, given) == {
        "policy": {"target": "player"}, "saliency": {"threads": 1, "weights": "corners"},
    }  # fmt: skip
    assert with_given({"saliency": {"threads": 1}}, None) == {"saliency": {"threads": 1}}


def test_what_is_tried_is_what_the_node_does_not_have() -> None:
    assert [settings for _, settings in ways_of(NetworkSettings(), 3)][:2] == [
        {"threads": 2}, {"threads": 3},
    ]  # fmt: skip
    assert (1, {"threads": 1, "provider": "cpu"}) in ways_of(NetworkSettings(provider="cuda"), 1)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--rate", "0"), "0.1<=x<=10000"),
        (("--rate", "nan"), "nan is no finite number"),
        (("--out", "/proc/none/tuned.yaml"), "/proc/none/tuned.yaml"),
    ],
)
def test_wrong_options_are_one_sentence(words: tuple[str, ...], sentence: str) -> None:
    done = command("tune", "tracking", "--frames", "5", "--threads", "1", *words)

    assert done.returncode in (1, 2)
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr


def test_a_graph_without_networks_has_nothing_to_tune(tmp_path: Path) -> None:
    path = tmp_path / "graph.yaml"
    path.write_text(f"name: plain\n{together(CHAIN, 'ticker', 'count', 'glance')}")

    done = command("tune", str(path), "--rate", "10")
    unknown = command("tune", str(path))

    assert "expected a node with a setting `threads`, got none" in done.stderr
    assert "its source tells no rate before it runs: give --rate" in unknown.stderr
