"""The name or file of a task leads to its command; any other is refused in one sentence."""

import sys
from pathlib import Path

import click
import pytest

from pipeline.cli.tasks import command_of, find, task_command
from pipeline.errors import GraphError, InstallError


def written(folder: Path, text: str) -> str:
    path = folder / "task.yaml"
    path.write_text(text)
    return str(path)


def test_a_shipped_task_is_found_by_name_and_has_both_commands() -> None:
    assert find("tracking").name == "tracking.yaml"
    assert isinstance(command_of("tracking", "eval"), click.Command)
    assert isinstance(command_of("tracking", "train"), click.Command)


def test_a_missing_extra_of_a_task_is_named_with_its_install_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "needs_torch.py").write_text("import torch\n")

    with pytest.raises(InstallError) as refused:
        command_of(written(tmp_path, "train: needs_torch:command\n"), "train")

    assert "expected the package torch, got none: pip install 'fovea[train]'" in str(refused.value)


def test_a_task_of_ones_own_is_named_by_its_path(tmp_path: Path) -> None:
    path = written(tmp_path, "eval: bench.tracking.evaluate:command\n")

    assert command_of(path, "eval") is command_of("tracking", "eval")


def test_a_name_that_is_no_task_gets_a_suggestion() -> None:
    with pytest.raises(GraphError, match=r"no task trakcing.*did you mean 'tracking'"):
        command_of("trakcing", "eval")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("eval: bench.tracking.evaluate:command\n", r"expected train: module:command, got eval"),
        ("train: bench.tracking.evaluate:ALL\n", r"train: expected a click command"),
        ("train: bench.tracking.nothing:command\n", r"task\.yaml: train: .*bench\.tracking"),
    ],
)
def test_a_task_file_that_leads_nowhere_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(GraphError, match=said):
        command_of(written(tmp_path, text), "train")


def test_words_after_the_task_are_handed_on(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        task_command("eval", "score").main(
            ["tracking", "--data", "procedural", "--targets", "coach"], standalone_mode=False
        )

    assert ended.value.code == 2
    assert "targets: expected ball, referee, player, got coach" in capsys.readouterr().err


def test_without_a_task_the_known_ones_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    task_command("eval", "score").main([], standalone_mode=False)

    assert "tasks: acting, manipulation, shirts, text, tracking" in capsys.readouterr().out


def test_a_task_without_a_training_is_neither_listed_for_it_nor_trained(
    capsys: pytest.CaptureFixture[str],
) -> None:
    task_command("train", "learn").main([], standalone_mode=False)

    assert "shirts" not in capsys.readouterr().out
    with pytest.raises(GraphError) as refused:
        command_of("shirts", "train")
    assert str(refused.value) == "fovea train shirts: no such command, there is fovea eval shirts"


@pytest.mark.parametrize("word", ["-h", "--help"])
def test_a_task_shows_its_options(word: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        task_command("eval", "score").main(["tracking", word], standalone_mode=False)

    assert "--strategies" in capsys.readouterr().out
