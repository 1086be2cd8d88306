"""Recordings: kept while graph, networks and code are the same, recorded anew otherwise."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from operators.policy.data import Recording, made_with, record
from operators.roi_features.roi_features import SHIPPED
from operators.training.arrays import outdated, write
from pipeline.errors import DriverError, GraphError, WeightsError


def test_a_clip_is_recorded_anew_when_the_graph_was_another(tmp_path: Path) -> None:
    path, said, longer = tmp_path / "1.npz", list[str](), ("association.horizon=20",)
    write(path, {"seqs": np.zeros(2)}, made_with(2))

    record([1], 2, tmp_path, workers=1, changes=longer, say=said.append)

    assert said == [f"{tmp_path}: made anew: other association.horizon (1 file)"]
    assert Recording(path).sides["horizon"] == 20
    assert outdated([path], made_with(2, longer), pytest.fail) == []
    assert list(tmp_path.iterdir()) == [path]


def test_networks_are_compared_by_content_and_not_by_path(tmp_path: Path) -> None:
    same, other = tmp_path / "same.onnx", tmp_path / "other.onnx"
    shutil.copy(SHIPPED, same)
    other.write_bytes(b"another")

    plain, moved, changed = (
        made_with(2, tuple(f"roi_features.weights={path}" for path in given))
        for given in ((), (same,), (other,))
    )

    assert plain == moved
    assert {name for name in plain if plain[name] != changed[name]} == {"roi_features.weights"}


def test_a_recording_depends_on_frames_and_code_and_not_on_threads() -> None:
    assert made_with(2)["frames"] != made_with(3)["frames"]
    assert "code of operators.association:Association" in made_with(2)
    assert made_with(2) == made_with(2, ("saliency.threads=2",))


@pytest.mark.parametrize(
    ("change", "kind", "said"),
    [
        ("nonsense=1", GraphError, "--set nonsense=1: expected node.setting=value"),
        ("saliency.weights=gone.onnx", WeightsError, "gone.onnx: no such file"),
    ],
)
def test_wrong_changes_are_refused_also_when_there_is_nothing_to_record(
    tmp_path: Path, change: str, kind: type[Exception], said: str
) -> None:
    with pytest.raises(kind, match=said):
        record([], 2, tmp_path, changes=(change,))


def test_a_file_that_is_no_recording_is_refused_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "1.npz").write_bytes(b"")

    with pytest.raises(DriverError, match=r"1\.npz: expected arrays, got "):
        Recording(tmp_path / "1.npz")
