"""Features of another network are mapped to those that others know; detections stay the same."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("torch", reason="needs the train extra")
pytest.importorskip("onnx", reason="needs the train extra")

from operators.saliency.alignment import explained, fitted, main, mapped
from pipeline import WeightsError
from pipeline.inference import Network
from tests.operators.saliency.exported import exported_detector

PICTURE = {"images": np.random.default_rng(1).random((1, 3, 288, 480), np.float32)}


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_linear_map_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mine = rng.standard_normal((300, 6)).astype(np.float32)
    matrix, offset = rng.standard_normal((6, 4)), rng.standard_normal(4) + 20
    theirs = (mine @ matrix + offset).astype(np.float32)

    found = fitted(mine, theirs)

    assert np.allclose(found[0], matrix, atol=0.05)
    assert explained(mine, theirs, *found) > 0.99


def test_nothing_is_explained_where_nothing_is_common() -> None:
    rng = np.random.default_rng(2)
    mine, theirs = rng.standard_normal((2, 400, 6)).astype(np.float32)
    theirs = np.abs(theirs)

    assert explained(mine[200:], theirs[200:], *fitted(mine[:200], theirs[:200])) < 0.2


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported_detector(tmp_path_factory.mktemp("exported"))


def test_the_map_changes_the_features_and_nothing_else(exported: Path, tmp_path: Path) -> None:
    matrix = np.random.default_rng(3).standard_normal((64, 64)).astype(np.float32)
    before, out = Network(exported, threads=1), tmp_path / "mapped.onnx"
    out.write_text("a network that somebody reads")

    with out.open() as reader:
        mapped(exported, matrix, np.ones(64, np.float32), out)
        assert reader.read() == "a network that somebody reads"  # replaced, not written over

    after = Network(out, threads=1)
    was, now = before(PICTURE), after(PICTURE)
    wanted = np.einsum("bchw,cd->bdhw", was["features"], matrix) + 1
    assert np.array_equal(now["output"], was["output"])
    assert np.allclose(now["features"], np.maximum(wanted, 0), atol=1e-2)
    assert after.metadata == before.metadata
    with pytest.raises(WeightsError, match="expected a detector as it was exported, got an align"):
        mapped(out, matrix, np.ones(64, np.float32), out)


def test_a_detector_aligned_to_itself_keeps_its_features(
    exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(4)
    pictures = rng.integers(0, 256, (40, 270, 480, 3)).astype(np.uint8)
    np.save(tmp_path / "1.npy", pictures)
    corners = rng.uniform(20, 200, (400, 2))
    np.savez(
        tmp_path / "1.npz", first=np.arange(0, 401, 10),
        boxes=np.hstack([corners, corners + 30]).astype(np.float32),
        labels=np.zeros(400, np.int64), ignored=np.zeros(400, np.bool_), made_with=np.array("{}"),
    )  # fmt: skip
    given = ["--weights", str(exported), "--like", str(exported), "--data", str(tmp_path)]

    main([*given, "--out", str(tmp_path / "aligned.onnx")])

    told = json.loads(capsys.readouterr().out)
    assert told["objects"] == 400
    assert told["explained"] > 0.95
