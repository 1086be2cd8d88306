"""A detector of eight bits finds what the one of single precision finds."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="needs the train extra")
pytest.importorskip("torch", reason="needs the train extra")
import onnx

from operators.saliency.quantise import main, quantise, quantised_nodes, training_pictures
from operators.saliency.saliency import SHIPPED
from pipeline.inference import Network
from tests.operators.saliency.exported import exported_detector
from tests.operators.training.labelled_stills import match_of_stills


def test_it_says_nearly_the_same_and_keeps_its_metadata(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    pictures = [rng.integers(0, 256, (270, 480, 3)).astype(np.uint8) for _ in range(2)]
    out = tmp_path / "small.onnx"
    out.write_text("a network that somebody reads")

    with out.open() as reader:
        quantise(SHIPPED, ((picture, None) for picture in pictures), out)
        assert reader.read() == "a network that somebody reads"  # replaced, not written over

    was, now = Network(SHIPPED, threads=1), Network(out, threads=1)
    padded = np.full((1, 3, 288, 480), 114 / 255, np.float32)
    padded[0, :, 9:279] = pictures[0].transpose(2, 0, 1) / 255
    before, after = was({"images": padded}), now({"images": padded})
    assert now.metadata == was.metadata
    assert np.corrcoef(before["features"].ravel(), after["features"].ravel())[0, 1] > 0.97
    people = slice(0, 2835)  # their boxes, in pixels
    assert np.median(np.abs(before["output"] - after["output"])[0, :4, people]) < 1
    assert out.stat().st_size < 0.5 * SHIPPED.stat().st_size


def test_a_network_that_reads_the_difference_is_calibrated_with_one(tmp_path: Path) -> None:
    path, out = exported_detector(tmp_path, difference=True), tmp_path / "small.onnx"
    folder = match_of_stills(tmp_path / "stills", "aa_1", "aa_2", "aa_3", "aa_4")

    quantise(path, training_pictures(folder, 4), out)

    pictures = np.random.default_rng(1).uniform(-1, 1, (1, 4, 288, 480)).astype(np.float32)
    before = Network(path, threads=1)({"images": pictures})
    after = Network(out, threads=1)({"images": pictures})
    assert np.corrcoef(before["features"].ravel(), after["features"].ravel())[0, 1] > 0.9
    assert any(changed is not None for _, changed in training_pictures(folder, 4))


def test_what_reads_a_roi_is_calibrated_with_parts_at_full_resolution(tmp_path: Path) -> None:
    folder = match_of_stills(tmp_path, "aa_1", "aa_2")

    shown = list(training_pictures(folder, 2, roi=True))

    assert {picture.shape for picture, _ in shown} == {(270, 480, 3)}
    whole = [picture for picture, _ in training_pictures(folder, 2)]
    assert all(
        np.isin(picture.reshape(-1, 3), still.reshape(-1, 3)).all()  # not resampled
        for (picture, _), still in zip(shown, whole, strict=True)
    )


def test_a_network_that_reads_the_difference_is_not_calibrated_with_a_roi(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = exported_detector(tmp_path, difference=True)

    with pytest.raises(SystemExit):
        main(["--weights", str(path), "--stills", str(tmp_path), "--roi", "--out", str(path)])

    assert "which a ROI does not show" in capsys.readouterr().err


def test_a_folder_that_is_not_there_is_told_before_the_calibration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = match_of_stills(tmp_path / "stills", "aa_1"), tmp_path / "none" / "small.onnx"

    with pytest.raises(SystemExit):
        main(["--weights", str(SHIPPED), "--stills", str(folder), "--out", str(out)])

    said = capsys.readouterr().err
    assert f"{out.parent}: No such file or directory" in said
    assert "calibrate" not in said  # whose bar would be there


def test_what_is_decoded_stays_in_single_precision() -> None:
    nodes = quantised_nodes(SHIPPED)

    kinds = {node.name: node.op_type for node in onnx.load(SHIPPED).graph.node}
    left = [
        name
        for name, kind in kinds.items()
        if kind == "Conv" and "/net/" in name and name not in nodes
    ]
    assert sum(kinds[name] == "Conv" for name in nodes) == 64
    assert len(left) == 9  # the first, and those that give scores, sides, heat and place
    assert not [name for name in nodes if kinds[name] in ("Sigmoid", "Exp", "Transpose")]


def test_a_folder_without_stills_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    match_of_stills(tmp_path, "08fd33_1")  # for development, and not to calibrate on
    words = ["--weights", str(SHIPPED), "--stills", str(tmp_path), "--out", str(tmp_path / "o")]

    with pytest.raises(SystemExit, match="2"):
        main(words)

    assert "expected pictures beside those left out, got none" in capsys.readouterr().err
