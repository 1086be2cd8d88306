"""The template tracker's training: pieces, samples, losses, and resuming where it stopped."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
import torch

from operators.tracker import training_run as training
from operators.tracker.data import ABSENT, batch, sample, targets
from operators.tracker.pieces import PIECE_PX, Pieces, of_source, piece, sources_of
from operators.tracker.template import Template
from operators.tracker.training_settings import TrainSettings
from pipeline import DriverError, SettingsError, WeightsError
from pipeline.boxes import centres


def pieces_of(count: int, seed: int) -> Pieces:
    """Return pieces of noise with a box in the middle; neighbours are pairs."""
    rng = np.random.default_rng(seed)
    rows = np.arange(count - count % 2).reshape(-1, 2)
    return Pieces(
        pictures=rng.integers(0, 256, (count, PIECE_PX, PIECE_PX, 3)).astype(np.uint8),
        boxes=np.tile(np.array([96, 96, 128, 128], np.float32), (count, 1)),
        scales=rng.uniform(0.5, 3, count).astype(np.float32),
        pairs=rows,
    )


def settings_in(folder: Path, **more: object) -> TrainSettings:
    return replace(TrainSettings(data=folder, out=folder, batch=2, device="cpu"), **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("size", [8, 40, 160])
def test_a_piece_shows_its_object_in_the_middle_at_32_pixels(size: int):
    picture = np.zeros((1400, 1400, 3), np.uint8)
    box = np.array([700 - size // 2, 650 - size // 2] * 2, np.float32)
    box[2:] += size
    left, top, right, bottom = box.astype(int)
    picture[top:bottom, left:right] = 255

    cut, own, scale = piece(picture, box)

    assert scale * size == pytest.approx(32)
    np.testing.assert_allclose(own, [96, 96, 128, 128], atol=1e-3)
    rows, columns = np.nonzero(cut[..., 0] > 127)
    ends = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    np.testing.assert_allclose(ends, own, atol=1.5)


def test_the_box_of_a_sample_is_where_the_object_is_in_the_search_picture():
    pieces = pieces_of(6, seed=1)
    pieces.pictures[:] = 20
    pieces.pictures[:, 96:128, 96:128] = 230
    apart = []

    for seed in range(40):
        _, _, search, box, there = sample(pieces, np.random.default_rng(seed))
        bright = np.argwhere(search.mean(2) > 110)
        if there and len(bright) > 100 and (box[:2] > 4).all() and (box[2:] < 124).all():
            apart.append(np.linalg.norm(bright.mean(0)[::-1] + 0.5 - centres(box)))

    assert len(apart) >= 10
    assert np.median(apart) < 2.5  # pasted things have other colours


def test_a_sample_is_the_same_for_the_same_seed_and_its_share_without_object_is_as_stated():
    pieces = pieces_of(40, seed=1)

    first, again = (batch(pieces, 60, np.random.default_rng(5)) for _ in range(2))

    for name, values in first.items():
        np.testing.assert_array_equal(values, again[name])
    assert abs(1 - first["there"].mean() - ABSENT) < 0.15


def test_the_heat_is_one_in_the_cell_of_the_object_only():
    heat, near, place = targets(np.array([50, 62, 70, 102], np.float32))

    assert np.argwhere(heat == 1).tolist() == [[10, 7]]
    assert near.sum() == 9
    np.testing.assert_allclose(place[:2, 10, 7], np.log([20 / 32, 40 / 32]), atol=1e-5)


def test_stills_held_out_are_never_read(tmp_path: Path):
    for name in ("798b45_0_1.jpg", "121364_0_1.jpg", "G_20231125_TOP_B_2nd_1_001.jpg"):
        cv2.imwrite(str(tmp_path / name), np.zeros((8, 8, 3), np.uint8))

    assert [p.name for p in sources_of(tmp_path)] == ["121364_0_1.jpg"]

    (tmp_path / "121364_0_1.jpg").unlink()
    with pytest.raises(DriverError, match="not held out, got none"):
        sources_of(tmp_path)


def test_a_label_that_is_none_is_an_error_with_file_and_line(tmp_path: Path):
    for name in ("images", "labels"):
        (tmp_path / name).mkdir()
    cv2.imwrite(str(tmp_path / "images" / "a.png"), np.zeros((200, 200, 3), np.uint8))
    (tmp_path / "labels" / "a.txt").write_text("0 .5 .5 .2 .2\n0 here\n")

    with pytest.raises(DriverError, match=r"a\.txt:2: expected a class number and four shares"):
        list(of_source(tmp_path / "images" / "a.png"))


def test_a_resumed_training_ends_with_the_same_network(tmp_path: Path, monkeypatch):
    pieces = pieces_of(6, seed=2)
    monkeypatch.setattr(training, "prepare", lambda *_: [])
    monkeypatch.setattr(training, "load", lambda _: pieces)
    whole = training.train(settings_in(tmp_path / "whole", steps=4))
    half = training.Run(settings_in(tmp_path / "parts", steps=4))
    half.settings.out.mkdir()
    half.net.train()
    for _ in range(2):
        training.advance(half, pieces)
    half.save()

    resumed = training.train(settings_in(tmp_path / "parts", steps=4))

    assert resumed.step == 4
    for name, value in whole.average.state_dict().items():
        torch.testing.assert_close(resumed.average.state_dict()[name], value)


def test_an_exported_network_says_what_the_trained_one_does(tmp_path: Path):
    run = training.Run(settings_in(tmp_path))
    training.export(run, tmp_path / "template.onnx")
    tracker = Template(tmp_path / "template.onnx")
    rng = np.random.default_rng(3)
    shapes = {"template": (1, 3, 64, 64), "shape": (1, 2), "search": (1, 3, 128, 128)}
    given = {n: rng.normal(size=s).astype(np.float32) for n, s in shapes.items()}

    found = tracker._network(given)
    net = training.Deployed(run.average.eval())
    with torch.no_grad():
        expected = net(*(torch.from_numpy(values) for values in given.values()))

    for name, values in zip(found, expected, strict=True):
        np.testing.assert_allclose(found[name], values.numpy(), rtol=1e-3, atol=1e-4)
    assert sum(p.numel() for p in run.net.parameters()) <= 1_500_000


def test_without_a_checkpoint_there_is_nothing_to_export(tmp_path: Path):
    with pytest.raises(WeightsError, match="expected a checkpoint to export"):
        training.kept(settings_in(tmp_path))


def test_a_batch_of_one_is_refused(tmp_path: Path):
    with pytest.raises(SettingsError, match="batch: must be at least 2, got 1"):
        settings_in(tmp_path, batch=1)
