"""Scores of an encoder."""

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the train extra")
from operators.roi_features.data import NOBODY
from operators.roi_features.evaluate import Look, found_again, main, team_in_scene, told_apart
from operators.roi_features.model import CLASSES


def look(persons: list[int], features: list[list[float]], teams: list[int] | None = None) -> Look:
    """Return people with the features that an encoder gives them."""
    count = len(persons)
    return Look(
        features=np.array(features, np.float32),
        logits=np.zeros((count, 0), np.float32),
        kinds=np.zeros(count, np.int64),
        persons=np.array(persons),
        teams=np.array(teams or [0] * count),
    )


def judged(kinds: list[int], likely: list[int]) -> dict[str, float]:
    """Return the scores of an encoder that is sure of the classes in `likely`."""
    return told_apart(
        [
            Look(
                features=np.zeros((len(kinds), 1), np.float32),
                logits=np.eye(4, dtype=np.float32)[likely] * 9,
                kinds=np.array(kinds),
                persons=np.full(len(kinds), NOBODY),
                teams=np.zeros(len(kinds), np.int64),
            )
        ],
        list(CLASSES),
        0.5,
    )


def test_precision_and_recall_of_a_class_are_against_false_candidates() -> None:
    figures = judged(kinds=[2, 2, 3, 3, 0], likely=[2, 3, 2, 3, 2])

    assert figures["accuracy"] == pytest.approx(0.4)
    assert figures["ball_precision"] == figures["ball_recall"] == pytest.approx(0.5)
    assert figures["player_recall"] == 0.0
    assert "referee_recall" not in figures


def test_an_encoder_without_classes_has_no_scores_for_them() -> None:
    assert told_apart([look([1], [[1.0]])], [], 0.5) == {}


def test_a_person_is_found_again_when_no_other_has_more_similar_features() -> None:
    earlier = look([1, 2, 3], [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]])
    later = look([1, 2, NOBODY], [[5, 1, 0, 0], [0, 1, 2, 0], [1, 0, 0, 0]])

    figures = found_again([(earlier, later)])

    assert figures["again_all"] == pytest.approx(0.5)
    assert figures["again_all_chance"] == pytest.approx(1 / 3)


def test_the_score_within_a_team_ignores_other_teams_and_people_who_left() -> None:
    earlier = look([1, 2, 3], [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], teams=[0, 0, 1])
    later = look([1, 3, 9], [[1, 0, 5, 0], [0, 0, 1, 0], [1, 0, 0, 0]], teams=[0, 1, 0])

    figures = found_again([(earlier, later)])

    assert figures["again_all"] == pytest.approx(0.5)
    assert figures["again_team"] == 1.0
    assert figures["again_team_chance"] == 0.5


def test_people_of_a_scene_with_the_same_clothes_are_a_team() -> None:
    assert team_in_scene(1) == team_in_scene(10) != team_in_scene(11)
    assert len({team_in_scene(person) for person in (10, 20, 21, 22, 23)}) == 5
    assert team_in_scene(23) == team_in_scene(25)


def test_more_scenes_than_are_held_out_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--on", "validation", "--scenes", "30"])

    assert "--scenes: expected 1 to 20 with --on validation, got 30" in capsys.readouterr().err
