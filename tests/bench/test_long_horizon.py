"""Long plans on recorded clips: rules, and the figures that stand beside the network's."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from bench.long_horizon import RULES, followed, main, row
from operators.policy.rollout import Task
from tests.operators.policy.test_rollout import recording

BALL = Task(clip=0, start=2, target=101, replan=12, delay=4)


def test_a_moving_target_leaves_a_window_that_holds_and_not_one_that_foresees(
    tmp_path: Path,
) -> None:
    clip = recording(tmp_path)

    shown = {name: followed(clip, BALL, 36, rule) for name, rule in RULES.items()}

    assert set(shown["oracle"]) == {1.0}
    assert min(shown["pursuit"]) == 1.0
    assert min(shown["hold"]) < 1.0
    assert len({len(shares) for shares in shown.values()}) == 1


def test_the_shares_begin_with_the_first_plan_that_had_time_to_arrive(tmp_path: Path) -> None:
    clip = recording(tmp_path)

    shown = followed(clip, BALL, 20, RULES["oracle"])

    assert len(shown) == 20 - BALL.delay - 1


def test_a_row_has_the_mean_of_each_class_and_of_all_episodes() -> None:
    shares, base = [[1.0, 0.5], [0.25], []], [[0.5], [0.5], [0.5]]

    found = row("hold", ["ball", "player", "ball"], shares, 1, base)

    assert (found["ball"], found["player"], found["all"]) == (0.75, 0.25, 0.5)
    assert found["above pursuit"] == 0
    assert found["episodes"] == 2


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--data", "{folder}"], "expected clips from 40000 on, got none"),
        (["--data", "{folder}/none"], "does not exist"),
    ],
)
def test_a_folder_without_clips_is_refused(tmp_path: Path, words: list[str], sentence: str) -> None:
    result = CliRunner().invoke(main, [word.format(folder=tmp_path) for word in words])

    assert result.exit_code
    assert sentence in result.output.replace("\n", "")
