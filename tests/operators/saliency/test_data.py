"""Training pictures come from scenes and stills, and never from stills that are left out."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")

from operators.saliency.data import Mixed, Real, Rendered, collate, rendered_in
from operators.saliency.example import ANYONE, CONTEXT_PX, NAMES, resized, sides_of
from operators.saliency.letterbox import Letterbox
from operators.saliency.stills import stills
from operators.saliency.training_run import Run, folders, source_of
from operators.saliency.training_settings import TrainSettings
from pipeline import SettingsError
from pipeline.errors import DriverError
from tests.operators.training.labelled_stills import match_of_stills, write_names, write_still

BALL = NAMES.index("ball")


@pytest.fixture
def pitch(tmp_path: Path) -> Path:
    """A folder whose labels know persons only."""
    write_names(tmp_path / "pitch", "person", "sports ball")
    write_still(tmp_path / "pitch", "p_1", [(0, 300, 200, 9, 17), (1, 500, 300, 6, 6)])
    return tmp_path / "pitch"


@pytest.fixture
def match(tmp_path: Path) -> Path:
    return match_of_stills(tmp_path / "match", "aa_1", "aa_2", "08fd33_1", "798b45_3")


def test_a_picture_depends_on_seed_and_number_alone(match: Path, pitch: Path) -> None:
    first = Real([stills(match), stills(pitch)], seed=1)
    again = pickle.loads(pickle.dumps(first))  # as it is sent to a worker

    whole = [first[k] for k in range(6)]

    for k in (5, 0, 3):
        assert np.array_equal(again[k].picture, whole[k].picture)
        assert np.array_equal(again[k].boxes, whole[k].boxes)
    other = Real([stills(match), stills(pitch)], seed=2)
    assert not np.array_equal(other[0].picture, whole[0].picture)


def test_both_kinds_of_stills_have_their_turn(match: Path, pitch: Path) -> None:
    real = Real([stills(match), stills(pitch)], seed=1)

    seen = {int(label) for k in range(40) for label in real[k].labels}

    assert seen == {*range(len(NAMES)), ANYONE}


def test_where_no_ball_is_labelled_no_place_counts_as_empty(tmp_path: Path) -> None:
    write_names(tmp_path, "ball", "player")
    write_still(tmp_path, "aa_1", [(1, 400, 250, 24, 60)])
    real = Real([stills(tmp_path)], seed=1)

    for k in range(5):
        example = real[k]
        anywhere = (example.labels == BALL) & example.ignored
        assert example.boxes[anywhere][-1].tolist() == [0, 0, *CONTEXT_PX]


def test_stills_held_out_are_not_trained_on(match: Path, pitch: Path, tmp_path: Path) -> None:
    given = TrainSettings(data=(tmp_path,), out=tmp_path, scenes=0, stills=(match, pitch))

    names = [file.stem for folder in folders(given) for file in folder.files]

    assert names == ["aa_1", "aa_2", "p_1"]


def test_a_malformed_label_is_refused_before_training(match: Path, tmp_path: Path) -> None:
    (match / "labels" / "aa_2.txt").write_text("2 0.5 0.5 0.1 1.7\n")
    given = TrainSettings(data=(tmp_path,), out=tmp_path, scenes=0, stills=(match,))

    with pytest.raises(DriverError, match=r"aa_2\.txt:1: expected a class number and four shares"):
        source_of(given)


def test_other_stills_or_labels_are_another_training(match: Path, tmp_path: Path) -> None:
    given = TrainSettings(data=(tmp_path,), out=tmp_path, scenes=0, stills=(match,))
    Run(given).save()
    Run(given).resume()
    (match / "labels" / "aa_2.txt").write_text("2 0.5 0.5 0.1 0.1\n")

    with pytest.raises(SettingsError, match="stills: this folder's training has 2 files"):
        Run(given).resume()


def test_scenes_and_stills_are_mixed_by_their_share(match: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "5.npy", np.zeros((1, 270, 480, 3), np.uint8))
    np.savez(
        tmp_path / "5.npz", first=np.zeros(2, int), boxes=np.zeros((0, 4), np.float32),
        labels=np.zeros(0, np.int64), ignored=np.zeros(0, np.bool_), made_with=np.array("{}"),
    )  # fmt: skip
    drawn, real = Rendered(rendered_in(tmp_path), seed=1), Real([stills(match)], seed=1)

    def people(share: float) -> int:
        mixed = Mixed(drawn, real, share, 1)
        return sum(bool((mixed[k].labels != BALL).any()) for k in range(40))

    assert people(0.0) == 0
    assert 8 < people(0.5) < 32
    assert people(1.0) > 30
    with pytest.raises(DriverError, match="data: expected rendered scenes or stills, got none"):
        Mixed(None, None, 0.5, 1)


def test_a_batch_holds_crops_as_the_network_sees_them(match: Path) -> None:
    real = Real([stills(match)], seed=1)

    batch = collate([real[0], real[1]])

    assert tuple(batch.pictures.shape) == (2, 3, 288, 480)
    assert batch.boxes.shape[0] == 2
    with pytest.raises(SettingsError, match=r"stills_share: must be within 0\.\.1, got 2"):
        TrainSettings(data=(match,), out=match, stills_share=2.0)


@pytest.mark.parametrize("width_px", [480, 736])
def test_a_batch_holds_what_the_operator_gives_a_network_of_that_input(
    match: Path, width_px: int
) -> None:
    example = Real([stills(match)], seed=1)[0]
    letterbox = Letterbox(*sides_of(width_px)[1], scale=1, bgr=False, corner=False)

    batch = collate([resized(example, sides_of(width_px)[0])])

    at = letterbox.put(example.picture)
    assert np.array_equal(batch.pictures.numpy(), letterbox.tensor)
    offset = np.array([at.left_px, at.top_px] * 2)
    assert np.allclose(batch.boxes[0], example.boxes * at.gain + offset, atol=0.5)


def test_pictures_for_a_larger_input_show_enlarged_contexts_and_larger_ones(match: Path) -> None:
    size_px = sides_of(736)[0]
    real = Real([stills(match)], seed=1)

    found = [real.sized(k, size_px) for k in range(12)]

    assert {example.picture.shape for example in found} == {(414, 736, 3)}
    assert all((example.boxes[:, 2:] <= np.array(size_px) + 1e-3).all() for example in found)


def test_a_roi_shows_people_near(match: Path) -> None:
    size_px = sides_of(384)[0]
    far, near = (Real([stills(match)], seed=1, roi_share=share) for share in (0.0, 1.0))

    def tall_px(real: Real) -> float:
        found = [real.sized(k, size_px) for k in range(40)]
        whole = np.concatenate([e.boxes[(e.labels != BALL) & ~e.ignored] for e in found])
        return float(np.median(whole[:, 3] - whole[:, 1]))

    assert tall_px(near) > 1.5 * tall_px(far)


@pytest.mark.parametrize("drawn", ["crops.with_marks", "pasted_balls.hands_over"])
def test_only_a_roi_has_marks_and_hands(
    match: Path, monkeypatch: pytest.MonkeyPatch, drawn: str
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError(drawn)

    monkeypatch.setattr(f"operators.saliency.{drawn}", refuse)
    far, near = (Real([stills(match)], seed=1, roi_share=share) for share in (0.0, 1.0))

    list(map(far.__getitem__, range(40)))
    with pytest.raises(AssertionError, match=drawn):
        list(map(near.__getitem__, range(40)))


def test_what_changed_is_made_up_only_for_a_network_that_reads_it(match: Path) -> None:
    with_it, without = (Real([stills(match)], seed=1, difference=d) for d in (True, False))

    assert any(with_it[k].difference is not None for k in range(8))
    assert all(without[k].difference is None for k in range(8))


@pytest.mark.parametrize(
    ("other", "said"), [({}, "expected stills"), ({"difference": True}, "expected no difference")]
)
def test_a_roi_is_not_trained_without_stills_or_with_a_difference(
    match: Path, other: dict[str, bool], said: str
) -> None:
    real = (match,) if other else ()

    with pytest.raises(SettingsError, match=f"^roi_share: {said}"):
        TrainSettings(data=(match,), out=match, stills=real, roi_share=0.5, **other)


@pytest.mark.parametrize(
    ("other", "said"), [({"scenes": 0}, "expected scenes"), ({"difference": True}, "expected no")]
)
def test_parts_of_scenes_as_a_roi_shows_them_need_scenes_and_have_no_difference(
    match: Path, other: dict[str, Any], said: str
) -> None:
    with pytest.raises(SettingsError, match=f"^rois: {said}"):
        TrainSettings(data=(match,), out=match, rois=2, **other)


def test_two_widths_take_turns_batch_by_batch(match: Path) -> None:
    settings = TrainSettings(data=(match,), out=match, width_px=736, also_px=480)
    mixed = Mixed(
        None, Real([stills(match)], seed=1), 1.0, 1, widths_px=settings.widths_px, batch=2
    )

    batches = [collate([mixed[2 * n], mixed[2 * n + 1]]) for n in range(3)]

    assert [tuple(b.pictures.shape[2:]) for b in batches] == [(416, 736), (288, 480), (416, 736)]


@pytest.mark.parametrize(
    ("width_px", "said"),
    [(500, "must be a multiple of 32, got 500"), (224, r"must be within 256\.\.2048, got 224")],
)
def test_a_width_that_no_input_has_is_refused(match: Path, width_px: int, said: str) -> None:
    with pytest.raises(SettingsError, match=f"^width_px: {said}"):
        TrainSettings(data=(match,), out=match, width_px=width_px)
    with pytest.raises(
        SettingsError, match=f"^also_px: {said.replace('be within', 'be 0 or within')}"
    ):
        TrainSettings(data=(match,), out=match, also_px=width_px)
