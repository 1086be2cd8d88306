"""Verification of detections: what is right, its figures, and calibrated probabilities."""

from pathlib import Path

import numpy as np
import onnxruntime
import pytest

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")
from operators.roi_features.roi_features import SHIPPED
from operators.roi_features.verify import (
    Verified,
    calibration,
    figures,
    main,
    probabilities,
    write_calibrated,
)
from operators.training.splits import DEVELOPMENT
from tests.operators.training.labelled_stills import match_of_stills


def guesses(seed: int, count: int, gain: float) -> Verified:
    """Return detections of a ball whose logits are too large by a factor, 5 % of them right."""
    rng = np.random.default_rng(seed)
    right = rng.random(count) < 0.05
    # of normal logits with variance 2 and means -1 and 1, the difference is the log odds
    odds = rng.normal(np.where(right, 1.0, -1.0), 2**0.5)
    logits = np.zeros((count, 4), np.float32)
    logits[:, 2] = odds * gain
    logits[:, [0, 1]] = -50
    return Verified(
        logits=logits,
        kinds=np.full(count, 2),
        right=right,
        scores=np.full(count, 0.1, np.float32),
    )


@pytest.mark.parametrize("seed", [1, 2])
def test_calibrated_probabilities_are_shares_at_even_odds(seed: int) -> None:
    found = guesses(seed, 20_000, gain=4.0)

    before = figures(probabilities(found), found.right)
    after = figures(probabilities(found, calibration(found)), found.right)

    assert after["ece"] < 0.05 < before["ece"]
    assert after["nll"] < before["nll"]
    assert after["auc"] == pytest.approx(before["auc"], abs=1e-3)


def test_the_figures_of_a_perfect_and_of_a_useless_rating() -> None:
    right = np.array([True, True, False, False, False])

    perfect = figures(right.astype(float), right)
    useless = figures(np.full(5, 0.5), right)

    assert (perfect["auc"], perfect["precision"], perfect["recall"], perfect["ece"]) == (1, 1, 1, 0)
    assert useless["auc"] == 0.5
    assert useless["ece"] == pytest.approx(0)  # half of them, with even weights


def test_a_calibrated_file_gives_scaled_and_shifted_logits(tmp_path: Path) -> None:
    theta = np.array([np.log(2.0), 1.0, 0.0, -1.0, 0.5])
    (tmp_path / "after.onnx").write_text("an encoder that somebody reads")
    with (tmp_path / "after.onnx").open() as reader:
        write_calibrated(SHIPPED, tmp_path / "after.onnx", theta, "numbers made up")
        assert reader.read() == "an encoder that somebody reads"  # replaced, not written over

    crops = {"crops": np.random.default_rng(3).random((2, 3, 96, 96), np.float32)}
    before, after = (
        onnxruntime.InferenceSession(str(path)) for path in (SHIPPED, tmp_path / "after.onnx")
    )
    plain, changed = before.run(["features", "classes"], crops), after.run(None, crops)

    names = [output.name for output in after.get_outputs()]
    np.testing.assert_allclose(
        changed[names.index("classes")], plain[1] * 2 + theta[1:], rtol=1e-4, atol=1e-4
    )
    np.testing.assert_allclose(changed[names.index("features")], plain[0], atol=1e-5)
    assert after.get_modelmeta().custom_metadata_map["calibrated"] == "numbers made up"


def test_the_command_scores_stills_of_a_split(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = match_of_stills(tmp_path, f"{DEVELOPMENT[0]}_1", "aa_1")

    main(["--stills", str(folder), "--split", "development"])

    assert "detections" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--split", "test"), "expected some of the test split"),
        (("--calibrate", "x.onnx"), "the test is to measure"),
    ],
)
def test_a_request_that_cannot_be_met_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], sentence: str
) -> None:
    folder = match_of_stills(tmp_path, "aa_1")

    with pytest.raises(SystemExit):
        main(["--stills", str(folder), *words])

    assert sentence in capsys.readouterr().err
