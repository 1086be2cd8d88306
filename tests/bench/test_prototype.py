"""The prototype's figures: lines of a run in, cycles, delays and shares out."""

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.prototype import delay_rows, share_rows
from bench.prototype_cycles import Cycle, Cycles, Recording, cycles_of, shares
from bench.prototype_objects import Prompter, class_rows, prompt_rows
from drivers.scenes import PanoramaScene
from drivers.source import Annotations
from pipeline.boxes import centres, roi_window
from pipeline.errors import SettingsError
from pipeline.messages import Frame, Geometry, RoiSchedule, Scanpath
from pipeline.testing import drive, header

PERIOD_NS = 33_333_333
READOUT, COMPUTE = 29, 3  # frames


def frame(seq: int, *, command_seq: int = -1) -> dict[str, Any]:
    stamp_ns = seq * PERIOD_NS
    return {
        "kind": "frame", "seq": seq, "stamp_ns": stamp_ns, "window": [0, 0, 40, 20],
        "command_seq": command_seq, "status": "ok", "recorded": command_seq >= 0,
        "captured_ns": stamp_ns + READOUT * PERIOD_NS,
    }  # fmt: skip


def plan(seq: int) -> dict[str, Any]:
    captured = (seq + READOUT) * PERIOD_NS
    spans = [
        ["capture", 0, captured, 0],
        ["saliency", captured, captured + PERIOD_NS, PERIOD_NS],
        ["dispatch", captured + PERIOD_NS, captured + COMPUTE * PERIOD_NS, 1],
    ]
    return {"kind": "plan", "seq": seq, "stamp_ns": 0, "first_seq": seq + 1, "frames": 200,
            "spans": spans}  # fmt: skip


def two_cycles() -> list[dict[str, Any]]:
    lines = []
    for start in (0, 400):
        lines += [frame(start + k) for k in range(0, 40, 4)]
        lines.insert(len(lines) - 1, plan(start + 36))
        lines += [frame(start + 69 + k, command_seq=start + 36) for k in range(105)]
    return lines


def test_a_cycle_is_over_when_a_preview_comes_after_its_burst() -> None:
    lines = two_cycles()

    assert len(cycles_of(lines)) == 1
    assert len(cycles_of([*lines, frame(800)])) == 2


def test_the_delay_is_the_sum_of_its_parts() -> None:
    cycles = cycles_of([*two_cycles(), frame(800)])

    rows = {row["part"]: row for row in delay_rows(cycles)}

    whole = rows["the plan's newest context to the first frame that it directs"]
    assert (whole["median"], whole["min"], whole["max"], whole["paper"]) == (33, 33, 33, 60)
    assert rows["read-out and transfer of the context"]["median"] == pytest.approx(
        READOUT, abs=0.01
    )
    assert rows["the graph"]["median"] == pytest.approx(COMPUTE, abs=0.01)
    assert rows["command, until the exposure that obeys it"]["median"] == pytest.approx(1, abs=0.01)
    assert cycles[0].planned == 200
    assert cycles[0].stages_ms["saliency"] == pytest.approx(33.3, abs=0.1)


def test_the_shares_are_those_of_the_true_boxes_in_the_windows() -> None:
    world = PanoramaScene(size_px=(1600, 912), seed=2)
    geometry = Geometry(
        width_px=1600, height_px=912, roi_width_px=400, roi_height_px=228, step_px=2
    )
    seqs = tuple(range(70, 175))
    windows = [roi_window(centres(world.truth(seq).boxes[0]), geometry) for seq in seqs]
    cycle = Cycle(
        made_from=36, first=70, seqs=seqs, windows=np.array(windows, np.int32), planned=200,
        readout_ms=0.0, compute_ms=0.0, stages_ms={},
    )  # fmt: skip

    found = shares(cycle, world)

    assert found["ball"] == found["ball 1"] == pytest.approx(1)
    assert {name for name in found if " " not in name} == {"ball", "player", "referee"}
    assert len([name for name in found if name.startswith("player ")]) == 9
    assert all(0 <= share <= 1 for share in found.values())
    (row,) = share_rows({"ball": [found]})
    assert row["ball"] == row["itself, median"] == 1.0


