"""The detector of what a robot handles: its maps, its loss, and what its export tells Saliency."""

import signal
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")
import torch
from click.testing import CliRunner

from operators.saliency import Saliency, SaliencySettings
from operators.saliency.objects import train
from operators.saliency.objects.data import CONTEXT_PX, maps_of, pictures
from operators.saliency.objects.model import CELL_PX, INPUT_PX, ObjectNet, export, loss_of
from pipeline import Frame, Geometry, Header

SIZE = INPUT_PX[1] // CELL_PX, INPUT_PX[0] // CELL_PX
BOXES = np.array([[10, 20, 18, 22], [60, 40, 70, 50]], np.float32)
STEPS = 100

needs_robot = pytest.mark.skipif(
    not (find_spec("mujoco") and find_spec("gym_aloha")), reason="needs the robot extra"
)


def test_maps_tell_the_boxes_at_and_around_their_centres() -> None:
    heat, told, weight = maps_of(BOXES, SIZE, CELL_PX)

    assert np.argwhere(heat[0] == 1).tolist() == [[10, 7], [22, 32]]
    assert told[:, 10, 7].tolist() == [14, 21, 8, 2]
    assert weight.sum() > 2
    assert not maps_of(BOXES[:, [0, 1, 0, 3]], SIZE, CELL_PX)[0].any()  # without a width


def test_an_interrupted_training_says_that_it_begins_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "train", interrupted)

    before = signal.getsignal(signal.SIGINT)
    try:
        done = CliRunner().invoke(train.command, ["--out", str(tmp_path)])
    finally:
        signal.signal(signal.SIGINT, before)  # of a process that ends it is not restored

    assert done.exit_code == 130
    assert "interrupted; repeat the command to begin anew" in done.output


def test_the_loss_falls_on_one_picture_until_its_objects_are_found(tmp_path: Path) -> None:
    torch.manual_seed(1)
    random = np.random.default_rng(2)
    picture = random.integers(90, 110, (INPUT_PX[1], INPUT_PX[0], 3), np.uint8)
    for left, top, right, bottom in BOXES.astype(int):
        picture[top:bottom, left:right] = (200, 30, 30)
    images = torch.from_numpy(picture.transpose(2, 0, 1)[None].astype(np.float32) / 255)
    maps = [torch.from_numpy(part)[None] for part in maps_of(BOXES, SIZE, CELL_PX)]
    net = ObjectNet().train()
    optimiser = torch.optim.Adam(net.parameters(), 5e-3)
    # the rate falls to 0, so that it ends at the boxes on every processor: 0.3 px off, with 3 seeds
    rate = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, STEPS)
    losses = []
    for _ in range(STEPS):
        loss = loss_of(net(images)[0], *maps)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        rate.step()
        losses.append(float(loss.detach()))

    export(net, tmp_path / "objects.onnx", "a test")
    subject = Saliency(SaliencySettings(weights=str(tmp_path / "objects.onnx"), confidence=0.3))
    subject.open()
    grid = Geometry(width_px=2 * INPUT_PX[0], height_px=2 * INPUT_PX[1])
    header = Header(stream="s", seq=0, stamp_ns=0, geometry=grid)
    found = subject.on_frame(
        Frame(header=header, pixels=picture, window=(0, 0, grid.width_px, grid.height_px))
    )

    assert losses[-1] < 0.2 * losses[0]
    assert found.names == ("object",)
    assert found.features.shape == (len(found.boxes), 64)
    for box in BOXES:
        assert np.abs(found.boxes - 2 * box).max(1).min() < 4


@needs_robot
def test_contexts_come_with_boxes_where_the_objects_are_seen() -> None:
    shown, boxes = pictures(80_003, 2)

    assert shown.shape == (2, CONTEXT_PX[1], CONTEXT_PX[0], 3)
    assert boxes.shape == (2, 4, 4)
    left, top, right, bottom = boxes[0, 1].round().astype(int)  # the socket, which is blue
    socket = shown[0, top : bottom + 1, left : right + 1].astype(int)
    assert (socket[..., 2] - socket[..., 1]).max() > 60
