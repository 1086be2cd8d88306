"""The template tracker's training: pieces, samples, losses, and resuming where it stopped."""

from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
import torch

from operators.tracker import batches, data
from operators.tracker import training_run as training
from operators.tracker.batches import Batches, normalised, reused, stream
from operators.tracker.data import ABSENT, Scene, batch, changed, sample, targets
from operators.tracker.look import normalise
from operators.tracker.pieces import PIECE_PX, Pieces, of_source, piece, prepare, sources_of
from operators.tracker.template import Template
from operators.tracker.training_settings import TrainSettings
from pipeline import DriverError, SettingsError, WeightsError
from pipeline.boxes import centres, iou


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


def person(tall_px: int) -> Scene:
    """A bright ellipse, three times as high as wide, in the middle of a dark piece."""
    picture = np.full((PIECE_PX, PIECE_PX, 3), 20, np.uint8)
    half, middle = np.array([tall_px / 6, tall_px / 2]), PIECE_PX / 2
    cv2.ellipse(picture, ((middle - 0.5, middle - 0.5), 2 * half, 0), (230, 230, 230), -1)
    box = np.concatenate([middle - half, middle + half]).astype(np.float32)
    return Scene(picture=picture, box=box, scale=1.0)


def seen_box(picture: np.ndarray) -> np.ndarray:
    rows, columns = np.nonzero(picture[..., 0] > 125)
    return np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1], np.float32)


@pytest.mark.parametrize("smeared", [0.0, 1.0])
def test_the_box_of_an_object_some_moments_later_is_around_it(monkeypatch, smeared: float):
    monkeypatch.setattr(data, "SMEARED", smeared)
    scene = person(60)
    later = [changed(scene, np.random.default_rng(seed)) for seed in range(120)]

    overlaps = [float(iou(seen_box(s.picture)[None], s.box[None])[0, 0]) for s in later]

    assert np.quantile(overlaps, 0.1) > (0.7 if smeared else 0.82)
    shapes = np.array([s.box[2:] - s.box[:2] for s in later])
    assert (shapes.std(0) > 1).all()  # none is as it was
    blurred = [np.abs(np.diff(s.picture[..., 0].astype(int), axis=1)).max() for s in later]
    assert (np.median(blurred) < 150) == bool(smeared)


class Stretched(np.random.Generator):
    """Doubles what is stretched; turns and smears nothing."""

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(1))

    def normal(self, loc: float = 0, scale: float = 1, size: int | None = None) -> Any:  # type: ignore[override]
        return np.log([2.0, 2.0]) if size else 0.0

    def random(self, *_: object) -> Any:  # type: ignore[override]
        return 0.99


def test_a_stretched_object_stays_in_the_middle_of_its_box():
    later = changed(person(60), Stretched())

    light = later.picture[..., 0].astype(float) - later.picture[0, 0, 0]
    rows, columns = np.indices(light.shape) + 0.5
    middle = [(light * columns).sum() / light.sum(), (light * rows).sum() / light.sum()]
    np.testing.assert_allclose(middle, centres(later.box), atol=0.2)


def test_a_made_up_moment_is_another_one_also_without_the_object(monkeypatch):
    pieces = pieces_of(6, seed=1)
    pieces.pairs[:, 1] = pieces.pairs[:, 0]  # stills: of each object there is one piece
    used: list[bool] = []
    monkeypatch.setattr(data, "changed", lambda scene, _: used.append(True) or scene)

    for seed in range(30):
        data.drawn(pieces, np.random.default_rng(seed))

    assert len(used) == 30


def test_of_a_still_sixteen_objects_are_cut_and_two_places_of_none(tmp_path: Path):
    image = np.random.default_rng(1).integers(0, 256, (400, 600, 3)).astype(np.uint8)
    for name in ("images", "labels"):
        (tmp_path / name).mkdir()
    cv2.imwrite(str(tmp_path / "images" / "a.png"), image)
    rows = [f"0 {0.1 + k % 9 * 0.1:.2f} {0.2 + k // 9 * 0.3:.2f} .04 .1" for k in range(20)]
    (tmp_path / "labels" / "a.txt").write_text("\n".join(rows))

    assert len(list(of_source(tmp_path / "images" / "a.png"))) == 16 + 2


def given_of(pieces: Pieces, count: int) -> batches.Batch:
    drawn = batch(pieces, count, np.random.default_rng(4))
    return {name: torch.from_numpy(values) for name, values in drawn.items()}


def likeness(one: torch.Tensor, other: torch.Tensor) -> float:
    return float(torch.corrcoef(torch.stack([one.flatten(), other.flatten()]).float())[0, 1])


def test_a_reused_batch_is_mirrored_with_all_that_belongs_to_it():
    given = given_of(pieces_of(8, seed=1), 6)

    found = reused(given, 7)

    for name in ("heat", "near"):
        torch.testing.assert_close(found[name], given[name].flip(-1))
    torch.testing.assert_close(found["place"][:, 2], -given["place"][:, 2].flip(-1))
    torch.testing.assert_close(found["place"][:, :2], given["place"][:, :2].flip(-1))
    torch.testing.assert_close(found["shape"], given["shape"])
    for name in ("template", "search"):
        assert likeness(found[name], given[name].flip(-1)) > 0.85


