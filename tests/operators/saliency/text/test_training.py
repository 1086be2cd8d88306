"""Training of the text detector: anchors, losses, batches, steps, and what it exports."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")
import torch

from operators.saliency.saliency import Detector, SaliencySettings
from operators.saliency.text.anchors import MOST, candidates, centres, uncounted
from operators.saliency.text.data import ANCHORS, Batch, Words, augment, collate, example
from operators.saliency.text.examples import INPUT_PX, KEPT_PX
from operators.saliency.text.losses import losses, overlap
from operators.saliency.text.model import Raw, TextNet, centres_of
from operators.saliency.text.quads import corners
from operators.saliency.text.settings import TextTrainSettings
from operators.saliency.text.streets import Picture
from operators.saliency.text.train import main
from operators.saliency.text.training_run import Run, advance, export
from operators.training.arrays import write
from pipeline import SettingsError
from pipeline.errors import DriverError

BOXES = np.array([[60, 40, 50, 10, 0.1], [200, 100, 6, 3, 0], [150, 150, 90, 24, -0.6]], np.float32)


def picture(seed: int = 1, height_px: int = INPUT_PX[1]) -> Picture:
    """Return noise with three words that are only told of."""
    rng = np.random.default_rng(seed)
    pixels = rng.integers(0, 256, (height_px, INPUT_PX[0], 3), np.uint8)
    return Picture(pixels=pixels, quads=corners(BOXES), ignored=np.zeros(3, np.bool_))


def settings_in(folder: Path) -> TextTrainSettings:
    return TextTrainSettings(data=folder, out=folder, steps=8, warmup=2)


def batch() -> Batch:
    return collate([example(picture(1)), example(picture(2))])


def test_every_word_has_anchors_within_it_and_no_more_than_allowed() -> None:
    chosen = candidates(BOXES, ANCHORS)

    assert chosen.shape == (3, MOST)
    assert ((chosen >= 0).sum(1) >= 1).all()
    for box, row in zip(BOXES, chosen, strict=True):
        away = np.linalg.norm(ANCHORS[row[row >= 0]] - box[:2], axis=1)
        assert away.max() < box[2] / 2 + 3


def test_the_network_has_its_anchors_where_the_data_expects_them() -> None:
    mine = centres_of(INPUT_PX[1] // 4, INPUT_PX[0] // 4, torch.device("cpu"))

    np.testing.assert_array_equal(mine.numpy(), centres(*INPUT_PX))


def test_what_may_be_found_or_not_does_not_count() -> None:
    told = picture()
    hazy = replace(told, ignored=np.array([True, False, False]))

    counts = example(hazy).counts

    assert not counts[uncounted(BOXES[:1], ANCHORS)].any()
    assert counts.mean() > 0.9
    assert len(example(hazy).boxes) == 2


def test_likeness_is_one_for_equal_boxes_and_falls_with_distance_and_angle() -> None:
    one = torch.tensor([[60.0, 40, 50, 10, 0.1]])

    def like(*change: float) -> float:
        return float(overlap(one, one + torch.tensor([change])))

    assert like(0, 0, 0, 0, 0) > 0.99
    assert like(0, 0, 0, 0, torch.pi) > 0.99  # the same turned by half
    assert like(2, 0, 0, 0, 0) > like(8, 0, 0, 0, 0) > like(30, 0, 0, 0, 0)
    assert like(0, 0, 0, 0, 0.1) > like(0, 0, 0, 0, 0.5)
    assert like(0, 4, 0, 0, 0) < like(4, 0, 0, 0, 0)  # a line too low is worse than a letter


def test_the_right_boxes_cost_nothing_and_wrong_ones_something() -> None:
    given = batch()
    count = len(ANCHORS)
    boxes = torch.zeros(2, count, 5) + torch.tensor([0.0, 0, 4, 4, 0])
    boxes[..., :2] = torch.from_numpy(ANCHORS)
    scores = torch.full((2, count), -9.0)
    for box, item, row in zip(given.boxes, given.item, given.candidates, strict=True):
        boxes[item, row[row >= 0]] = box
        scores[item, row[row >= 0]] = 3.0

    def parts(of: torch.Tensor) -> dict[str, float]:
        raw = Raw(scores=scores, boxes=of, features=torch.zeros(0))
        return {name: float(part) for name, part in losses(raw, given).items()}

    right, wrong = parts(boxes), parts(boxes + torch.tensor([3.0, 1, 0, 0, 0.3]))
    assert right["boxes"] < 0.02
    assert right["turn"] == pytest.approx(0, abs=1e-5)
    assert wrong["boxes"] > 0.3
    assert wrong["turn"] > 0.1


def test_pictures_without_words_are_learnt_from_too() -> None:
    empty = replace(picture(), quads=np.zeros((0, 4, 2), np.float32), ignored=np.zeros(0, np.bool_))
    given = collate([example(empty), example(empty)])
    raw = TextNet()(given.pictures.float() / 255)

    parts = losses(raw, given)

    assert float(parts["text"].detach()) > 0
    assert float(parts["boxes"].detach()) == 0


def test_a_few_steps_lower_the_loss_and_a_stopped_training_resumes(tmp_path: Path) -> None:
    def step(run: Run) -> float:
        run.net.train()
        return sum(float(part) for part in advance(run, run.net, batch()).values())

    whole = Run(settings_in(tmp_path))
    first = [step(whole) for _ in range(4)]
    whole.save()

    resumed = Run(settings_in(tmp_path))
    resumed.resume()

    assert first[-1] < first[0]
    assert resumed.step == 4
    assert step(resumed) == pytest.approx(step(whole), rel=1e-3)


def test_the_operator_loads_what_the_training_exports(tmp_path: Path) -> None:
    path = tmp_path / "text.onnx"
    torch.manual_seed(1)
    export(TextNet(), path)

    detector = Detector(SaliencySettings(weights=str(path)))
    large = Detector(SaliencySettings(weights=str(path), input_px=(640, 384)))

    assert (detector.kind, detector.names, detector.size_px) == ("obb", ("text",), INPUT_PX)
    assert detector.channels == 64
    assert large.size_px == (640, 384)
    _, _, features = detector.look(np.zeros((180, 320, 3), np.uint8))
    assert features is not None
    assert features.shape == (64, 24, 40)


def kept(folder: Path) -> Path:
    """Write two kept pictures with one word each."""
    rng = np.random.default_rng(1)
    pixels = rng.integers(0, 256, (2, KEPT_PX[1], KEPT_PX[0], 3), np.uint8)
    np.save(folder / "0.npy", pixels)
    truth = {
        "first": np.array([0, 1, 2]),
        "quads": corners(np.array([[300, 200, 90, 20, 0.2]] * 2, np.float32)),
        "ignored": np.zeros(2, np.bool_),
    }
    write(folder / "0.npz", truth, {})
    return folder / "0.npz"


def test_a_picture_of_a_stream_depends_on_seed_and_number_alone(tmp_path: Path) -> None:
    path = kept(tmp_path)
    source, again = (Words([[path]], [1.0], 5) for _ in range(2))

    first = source[7]

    np.testing.assert_array_equal(first.pixels, again[7].pixels)
    assert first.pixels.shape == (INPUT_PX[1], INPUT_PX[0], 3)
    assert any(not np.array_equal(first.pixels, source[n].pixels) for n in range(3))


def test_words_stay_on_their_pixels_when_a_picture_is_augmented() -> None:
    pixels = np.zeros((KEPT_PX[1], KEPT_PX[0], 3), np.uint8)
    pixels[180:200, 250:350] = 255
    quads = np.array([[[250, 180], [350, 180], [350, 200], [250, 200]]], np.float32)
    told = Picture(pixels=pixels, quads=quads, ignored=np.zeros(1, np.bool_))

    for seed in range(12):
        seen = augment(told, np.random.default_rng(seed))
        inner = seen.quads[0].clip([0, 0], np.array(INPUT_PX) - 1)
        middle = inner.mean(0).astype(int)
        if np.ptp(inner[:, 0]) > 8 and np.ptp(inner[:, 1]) > 4:
            light = seen.pixels.astype(int).sum(2)
            assert light[middle[1], middle[0]] >= np.quantile(light[8:-8], 0.9)


def test_of_a_picture_that_is_nearly_whole_no_more_is_grey_than_is_missing() -> None:
    white = np.full((KEPT_PX[1], KEPT_PX[0], 3), 255, np.uint8)
    told = Picture(
        pixels=white, quads=np.zeros((0, 4, 2), np.float32), ignored=np.zeros(0, np.bool_)
    )
    seed = 1  # the first whose part is a little lower than what the input shows

    seen = augment(told, np.random.default_rng(seed))

    rng = np.random.default_rng(seed)
    assert rng.random() >= 0.45
    share = np.exp(rng.uniform(np.log(0.45), 0))
    missing = (INPUT_PX[1] - KEPT_PX[1] * INPUT_PX[0] / (KEPT_PX[0] * share)) / 2
    assert 0 < missing < 5
    assert (seen.pixels == 114).all((1, 2)).sum() == 2 * np.ceil(missing)


def test_wrong_settings_and_missing_pictures_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="stills: expected a folder"):
        TextTrainSettings(data=tmp_path, out=tmp_path, stills=tmp_path / "none")
    with pytest.raises(SettingsError, match="steps"):
        TextTrainSettings(data=tmp_path, out=tmp_path, steps=0)
    with pytest.raises(DriverError, match="expected pictures"):
        Words([[]], [1.0], 1)


def test_the_command_line_refuses_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["--data", str(tmp_path), "--out", str(tmp_path), "--rate", "0"])

    assert stopped.value.code == 2
    assert capsys.readouterr().err.startswith("fovea: rate: must be above 0")
