"""The prototype's figures: lines of a run in, cycles, delays and shares out."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.prototype import delay_rows, share_rows
from bench.prototype_cycles import Cycle, Cycles, cycles_of, read_lines, shares
from drivers.scenes import PanoramaScene
from pipeline.boxes import centres, roi_window
from pipeline.errors import SettingsError
from pipeline.messages import Frame, Geometry, RoiSchedule
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
    assert rows["command, until the next exposure"]["median"] == pytest.approx(1, abs=0.01)
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

    drive(Cycles, [{"roi": roi}, {"schedule": schedule}], {"path": str(path)})
    with path.open("a", encoding="utf-8") as file:
        file.write('{"kind": "fra')  # it is being written

    one, two = read_lines(path)
    assert (one["kind"], one["seq"], one["command_seq"], one["recorded"]) == ("frame", 7, 3, True)
    assert (two["kind"], two["first_seq"], two["frames"]) == ("plan", 8, 200)
    assert json.dumps(one)


def test_the_node_needs_a_file() -> None:
    with pytest.raises(SettingsError, match="path: expected a file to write, got nothing"):
        drive(Cycles, [], {})
