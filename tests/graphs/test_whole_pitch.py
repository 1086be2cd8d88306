"""The tracking graph over a still view of the whole pitch."""

from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from pipeline.cli import check, commands
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.messages import Frame, Message
from pipeline.planner.machine import Machine
from pipeline.run.inline import InlineRunner

GRAPHS = Path(__file__).resolve().parents[2] / "graphs"
SOURCE = GRAPHS / "sources" / "whole_pitch.yaml"
CASES = (
    (GRAPHS / "whole_pitch.yaml", Overlay(clock="lockstep")),
    (
        GRAPHS / "tracking.yaml",
        Overlay(source=SOURCE, changes=("capture.size_px=[3840, 960]",), clock="lockstep"),
    ),
)


@pytest.mark.parametrize("arguments", [["whole_pitch"], ["tracking", "--source", "whole_pitch"]])
def test_the_graph_is_checked_without_a_warning(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    most = 16 << 30
    machine = Machine(
        cores=4, shared_bytes=most, shared_free_bytes=most, memory_bytes=most,
        memory_free_bytes=most,
    )  # fmt: skip
    monkeypatch.setattr(check, "this_machine", lambda: machine)

    result = CliRunner().invoke(commands, ["check", *arguments])

    assert result.exit_code == 0, result.output
    assert "warning" not in result.output


@pytest.mark.parametrize(("path", "overlay"), CASES, ids=["graph", "source"])
def test_it_runs_with_a_context_and_a_region_of_a_sixteenth_each(
    path: Path, overlay: Overlay
) -> None:
    seen: dict[str, list[Any]] = {}

    def watch(output: str, message: Message) -> None:
        if isinstance(message, Frame):  # its pixels are lent
            seen.setdefault(output, []).append((message.size_px, message.window))
        else:
            seen.setdefault(output, []).append(message)

    with InlineRunner(load(path, overlay), watch=watch) as run:
        assert list(run.run(4)) == [0, 1, 2, 3]

    width, height = (7680, 4320) if path.stem == "whole_pitch" else (3840, 960)
    assert seen["capture.context"][0] == ((width // 4, height // 4), (0, 0, width, height))
    sides = [(w[2] - w[0], w[3] - w[1]) for _, w in seen["capture.roi"]]
    assert sides == [(width // 4, height // 4)] * 4
    assert all(len(truth.ids) == 26 for truth in seen["capture.truth"])
    assert len(seen["policy.out"]) == 4
