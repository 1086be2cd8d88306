"""The shipped examples: each graph runs, and each operator computes what it documents."""

import secrets
from dataclasses import replace
from pathlib import Path
from typing import Any

import fovea
import numpy as np
import pytest

from operators.examples.blend import Blend
from operators.examples.brighten import Brighten
from operators.examples.meter import Meter, MeterSettings
from operators.examples.motion import Motion, MotionSettings
from pipeline.client.find import find
from pipeline.commands import carry_out
from pipeline.errors import SettingsError
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan
from pipeline.graph.shipped import FOLDER, graph_names
from pipeline.protocol.orders import SwapOrder, SwapResult
from pipeline.run.inline import InlineRunner
from tests.sample_graphs import beside, go, handled, wait_for

NAMES = [name for name in graph_names() if name.startswith("examples/")]


def frame(seq: int, value: float) -> fovea.Frame:
    pixels = np.full((4, 6, 3), value, np.uint8)
    return fovea.Frame(header=fovea.header(seq), pixels=pixels, window=(0, 0, 6, 4))


DEEP = fovea.Frame(
    header=fovea.header(0), pixels=np.full((4, 6), 2000, np.uint16), window=(0, 0, 6, 4),
    pixel_format="bayer_rggb16",
)  # fmt: skip
PACKED = replace(DEEP, pixels=np.zeros((4, 9), np.uint8), pixel_format="bayer_rggb12p")


def delivered(report: dict[str, Any]) -> dict[str, int]:
    return {edge["to"]: edge["delivered"] for edge in report["edges"]}


def test_every_example_has_a_graph_of_its_name() -> None:
    modules = {p.stem for p in (FOLDER.parent / "operators" / "examples").glob("[!_]*.py")}

    assert {name.removeprefix("examples/") for name in NAMES} == modules
    assert len(modules) == 5


@pytest.mark.parametrize("name", NAMES)
def test_every_example_answers_every_frame_in_line(name: str) -> None:
    report = fovea.load(name).run(frames=12)

    assert [s["handled"] for s in report["stages"] if s["node"] != "camera"] == [12] * (
        len(report["stages"]) - 1
    )
    assert set(delivered(report).values()) <= {12}


@pytest.mark.parametrize("name", NAMES)
def test_every_example_answers_every_frame_as_processes(name: str) -> None:
    report = fovea.load(name, clock="lockstep").run(frames=12, processes=True)

    assert set(delivered(report).values()) <= {12}
    assert report["restarts"] == {}


def test_the_square_moves_and_the_stream_ends() -> None:
    seen: list[int] = []
    graph = fovea.load("examples/moving_square", settings={"camera.length": 3})

    graph.run(watch=lambda _output, m: seen.append(int(m.pixels[64, :, 0].argmax())))  # type: ignore[attr-defined]

    assert seen == [0, 2, 4]


def test_the_square_reports_the_rate_asked_for_only_in_real_time() -> None:
    graph = fovea.load(
        "examples/moving_square", settings={"camera.length": 11, "camera.rate_hz": 100}
    )

    real, inline = graph.run(processes=True)["rate"], graph.run()["rate"]

    assert (real["frames"], real["asked_hz"]) == (11, 100)
    assert 0 < real["achieved_hz"] <= 101
    assert (inline["frames"], inline["asked_hz"]) == (11, None)


def test_brighten_clips_at_255_and_keeps_the_window() -> None:
    (bright,) = fovea.drive(Brighten, [frame(0, 200)], {"gain": 1.5})

    assert (bright.pixels == 255).all()
    assert bright.window == (0, 0, 6, 4)


def test_blend_mixes_the_frames_of_one_exposure() -> None:
    (mixed,) = fovea.drive(Blend, [{"left": frame(0, 100), "right": frame(0, 200)}])

    assert (mixed.pixels == 150).all()


