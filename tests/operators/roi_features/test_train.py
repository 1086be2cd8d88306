"""The encoder's training: its objectives, and resuming where it stopped."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
import torch

from operators.roi_features import training_run as training
from operators.roi_features.data import NOBODY, Crops
from operators.roi_features.model import CLASSES
from operators.roi_features.training_run import Run, advance, batch_rows, changed, identity_loss
from operators.roi_features.training_settings import TrainSettings
from pipeline import SettingsError, WeightsError
from tests.operators.training.elsewhere import PLACE, pretended


def crops_of(scenes: int, seed: int) -> Crops:
    """Return scenes of four people seen twice, two crops of a ball and nine false candidates."""
    kinds = [0] * 6 + [1] * 2 + [2] * 2 + [3] * 9
    persons = [1, 1, 2, 2, 3, 3, 4, 4] + [NOBODY] * 11
    count = len(kinds)
    rng = np.random.default_rng(seed)
    return Crops(
        pictures=rng.integers(0, 256, (scenes * count, 96, 96, 3)).astype(np.uint8),
        kinds=np.tile(kinds, scenes),
        persons=np.tile(persons, scenes),
        scenes=np.repeat(np.arange(scenes), count),
        moments=np.zeros(scenes * count, np.int64),
    )


def settings_in(folder: Path, **more: object) -> TrainSettings:
    """Return the settings of a training with few and small steps."""
    return replace(TrainSettings(data=folder, out=folder, batch=48, steps=10, device="cpu"), **more)  # type: ignore[arg-type]


def vectors(*angles_deg: float) -> torch.Tensor:
    """Return unit vectors in a plane."""
    turned = torch.deg2rad(torch.tensor(angles_deg))
    return torch.stack([turned.cos(), turned.sin()], 1)


def test_the_identity_loss_is_low_where_features_of_a_person_are_alike() -> None:
    persons, scenes = torch.tensor([1, 1, 2, 2]), torch.zeros(4)

    right = identity_loss(vectors(0, 5, 90, 95), persons, scenes)
    wrong = identity_loss(vectors(0, 90, 5, 95), persons, scenes)

    assert right < 0.01 < 1 < wrong


def test_the_identity_loss_ignores_false_candidates_and_people_of_other_scenes() -> None:
    persons = torch.tensor([1, 1, 2, 2, NOBODY, 1])
    scenes = torch.tensor([0, 0, 0, 0, 0, 1])

    alone = identity_loss(vectors(0, 20, 60, 80), persons[:4], scenes[:4])
    with_others = identity_loss(vectors(0, 20, 60, 80, 10, 10), persons, scenes)

    assert with_others == pytest.approx(float(alone), abs=1e-4)


def test_a_batch_in_which_nobody_is_twice_leaves_the_weights_numbers() -> None:
    told = vectors(0, 20, 60).requires_grad_()

    loss = identity_loss(told, torch.tensor([1, 2, NOBODY]), torch.zeros(3))
    loss.backward()

    assert float(loss.detach()) == 0
    assert told.grad is not None
    assert not told.grad.any()


def test_a_batch_shows_people_twice_and_every_class() -> None:
    crops = crops_of(scenes=5, seed=1)

    rows = batch_rows(crops, 72, np.random.default_rng(1))

    assert len(rows) == 72
    assert set(crops.kinds[rows]) == set(range(len(CLASSES)))
    for scene in set(crops.scenes[rows]):
        persons = crops.persons[rows][crops.scenes[rows] == scene]
        assert (np.unique(persons[persons != NOBODY], return_counts=True)[1] == 2).all()


def test_a_crop_changes_but_keeps_its_shape_and_its_seed() -> None:
    picture = crops_of(scenes=1, seed=2).pictures[0]

    one, same, other = (
        changed(picture, 1, np.random.default_rng(seed), mirror=True) for seed in (3, 3, 4)
    )

    assert one.shape == picture.shape
    assert one.dtype == np.uint8
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


class Middling(np.random.Generator):
    """Draws the middle of every range, and no rare event."""

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(1))

    def uniform(self, low: float = 0, high: float = 1, size: int | None = None) -> Any:  # type: ignore[override]
        return np.full(size, (low + high) / 2) if size else (low + high) / 2

    def random(self, *_: object) -> Any:  # type: ignore[override]
        return 0.99


def test_a_mirrored_crop_has_all_its_pixels() -> None:
    picture = crops_of(scenes=1, seed=2).pictures[0]

    plain, turned = (changed(picture, 1, Middling(), mirror=mirror) for mirror in (False, True))

    assert np.array_equal(turned, plain[:, ::-1])


def test_crops_of_one_scene_are_relit_alike() -> None:
    plain = np.full((96, 96, 3), (200, 60, 90), np.uint8)

    def middle(light: int, seed: int) -> np.ndarray:
        crop = changed(plain, light, np.random.default_rng(seed), mirror=False)
        return np.asarray(crop[32:64, 32:64].mean((0, 1)))

    assert middle(5, 1) == pytest.approx(middle(5, 2), abs=4)
    assert abs(middle(5, 1) - middle(6, 1)).max() > 4


def test_a_stopped_training_resumes_as_if_it_had_not_stopped(tmp_path: Path) -> None:
    crops = crops_of(scenes=4, seed=5)
    whole = Run(settings_in(tmp_path))
    advance(whole, crops)
    whole.save()
    expected = advance(whole, crops)

    resumed = Run(settings_in(tmp_path))
    resumed.resume()

    assert resumed.step == 1
    assert advance(resumed, crops) == pytest.approx(expected, rel=1e-3)


def test_a_step_on_another_device_gives_the_same_and_mixes_no_devices(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    crops = crops_of(scenes=4, seed=7)
    here = Run(settings_in(tmp_path))
    here.prepare()
    monkeypatch.setattr(training, "device_of", lambda _: PLACE)

    with pretended():
        there = Run(settings_in(tmp_path))
        there.prepare()
        found = [advance(there, crops) for _ in range(2)]

    assert {p.device for p in there.net.parameters()} == {PLACE}
    assert found == [pytest.approx(advance(here, crops), rel=1e-3) for _ in range(2)]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_training_on_a_gpu_resumes_without_one(tmp_path: Path) -> None:
    crops = crops_of(scenes=4, seed=8)
    there = Run(settings_in(tmp_path, device="cuda"))
    there.prepare()
    advance(there, crops)
    there.save()

    here = Run(settings_in(tmp_path))
    here.resume()
    here.prepare()

    assert here.step == 1
    assert advance(here, crops) == pytest.approx(advance(there, crops), rel=1e-2)


def test_a_new_head_leaves_the_features_as_they_are(tmp_path: Path) -> None:
    crops = crops_of(scenes=4, seed=6)
    first = Run(settings_in(tmp_path))
    first.save()

    head = Run(settings_in(tmp_path, head_of=first.path, warmup=1))
    head.prepare()
    advance(head, crops)

    before, after = first.net.state_dict(), head.net.state_dict()
    changed_ones = {name for name in before if not torch.equal(before[name], after[name])}
    assert changed_ones == {"kind.weight", "kind.bias"}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"batch": 8}, "batch: must be at least 24, got 8"),
        ({"scenes": 1}, "scenes: a batch of 48 needs at least 2, got 1"),
        ({"moments": 1}, "moments: must be at least 2, got 1"),
        ({"rate": float("nan")}, "rate: must be above 0, got nan"),
        ({"steps": 0}, "steps: must be at least 1, got 0"),
        ({"device": "gpu"}, "device: expected auto, cpu, cuda, cuda:N or mps, got gpu"),
    ],
)
def test_wrong_settings_of_a_training_are_refused(
    settings: dict[str, object], message: str
) -> None:
    with pytest.raises(SettingsError, match=message):
        settings_in(Path(), **settings)


def test_features_of_another_network_are_refused(tmp_path: Path) -> None:
    torch.save({"net": {"weight": torch.zeros(3)}}, tmp_path / "c.pt")

    with pytest.raises(WeightsError, match=r"c\.pt: expected this training's net, got"):
        Run(settings_in(tmp_path, head_of=tmp_path / "c.pt"))
