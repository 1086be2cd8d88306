"""Pieces of stills: made again where pictures or labels changed, each in a file of its own."""

from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")

from operators.tracker import training_run as training
from operators.tracker.pieces import load, prepare
from operators.tracker.training_settings import TrainSettings
from pipeline import DriverError, SettingsError


def stills_in(folder: Path, *labels: str) -> Path:
    """Return a folder with a picture of noise and its labels."""
    for name in ("images", "labels"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    image = np.random.default_rng(1).integers(0, 256, (300, 300, 3)).astype(np.uint8)
    cv2.imwrite(str(folder / "images" / "a.png"), image)
    (folder / "labels" / "a.txt").write_text("\n".join(labels))
    return folder


def test_pieces_follow_labels_that_were_corrected_and_the_training_is_another(tmp_path: Path):
    stills = stills_in(tmp_path / "match", "0 .5 .5 .1 .1")
    settings = TrainSettings(data=tmp_path, out=tmp_path / "run", stills=(stills,), device="cpu")
    settings.out.mkdir()
    training.Run(settings).save()
    (before,) = prepare(tmp_path / "pieces", 0, 1, (stills,), "cut")
    known = len(load([before]).pictures)

    stills_in(stills, "0 .5 .5 .1 .1", "0 .3 .3 .1 .1")

    (after,) = prepare(tmp_path / "pieces", 0, 1, (stills,), "cut")
    assert len(load([after]).pictures) == known + 1
    with pytest.raises(SettingsError, match="pictures: this folder's training has 1 files, "):
        training.Run(settings).resume()


def test_pictures_of_one_name_in_two_folders_of_one_name_are_refused(tmp_path: Path):
    folders = tuple(stills_in(tmp_path / place / "match" / "train") for place in "ab")

    with pytest.raises(DriverError, match=r"match_train_a\.npz; rename one of them, or its folder"):
        prepare(tmp_path / "pieces", 0, 1, folders, "cut")