@pytest.mark.parametrize(
    ("operator", "given"),
    [(Brighten, DEEP), (Motion, DEEP), (Blend, {"left": DEEP, "right": DEEP})],
)
def test_examples_for_8_bit_pixels_refuse_others(
    operator: type[fovea.Operator[Any, Any]], given: Any
) -> None:
    with pytest.raises(fovea.MessageError, match="expected 8-bit pixels, got uint16"):
        fovea.drive(operator, [given])


@pytest.mark.parametrize(
    ("operator", "given"),
    [
        (Brighten, PACKED),
        (Motion, PACKED),
        (Meter, PACKED),
        (Blend, {"left": PACKED, "right": PACKED}),
    ],
)
def test_examples_take_packed_bytes_for_no_picture(
    operator: type[fovea.Operator[Any, Any]], given: Any
) -> None:
    with pytest.raises(fovea.MessageError, match=r"expected .* got .*bayer_rggb12p"):
        fovea.drive(operator, [given])


@pytest.mark.parametrize("setting", ["step_px", "length"])
def test_a_negative_step_or_length_of_the_square_is_refused(setting: str) -> None:
    with pytest.raises(fovea.SettingsError, match=rf"{setting}: must be at least 0, got -1"):
        fovea.load("examples/moving_square", settings={f"camera.{setting}": -1})


def test_motion_continues_with_the_state_of_another_instance() -> None:
    first, second = (Motion(MotionSettings(rate=0.5)) for _ in range(2))
    first.open()
    for seq, value in enumerate((0, 100, 100)):
        first.on_frame(frame(seq, value))

    second.open()
    second.restore(first.state())

    assert second.state().frames == 3
    assert (second.on_frame(frame(3, 100)).pixels == 25).all()  # 100 - (0 + 50 + 25)


def test_motion_keeps_its_background_over_a_swap_of_processes(tmp_path: Path) -> None:
    plan = renamed(tmp_path, "examples/motion", clock="realtime")
    results: list[SwapResult] = []

    def during(supervisor: Any) -> None:
        wait_for(supervisor, lambda: handled(supervisor, "motion") > 5)
        order = SwapOrder(node="motion", changes={"rate": 0.2}, probation=5, budget_ms=60_000.0)
        results.append(beside(supervisor, lambda: find(plan.name).swap(order)))
        supervisor.finish()

    go(plan, 0, during)

    assert results[0].state == "carried over"


def test_the_limit_of_the_meter_changes_while_it_runs() -> None:
    plan = load(FOLDER / "examples" / "meter.yaml", Overlay(clock="lockstep"))
    with InlineRunner(plan) as runner:
        frames = runner.run(10)
        next(frames)
        runner.change("meter", {"alarm_above": 1.0})
        list(frames)

        assert runner.report()["brightness"] == {"frames": 10, "alarms": 9}


def test_the_meter_carries_out_its_commands() -> None:
    meter = Meter(MeterSettings())
    meter.open()
    for seq, value in enumerate((5, 9, 7)):
        meter.on_frame(frame(seq, value))

    told = carry_out("meter", meter, "brightest", {"count": 2})
    with pytest.raises(SettingsError, match=r"^brightest\.count: must be at least 1, got 0$"):
        carry_out("meter", meter, "brightest", {"count": 0})
    carry_out("meter", meter, "forget", {})

    assert told == {"frames": [1, 2], "means": [9.0, 7.0]}
    assert meter.summary()["brightness"] == {"frames": 0, "alarms": 0}


def renamed(folder: Path, name: str, **overlay: Any) -> Plan:
    """Load a shipped graph under a name that no other run of this user has."""
    text = (FOLDER / f"{name}.yaml").read_text()
    own = f"name: e-{secrets.token_hex(3)}"
    lines = [own if line.startswith("name:") else line for line in text.splitlines()]
    path = folder / "graph.yaml"
    path.write_text("\n".join(lines))
    return load(path, Overlay(**overlay))
