"""The detector's training: steps are the same on every device, and a training resumes."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")
import torch

from operators.saliency import training_run as training
from operators.saliency.data import Batch, Rendered, rendered_in
from operators.saliency.detector import SHIPPED, Detector
from operators.saliency.example import INPUT_PX, NAMES
from operators.saliency.saliency import SaliencySettings
from operators.saliency.train import TrainSettings, asked, main
from operators.saliency.training_run import Run, advance, drawn, train
from operators.saliency.training_settings import HEADS
from pipeline import SettingsError
from pipeline.errors import DriverError
from tests.operators.training.elsewhere import PLACE, pretended
from tests.operators.training.labelled_stills import match_of_stills, write_names


@pytest.fixture(autouse=True)
def _few_pictures_to_measure_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "CALIBRATION", 4)  # 64 take seconds each time


def settings_in(folder: Path, device: str = "cpu") -> TrainSettings:
    return TrainSettings(data=(folder,), out=folder, steps=8, warmup=2, threads=1, device=device)


def batch() -> Batch:
    """Return two pictures of noise with people and balls, some too hidden to count."""
    width, height = INPUT_PX
    made = torch.Generator().manual_seed(1)
    boxes = torch.tensor([[40.0, 60, 60, 110], [200, 100, 206, 106], [300, 90, 330, 150], [9] * 4])
    boxes[3, 2:] = 14
    ball = NAMES.index("ball")
    return Batch(
        pictures=torch.randint(0, 256, (2, 3, height, width), dtype=torch.uint8, generator=made),
        boxes=boxes.repeat(2, 1, 1),
        labels=torch.tensor([[0, ball, 1, ball], [1, -1, -1, -1]]),
        ignored=torch.tensor([[False, False, True, True], [False] * 4]),
        difference=torch.randint(-99, 99, (2, 1, height, width), dtype=torch.int8, generator=made),
    )


def steps(run: Run, count: int = 1) -> list[float]:
    run.net.train()
    found = [advance(run, run.net, batch()) for _ in range(count)]
    return [float(part) for parts in found for part in parts.values()]


def test_a_step_on_another_device_gives_the_same_and_mixes_no_devices(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # torch has no autocast for the fake device
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())
    wanted = steps(Run(settings_in(tmp_path)), 2)
    monkeypatch.setattr(training, "device_of", lambda _: PLACE)

    with pretended():
        there = Run(settings_in(tmp_path))
        found = steps(there, 2)

    assert {p.device for p in (*there.net.parameters(), *there.mean.buffers())} == {PLACE}
    assert found == pytest.approx(wanted, rel=1e-3)


def test_a_stopped_training_resumes_as_if_it_had_not_stopped(tmp_path: Path) -> None:
    whole = Run(settings_in(tmp_path))
    steps(whole)
    whole.save()

    resumed = Run(settings_in(tmp_path))
    resumed.resume()

    assert resumed.step == 1
    assert steps(resumed) == pytest.approx(steps(whole), rel=1e-3)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_training_on_a_gpu_resumes_without_one(tmp_path: Path) -> None:
    there = Run(settings_in(tmp_path, "cuda"))
    steps(there)
    there.save()

    here = Run(settings_in(tmp_path))
    here.resume()

    assert here.step == 1
    assert steps(here) == pytest.approx(steps(there), rel=0.1)  # bfloat16


def test_options_of_the_command_line_become_settings() -> None:
    settings, target = asked(["--data", "a", "b", "--out", "c"])

    assert settings == TrainSettings(data=(Path("a"), Path("b")), out=Path("c"))
    assert target is None
    more = ["--data", "a", "--out", "c", "--init", "b.onnx", "--only", "ball"]
    assert asked(more)[0].only == "ball"
    with pytest.raises(SystemExit, match="2"):
        asked([*more[:-1], "neck"])


@pytest.mark.parametrize("step", [0, 1])
def test_another_training_in_the_same_folder_is_refused(tmp_path: Path, step: int) -> None:
    first = Run(settings_in(tmp_path))
    first.step = step
    first.save()

    with pytest.raises(SettingsError, match=r"^seed: this folder's training has 1, got 2; use an"):
        Run(replace(settings_in(tmp_path), seed=2)).resume()


def footage(folder: Path, light: int) -> Path:
    """Make a folder with one grey picture and nobody in it."""
    folder.mkdir()
    np.save(folder / "1.npy", np.full((1, 270, 480, 3), light, np.uint8))
    nobody = {"boxes": np.zeros((0, 4), np.float32), "labels": np.zeros(0, np.int64)}
    ignored = np.zeros(0, np.bool_)
    np.savez(folder / "1.npz", first=np.zeros(2, int), ignored=ignored, **nobody)
    return folder


def test_a_training_on_other_footage_is_refused(tmp_path: Path) -> None:
    here, there = footage(tmp_path / "here", 90), footage(tmp_path / "there", 91)
    settings = replace(settings_in(tmp_path), data=(here,), scenes=0)
    Run(settings).save()

    Run(settings).resume()
    for other in ((there,), (here, here)):
        with pytest.raises(SettingsError, match=r"^data: this folder's training has 1 files, "):
            Run(replace(settings, data=other)).resume()


def test_a_training_on_stills_whose_classes_were_renamed_is_refused(tmp_path: Path) -> None:
    folder = match_of_stills(tmp_path / "match", "aa_1")
    settings = replace(settings_in(tmp_path), stills=(folder,))
    Run(settings).save()

    write_names(folder, "ball", "referee", "player", "player")

    with pytest.raises(SettingsError, match=r"^stills: this folder's training has 1 files, "):
        Run(settings).resume()


def test_files_beside_those_of_the_drawn_scenes_are_ignored(tmp_path: Path) -> None:
    settings = replace(settings_in(tmp_path), scenes=2)
    (tmp_path / "10399.npz").touch()

    assert [path.name for path in drawn(settings)] == ["10000.npz", "10001.npz"]


def test_a_training_that_has_reached_its_time_limit_does_not_continue(tmp_path: Path) -> None:
    data = (footage(tmp_path / "data", 90),)
    settings = replace(settings_in(tmp_path), data=data, scenes=0, batch=1, minutes=1e-6)

    assert [train(settings).step for _ in range(2)] == [1, 1]


@pytest.mark.parametrize(("width_px", "input_px"), [(480, (480, 288)), (736, (736, 416))])
def test_weights_of_any_training_are_exported_with_its_input(
    tmp_path: Path, width_px: int, input_px: tuple[int, int]
) -> None:
    Run(replace(settings_in(tmp_path), width_px=width_px)).save()

    main(
        ["--data", str(tmp_path), "--out", str(tmp_path), "--export", str(tmp_path / "own"),
         "--width-px", str(width_px)]
    )  # fmt: skip

    found = Detector(SaliencySettings(weights=str(tmp_path / "own" / "detector.onnx")))
    assert found.size_px == input_px


def test_a_training_of_larger_inputs_takes_its_steps(tmp_path: Path) -> None:
    data = (footage(tmp_path / "data", 90),)
    given = replace(
        settings_in(tmp_path), data=data, scenes=0, batch=2, steps=2, width_px=512, also_px=480,
        init=SHIPPED, out=tmp_path / "run",
    )  # fmt: skip

    assert train(given).step == 2


@pytest.mark.parametrize("head", HEADS)
def test_a_head_trained_alone_leaves_the_rest_as_it_was(head: str, tmp_path: Path) -> None:
    data = (footage(tmp_path / "data", 90),)
    given = replace(
        settings_in(tmp_path), data=data, scenes=0, batch=2, steps=2, init=SHIPPED,
        difference=True, only=head, rate=0.01, warmup=1, out=tmp_path / "run",
    )  # fmt: skip
    untouched, run = Run(replace(given, steps=1, out=tmp_path / "none")), Run(given)
    source = training.source_of(given)
    untouched.begin(source)
    run.begin(source)
    training.learn(run.net, head)

    for _ in range(2):
        advance(run, run.net, batch())

    with torch.no_grad():
        found = run.mean.eval()(batch().inputs(4))  # what is exported
        wanted = untouched.mean.eval()(batch().inputs(4))
    assert torch.equal(found.features, wanted.features)
    assert torch.equal(found.scores, wanted.scores)
    assert torch.equal(found.boxes, wanted.boxes)
    assert found.moving is not None
    assert wanted.moving is not None
    heats = {"ball": (found.heat, wanted.heat), "moving": (found.moving[0], wanted.moving[0])}
    for name, (now, before) in heats.items():
        learned = head in (name, "balls")
        assert not torch.allclose(now, before, atol=1e-3) if learned else torch.equal(now, before)


def test_a_network_that_reads_the_difference_says_so_in_its_file(tmp_path: Path) -> None:
    Run(replace(settings_in(tmp_path), difference=True)).save()
    words = ["--data", str(tmp_path), "--out", str(tmp_path), "--export", str(tmp_path)]

    main([*words, "--difference"])

    detector = Detector(SaliencySettings(weights=str(tmp_path / "detector.onnx")))
    assert detector.reads_difference
    picture = np.full((270, 480, 3), 90, np.uint8)
    changed = np.zeros((270, 480), np.int16)
    changed[100:110, 100:110] = 200
    detector.look(picture, changed)
    assert detector.channels == 64


def test_a_head_is_not_trained_alone_from_nothing_and_no_other_part_is(tmp_path: Path) -> None:
    given = settings_in(tmp_path)
    with pytest.raises(SettingsError, match=r"^only: expected weights to begin with"):
        replace(given, only="ball")
    with pytest.raises(SettingsError, match=r"^only: expected a difference for the moving head"):
        replace(given, only="moving", init=SHIPPED)
    with pytest.raises(SettingsError, match=r"^only: expected a difference for the moving head"):
        replace(given, only="balls", init=SHIPPED)
    with pytest.raises(SettingsError, match=r"^only: expected one of ball, moving, balls, got"):
        replace(given, only="neck", init=SHIPPED)


def test_without_a_checkpoint_exporting_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--data", str(tmp_path), "--out", str(tmp_path), "--export", str(tmp_path)]

    with pytest.raises(SystemExit, match="2"):
        main(words)

    assert "checkpoint.pt: expected a state dict of tensors, got" in capsys.readouterr().err


@pytest.mark.parametrize("lost", ["5.npz", "5.npy"])
def test_damaged_pictures_are_refused(tmp_path: Path, lost: str) -> None:
    np.save(tmp_path / "5.npy", np.zeros((1, 270, 480, 3), np.uint8))
    np.savez(tmp_path / "5.npz", first=np.zeros(2, int))
    (tmp_path / lost).write_bytes(b"")

    with pytest.raises(DriverError, match=rf"{lost}: expected "):
        Rendered(rendered_in(tmp_path), seed=1)


def test_a_folder_without_pictures_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match="data: expected rendered scenes, got none"):
        Rendered(rendered_in(tmp_path), seed=1)


def test_an_unknown_device_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"device: expected auto, cpu, .* got gpu"):
        settings_in(tmp_path, "gpu")
