"""Profiles of runs: CPU from samples, what is read back, and files that are no profile."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import SettingsError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan
from pipeline.run.process_handle import Sample
from pipeline.run.recorded_run import as_data, cores_used, digest, profile_of, read_profile
from tests.sample_graphs import CHAIN


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    path = tmp_path / "graph.yaml"
    path.write_text(f"name: profiled\n{CHAIN}")
    return load(path)


def report(plan: Plan, **changes: Any) -> dict[str, Any]:
    """Return what a report says of a run that used half a core for `ticker`."""
    samples = {"ticker": [Sample(float(s), s / 2, 50.0, pid=7) for s in range(5)]}
    profile = profile_of(plan, samples, {"ticker.roi": 4096}, cores=2.0, since_s=0.0)
    whole = {
        "graph": plan.name, "clock": "realtime", "duration_s": 4.0,
        "edges": [{"to": "count.frame", "offered": 80}],
        "stages": [{"node": "count", "handled": 9}],
        "rate": {"frames": 80, "asked_hz": 20.0, "achieved_hz": 20.0},
        "loop": {"latency_ms": {"p50": 1.0, "p99": 2.0}, "commands": 0},
        "profile": as_data(profile),
    }  # fmt: skip
    return {**whole, **changes}


def read(plan: Plan, folder: Path, text: str) -> Any:
    path = folder / "profile.json"
    path.write_text(text)
    return read_profile(path, plan)


def test_what_was_recorded_is_read_back(plan: Plan, tmp_path: Path) -> None:
    run = read(plan, tmp_path, json.dumps(report(plan)))

    assert run.profile.processes["ticker"].cores == 0.5
    assert run.profile.pools == {"ticker.roi": 4096}
    assert run.profile.settings == {node.name: digest(node) for node in plan.nodes}


def test_only_the_newest_instance_counts_and_only_since_the_first_exposure() -> None:
    before = [Sample(0.0, 0.0, 50.0, pid=1), Sample(1.0, 9.0, 50.0, pid=1)]
    loading = [Sample(2.0, 0.0, 50.0, pid=2), Sample(3.0, 1.0, 50.0, pid=2)]
    exposing = [Sample(float(s), 1.0 + (s - 4) * 0.25, 50.0, pid=2) for s in range(4, 9)]

    assert cores_used([*before, *loading, *exposing], 4.0) == 0.25


@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_run_that_is_too_short_has_no_figure(count: int) -> None:
    samples = [Sample(float(s), float(s), 50.0, pid=1) for s in range(count)]

    assert cores_used(samples, 0.0) is None


def test_other_settings_have_another_digest(plan: Plan, tmp_path: Path) -> None:
    faster = load(tmp_path / "graph.yaml", Overlay(changes=("ticker.rate_hz=30",)))

    same = {n.name for n in plan.nodes if digest(n) == digest(faster.node(n.name))}
    assert same == {"count", "glance"}


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"graph": "other"}, "expected a run of profiled, got one of 'other'"),
        ({"profile": None}, "expected a run as processes in real time, got one without a profile"),
        ({"clock": "lockstep"}, "expected a run as processes in real time, got one in 'lockstep'"),
        ({"duration_s": 0.0}, "expected a run of some seconds, got one without figures"),
        ({"rate": {"frames": 0, "achieved_hz": 0.0}}, "expected a run of some seconds"),
        ({"duration_s": -1}, "expected the report of a run: Expected `float` >= 0.0"),
        ({"edges": 5}, "expected the report of a run: Expected `array`, got `int`"),
    ],
)
def test_a_report_that_cannot_be_planned_with_is_one_sentence(
    plan: Plan, tmp_path: Path, changes: dict[str, Any], why: str
) -> None:
    with pytest.raises(SettingsError) as caught:
        read(plan, tmp_path, json.dumps(report(plan, **changes)))

    said = str(caught.value)
    assert said.startswith(f"--profile {tmp_path / 'profile.json'}: {why}")
    assert "\n" not in said


@given(share=st.floats(0, 0.999))
def test_a_truncated_file_is_one_sentence(share: float, tmp_path_factory: Any) -> None:
    folder = tmp_path_factory.mktemp("cut")
    (folder / "graph.yaml").write_text(f"name: profiled\n{CHAIN}")
    plan = load(folder / "graph.yaml")
    whole = json.dumps(report(plan))

    with pytest.raises(SettingsError, match="expected the report of a run: "):
        read(plan, folder, whole[: int(share * len(whole))])


@given(st.binary(max_size=200))
def test_any_other_file_is_one_sentence(tmp_path_factory: Any, data: bytes) -> None:
    folder = tmp_path_factory.mktemp("any")
    (folder / "graph.yaml").write_text(f"name: profiled\n{CHAIN}")
    (folder / "profile.json").write_bytes(data)

    with pytest.raises(SettingsError, match="expected the report of a run: "):
        read_profile(folder / "profile.json", load(folder / "graph.yaml"))


def test_a_file_that_is_nested_too_deeply_is_one_sentence(plan: Plan, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"expected the report of a run: .* recursion depth"):
        read(plan, tmp_path, '{"more": ' + "[" * 100_000)


def test_a_file_that_is_not_there_is_one_sentence(plan: Plan, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"none\.json: cannot be read: No such file"):
        read_profile(tmp_path / "none.json", plan)
