"""A whole plan: streams through nodes, every refusal, and tables of any width."""

from pathlib import Path
from typing import Any

import pytest
from rich.console import Console, Group

from pipeline.contract import settings_of
from pipeline.errors import FoveaError, GraphError, SettingsError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan, load_operator
from pipeline.planner.machine import Machine, this_machine
from pipeline.planner.planner import Examination, examine
from pipeline.planner.tables import tables
from pipeline.run.recorded_run import digest
from pipeline.settings import build
from tests.pipeline.planner.test_cpu_plan import run as recorded

ROOT = Path(__file__).resolve().parents[3]
PARTS = "tests.pipeline.planner.parts"
GRAPH = f"""\
name: seen
nodes:
  eye:
    operator: {PARTS}:Eye
    settings: {{}}
  half:
    operator: {PARTS}:Half
    inputs: {{frame: eye}}
  count:
    operator: tests.samples:Count
    inputs: {{frame: half}}
  quarter:
    operator: {PARTS}:Half
    inputs: {{frame: half}}
"""
GIB = 1 << 30
LARGE = Machine(
    cores=4,
    shared_bytes=GIB,
    shared_free_bytes=GIB,
    memory_bytes=4 * GIB,
    memory_free_bytes=2 * GIB,
)


def planned(path: Path, *changes: str, text: str = GRAPH) -> Plan:
    (path / "graph.yaml").write_text(text)
    return load(path / "graph.yaml", Overlay(changes=changes))


def examined(plan: Plan, machine: Machine = LARGE, **more: Any) -> Examination:
    settings = {
        n.name: build(settings_of(load_operator(n.operator)), n.settings, n.name)
        for n in plan.nodes
    }
    return examine(plan, settings, machine, **more)


def test_streams_follow_from_the_source_through_the_nodes(tmp_path: Path) -> None:
    found = examined(planned(tmp_path))

    assert [(row.output, row.size_px, row.frame_bytes) for row in found.streams] == [
        ("eye", (640, 480), 921_600),
        ("half", (320, 480), 460_800),
        ("quarter", (160, 480), 230_400),
    ]
    assert [row.output for row in found.pools.rows] == ["eye", "half"]
    assert not [*found.refusals, *found.warnings, *found.notes]


def test_what_does_not_fit_its_link_is_refused_and_the_rest_is_still_planned(
    tmp_path: Path,
) -> None:
    plan = planned(tmp_path, "eye.kind=usb2", "eye.rate_hz=100")

    found = examined(plan)

    (said,) = found.refusals
    assert said == (
        "eye: link: expected up to 53 MB/s over USB 2, got 92: 640x480 rgb8 at 100 Hz; at most "
        "57.7 Hz"
    )
    assert len(found.streams) == 3


def test_a_link_given_with_the_command_counts_instead_of_the_stated_one(tmp_path: Path) -> None:
    plan = planned(tmp_path, "eye.kind=usb2", "eye.rate_hz=100")

    assert not examined(plan, link="usb3.0").refusals


def test_everything_that_cannot_work_is_refused_at_once(tmp_path: Path) -> None:
    plan = planned(tmp_path, "eye.kind=usb2", "eye.rate_hz=100")
    small = Machine(
        cores=0.1,
        shared_bytes=10_000,
        shared_free_bytes=9,
        memory_bytes=10_000,
        memory_free_bytes=9,
    )
    run = recorded(plan)

    found = examined(plan, small, run=run)

    assert [said.split(":")[0] for said in found.refusals] == ["eye", "pools", "pools", "CPU"]


def test_a_rate_that_is_not_known_leaves_the_link_open(tmp_path: Path) -> None:
    found = examined(planned(tmp_path, "eye.rate_hz=0", "eye.kind=usb2"))

    assert found.links[0].needed_bytes_per_s is None
    assert set(found.links[0].verdicts.values()) == {"not known"}
    assert not found.refusals
    assert [row.pool_bytes for row in found.pools.rows] == [
        4096 + 11 * 921_600,
        4096 + 20 * 462_848,
    ]


