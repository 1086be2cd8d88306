"""The paper's prototype: plans of 200 frames, bursts that a board records, previews between."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.virtual_board.profiles import PROFILES
from pipeline.cli import check, commands
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.messages import Frame, Message, RoiSchedule, Tracks
from pipeline.planner.machine import Machine
from pipeline.run.inline import InlineRunner

GRAPH = Path(__file__).resolve().parents[2] / "graphs" / "prototype.yaml"
BURST, INTERVAL = 12, 180
SMALL = (
    "capture.options.backend_options.size_px=[3264, 1840]",
    f"capture.options.burst_frames={BURST}",
)


@pytest.fixture(scope="module")
def heard() -> dict[str, list[Any]]:
    """Everything that three plans lead to, on a sensor of a fifth of the sides."""
    kept: dict[str, list[Any]] = {}

    def watch(output: str, message: Message) -> None:
        if isinstance(message, Frame):  # its pixels are lent
            window, size = message.window, message.pixels.size
            kept.setdefault(output, []).append(
                (message.header.seq, window, size, message.command_seq)
            )
        else:
            kept.setdefault(output, []).append(message)

    plan = load(GRAPH, Overlay(changes=SMALL, clock="lockstep"))
    with InlineRunner(plan, watch=watch) as run:
        for _ in run.run(150):
            if len(kept.get("dispatch.out", ())) >= 3 and not kept["capture.roi"][-1][2]:
                break
    return kept


def recorded(heard: dict[str, list[Any]], made_from: int) -> list[tuple[int, Any]]:
    """Return number and window of the frames that a plan directed."""
    frames = heard["capture.roi"]
    return [(seq, w) for seq, w, size, command in frames if size and command == made_from]


def test_the_graph_is_checked_without_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    most = 16 << 30
    machine = Machine(
        cores=4, shared_bytes=most, shared_free_bytes=most, memory_bytes=most,
        memory_free_bytes=most,
    )  # fmt: skip
    monkeypatch.setattr(check, "this_machine", lambda: machine)

    result = CliRunner().invoke(commands, ["check", str(GRAPH)])

    assert result.exit_code == 0, result.output
    assert "warning" not in result.output


@pytest.mark.lengthy
def test_plans_have_200_windows_and_come_every_180_frames(heard: dict[str, list[Any]]) -> None:
    plans: list[RoiSchedule] = heard["dispatch.out"]

    assert [len(plan.windows) for plan in plans] == [200] * 3
    assert [plan.first_seq for plan in plans] == [37, 37 + INTERVAL, 37 + 2 * INTERVAL]


@pytest.mark.lengthy
def test_every_plan_is_recorded_as_a_burst_whose_windows_are_its_own(
    heard: dict[str, list[Any]],
) -> None:
    for plan in heard["dispatch.out"][:2]:
        burst = recorded(heard, plan.header.seq)

        assert [seq for seq, _ in burst] == list(range(burst[0][0], burst[0][0] + BURST))
        for seq, window in burst:
            assert window == tuple(plan.windows[seq - plan.first_seq])


@pytest.mark.lengthy
def test_previews_have_no_region_and_come_every_fourth_frame(heard: dict[str, list[Any]]) -> None:
    previews = [seq for seq, _, size, _ in heard["capture.roi"] if not size]

    assert not any(seq % 4 for seq in previews)
    assert previews[:10] == list(range(0, 40, 4))


@pytest.mark.lengthy
def test_tracks_hold_ten_frames_and_foresee_200(heard: dict[str, list[Any]]) -> None:
    tracks: list[Tracks] = heard["association.out"]

    assert tracks[-1].boxes.shape[1] == 10
    assert tracks[-1].predicted.shape[1] == 200
    assert any(len(each.ids) >= 5 for each in tracks)


def test_the_geometry_is_the_papers() -> None:
    plan = load(GRAPH)
    options = plan.node("capture").settings["options"]
    can = PROFILES[options["backend_options"]["profile"]].can

    assert (can.width_px, can.height_px) == (16_320, 9_184)
    assert can.context_px == (2040, 1148)
    assert (can.roi_sizes[0].width_px, can.roi_sizes[0].height_px) == (4080, 2296)
    assert np.isclose(can.preview_mhz, 7500)
