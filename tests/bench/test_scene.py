"""Statistics that compare the procedural match with real footage are correct."""

import numpy as np
import pytest

from bench.scene import ball_box, measure, summary, table
from drivers.scenes.soccer import SoccerScene
from drivers.source import Annotations


class Pitch:
    """A grey picture in which a bright square of 10 pixels moves by (3, 4) per frame."""

    size_px = (200, 600)
    rate_hz = 25.0
    length: int | None = 20

    def picture(self, index: int) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
        image = np.full((600, 200, 3), 100, np.uint8)
        x, y = 50 + 3 * index, 50 + 4 * index
        image[y : y + 10, x : x + 10] = 220
        return image

    def truth(self, index: int) -> Annotations:
        x, y = 50 + 3 * index, 50 + 4 * index
        return Annotations(
            boxes=np.array([[x, y, x + 10, y + 10], [20, 30, 40, 90]], np.float32),
            ids=np.array([1, 2], np.int32),
            labels=("ball", "player"),
            visibility=np.ones(2, np.float32),
        )

    def close(self) -> None:
        pass


def test_sizes_speed_and_contrast_are_measured_correctly() -> None:
    found = measure(Pitch(), 20)

    assert set(found["ball width"]) == {10.0}
    assert found["ball speed, px/frame"] == pytest.approx([5.0] * 19)
    assert found["player height"] == [60.0] * 20
    assert found["ball luma less its ring's"] == pytest.approx([120.0] * 2, abs=1)


def test_a_hidden_ball_is_not_measured() -> None:
    seen = Pitch().truth(0)
    hidden = Annotations(
        boxes=seen.boxes, ids=seen.ids, labels=seen.labels, visibility=np.zeros(2, np.float32)
    )

    assert ball_box(seen) is not None
    assert ball_box(hidden) is None


def test_the_table_has_a_column_for_each_source_and_a_dash_for_what_is_unknown() -> None:
    text = table({"real": {"width": [1.0]}, "made": {"height": [2.0]}})

    assert text.splitlines()[2] == f"| width | {summary([1.0])} | – |"
    assert text.splitlines()[3] == f"| height | – | {summary([2.0])} |"


def test_the_procedural_match_can_be_measured() -> None:
    found = measure(SoccerScene(size_px=(480, 270), rate_hz=25, seed=1), 11)

    assert len(found["people in view"]) == 11
    assert found["ball luma less its ring's"]
