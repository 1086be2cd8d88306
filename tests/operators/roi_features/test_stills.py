"""Crops of labelled stills: who and what is cut out, and what never is."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
import torch

from operators.roi_features.data import ANYONE, BALLS, NOBODY, load
from operators.roi_features.model import CLASSES
from operators.roi_features.stills import false_balls, prepare, truth_of
from operators.roi_features.training_run import batch_rows, class_loss
from operators.training.splits import HELD_OUT
from operators.training.stills import class_names
from pipeline.errors import DriverError
from pipeline.messages import Detections
from pipeline.testing import header
from tests.operators.training.labelled_stills import match_of_stills, write_names, write_still

BALL, BACKGROUND = CLASSES.index("ball"), CLASSES.index("background")


def test_a_still_gives_everybody_twice_the_ball_and_false_balls(tmp_path: Path) -> None:
    folder = match_of_stills(tmp_path / "match", "aa_1")

    crops = load(prepare(tmp_path / "crops", (folder,), "stills"))

    assert crops.pictures.shape[1:] == (96, 96, 3)
    assert np.bincount(crops.kinds[crops.kinds != BACKGROUND]).tolist() == [0, 0, 2 * BALLS, 0, 6]
    persons, times = np.unique(crops.persons[crops.kinds == ANYONE], return_counts=True)
    assert (len(persons), times.tolist()) == (3, [2, 2, 2])
    assert (crops.persons[crops.kinds != ANYONE] == NOBODY).all()
    assert (crops.kinds == BACKGROUND).sum() >= 12


def test_a_still_whose_ball_is_not_marked_gives_no_false_balls(tmp_path: Path) -> None:
    folder = match_of_stills(tmp_path / "match", "aa_1")
    write_still(folder, "aa_2", [(2, 300, 250, 24, 60), (2, 700, 260, 24, 60)])

    crops = load(prepare(tmp_path / "crops", (folder,), "stills"))

    second = crops.scenes == crops.scenes.max()
    assert set(crops.kinds[second]) == {ANYONE}
    rows = batch_rows(crops, 48, np.random.default_rng(1))
    assert len(rows) == 48


def test_stills_that_are_held_out_are_never_cut_out(tmp_path: Path) -> None:
    folder = match_of_stills(tmp_path / "match", "aa_1", f"{HELD_OUT[0]}_1")

    assert [f.stem for f in prepare(tmp_path / "crops", (folder,), "stills")] == ["match_aa_1"]
    with pytest.raises(DriverError, match="beside those held out, got none"):
        prepare(tmp_path / "crops", (match_of_stills(tmp_path / "test", HELD_OUT[0]),), "stills")


def test_crops_of_stills_are_made_anew_only_when_they_must(tmp_path: Path) -> None:
    folder = match_of_stills(tmp_path / "match", "aa_1")
    (file,) = prepare(tmp_path / "crops", (folder,), "stills")
    before = file.stat().st_mtime_ns

    prepare(tmp_path / "crops", (folder,), "stills")

    assert file.stat().st_mtime_ns == before


def test_stills_whose_crops_are_missing_are_cut_out_alone_and_as_before(tmp_path: Path) -> None:
    folder = match_of_stills(tmp_path / "match", "aa_1", "aa_2", "aa_3")
    files = prepare(tmp_path / "crops", (folder,), "stills")
    before, kept = load(files), [file.stat().st_mtime_ns for file in files]
    files[1].unlink()

    after = load(prepare(tmp_path / "crops", (folder,), "stills"))

    for name, values in vars(before).items():
        assert np.array_equal(values, vars(after)[name]), name
    told = [file.stat().st_mtime_ns == was for file, was in zip(files, kept, strict=True)]
    assert told == [True, False, True]


def test_a_detected_ball_is_false_unless_it_touches_the_true_one(tmp_path: Path) -> None:
    folder = match_of_stills(tmp_path, "aa_1")
    _, truth = truth_of(folder / "images" / "aa_1.png", class_names(folder / "data.yaml"))
    x, y = 2 * 500, 2 * 300  # stills are scaled to full HD
    boxes = [[x - 9, y - 9, x + 9, y + 9], [100, 100, 120, 120], [200, 100, 220, 120]]
    seen = Detections(
        header=header(),
        boxes=np.array(boxes, np.float32),
        angles=np.zeros(3, np.float32),
        scores=np.array([0.9, 0.1, 0.5], np.float32),
        labels=np.array([2, 2, 2], np.int32),
        features=np.zeros((3, 0), np.float32),
        names=("player", "referee", "ball"),
    )

    assert false_balls(seen, truth).tolist() == [boxes[2], boxes[1]]  # the surest first


def test_somebody_costs_nothing_as_a_player_or_a_referee_and_much_as_a_ball() -> None:
    sure = torch.eye(len(CLASSES)) * 20

    loss = [float(class_loss(sure[[k]], torch.tensor([ANYONE]))) for k in range(len(CLASSES))]

    assert max(loss[0], loss[1]) < 0.01 < 10 < min(loss[BALL], loss[BACKGROUND])


def test_crops_follow_labels_and_names_that_were_corrected(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = match_of_stills(tmp_path / "match", "aa_1")
    prepare(tmp_path / "crops", (folder,), "stills")
    labels = folder / "labels" / "aa_1.txt"
    labels.write_text("".join(labels.read_text().splitlines(keepends=True)[:2]))  # two people less

    crops = load(prepare(tmp_path / "crops", (folder,), "stills"))

    assert (crops.kinds == ANYONE).sum() == 2
    write_names(folder, "ball", "goalkeeper", "ball", "referee")
    assert not (load(prepare(tmp_path / "crops", (folder,), "stills")).kinds == ANYONE).any()
    assert capsys.readouterr().out.count("made anew: other stills (1 file)") == 2


def test_stills_of_two_folders_have_numbers_and_files_of_their_own(tmp_path: Path) -> None:
    first, second = (match_of_stills(tmp_path / name, "aa_1") for name in ("one", "two"))
    prepare(tmp_path / "crops", (first, second), "stills")
    write_still(first, "aa_2", [(2, 300, 250, 24, 60)])

    crops = load(prepare(tmp_path / "crops", (first, second), "stills"))

    persons = np.stack([crops.scenes, crops.persons], 1)[crops.kinds == ANYONE]
    assert (np.unique(persons, axis=0, return_counts=True)[1] == 2).all()
    alike = match_of_stills(tmp_path / "elsewhere" / "one", "aa_1")
    with pytest.raises(DriverError, match=r"one_aa_1\.npz; rename one of them, or its folder"):
        prepare(tmp_path / "crops", (first, alike), "stills")
