"""Kits: a shirt that few wear, above dark shorts, is a referee's beside two teams."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from operators.kits import Kits, KitsSettings
from pipeline import Detections, Frame, SettingsError
from pipeline.cli import commands
from pipeline.settings import build
from pipeline.testing import drive, header

NAMES = ("ball", "player", "referee")
RED, WHITE, YELLOW, GREY = (200, 30, 40), (235, 235, 235), (230, 220, 20), (150, 150, 150)
BLACK, LIGHT = (20, 20, 20), (230, 230, 230)
TEAMS = [(RED, LIGHT)] * 6 + [(WHITE, LIGHT)] * 6
WINDOW = (0, 0, 1920, 1080)


def frame(kits: list[tuple[Any, Any]], window: tuple[int, int, int, int] = WINDOW) -> Frame:
    """A lawn at a quarter of the sides, on which people stand in a row in these kits."""
    pixels = np.full((270, 480, 3), (60, 130, 50), np.uint8)
    for k, (shirt, shorts) in enumerate(kits):
        left = 10 + 30 * k
        pixels[103:110, left : left + 8] = shirt
        pixels[110:114, left : left + 8] = shorts
        pixels[114:120, left : left + 8] = shirt
    return Frame(header=header(), pixels=pixels, window=window)


def seen(*people: tuple[int, str, float], corner: tuple[int, int] = (0, 0)) -> Detections:
    """Detections (place in the row, class, score) in sensor pixels."""
    boxes = [[40 + 120 * k, 400, 72 + 120 * k, 480] for k, _, _ in people]
    return Detections(
        header=header(),
        boxes=np.array(boxes, np.float32).reshape(-1, 4) + np.array(corner * 2, np.float32),
        angles=np.zeros(len(people), np.float32),
        scores=np.array([score for _, _, score in people], np.float32),
        labels=np.array([NAMES.index(name) for _, name, _ in people], np.int32),
        features=np.arange(len(people), dtype=np.float32)[:, None],
        names=NAMES,
    )


def told(detections: Detections, picture: Frame, **settings: Any) -> Detections:
    (answer,) = drive(Kits, [{"detections": detections, "frame": picture}], settings)
    assert isinstance(answer, Detections)
    return answer


def classes(found: Detections) -> list[str]:
    return [found.names[label] for label in found.labels]


def everybody(count: int) -> list[tuple[int, str, float]]:
    return [(k, "player", 0.7) for k in range(count)]


def test_the_only_one_in_a_shirt_above_dark_shorts_is_a_referee() -> None:
    kits = [*TEAMS, (YELLOW, BLACK)]

    found = told(seen(*everybody(len(kits))), frame(kits))

    assert classes(found) == ["player"] * 12 + ["referee"]


def test_two_teams_alone_have_no_referee() -> None:
    assert classes(told(seen(*everybody(12)), frame(TEAMS))) == ["player"] * 12


def test_whom_the_detector_surely_names_is_a_referee_whoever_else_has_a_rare_kit() -> None:
    kits = [*TEAMS, (YELLOW, BLACK), (GREY, LIGHT)]
    people = [*everybody(12), (12, "referee", 0.8), (13, "player", 0.7)]

    assert classes(told(seen(*people), frame(kits))) == ["player"] * 12 + ["referee", "player"]


def test_a_player_in_a_teams_kit_that_the_detector_takes_for_a_referee_is_none() -> None:
    people = [(0, "referee", 0.35), *everybody(12)[1:]]

    assert classes(told(seen(*people), frame(TEAMS))) == ["player"] * 12


def test_boxes_scores_and_features_stay_and_nobody_is_told_twice() -> None:
    kits = [*TEAMS, (YELLOW, BLACK)]
    people = [*everybody(12), (12, "player", 0.6), (12, "referee", 0.4), (3, "ball", 0.2)]

    found = told(seen(*people), frame(kits))

    kept = [*range(13), 14]
    assert classes(found) == [*["player"] * 12, "referee", "ball"]
    assert found.features[:, 0].tolist() == kept
    assert found.scores.tolist() == pytest.approx([people[k][2] for k in kept])
    assert found.boxes.tolist() == seen(*people).boxes[kept].tolist()


def test_a_picture_of_a_window_is_read_where_its_people_are() -> None:
    kits, corner = [*TEAMS, (YELLOW, BLACK)], (700, 300)
    window = (*corner, corner[0] + 1920, corner[1] + 1080)

    found = told(seen(*everybody(13), corner=corner), frame(kits, window))

    assert classes(found)[-1] == "referee"


def test_of_few_people_and_without_colours_the_detectors_word_counts() -> None:
    kits = [*TEAMS[:4], (YELLOW, BLACK)]
    grey = Frame(
        header=header(), pixels=frame(kits).pixels[..., 0], window=WINDOW, pixel_format="grey8"
    )

    assert classes(told(seen(*everybody(5)), frame(kits))) == ["player"] * 5
    assert classes(told(seen(*everybody(13)), grey)) == ["player"] * 13
    assert classes(told(seen(*everybody(5)), frame(kits), least_people=2))[-1] == "referee"


@given(
    boxes=st.lists(
        st.tuples(*[st.floats(-1e4, 1e4, width=32)] * 4, st.integers(0, 2)), max_size=20
    ),
    window=st.sampled_from([WINDOW, (1900, 1000, 1920, 1080)]),
)
def test_any_boxes_give_an_answer_with_some_of_them(
    boxes: list[tuple[float, float, float, float, int]], window: tuple[int, int, int, int]
) -> None:
    given_ = seen(*[(k, NAMES[row[4]], 0.5) for k, row in enumerate(boxes)])
    corners = np.array([row[:4] for row in boxes], np.float32).reshape(-1, 4)
    ordered: NDArray[np.float32] = np.hstack(
        [np.minimum(corners[:, :2], corners[:, 2:]), np.maximum(corners[:, :2], corners[:, 2:])]
    )
    given_.boxes[:] = ordered

    found = told(given_, frame([], window))

    assert set(found.features[:, 0]) <= set(range(len(boxes)))
    assert classes(found).count("ball") == [row[4] for row in boxes].count(0)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"least_people": 1}, "least_people: expected 2 to 1000, got 1"),
        ({"least_evidence": 99.0}, "least_evidence: expected -20 to 20, got 99"),
    ],
)
def test_wrong_settings_are_refused_in_a_sentence(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        build(KitsSettings, settings, "kits")


def test_of_a_detector_of_other_classes_the_check_says_that_they_stay() -> None:
    change = "saliency.names={player: person, referee: person, ball: ball}"

    result = CliRunner().invoke(commands, ["check", "tracking", "--set", change])

    assert result.exit_code == 0
    assert "kits: classes stay as they are: no player and referee among person, ball" in (
        " ".join(result.output.split())
    )


def test_of_other_classes_nothing_changes() -> None:
    people = seen(*everybody(13))
    other = replace(people, names=("ball", "player", "horse"))

    assert classes(told(other, frame([*TEAMS, (YELLOW, BLACK)]))) == ["player"] * 13
