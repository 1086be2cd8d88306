"""The ball among a detector's candidates in a sequence, over a network whose answers are known."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from bench import ball_candidates
from tests.drivers.sequences import write_sequence
from tests.operators.networks import constant_network

FRAMES = 12
BOXES = [(1, 8, 8, 4), (2, 40, 4, 8), (3, 40, 20, 8), (4, 40, 36, 8), (5, 20, 36, 8)]
# at 64x48: four players who stand, and a ball that lies still, at 8..12 of both sides
GT = "".join(
    f"{k},{i},{left},{top},{side},{side},1,-1,-1,-1\n"
    for k in range(1, FRAMES + 1)
    for i, left, top, side in BOXES
)  # fmt: skip
ROLES = "[Sequence]\ntrackletID_1= ball;1\n" + "".join(
    f"trackletID_{i}= player team left;{i}\n" for i in (2, 3, 4, 5)
)


def weights(folder: Path, place_of_ball: float) -> str:
    """It finds a player, two places that are no ball, and one at `place_of_ball` of the input."""
    rows = np.zeros((1, 300, 6), np.float32)
    rows[0, 0] = (20, 2, 24, 6, 0.9, 0)
    for row, (x, score) in enumerate([(30.0, 0.9), (24.0, 0.8), (place_of_ball, 0.01)]):
        rows[0, row + 1] = (x - 0.5, x * 0.6 - 0.5, x + 0.5, x * 0.6 + 0.5, score, 2)
    return constant_network(
        folder / "n.onnx", rows, size_px=(32, 24), names="['player', 'referee', 'ball']"
    )


def run(*words: str) -> Result:
    return CliRunner().invoke(ball_candidates.main, words)


@pytest.mark.parametrize(("place", "share"), [(5.0, 1.0), (14.0, 0.0)])
def test_a_weak_candidate_counts_if_it_is_among_the_best_three(
    tmp_path: Path, place: float, share: float
) -> None:
    sequence = write_sequence(tmp_path / "s", gt=GT, gameinfo=ROLES, frames=FRAMES)
    path = tmp_path / "figures.json"

    done = run(
        str(sequence), "--weights", weights(tmp_path, place), "--scale", "0.5", "--json", str(path)
    )

    assert done.exit_code == 0, done.output
    report = json.loads(path.read_text())
    assert report["among"] == {"still": {"frames": FRAMES, "share": share}}
    player = next(row for row in report["classes"] if row["class"] == "player")
    assert (player["present"], player["precision"]) == (4 * FRAMES, 1.0)
    assert player["recall"] == 0.25


def test_a_sequence_without_a_ball_is_refused(tmp_path: Path) -> None:
    gt = "".join(line for line in GT.splitlines(keepends=True) if line.split(",")[1] != "1")
    sequence = write_sequence(tmp_path / "s", gt=gt, gameinfo=ROLES, frames=FRAMES)

    done = run(str(sequence), "--weights", weights(tmp_path, 5.0))

    assert done.exit_code == 1
    assert "expected a ball in at least a tenth of the frames, got none" in done.output


def test_a_detector_of_other_classes_is_refused(tmp_path: Path) -> None:
    rows = np.zeros((1, 300, 6), np.float32)
    other = constant_network(tmp_path / "n.onnx", rows, size_px=(32, 24), names="['cat']")
    sequence = write_sequence(tmp_path / "s", gt=GT, gameinfo=ROLES, frames=FRAMES)

    done = run(str(sequence), "--weights", other)

    assert done.exit_code == 1
    assert "classes: expected one of cat, got 'player'" in done.output