@pytest.mark.parametrize(
    ("change", "error", "why"),
    [
        ("eye.pixel_format=yuv7", SettingsError, "eye: pixel_format: expected pixels as rgb8"),
        ("eye.rate_hz=-1", SettingsError, "eye.rate_hz: expected a number from 0 on, got -1"),
        ("eye.fault=raises", GraphError, "parts.py:29: ZeroDivisionError: no rate"),
        ("eye.fault=nonsense", GraphError, "expected a Forecast of PictureStreams, got '30 Hz'"),
        ("eye.fault=streams", GraphError, "expected a Forecast of PictureStreams, got "),
    ],
)
def test_what_an_operator_states_wrongly_is_one_sentence(
    tmp_path: Path, change: str, error: type[FoveaError], why: str
) -> None:
    plan = planned(tmp_path, change)

    with pytest.raises(error) as caught:
        examined(plan)

    assert why in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_sensor_is_only_asked_when_it_may_be_and_is_here(tmp_path: Path) -> None:
    away = "hosts: [far]\n" + GRAPH.replace("inputs:", "host: far\n    inputs:").replace(
        "settings: {}", "host: far"
    )

    assert examined(planned(tmp_path), ask=True).notes == ("eye: it was asked",)
    assert not examined(planned(tmp_path)).notes
    assert not examined(planned(tmp_path, text=away), ask=True).notes


def test_operators_that_state_nothing_are_shown_as_not_known(tmp_path: Path) -> None:
    plan = planned(tmp_path, text=GRAPH.replace(f"{PARTS}:Eye", "tests.samples:Ticker").replace(
        "frame: eye", "frame: eye.context"
    ))  # fmt: skip

    found = examined(plan)

    assert examined(plan, link="usb2").warnings == (
        "eye: link: not known whether what it sends fits USB 2",
    )
    assert {(row.size_px, row.bytes_per_s) for row in found.streams} == {(None, None)}
    assert not [*found.links, *found.refusals, *found.warnings]
    assert "not known" in "\n".join(lines_of(found, 80))


def test_the_shipped_graph_is_planned_down_to_its_delay() -> None:
    plan = load(ROOT / "graphs" / "tracking.yaml")

    found = examined(plan, this_machine())

    (delay,) = found.delays
    assert (delay.horizon_frames, delay.replan_frames, delay.rate_hz) == (16, 1, 30)
    assert [(row.of, row.frames, row.coverage) for row in delay.rows] == [("sensor", 0, 1.0)]
    assert found.streams[0].bytes_per_s == 480 * 270 * 3 * 30


def lines_of(found: Examination, width: int) -> list[str]:
    console = Console(width=width)
    with console.capture() as caught:
        console.print(Group(*tables(found, "graphs/tracking.yaml")))
    return caught.get().splitlines()


@pytest.mark.parametrize("width", [80, 50, 30])
def test_tables_fit_and_name_every_output_and_link(width: int) -> None:
    plan = load(ROOT / "graphs" / "tracking.yaml")
    run = recorded(plan)
    assert run.profile is not None
    run.profile.settings.update({node.name: digest(node) for node in plan.nodes})

    lines = lines_of(examined(plan, run=run), width)

    firsts = {line.split()[0] for line in lines if line.split()}
    assert max(map(len, lines)) <= width
    assert {"capture.context", "capture.roi", "downsample", "USB", "GigE", "sensor"} <= firsts
    assert ("too narrow for: " in " ".join(lines)) == (width < 80)
    if width >= 50:
        assert sum("fits" in line for line in lines) == 4


def test_without_a_profile_the_command_that_records_one_is_shown() -> None:
    plan = load(ROOT / "graphs" / "tracking.yaml")

    text = " ".join(" ".join(lines_of(examined(plan), 80)).split())

    assert "CPU: no profile: run `fovea run graphs/tracking.yaml --duration-s 30 --report" in text
    assert "what the loop adds is not known without a profile" in text


def test_pictures_that_cross_to_another_host_are_summed_by_pair() -> None:
    found = examined(load(ROOT / "graphs" / "multi_host.yaml"))

    pairs = {(row.source, row.target): row for row in found.hosts}
    one = 480 * 270 * 3 * 30
    assert {pair: row.bytes_per_s for pair, row in pairs.items()} == {
        ("sensor", "compute"): 2 * one,
        ("sensor", "viewer"): 2 * one,
    }
    assert pairs["sensor", "compute"].edges == ("saliency.frame", "roi_features.roi")
    assert "over GigE" in "\n".join(lines_of(found, 80))