def test_a_reused_batch_has_other_light_colours_and_noise():
    given = given_of(pieces_of(8, seed=1), 6)
    for name in ("template", "search"):
        given[name] = torch.full_like(given[name], 120)

    found = reused(given, 6)

    torch.testing.assert_close(found["heat"], given["heat"])  # an even seed does not mirror
    for name in ("template", "search"):
        means = found[name].float().mean((2, 3))
        assert means.mean(1).std() > 5  # light
        assert (means - means.mean(1, keepdim=True)).std() > 1  # colours
        assert found[name].float().std((2, 3)).max() > 0.5  # noise
    assert not torch.equal(found["template"], reused(given, 8)["template"])


def test_pictures_are_normalised_as_they_are_live():
    picture = np.random.default_rng(2).integers(0, 256, (16, 16, 3)).astype(np.uint8)
    live = np.empty((1, 3, 16, 16), np.float32)
    normalise(picture, live)

    found = normalised(torch.from_numpy(picture.transpose(2, 0, 1).copy())[None])

    np.testing.assert_allclose(found.numpy(), live, atol=1e-5)


@pytest.mark.parametrize("reuses", [0, 1, 2])
def test_a_resumed_training_ends_with_the_same_network(tmp_path: Path, monkeypatch, reuses: int):
    pieces = pieces_of(6, seed=2)
    monkeypatch.setattr(training, "prepare", lambda *_: [])
    monkeypatch.setattr(batches, "load", lambda _: pieces)
    whole = training.train(settings_in(tmp_path / "whole", steps=5, reuses=reuses))
    half = training.Run(settings_in(tmp_path / "parts", steps=5, reuses=reuses))
    half.settings.out.mkdir()
    half.net.train()
    source = Batches([], half.settings)
    for given in stream(source, range(2), half.settings, half.device):
        training.advance(half, given)
    half.save()

    resumed = training.train(settings_in(tmp_path / "parts", steps=5, reuses=reuses))

    assert resumed.step == 5
    for name, value in whole.average.state_dict().items():
        torch.testing.assert_close(resumed.average.state_dict()[name], value)


def counted(pieces: Pieces, settings: TrainSettings, made: list[int]) -> Batches:
    class Counted(Batches):
        def __getitem__(self, number: int) -> batches.Batch:
            made.append(number)
            return super().__getitem__(number)

    source = Counted([], settings)
    source._pieces = pieces
    return source


@pytest.mark.parametrize("room", [0, 10**9])
def test_an_interrupted_stream_goes_on_with_the_same_batches_and_makes_few_twice(
    tmp_path: Path, monkeypatch, room: int
):
    monkeypatch.setattr(batches, "REUSED_OF", 8)  # four batches of two
    monkeypatch.setattr(batches, "room_bytes", lambda _: room)
    settings, cpu, made = settings_in(tmp_path, reuses=2), torch.device("cpu"), list[int]()
    source = counted(pieces_of(6, seed=2), settings, made)

    whole = list(stream(source, range(24), settings, cpu))
    at_once, made[:] = len(made), []
    parts = [
        *stream(source, range(13), settings, cpu),
        *stream(source, range(13, 24), settings, cpu),
    ]

    for mine, theirs in zip(whole, parts, strict=True):
        for name, values in mine.items():
            torch.testing.assert_close(theirs[name], values)
    assert at_once == (8 if room else 24)
    assert len(made) <= 8 + 3 or not room  # of the four last ones only those before the pause
    assert list(stream(source, range(24, 24), settings, cpu)) == []


def test_a_file_that_is_damaged_is_an_error_of_one_sentence_also_beside(tmp_path: Path):
    file = tmp_path / "a.npz"
    file.write_bytes(b"")
    settings = settings_in(tmp_path, threads=1)

    with pytest.raises(DriverError, match=r"^\S+a\.npz: expected .*$"):
        next(stream(Batches([file], settings), range(1), settings, torch.device("meta")))


def test_no_more_than_the_last_batches_are_kept(monkeypatch):
    monkeypatch.setattr(batches, "room_bytes", lambda _: 10**9)
    kept = batches.Kept(torch.device("cpu"), 3)

    for number in range(6):
        kept.put(number, {"x": torch.zeros(4)})
    kept.put(1, {"x": torch.zeros(4)})

    assert sorted(kept.batches) == [3, 4, 5]


def test_a_process_beside_gets_no_pieces(tmp_path: Path):
    source = Batches([], settings_in(tmp_path))
    source._pieces = pieces_of(6, seed=1)

    assert copy(source)._pieces is None


def test_processes_beside_the_training_make_the_batches_that_it_makes_itself(
    tmp_path: Path, monkeypatch
):
    image = np.random.default_rng(1).integers(0, 256, (300, 300, 3)).astype(np.uint8)
    for name in ("images", "labels"):
        (tmp_path / name).mkdir()
    cv2.imwrite(str(tmp_path / "images" / "a.png"), image)
    (tmp_path / "labels" / "a.txt").write_text("0 .5 .5 .1 .1\n")
    files = prepare(tmp_path / "pieces", 0, 1, (tmp_path,), "cut")
    settings = settings_in(tmp_path, reuses=1, threads=2)
    steps = range(1, 4)
    alone = list(stream(Batches(files, settings), steps, settings, torch.device("cpu")))
    monkeypatch.setattr(batches, "on", lambda given, _: given)

    # a device that is no processor has batches made beside the training
    beside = list(stream(Batches(files, settings), steps, settings, torch.device("meta")))

    assert len(beside) == len(alone) == 3
    for mine, theirs in zip(alone, beside, strict=True):
        for name, values in mine.items():
            torch.testing.assert_close(theirs[name], values)


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
