"""Tracks of many objects are scored against the truth: identities, hidden people, no tracks."""

import sys

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.tracking.many import figures, matched
from bench.tracking.many_tables import COLUMNS, markdown_of_many
from bench.tracking.metrics import metrics
from drivers.source import Annotations
from pipeline.errors import InstallError
from pipeline.messages import Tracks
from pipeline.testing import header

BOXES = np.array([[100, 100, 140, 200], [300, 100, 340, 200], [500, 100, 540, 200]], np.float32)
NAMES = ("player", "referee", "ball")


def truth(*visibility: float) -> Annotations:
    count = len(visibility)
    return Annotations(
        boxes=BOXES[:count],
        ids=np.arange(7, 7 + count, dtype=np.int32),
        labels=("player", "main referee", "ball")[:count],
        visibility=np.array(visibility, np.float32),
    )


def tracks(ids: list[int], boxes: NDArray[np.float32], *, seen: bool = True) -> Tracks:
    count = len(ids)
    return Tracks(
        header=header(),
        ids=np.array(ids, np.int32),
        labels=np.arange(count, dtype=np.int32),
        scores=np.ones(count, np.float32),
        boxes=boxes[:count, None].astype(np.float32),
        visible=np.full((count, 1), seen),
        features=np.zeros((count, 1, 4), np.float32),
        predicted=np.repeat(boxes[:count, None], 2, axis=1).astype(np.float32),
        names=NAMES,
    )


def test_only_objects_and_tracks_of_the_classes_that_are_asked_for_are_matched() -> None:
    people = matched(truth(1, 1, 1), tracks([1, 2, 3], BOXES), ("player", "referee"))
    ball = matched(truth(1, 1, 1), tracks([1, 2, 3], BOXES), ("ball",))

    assert [list(part) for part in people[:2]] == [[7, 8], [1, 2]]
    assert people[2] == pytest.approx(np.eye(2))
    assert [list(part) for part in ball[:2]] == [[9], [3]]


def test_a_track_of_a_hidden_person_is_neither_right_nor_wrong() -> None:
    found = matched(truth(1, 0.1), tracks([1, 2], BOXES), ("player", "referee"))

    assert [list(part) for part in found[:2]] == [[7], [1]]


def test_a_track_without_a_detection_does_not_count() -> None:
    found = matched(truth(1, 1), tracks([1, 2], BOXES, seen=False), ("player", "referee"))

    assert (len(found[0]), len(found[1]), found[2].shape) == (2, 0, (2, 0))


def test_tracks_that_change_their_identity_lose_association_and_not_detection() -> None:
    pytest.importorskip("trackeval")
    classes = ("player", "referee")
    whole = [matched(truth(1, 1), tracks([1, 2], BOXES), classes) for _ in range(20)]
    torn = [matched(truth(1, 1), tracks([1 + 2 * (k // 10), 2], BOXES), classes) for k in range(20)]

    right, changed = figures(whole), figures(torn)

    assert {right[name] for name in ("HOTA", "DetA", "AssA", "IDF1")} == {1.0}
    assert changed["DetA"] == 1.0
    assert changed["AssA"] == pytest.approx(0.75, abs=1e-3)  # of two objects: 1 and .5
    assert changed["IDF1"] == pytest.approx(0.75, abs=1e-3)
    assert (changed["objects"], changed["tracks"], changed["frames"]) == (2, 3, 20)


def test_without_tracks_every_figure_is_zero() -> None:
    pytest.importorskip("trackeval")

    found = figures([matched(truth(1), tracks([], BOXES), ("player",))])

    assert {found[name] for name in ("HOTA", "AssA", "IDF1")} == {0.0}


def test_rows_are_written_as_markdown() -> None:
    row = {column: 0.5 if column[0].isupper() else "x" for column in COLUMNS}

    assert markdown_of_many([row]).splitlines()[2].count("0.500") == 4


def test_nothing_is_imported_by_what_only_looks_at_the_metrics(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "trackeval", None)  # as where it is not installed

    assert not hasattr(metrics, "__wrapped__")
    with pytest.raises(InstallError, match="metrics: expected the package trackeval"):
        _ = metrics.HOTA