def test_the_node_writes_what_the_cycles_are_read_from(tmp_path: Path) -> None:
    path = tmp_path / "cycles.jsonl"
    roi = Frame(
        header=header(7), pixels=np.zeros((4, 4), np.uint8), pixel_format="bayer_rggb8",
        window=(0, 0, 4, 4), command_seq=3,
    )  # fmt: skip
    schedule = RoiSchedule(
        header=header(7), first_seq=8, windows=np.zeros((200, 4), np.int32), scanpath_seq=7
    )

    scanpath = Scanpath(
        header=header(7), ids=np.array([5], np.int32), probability=np.ones((1, 1), np.float32),
        choice=np.array([5], np.int32), boxes=np.ones((1, 4), np.float32), first_seq=8,
    )  # fmt: skip

    messages = [{"roi": roi}, {"schedule": schedule}, {"scanpath": scanpath}]
    drive(Cycles, messages, {"path": str(path)})
    with path.open("a", encoding="utf-8") as file:
        file.write('{"kind": "fra')  # it is being written

    recording = Recording(path=path)
    assert recording.update()
    one, two, three = recording.lines
    assert (one["kind"], one["seq"], one["command_seq"], one["recorded"]) == ("frame", 7, 3, True)
    assert (two["kind"], two["first_seq"], two["frames"]) == ("plan", 8, 200)
    assert (three["kind"], three["seq"], three["object"]) == ("aim", 7, 5)
    assert not recording.update()
    with path.open("a", encoding="utf-8") as file:
        file.write('me", "seq": 8, "recorded": false}\n')
    assert recording.update()
    assert (recording.newest_preview, recording.newest_aim, recording.aimed_at) == (8, 7, 5)


class Boxes:
    """A world of three objects that move to the right."""

    def truth(self, index: int) -> Annotations:
        left = np.array([0, 100, 200], np.float32) + index
        boxes = np.stack([left, np.zeros(3), left + 20, np.full(3, 20)], -1).astype(np.float32)
        return Annotations(
            boxes=boxes, ids=np.array([1, 2, 3], np.int32),
            labels=("ball", "goalkeeper", "main referee"), visibility=np.ones(3, np.float32),
        )  # fmt: skip


def fed(path: Path, lines: Iterable[dict[str, Any]], prompter: Prompter) -> list[Any]:
    """Return what the prompter asks for as line after line is written."""
    recording, asked = Recording(path=path), []
    for line in lines:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        recording.update()
        prompter.watch(recording, asked.append)
    return asked


def preview(seq: int) -> dict[str, Any]:
    return {"kind": "frame", "seq": seq, "recorded": False}


def aim(seq: int, found: int) -> dict[str, Any]:
    return {"kind": "aim", "seq": seq, "object": found}


def test_a_prompt_is_the_box_in_the_next_preview_and_repeated_until_found(tmp_path: Path) -> None:
    prompter = Prompter(world=Boxes(), objects=[2], each=1)  # type: ignore[arg-type]
    lines = [preview(0), aim(0, -1), preview(4), aim(4, -1), preview(8), aim(8, -1), preview(12)]

    asked = fed(tmp_path / "lines", [*lines, aim(12, -1), preview(16), aim(16, 7)], prompter)

    assert [own["prompt_box"][0] for own in asked] == [104, 112]
    fed(tmp_path / "more", [preview(20), aim(20, -1), preview(24)], prompter)
    assert len(prompter.asked) == 2


def test_every_object_has_its_bursts_after_the_first_cycle(tmp_path: Path) -> None:
    prompter = Prompter(world=Boxes(), objects=[1, 2, 3], each=2)  # type: ignore[arg-type]
    burst = {"kind": "frame", "seq": 30, "recorded": True}
    lines = [line for k in range(8) for line in (preview(100 * k), burst)]

    fed(tmp_path / "lines", lines, prompter)

    assert [own for _, own in prompter.asked] == [1, 1, 1, 2, 2, 3, 3, 3]


def test_an_object_is_judged_by_the_bursts_whose_plan_came_after_its_prompt() -> None:
    prompter = Prompter(world=Boxes(), objects=[1, 2], each=1, asked=[(4, 1), (400, 2)])  # type: ignore[arg-type]
    first = Cycle(
        made_from=36, first=70, seqs=(70,), windows=np.array([[0, 0, 80, 40]], np.int32),
        planned=200, readout_ms=0.0, compute_ms=0.0, stages_ms={},
    )  # fmt: skip

    rows = prompt_rows(prompter, [first, replace(first, made_from=436)], Boxes())  # type: ignore[arg-type]

    assert [row["object"] for row in rows] == ["ball 1", "player 2"]
    assert [row["mean"] for row in rows] == [0.5, 0.0]
    assert [row["bursts that show it"] for row in rows] == [1, 0]


def test_objects_of_a_class_have_rows_of_their_own() -> None:
    cycles = [{"ball": 0.2, "player": 0.5, "player 10": 1.0, "player 2": share} for share in (0, 1)]

    rows = class_rows({"player": cycles})

    assert [row["object"] for row in rows] == ["player 2", "player 10"]
    assert (rows[0]["mean"], rows[0]["min"], rows[0]["max"]) == (0.5, 0, 1)
    assert (rows[0]["bursts that show it"], rows[0]["bursts"]) == (1, 2)


def test_the_node_needs_a_file() -> None:
    with pytest.raises(SettingsError, match="path: expected a file to write, got nothing"):
        drive(Cycles, [], {})
