"""Training of the consumer: it learns, exports what the live operator reads, and resumes."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")
import torch
from click.testing import CliRunner

from operators.manipulation import data
from operators.manipulation.model import ActNet, Shape, export, loss_of
from operators.manipulation.network import ActNetwork
from operators.manipulation.picture import PICTURE_PX
from operators.manipulation.train import command
from operators.manipulation.training_settings import TrainSettings
from pipeline.errors import SettingsError

needs_robot = pytest.mark.skipif(
    not (find_spec("mujoco") and find_spec("gym_aloha")), reason="needs the robot extra"
)
SMALL = Shape(chunk=10, points=4, width=16, heads=2, inner=16, layers=1, style=2)


def net(seed: int = 1) -> ActNet:
    torch.manual_seed(seed)
    return ActNet(SMALL, torch.zeros(14), torch.ones(14))


def pictures(count: int, seed: int = 2) -> torch.Tensor:
    random = np.random.default_rng(seed)
    return torch.from_numpy(
        random.integers(0, 255, (count, PICTURE_PX[1], PICTURE_PX[0], 3), np.uint8)
    )


def test_the_error_falls_where_targets_follow_from_the_joints() -> None:
    subject, shown = net(), pictures(4)
    joints = torch.randn(4, 14, generator=torch.Generator().manual_seed(3))
    targets = joints[:, None].expand(-1, SMALL.chunk, -1)
    places = torch.full((4, 2, 2), torch.nan)
    optimiser = torch.optim.Adam(subject.parameters(), 1e-2)
    errors = []

    for _ in range(40):
        loss, error = loss_of(subject, shown, joints, targets, places, divergence=0.01, guide=1.0)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        errors.append(float(error))

    assert errors[-1] < 0.5 * errors[0]


def test_a_guided_point_follows_an_object_and_others_are_free() -> None:
    corners = [(20, 10), (200, 20), (60, 90), (150, 60)]
    shown = torch.full((4, PICTURE_PX[1], PICTURE_PX[0], 3), 90, dtype=torch.uint8)
    for picture, (left, top) in zip(shown, corners, strict=True):
        picture[top : top + 8, left : left + 20] = torch.tensor([200, 20, 20], dtype=torch.uint8)
    centres = (torch.tensor(corners) + torch.tensor([10, 4])) / torch.tensor(PICTURE_PX) * 2 - 1
    places = torch.stack([centres, torch.full_like(centres, torch.nan)], 1)
    joints, targets = torch.zeros(4, 14), torch.zeros(4, SMALL.chunk, 14)

    def left_of_distance(seed: int) -> float:
        """Return how much of the mean distance to the object training leaves."""
        subject = net(seed)
        optimiser = torch.optim.Adam(subject.parameters(), 1e-2)
        before = apart(subject)
        for _ in range(40):
            loss, _ = loss_of(subject, shown, joints, targets, places, divergence=0.01, guide=2.0)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        assert bool(torch.isfinite(loss))
        return apart(subject) / before

    def apart(subject: ActNet) -> float:
        return float((subject.eyes(shown)[:, 0, :2] - centres).abs().mean().detach())

    # of five first weights, two end beyond half the distance: no claim about any single one
    assert min(left_of_distance(seed) for seed in (1, 2, 4)) < 0.4


def test_the_exported_network_answers_as_the_trained_one(tmp_path: Path) -> None:
    subject, shown, joints = net().eval(), pictures(1), torch.randn(1, 14)
    with torch.no_grad():
        expected = subject(shown, joints)[0].numpy()

    export(subject, tmp_path / "act.onnx")
    read = ActNetwork(tmp_path / "act.onnx")

    found = read(shown[0].numpy(), joints[0].numpy())
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert (read.picture_px, read.workplace[0]) == (PICTURE_PX, 0.2)


def test_a_disturbance_pushes_the_arms_and_never_grippers_or_while_objects_are_taken() -> None:
    push = data.disturbance(np.random.default_rng(4))

    assert not push[:, data.GRIPPERS].any()
    assert np.abs(push[160:220]).max() < 1e-3
    assert 0.5 < push[:120, :6].std() / data.DISTURBED_RAD < 1.5


@needs_robot
def test_a_demonstration_keeps_the_experts_targets_though_the_arms_are_pushed() -> None:
    from drivers.scenes.insertion import demonstration

    found = data.demonstrated(80_001, frames=3)

    np.testing.assert_array_equal(found["targets"], demonstration(80_001))
    assert found["pictures"].shape == (3, PICTURE_PX[1], PICTURE_PX[0], 3)
    assert (np.diff(found["steps"]) > 0).all()
    # before each picture the arms are near where the targets said, but not there
    before = found["targets"][found["steps"][1:] - 1, :6]
    assert 1e-3 < np.abs(found["joints"][1:, :6] - before).max() < 0.3


@needs_robot
def test_a_training_records_trains_resumes_and_refuses_other_settings(tmp_path: Path) -> None:
    def ran(**changes: int) -> Any:
        values = {
            "demonstrations": 2, "frames": 2, "iterations": 2, "batch": 2, "chunk": 20,
            "trials": 0, "threads": 1,
        } | changes  # fmt: skip
        options = [f"--{name}={value}" for name, value in values.items()]
        folders = ["--data", str(tmp_path / "data"), "--out", str(tmp_path / "out")]
        return CliRunner().invoke(command, [*folders, "--device=cpu", *options])

    first, again, other = ran(), ran(), ran(batch=3)

    assert (first.exit_code, again.exit_code) == (0, 0), first.output
    assert ActNetwork(tmp_path / "out" / "act.onnx").picture_px == PICTURE_PX
    assert other.exit_code == 2
    assert "batch: this folder's training has 2, got 3" in other.output


@pytest.mark.parametrize("wrong", [{"batch": 0}, {"rate": 0.0}, {"device": "gpu"}, {"trials": -1}])
def test_settings_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        TrainSettings(data=Path(), out=Path(), **wrong)
